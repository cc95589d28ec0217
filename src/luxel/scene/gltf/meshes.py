"""glTF mesh primitives to `Mesh`: attributes, index buffers, strips and fans, morph targets, joint influences."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from luxel.scene.gltf.accessors import AccessorReader
from luxel.scene.gltf.compressed import ADVICE, DRACO, decode_draco, find_decoder
from luxel.scene.gltf.document import Document
from luxel.scene.gltf.materials import MaterialTable
from luxel.scene.gltf.schema import GltfPrimitive
from luxel.scene.gltf.textures import LAST_UV_SET
from luxel.scene.model import Mesh

MODE_TRIANGLES, MODE_STRIP, MODE_FAN = 4, 5, 6
MODES_WITHOUT_AREA = (0, 1, 2, 3)
VECTOR2, VECTOR3, VECTOR4, COLOR = ("VEC2",), ("VEC3",), ("VEC4",), ("VEC3", "VEC4")
MORPH_ATTRIBUTES = frozenset({"POSITION", "NORMAL", "TANGENT"})
SHORTEST_NORMAL = 1e-12


@dataclass
class Primitive:
    """One primitive as the file stores it, before morphing and skinning."""

    mesh: Mesh
    morph_positions: np.ndarray
    """(T, V, 3) float32 offsets of each morph target; T may be 0."""
    morph_normals: np.ndarray
    """(T, V, 3) float32."""
    joints: np.ndarray | None = None
    """(V, K) int64 indices into the skin's joints."""
    weights: np.ndarray | None = None
    """(V, K) float32, each row summing to one."""


class MeshReader:
    """Reads the meshes of one document, each once."""

    def __init__(self, document: Document, reader: AccessorReader, materials: MaterialTable) -> None:
        self.document = document
        self.reader = reader
        self.materials = materials
        self._cache: dict[int, list[Primitive]] = {}

    def read(self, index: int) -> list[Primitive]:
        """The primitives of mesh `index` that have triangles.

        Raises `LuxelError` for indices out of range, positions that are not finite and attributes of unequal length.
        """
        if index not in self._cache:
            mesh = self.document.item(self.document.gltf.meshes, index, "mesh")
            found = [self._primitive(p, f"mesh {index}") for p in mesh.primitives]
            self._cache[index] = [primitive for primitive in found if primitive is not None]
        return self._cache[index]

    def _primitive(self, entry: GltfPrimitive, label: str) -> Primitive | None:
        mode = MODE_TRIANGLES if entry.mode is None else entry.mode
        if mode in MODES_WITHOUT_AREA:
            self.document.warn("Points and lines are not supported and are skipped.")
            return None
        if mode not in (MODE_TRIANGLES, MODE_STRIP, MODE_FAN):
            self.document.fail(f"a primitive of {label} has the unknown mode {mode}")
        attributes = entry.attributes
        if "POSITION" not in attributes:
            self.document.warn("A primitive without POSITION is skipped.")
            return None
        packed = self._unpack(entry, label)
        positions = self._positions(attributes["POSITION"], label)
        if packed is None:
            faces = self._faces(entry.indices, mode, len(positions), label)
        else:
            faces = self._checked(packed, len(positions), label).astype(np.uint32)
        if not len(faces):
            return None
        normals = self._attribute(attributes, "NORMAL", VECTOR3, len(positions), label)
        colors = self._attribute(attributes, "COLOR_0", COLOR, len(positions), label, unit=True)
        material = self.materials.index_of(entry.material)
        if colors is not None and self.materials.ignores_alpha(material):
            colors = np.ascontiguousarray(colors[:, :3])
        mesh = Mesh(
            positions=positions,
            faces=faces,
            material=material,
            normals=None if normals is None else self._repair_normals(positions, faces, normals),
            uv=self._uv(attributes, 0, material, len(positions), label),
            uv2=self._uv(attributes, 1, material, len(positions), label),
            uv2_set=self.materials.second_set(material),
            uv_more=self._unread_uv(attributes, material, len(positions), label),
            colors=None if colors is None else self._finite(colors, "COLOR_0"),
        )
        self._warn_of_unread(attributes, self.materials.second_set(material))
        joints, weights = self._influences(attributes, len(positions), label)
        return Primitive(mesh, *self._morphs(entry, mesh, label), joints, weights)

    def _unpack(self, entry: GltfPrimitive, label: str) -> np.ndarray | None:
        """Decode a Draco primitive: its attributes go to their accessors, its (F, 3) faces come back.

        None where it is not compressed, or its plain copy serves as the decoder is missing.
        """
        part = entry.extensions.get(DRACO)
        if part is None:
            return None
        stored = self.reader.has_data(entry.attributes["POSITION"])
        if find_decoder("DracoPy") is None:
            if not stored:
                self.document.fail(f"{label} is compressed with {DRACO}, whose decoder is missing; {ADVICE}")
            return None
        faces, values = decode_draco(self.document, self.reader.view_bytes(part.get("bufferView")), label)
        stated = (
            None
            if entry.indices is None
            else self.document.item(self.document.gltf.accessors, entry.indices, "accessor")
        )
        if stated is not None and entry.mode in (None, MODE_TRIANGLES) and stated.count != faces.size:
            self.document.fail(
                f"the Draco data of {label} has {faces.size} corners but the file declares {stated.count}"
            )
        for name, identity in part.get("attributes", {}).items():
            if identity not in values:
                self.document.fail(f"the Draco data of {label} has no attribute {identity}, which {name} asks for")
            if name in entry.attributes:
                self.reader.supply(entry.attributes[name], values[identity], f"{name} of {label}")
        return faces

    def _positions(self, index: int, label: str) -> np.ndarray:
        positions = self.reader.read_floats(index, VECTOR3)
        if not np.isfinite(positions).all():
            self.document.fail(f"a position of {label} is NaN or infinite")
        return positions

    def _checked(self, corners: np.ndarray, vertex_count: int, label: str) -> np.ndarray:
        if corners.size and int(corners.max()) >= vertex_count:
            self.document.fail(f"a face of {label} names vertex {corners.max()} but it has {vertex_count} vertices")
        return corners

    def _faces(self, indices: int | None, mode: int, vertex_count: int, label: str) -> np.ndarray:
        """(F, 3) uint32 triangles, checked against the vertex count."""
        if indices is None:
            corners = np.arange(vertex_count, dtype=np.int64)
        else:
            corners = self._checked(self.reader.read_integers(indices, ("SCALAR",)), vertex_count, label)
        if mode == MODE_TRIANGLES:
            if len(corners) % 3:
                self.document.warn("A triangle list whose length is no multiple of three loses its last corners.")
            return corners[: len(corners) // 3 * 3].reshape(-1, 3).astype(np.uint32)
        return (triangles_of_strip(corners) if mode == MODE_STRIP else triangles_of_fan(corners)).astype(np.uint32)

    def _attribute(
        self, attributes: dict[str, int], name: str, types: tuple[str, ...], count: int, label: str, unit: bool = False
    ) -> np.ndarray | None:
        if name not in attributes:
            return None
        values = self.reader.read_floats(attributes[name], types, unit=unit)
        if len(values) != count:
            self.document.fail(f"{name} of {label} has {len(values)} entries for {count} vertices")
        return values

    def _uv(self, attributes: dict[str, int], uv_set: int, material: int, count: int, label: str) -> np.ndarray | None:
        name = f"TEXCOORD_{self.materials.second_set(material) if uv_set else 0}"
        values = self._attribute(attributes, name, VECTOR2, count, label)
        if values is not None:
            return self._finite(values, name)
        if uv_set in self.materials.uv_sets(material):
            self.document.warn(f"A textured primitive has no {name}; its textures are read at (0, 0).")
            return np.zeros((count, 2), dtype=np.float32)
        return None

    def _unread_uv(self, attributes: dict[str, int], material: int, count: int, label: str) -> dict[int, np.ndarray]:
        """The texture coordinates that no texture of the material reads, by their numbers."""
        found, read = {}, {0, self.materials.second_set(material)}
        for name in sorted(attributes):
            family, _, number = name.partition("_")
            if family == "TEXCOORD" and number.isdecimal() and int(number) not in read:
                values = self._attribute(attributes, name, VECTOR2, count, label)
                if values is not None:
                    found[int(number)] = self._finite(values, name)
        return found

    def _finite(self, values: np.ndarray, name: str) -> np.ndarray:
        if np.isfinite(values).all():
            return values
        self.document.warn(f"{name} holds NaN or infinity, which is read as zero.")
        return np.nan_to_num(values, nan=0.0, posinf=0.0, neginf=0.0)

    def _repair_normals(self, positions: np.ndarray, faces: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Replace normals without a direction by those of the triangles around the vertex, weighted by area."""
        with np.errstate(invalid="ignore", over="ignore"):
            length = np.linalg.norm(normals, axis=1)
        broken = ~(np.isfinite(length) & (length > SHORTEST_NORMAL))
        if not broken.any():
            return normals
        self.document.warn("Normals of zero length or not finite are rebuilt from the triangles around them.")
        corner = positions[faces].astype(np.float64)
        area = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        total = np.zeros((len(positions), 3))
        for k in range(3):
            np.add.at(total, faces[:, k], area)
        length = np.linalg.norm(total, axis=1, keepdims=True)
        total = np.where(length > 0.0, total / np.where(length > 0.0, length, 1.0), (0.0, 1.0, 0.0))
        return np.where(broken[:, None], total, normals).astype(np.float32)

    def _warn_of_unread(self, attributes: dict[str, int], second_set: int) -> None:
        for name in sorted(set(attributes) - {f"TEXCOORD_{second_set}"}):
            family, _, number = name.rpartition("_")
            limit = {"TEXCOORD": LAST_UV_SET, "COLOR": 0}.get(family)
            if limit is not None and number.isdigit() and int(number) > limit:
                self.document.warn(f"The vertex attribute {name} is not supported and is ignored.")

    def _influences(
        self, attributes: dict[str, int], count: int, label: str
    ) -> tuple[np.ndarray | None, np.ndarray | None]:
        """Joint indices and weights of all sets JOINTS_n / WEIGHTS_n side by side: (V, 4 n) each."""
        joints, weights = [], []
        while f"JOINTS_{len(joints)}" in attributes:
            number = len(joints)
            joint = self.reader.read_integers(attributes[f"JOINTS_{number}"], VECTOR4)
            weight = self._attribute(attributes, f"WEIGHTS_{number}", VECTOR4, count, label, unit=True)
            if weight is None or len(joint) != count:
                self.document.fail(f"JOINTS_{number} and WEIGHTS_{number} of {label} do not match its vertices")
            joints.append(joint)
            weights.append(np.maximum(self._finite(weight, f"WEIGHTS_{number}"), 0.0))
        if not joints:
            return None, None
        joint, weight = np.concatenate(joints, axis=1), np.concatenate(weights, axis=1)
        # A vertex without any weight would collapse to the origin: it follows its first joint.
        weight[weight.sum(axis=1) == 0.0, 0] = 1.0
        # The joint of a weight of zero may be anything; joint 0 always exists.
        joint[weight == 0.0] = 0
        return joint, weight / weight.sum(axis=1, keepdims=True)

    def _morphs(self, entry: GltfPrimitive, mesh: Mesh, label: str) -> tuple[np.ndarray, np.ndarray]:
        count = len(mesh.positions)
        targets = entry.targets or []
        positions = np.zeros((len(targets), count, 3), dtype=np.float32)
        normals = np.zeros_like(positions)
        for i, target in enumerate(targets):
            for name in sorted(set(target) - MORPH_ATTRIBUTES):
                self.document.warn(f"Morph targets of {name} are not supported and are ignored.")
            for name, offsets in (("POSITION", positions), ("NORMAL", normals)):
                values = self._attribute(target, name, VECTOR3, count, f"morph target {i} of {label}")
                if values is not None:
                    offsets[i] = values
        if not np.isfinite(positions).all():
            self.document.fail(f"a morph target of {label} has a position that is NaN or infinite")
        return positions, np.nan_to_num(normals)


def triangles_of_strip(corners: np.ndarray) -> np.ndarray:
    """(N,) corners of a strip to (F, 3); every second triangle is turned, and joints of zero area are left out."""
    if len(corners) < 3:
        return np.zeros((0, 3), dtype=corners.dtype)
    faces = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
    faces[1::2] = faces[1::2][:, [0, 2, 1]]
    return _without_repeats(faces)


def triangles_of_fan(corners: np.ndarray) -> np.ndarray:
    """(N,) corners of a fan about the first to (F, 3), in glTF's order (1, 2, 0)."""
    if len(corners) < 3:
        return np.zeros((0, 3), dtype=corners.dtype)
    return _without_repeats(np.stack([corners[1:-1], corners[2:], np.full(len(corners) - 2, corners[0])], axis=1))


def _without_repeats(faces: np.ndarray) -> np.ndarray:
    a, b, c = faces.T
    return faces[(a != b) & (b != c) & (c != a)]
