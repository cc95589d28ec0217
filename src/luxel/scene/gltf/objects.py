"""Nodes with a mesh to `Object`: posed, mirrored where their space is, and once for each instance.

Objects of one mesh share its arrays, and where nothing deforms them the `Mesh` itself.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from luxel.scene.gltf.accessors import AccessorReader
from luxel.scene.gltf.deform import MIRROR, Deformation, Skin, read_skin
from luxel.scene.gltf.document import Document
from luxel.scene.gltf.instancing import read_instances
from luxel.scene.gltf.materials import MaterialTable
from luxel.scene.gltf.meshes import MeshReader, Primitive
from luxel.scene.gltf.nodes import NodeMotion, NodeTree
from luxel.scene.gltf.schema import GltfNode
from luxel.scene.local import translation
from luxel.scene.model import Mesh, Object
from luxel.scene.origin import far_centre

Body = tuple[list[Mesh], Deformation | None]
"""Meshes at time 0, and what moves their vertices."""


class ObjectReader:
    """Makes the objects of one document."""

    def __init__(self, document: Document, reader: AccessorReader, materials: MaterialTable, tree: NodeTree) -> None:
        self.document = document
        self.reader = reader
        self.tree = tree
        self.meshes = MeshReader(document, reader, materials)
        self._still: dict[tuple[int, bool], list[Mesh]] = {}

    def objects_of(self, index: int, node: GltfNode) -> list[Object]:
        """The objects of node `index`, which has a mesh, at time 0: one, or one for each instance.

        Empty where the mesh has no triangles. A skin ignores its node's place, so that instances of a skinned mesh
        stand about the world's origin as the others stand about their node. Raises `LuxelError` for what is broken.
        """
        primitives = self.meshes.read(node.mesh)
        instances = read_instances(self.document, self.reader, index, node)
        if not primitives:
            return []
        skin = None if node.skin is None else read_skin(self.document, self.reader, node.skin)
        anchor = np.zeros(3) if skin is None else _find_anchor(primitives, skin, self.tree)
        base = np.eye(4) if skin else self.tree.world(index)
        places = base[None] if instances is None else base @ instances
        places = places @ translation(anchor)
        inners = np.eye(4)[None] if instances is None else instances
        mirrored = (np.linalg.det(places[:, :3, :3]) < 0.0).tolist()
        bodies = {flip: self._body(index, node, primitives, skin, flip, anchor) for flip in set(mirrored)}
        moving = bool(self.tree.moving[index]) and not skin
        mesh_name = self.document.gltf.meshes[node.mesh].name
        name = node.name or mesh_name or f"node-{index}"
        objects = []
        for place, inner, flip in zip(places, inners, mirrored, strict=True):
            meshes, deform = bodies[flip]
            mirror = MIRROR if flip else np.eye(4)
            motion = NodeMotion(self.tree, index, inner @ mirror) if moving else None
            objects.append(Object(name, meshes, place @ mirror, motion, deform))
        return objects

    def _body(
        self,
        index: int,
        node: GltfNode,
        primitives: list[Primitive],
        skin: Skin | None,
        mirrored: bool,
        anchor: np.ndarray,
    ) -> Body:
        """The meshes of a node, mirrored or not; those that nothing deforms are made once for all nodes."""
        stated = node.weights or self.document.gltf.meshes[node.mesh].weights
        tracked = (index, "weights") in self.tree.tracks
        weighed = stated or tracked or any(len(one.morph_positions) for one in primitives)
        if skin is None and not weighed:
            key = (node.mesh, mirrored)
            if key not in self._still:
                self._still[key] = [_mirror(p.mesh) if mirrored else p.mesh for p in primitives]
            return self._still[key], None
        deform = self._deformation(index, node, primitives, skin, mirrored)
        deform.anchor = anchor
        # A skin may turn the space inside out too.
        turned = skin is not None and bool(np.linalg.det(skin.matrices(self.tree, 0.0)[:, :3, :3]).sum() < 0.0)
        posed = []
        for primitive, (positions, normals) in zip(primitives, deform(0.0), strict=True):
            if not np.isfinite(positions).all():
                self.document.fail(f"the vertices of node {index} become NaN or infinite when it is posed")
            faces = primitive.mesh.faces
            faces = np.ascontiguousarray(faces[:, ::-1]) if mirrored != turned else faces
            posed.append(replace(primitive.mesh, positions=positions, normals=normals, faces=faces))
        return posed, deform if deform.moves else None

    def _deformation(
        self, index: int, node: GltfNode, primitives: list[Primitive], skin: Skin | None, mirrored: bool
    ) -> Deformation:
        """Checks joints and morph weights against the mesh; weights come from the track, the node, or the mesh."""
        document = self.document
        target_count = max(len(primitive.morph_positions) for primitive in primitives)
        track = self.tree.tracks.get((index, "weights"))
        if track is not None and track.values.shape[-1] != target_count:
            document.fail(f"the animated weights of node {index} do not match its {target_count} morph targets")
        mesh = document.item(document.gltf.meshes, node.mesh, "mesh")
        weights = node.weights or mesh.weights or [0.0] * target_count
        for primitive in primitives:
            if skin is None or primitive.joints is None:
                continue
            largest = int(primitive.joints.max())
            if largest >= len(skin.joints):
                document.fail(f"a vertex of node {index} names joint {largest} but its skin has {len(skin.joints)}")
        values = document.numbers(weights, target_count, f"weights of node {index}")
        return Deformation(primitives, self.tree, index, values, track, skin, mirrored)


def _find_anchor(primitives: list[Primitive], skin: Skin, tree: NodeTree) -> np.ndarray:
    """Where a skinned mesh stands at time 0, (3,), if that is far from (0, 0, 0) for its size; else zero."""
    matrices = skin.matrices(tree, 0.0)[:, :3]
    points = np.concatenate([primitive.mesh.positions for primitive in primitives]).astype(np.float64)
    corners = np.array([points.min(axis=0), points.max(axis=0)])
    return far_centre(np.concatenate([corners @ matrix[:, :3].T + matrix[:, 3] for matrix in matrices]))


def _mirror(mesh: Mesh) -> Mesh:
    """`mesh` mirrored in x; its triangles stay counter-clockwise from the front."""
    flip = np.array([-1.0, 1.0, 1.0], dtype=np.float32)
    normals = None if mesh.normals is None else mesh.normals * flip
    return replace(
        mesh, positions=mesh.positions * flip, normals=normals, faces=np.ascontiguousarray(mesh.faces[:, ::-1])
    )
