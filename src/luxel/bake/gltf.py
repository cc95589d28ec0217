"""A bake as a .glb that any viewer shows: the file's own nodes, materials and coordinates, and the light on a free set.

What is shown is unlit: the light in one texture, on the first set of texture coordinates that no mesh of the file uses.
Vertices are split where the atlas cuts a chart, with all that they have, and triangles that lie in several charts. A
mesh that lacks one of the sets below repeats the light's, as the format wants sets without gaps.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pygltflib as gltf
from scipy.ndimage import distance_transform_edt

from luxel import __version__
from luxel.bake.core import Baked
from luxel.bake.gltf_materials import MaterialWriter
from luxel.bake.gltf_writer import Writer
from luxel.bake.layout import Layout
from luxel.bake.light import passes_light
from luxel.bake.sources import Source, find_sources
from luxel.files import write_bytes
from luxel.image.tonemap import to_display
from luxel.kernels.triangle import read_triangles
from luxel.render.exposure import Exposure, resolve_exposure
from luxel.scene.accel import place
from luxel.scene.local import translation
from luxel.scene.model import Mesh, SceneData
from luxel.scene.origin import far_centre
from luxel.scene.rounding import twin_gaps

BACK_GAP = 1e-4
"""How far backs stand off their fronts, as a share of the longest edge there: depth buffers tell them apart."""
COLORS = "_COLOR_0"
"""Vertex colours under a name that no viewer reads: they would colour the light once more."""


def sheet_of(layout: Layout, values: np.ndarray) -> np.ndarray:
    """Return texels (M, C) as an image (height, width, C) float32; the gutter repeats the nearest texel."""
    channels = values.shape[1]
    image = np.zeros((layout.height * layout.width, channels), np.float32)
    image[layout.slot] = values
    empty = np.ones(layout.height * layout.width, bool)
    empty[layout.slot] = False
    nearest = distance_transform_edt(
        empty.reshape(layout.height, layout.width), return_distances=False, return_indices=True
    )
    return image.reshape(layout.height, layout.width, channels)[tuple(nearest)]  # type: ignore[arg-type]


def shown(baked: Baked, light_only: bool) -> np.ndarray:
    """Return what the texture holds, (M, 3) linear: the surface's radiance, or what a white one would send."""
    return baked.light.irradiance / np.pi if light_only else baked.light.radiance


def light_set_of(data: SceneData) -> int:
    """Return the number of the texture coordinates that hold the light: the first after all that a mesh has, from 1."""
    return 1 + max((number for item in data.objects for mesh in item.meshes for number in _uv_sets(mesh)), default=0)


def write_glb(
    baked: Baked, path: str | Path, light_only: bool = False, exposure: Exposure | float | None = None
) -> float:
    """Write the bake to `path` (.glb), whole or not at all; return the exposure of its texture.

    Raises LuxelError where it cannot be written.
    """
    values = shown(baked, light_only)
    factor = resolve_exposure(exposure, values)
    picture = to_display(sheet_of(baked.layout, values), factor)
    if _find_cut(baked).any():
        picture = np.concatenate([picture, sheet_of(baked.layout, baked.light.opacity[:, None])], axis=2)
    writer, light_set = Writer(), light_set_of(baked.data)
    materials = MaterialWriter(writer, baked.data, picture, light_set, baked.materials)
    attached = _write_nodes(writer, baked.data)
    pieces: dict[int, list[gltf.Primitive]] = {}
    placements: dict[int, NodePlacement] = {}
    for source, places, corners, cut in _find_pieces(baked):
        placement = placements.setdefault(source.object, _find_placement(baked.data, source.object, attached))
        pieces.setdefault(source.object, []).extend(
            _write_mesh(writer, materials, baked, source, placement.world, light_set, places, corners, cut)
        )
    for number, primitives in pieces.items():
        _attach(writer, baked.data.objects[number].name, primitives, placements[number])
    holds = "light" if light_only else "light and albedo"
    extras = {"luxel": __version__, "holds": holds, "exposure": factor, "texCoord": light_set}
    write_bytes(path, writer.finish(extras))
    return factor


# ---------- Nodes ----------


def _write_nodes(writer: Writer, data: SceneData) -> dict[int, int]:
    """Write the file's node tree as it is; return the node that each object hangs on, where it has one."""
    for item in data.nodes:
        node = gltf.Node(name=item.name)
        for key, values in item.transform.items():
            setattr(node, key, values)
        writer.file.nodes.append(node)
    for number, item in enumerate(data.nodes):
        siblings = writer.file.scenes[0].nodes if item.parent is None else writer.file.nodes[item.parent].children
        assert siblings is not None
        siblings.append(number)
    return {number: item.node for number, item in enumerate(data.objects) if item.node is not None}


@dataclass(frozen=True)
class NodePlacement:
    """Where an object's vertices are written."""

    node: int | None
    """The node that it hangs on; None: a root of its own."""
    world: np.ndarray
    """(4, 4) float64 of that node; a root of its own has a translation only."""


def _find_placement(data: SceneData, number: int, attached: dict[int, int]) -> NodePlacement:
    """Return the object's node, or a root where single precision would round its vertices in that node's space."""
    item, node = data.objects[number], attached.get(number)
    world = np.eye(4) if node is None else data.nodes[node].world
    points = np.concatenate([mesh.positions for mesh in item.meshes]).astype(np.float64)
    if (
        np.allclose(item.to_world, world, rtol=1e-12, atol=1e-12)
        or not far_centre(place(points, np.linalg.inv(world) @ item.to_world)).any()
    ):
        return NodePlacement(node, world)
    return NodePlacement(None, translation(far_centre(place(points, item.to_world))))


def _attach(writer: Writer, name: str, primitives: list[gltf.Primitive], placement: NodePlacement) -> None:
    """Hang a mesh on its object's node, or on one of its own: below that where another has it, else at the root."""
    writer.file.meshes.append(gltf.Mesh(name=name, primitives=primitives))
    node = placement.node
    if node is None:
        offset = placement.world[:3, 3].tolist()
        node = writer.node(name, None, **({"translation": offset} if any(offset) else {}))
    elif writer.file.nodes[node].mesh is not None:
        node = writer.node(name, node)
    writer.file.nodes[node].mesh = len(writer.file.meshes) - 1


# ---------- Meshes ----------


def _find_cut(baked: Baked) -> np.ndarray:
    """Return which of the layout's faces (F,) may have holes; what is shown of glass lets light pass like one."""
    prim, cut = baked.layout.prim, np.zeros(len(baked.layout.prim), bool)
    for group in baked.scene.groups:
        if group.cutout:
            cut |= (prim >= group.prim_offset) & (prim < group.prim_offset + group.prim_count)
    if baked.scene.host.looks == "full":
        cut |= np.array([*map(passes_light, baked.data.materials)])[read_triangles(baked.scene).material[prim]]
    return cut


def _find_pieces(baked: Baked) -> Any:
    """Yield for each mesh that the atlas holds (source, its faces of the layout (n,), their corners (n, 3), holes)."""
    layout, cut = baked.layout, _find_cut(baked)
    held = np.flatnonzero(layout.chart >= 0)
    held = held[np.argsort(layout.prim[held], kind="stable")]
    prim = layout.prim[held]
    for source in find_sources(baked.data, baked.scene):
        low, high = np.searchsorted(prim, [source.first, source.first + len(source.corners)])
        faces = held[low:high]
        if len(faces):
            yield source, faces, source.corners[layout.prim[faces] - source.first], bool(cut[faces[0]])


def _write_mesh(
    writer: Writer, materials: MaterialWriter, baked: Baked, source: Source, world: np.ndarray, light_set: int,
    faces: np.ndarray, corners: np.ndarray, cut: bool,
) -> list[gltf.Primitive]:  # fmt: skip
    """Write one mesh in the space of its node, at `world`; return its primitive."""
    item = baked.data.objects[source.object]
    mesh = item.meshes[source.mesh]
    table = {**_shape(baked, mesh, item.to_world, world, faces, corners), **_coordinates(baked, mesh, faces, corners)}
    atlas = (baked.layout.uv[faces] + 0.5) / [baked.layout.width, baked.layout.height]
    for number in range(light_set + 1):
        table.setdefault(f"TEXCOORD_{number}", atlas)
    # A back is a triangle of its own that faces the other way; in a space that mirrors, all are turned once more.
    turned = baked.layout.back[faces] != (np.linalg.det(world[:3, :3]) < 0.0)
    turn = np.where(turned[:, None], [0, 2, 1], [0, 1, 2])[..., None]
    columns = [np.take_along_axis(values, turn, axis=1) for values in table.values()]
    rows = np.concatenate(columns, axis=2).reshape(3 * len(faces), -1).astype(np.float32)
    unique, index = np.unique(rows, axis=0, return_inverse=True)
    ends = np.cumsum([column.shape[2] for column in columns])
    parts = zip(table, np.split(unique, ends[:-1], axis=1), strict=True)
    places = {name: writer.array(part, bounds=name == "POSITION") for name, part in parts}
    return [
        gltf.Primitive(
            attributes=gltf.Attributes(**places),
            indices=writer.triangles(index.reshape(-1, 3)),
            material=materials.shown(mesh.material, cut),
            extensions=materials.variant(mesh.material),
        )
    ]


def _shape(
    baked: Baked, mesh: Mesh, to_world: np.ndarray, world: np.ndarray, faces: np.ndarray, corners: np.ndarray
) -> dict[str, np.ndarray]:
    """Return positions and normals (n, 3, 3) of corners in the space of the node at `world`."""
    positions = baked.layout.at_corners(faces, mesh.positions[corners].astype(np.float64))
    inverse = np.linalg.inv(world[:3, :3])
    if not np.allclose(to_world, world, rtol=1e-12, atol=1e-12):
        local = np.linalg.inv(world) @ to_world
        positions = positions @ local[:3, :3].T + local[:3, 3]
    # A back stands a hair off its front: some viewers draw both sides of both.
    near = translation(-baked.scene.host.origin) @ to_world
    gaps = twin_gaps(place(mesh.positions, near), mesh.faces, BACK_GAP)[corners, None]
    apart = np.where(baked.layout.back[faces, None, None], baked.layout.at_corners(faces, gaps), 0.0)
    positions += (apart * baked.normals[faces]) @ inverse.T
    normals = baked.normals[faces] @ world[:3, :3]
    normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-30)
    return {"POSITION": positions, "NORMAL": normals}


def _coordinates(baked: Baked, mesh: Mesh, faces: np.ndarray, corners: np.ndarray) -> dict[str, np.ndarray]:
    """Return what else the file's vertices have, (n, 3, C) at corners: texture coordinates and colours."""
    named = {f"TEXCOORD_{number}": values for number, values in _uv_sets(mesh).items()}
    if mesh.colors is not None:
        named[COLORS] = mesh.colors
    return {name: baked.layout.at_corners(faces, values[corners]) for name, values in named.items()}


def _uv_sets(mesh: Mesh) -> dict[int, np.ndarray]:
    """Return all texture coordinates of the mesh by the numbers that the file gives them."""
    held = {0: mesh.uv, mesh.uv2_set: mesh.uv2, **mesh.uv_more}
    return {number: values for number, values in held.items() if values is not None}
