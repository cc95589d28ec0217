"""From the uploaded scene back to what the file brought: of which mesh each triangle is, and of which vertices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from luxel.errors import LuxelError
from luxel.kernels.triangle import read_positions, read_triangles
from luxel.scene.device import Scene
from luxel.scene.local import localise
from luxel.scene.model import Mesh, Object, SceneData

NEAR = 1e-4
"""How far a corner may lie from its vertex, over the size of the mesh's coordinates: single precision."""


@dataclass
class Source:
    """One mesh of one object, and where its triangles stand in the scene."""

    object: int
    """Index into `SceneData.objects`."""
    mesh: int
    """Index into `Object.meshes`."""
    first: int
    """Its first triangle in the scene; the others follow."""
    corners: np.ndarray
    """(F, 3) vertices of the mesh, in the order of the scene's corners: counter-clockwise in the world."""


def find_sources(data: SceneData, scene: Scene) -> list[Source]:
    """Return the meshes with triangles of `data`, which `scene` was made of and where nothing moves, in its order."""
    host, found, data = scene.host, [], localise(data)
    triangles, places = read_triangles(scene), read_positions(scene)
    ends = np.append(host.part_starts[1:], len(triangles.material))
    open_meshes = [[i for i, mesh in enumerate(item.meshes) if len(mesh.faces)] for item in data.objects]
    for number, first, end in zip(host.part_objects.tolist(), host.part_starts.tolist(), ends.tolist(), strict=True):
        item = data.objects[number]
        corner = places[triangles.vertices[first]]
        for index in open_meshes[number]:
            mesh = item.meshes[index]
            if len(mesh.faces) != end - first or mesh.material != triangles.material[first]:
                continue
            corners = _match(item, mesh, corner)
            if corners is not None:
                open_meshes[number].remove(index)
                found.append(Source(number, index, first, corners))
                break
        else:
            raise LuxelError(f"object '{item.name}' has changed since it was uploaded; load the scene and bake it anew")
    return sorted(found, key=lambda source: (source.object, source.mesh))


def _match(item: Object, mesh: Mesh, corner: np.ndarray) -> np.ndarray | None:
    """Return the mesh's faces in the order in which its first triangle has `corner` (3, 3); None where it differs."""
    for faces in (mesh.faces, mesh.faces[:, ::-1]):
        placed = mesh.positions[faces[0]] @ item.to_world[:3, :3].T + item.to_world[:3, 3]
        if np.abs(placed - corner).max() <= NEAR * max(float(np.abs(corner).max()), 1e-6):
            return faces.astype(np.int64)
    return None
