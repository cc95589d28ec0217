"""Skins and morph targets: vertices at any time (glTF 2.0, sections 3.7.2.2 and 3.7.3)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.sparse import csr_matrix

from luxel.scene.gltf.accessors import AccessorReader
from luxel.scene.gltf.animation import Track
from luxel.scene.gltf.document import Document
from luxel.scene.gltf.meshes import Primitive
from luxel.scene.gltf.nodes import NodeTree

# Mirrors object space in x. A node whose transform turns the space inside out is loaded with mirrored vertices and
# the mirror taken out of its matrix, so that triangles stay counter-clockwise from the front in every space.
MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])

Vertices = tuple[np.ndarray, np.ndarray | None]


@dataclass
class Skin:
    """Joints (node indices) and the (J, 4, 4) float64 matrices that take the bind pose to each joint's space."""

    joints: list[int]
    inverse_bind: np.ndarray

    def matrices(self, tree: NodeTree, time: float) -> np.ndarray:
        """(J, 4, 4) bind pose to world."""
        return tree.world_all(time)[self.joints] @ self.inverse_bind


@dataclass
class Deformation:
    """`Object.deform`: time to one ((V, 3) positions, (V, 3) normals or None) per primitive, float32.

    A skinned object answers in world space (glTF ignores the transform of its node) about its `anchor`, a morphed
    one in object space.
    The arrays may be shared with the rest pose: do not write into them.
    """

    primitives: list[Primitive]
    tree: NodeTree
    node: int
    weights: np.ndarray
    """(T,) weights of the morph targets where no track moves them."""
    track: Track | None
    skin: Skin | None
    mirrored: bool
    """True where the answer is mirrored in x, as the object's matrix has a mirror taken out of it."""
    anchor: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """(3,) what a skinned object's answers are measured from, before any mirror."""

    def __post_init__(self) -> None:
        joint_count = len(self.skin.joints) if self.skin else 0
        self._influence = [_influence_matrix(primitive, joint_count) for primitive in self.primitives]

    def __call__(self, time: float) -> list[Vertices]:
        weights = self.weights if self.track is None else self.track.sample(time)
        result: list[Vertices] = []
        for primitive, influence in zip(self.primitives, self._influence, strict=True):
            positions, normals = morph(primitive, weights)
            if self.skin is not None:
                if influence is None:
                    blended = self.tree.world(self.node, time)[None, :3]
                else:
                    joints = self.skin.matrices(self.tree, time)[:, :3].reshape(-1, 12)
                    blended = (influence @ joints).reshape(-1, 3, 4)
                positions, normals = transform_vertices(blended, positions, normals, self.anchor)
            if self.mirrored:
                flip = np.array([-1.0, 1.0, 1.0], dtype=np.float32)
                positions, normals = positions * flip, None if normals is None else normals * flip
            result.append((positions, normals))
        return result

    @property
    def moves(self) -> bool:
        """True where the answer depends on time."""
        if self.track is not None and any(len(p.morph_positions) for p in self.primitives):
            return True
        return self.skin is not None and bool(self.tree.moving[[*self.skin.joints, self.node]].any())


def morph(primitive: Primitive, weights: np.ndarray) -> Vertices:
    """Vertices of `primitive` with its morph targets added by `weights` (T,)."""
    positions, normals = primitive.mesh.positions, primitive.mesh.normals
    used = np.flatnonzero(weights[: len(primitive.morph_positions)])
    if not len(used):
        return positions, normals
    factor = weights[used].astype(np.float32)
    positions = positions + np.tensordot(factor, primitive.morph_positions[used], axes=1)
    if normals is not None:
        normals = unit_vectors(normals + np.tensordot(factor, primitive.morph_normals[used], axes=1))
    return positions, normals


def transform_vertices(
    matrices: np.ndarray, positions: np.ndarray, normals: np.ndarray | None, anchor: np.ndarray | None = None
) -> Vertices:
    """Vertices (V, 3) under their own (V, 3, 4) matrices (or one, (1, 3, 4)), measured from `anchor` (3,).

    Normals take the inverse transpose, which is the cofactor matrix over the determinant; only the determinant's
    sign matters, as they are made unit vectors.
    """
    linear = matrices[:, :, :3]
    moved = np.einsum("vij,vj->vi", np.broadcast_to(linear, (len(positions), 3, 3)), positions) + matrices[:, :, 3]
    moved = moved if anchor is None else moved - anchor
    if normals is None:
        return moved.astype(np.float32), None
    x, y, z = linear[:, :, 0], linear[:, :, 1], linear[:, :, 2]
    yz = np.cross(y, z)
    turned = yz * normals[:, 0:1] + np.cross(z, x) * normals[:, 1:2] + np.cross(x, y) * normals[:, 2:3]
    sign = np.where((x * yz).sum(axis=1, keepdims=True) < 0.0, -1.0, 1.0)
    return moved.astype(np.float32), unit_vectors(turned * sign)


def unit_vectors(vectors: np.ndarray) -> np.ndarray:
    """(V, 3) float32 of length one; vectors of zero length point up."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    up = np.array([0.0, 1.0, 0.0])
    return np.where(length > 0.0, vectors / np.where(length > 0.0, length, 1.0), up).astype(np.float32)


def read_skin(document: Document, reader: AccessorReader, index: int) -> Skin:
    """Skin `index`; raises `LuxelError` for joints out of range or too few inverse bind matrices."""
    entry = document.item(document.gltf.skins, index, "skin")
    joints = list(entry.joints)
    for joint in joints:
        document.item(document.gltf.nodes, joint, f"joint of skin {index}, node")
    if not joints:
        document.fail(f"skin {index} has no joints")
    if entry.inverseBindMatrices is None:
        return Skin(joints, np.tile(np.eye(4), (len(joints), 1, 1)))
    matrices = reader.read_floats(entry.inverseBindMatrices, ("MAT4",)).astype(np.float64)
    if len(matrices) < len(joints):
        document.fail(f"skin {index} has {len(joints)} joints but {len(matrices)} inverse bind matrices")
    if not np.isfinite(matrices).all():
        document.fail(f"the inverse bind matrices of skin {index} hold NaN or infinity")
    return Skin(joints, matrices[: len(joints)])


def _influence_matrix(primitive: Primitive, joint_count: int) -> csr_matrix | None:
    """Sparse (V, J) weights: one product blends all joint matrices, whatever the number of influences."""
    if joint_count == 0 or primitive.joints is None or primitive.weights is None:
        return None
    count, width = primitive.joints.shape
    rows = np.repeat(np.arange(count), width)
    entries = (primitive.weights.reshape(-1).astype(np.float64), (rows, primitive.joints.reshape(-1)))
    return csr_matrix(entries, shape=(count, joint_count))
