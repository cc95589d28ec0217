"""Which sides of which triangles carry light: still ones, their fronts, and backs that something sees.

A back counts where light can get to it: its material reflects on both sides, and it lies in the open (`openness.py`).
Other backs are the inside of things: what sees mostly those lies inside geometry.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import mitsuba as mi
import numpy as np
import scipy

from luxel.errors import LuxelError
from luxel.kernels.surface import reflects_back
from luxel.kernels.triangle import read_normals, read_positions, read_triangles, read_uv2
from luxel.methods.lightmap.flatten.octaves import cut_triangles, weigh_parts
from luxel.methods.lightmap.flatten.openness import Shells, orient_shells
from luxel.scene.arrays import from_numpy
from luxel.scene.device import Scene, upload
from luxel.scene.triangles import Box

NONE = 0xFFFFFFFF
"""No face, no surfel, no leaf."""
WELD = 1e-6
"""Vertices nearer than this share of the diagonal of the scene's bounds are one."""


@dataclass
class Faces:
    """Sides of triangles. F faces; corners stand in the order of the triangle's own, for backs too."""

    prim: np.ndarray
    """(F,) triangle, counted over the whole scene."""
    back: np.ndarray
    """(F,) bool: this is the triangle's back."""
    unit: np.ndarray
    """(F,) what is unwrapped together: an object's fronts, or its backs."""
    corners: np.ndarray
    """(F, 3, 3) world positions."""
    normals: np.ndarray
    """(F, 3, 3) unit vertex normals on the face's side."""
    normal: np.ndarray
    """(F, 3) unit normal on the face's side."""
    area: np.ndarray
    """(F,) m^2."""
    part: np.ndarray
    """(F,) connected part of the surface."""
    uv2: np.ndarray | None
    """(F, 3, 2) the file's second texture coordinates, where it has them."""
    weld: float
    """Metres within which vertices are one."""
    whole: np.ndarray
    """(F, 3, 3) world positions of the corners of the triangle that the face is a part of: `corners`, if it is all."""
    inside: np.ndarray
    """(F, 3, 3) each corner by the weights of that triangle's corners; (0, 3, 3): all faces are whole triangles."""
    octave: np.ndarray
    """(F,) octave of distance of each part; -1: the face is a whole triangle."""


def still_scene(scene: Scene) -> Scene:
    """Return the scene without what moves: what the bake traces. Triangles keep their numbers.

    Raises LuxelError where everything moves.
    """
    if not scene.features.moving:
        return scene
    if not any(group.object_id == 0 for group in scene.groups):
        raise LuxelError(f"{scene.host.data.name}: everything moves, so there is no still surface to bake light for")
    if scene.one is None:
        groups = [group for group in scene.groups if group.object_id == 0]
        return replace(scene, groups=groups, features=replace(scene.features, moving=False, deforming=False))
    data = scene.host.data
    objects = [item for item in data.objects if item.motion is None and item.deform is None]
    return upload(replace(data, objects=objects, duration=0.0))


def find_faces(scene: Scene, still: Scene) -> Faces:
    """Return every side that can carry light. `still` is `still_scene(scene)`."""
    count = sum(group.prim_count for group in scene.groups if group.object_id == 0)
    triangles = read_triangles(scene)
    rows = triangles.vertices[:count]
    corners = read_positions(scene).astype(np.float64)[rows]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1)
    edge = np.abs(corners - corners[:, [1, 2, 0]]).max(axis=(1, 2))
    # A needle of no width has no place in a chart; nothing is lost, as it has no area either.
    usable = length > 1e-5 * edge**2
    if not usable.any():
        raise LuxelError(f"{scene.host.data.name}: all still triangles are without area, so nothing can be baked")
    normal = normal / np.maximum(length, 1e-300)[:, None]
    weld = WELD * float(np.linalg.norm(scene.host.upper - scene.host.lower))
    part, closed = find_parts(corners, weld)
    prim = from_numpy(mi.UInt32, np.arange(count))
    two_sided = np.array(reflects_back(scene, prim, mi.Bool(True))).astype(bool)
    parts = cut_triangles(corners, Box(scene.host.lower, scene.host.upper), usable)
    weight = weigh_parts(parts, corners)
    shells, turned, on_back = orient_shells(still, Shells(corners, normal, parts, weight, two_sided, part, closed))
    vertex_normals = _vertex_normals(scene, rows, shells.normal)
    uv2 = read_uv2(scene)[rows] if scene.features.uv2 else None
    fronts, backs = np.flatnonzero(usable), np.flatnonzero(usable & two_sided & on_back[part])
    prims, behind = np.concatenate([fronts, backs]), np.repeat([False, True], [len(fronts), len(backs)])
    sign = np.where(behind, -1.0, 1.0)
    return Faces(
        prim=prims, back=behind ^ turned[part[prims]], unit=2 * triangles.object_id[prims] + behind,
        corners=corners[prims],
        normals=vertex_normals[prims] * sign[:, None, None], normal=shells.normal[prims] * sign[:, None],
        area=0.5 * length[prims], part=part[prims], uv2=None if uv2 is None else uv2[prims], weld=weld,
        whole=corners[prims], inside=np.zeros((0, 3, 3)), octave=np.full(len(prims), -1),
    )  # fmt: skip


def find_parts(corners: np.ndarray, distance: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the connected part (T,) of each triangle (T, 3, 3), and which parts (P,) are closed surfaces.

    Vertices closer than `distance` are one. A part is closed where every edge is used as often one way as the other.
    """
    keys = np.round(corners.reshape(-1, 3) / max(distance, 1e-300)).astype(np.int64)
    _, ids = np.unique(keys, axis=0, return_inverse=True)
    ids = ids.reshape(-1, 3)
    count = int(ids.max()) + 1
    first, second = ids.ravel(), ids[:, [1, 2, 0]].ravel()
    graph = scipy.sparse.coo_array((np.ones(len(first)), (first, second)), shape=(count, count))
    _, of_vertex = scipy.sparse.csgraph.connected_components(graph, directed=False)
    part = of_vertex[ids[:, 0]]
    low, high = np.minimum(first, second), np.maximum(first, second)
    _, edge = np.unique(low * count + high, return_inverse=True)
    balance = np.bincount(edge, weights=np.where(first < second, 1.0, -1.0))
    uneven = np.bincount(of_vertex[first], weights=(balance[edge] != 0.0), minlength=of_vertex.max() + 1)
    return part, uneven == 0


def _vertex_normals(scene: Scene, rows: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Return unit vertex normals (T, 3, 3) on the front's side; the triangle's own where it has none."""
    held = read_normals(scene).astype(np.float64)[rows]
    length = np.linalg.norm(held, axis=2, keepdims=True)
    held = np.where(length > 1e-6, held / np.maximum(length, 1e-6), normal[:, None])
    return np.where((held * normal[:, None]).sum(axis=2, keepdims=True) < 0.0, -held, held)
