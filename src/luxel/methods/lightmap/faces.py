"""Which sides of which triangles carry light: still ones, their fronts, and backs that something sees.

A back counts where light can get to it: its material reflects on both sides, its surface is not the skin of a closed
solid, and rays from surfaces and cameras meet it. Other backs are the inside of things: what sees mostly those lies
inside geometry.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np
import scipy

from luxel.errors import LuxelError
from luxel.kernels.fibonacci import fibonacci_direction
from luxel.kernels.surface import reflects_back
from luxel.kernels.trace import trace_closest
from luxel.scene.device import Scene, upload

NONE = 0xFFFFFFFF
"""No face, no surfel, no leaf."""
WELD = 1e-6
"""Vertices nearer than this share of the scene's diagonal are one."""
VOTE_POINTS, VOTE_RAYS, ROUNDS = 8192, 16, 3
"""Points on either side and rays a point that look for backs, and rounds in which their openness settles."""
VOTE_HITS, SEEN_SHARE = 3, 0.02
"""Rays that must meet a part's back, and their share of those that meet its front, for it to count."""
OPEN = 0.65
"""Share of a point's rays that must find open space for it to lie there."""
BURIED = 0.5
"""Share of rays that meet the inside of things from which a point lies inside geometry."""


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
    rows = np.array(scene.geometry.triangles).reshape(-1, 4)[:count].astype(np.int64)
    vertices = np.array(scene.geometry.vertices).reshape(-1, 4)[:, :3].astype(np.float64)
    corners = vertices[rows[:, :3]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1)
    edge = np.abs(corners - corners[:, [1, 2, 0]]).max(axis=(1, 2))
    # A needle of no width has no place in a chart; nothing is lost, as it has no area either.
    usable = (length > 1e-5 * edge**2) & (length > 1e-12 * length.sum())
    if not usable.any():
        raise LuxelError(f"{scene.host.data.name}: all still triangles are without area, so nothing can be baked")
    normal = normal / np.maximum(length, 1e-300)[:, None]
    part, closed = find_parts(corners, WELD * float(np.linalg.norm(np.ptp(corners.reshape(-1, 3), axis=0))))
    prim = mi.UInt32(np.arange(count, dtype=np.uint32))
    open_back = np.array(reflects_back(scene, prim, mi.Bool(True))).astype(bool) & ~closed[part]
    seen = np.zeros(part.max() + 1, bool)
    if open_back.any():
        seen = _vote(still, corners, normal, 0.5 * length, open_back, part)
    vertex_normals = _vertex_normals(scene, rows, normal)
    uv2 = np.array(scene.geometry.uv2).reshape(-1, 2)[rows[:, :3]] if scene.features.uv2 else None
    chosen, back = [], []
    for side, wanted in ((False, usable), (True, usable & open_back & seen[part])):
        chosen.append(np.flatnonzero(wanted))
        back.append(np.full(len(chosen[-1]), side))
    prims, backs = np.concatenate(chosen), np.concatenate(back)
    sign = np.where(backs, -1.0, 1.0)
    return Faces(
        prim=prims, back=backs, unit=2 * (rows[prims, 3] >> 16) + backs, corners=corners[prims],
        normals=vertex_normals[prims] * sign[:, None, None], normal=normal[prims] * sign[:, None],
        area=0.5 * length[prims], part=part[prims], uv2=None if uv2 is None else uv2[prims],
    )  # fmt: skip


def find_parts(corners: np.ndarray, distance: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the connected part (T,) of each triangle (T, 3, 3), and which parts (P,) are closed skins.

    Vertices closer than `distance` are one. A skin is closed where every edge is used as often one way as the other.
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
    held = np.array(scene.geometry.normals).reshape(-1, 4)[:, :3].astype(np.float64)[rows[:, :3]]
    length = np.linalg.norm(held, axis=2, keepdims=True)
    held = np.where(length > 1e-6, held / np.maximum(length, 1e-6), normal[:, None])
    return np.where((held * normal[:, None]).sum(axis=2, keepdims=True) < 0.0, -held, held)


def _vote(
    still: Scene, corners: np.ndarray, normal: np.ndarray, area: np.ndarray, open_back: np.ndarray, part: np.ndarray
) -> np.ndarray:
    """Return which parts (P,) carry light on their backs: those lie in the open, and surfaces or cameras see them.

    Points on backs lie in the open where most of their rays leave the scene, meet fronts, or backs that lie in the
    open: settled in a few rounds. So the two sides of a cloth do, and the inside of a column without lids does not.
    """
    random = np.random.default_rng(7)
    epsilon = float(np.array(still.epsilon)[0])
    front = _sample(corners, normal, area, epsilon, random)
    behind = _sample(corners, -normal, area * open_back, epsilon, random)
    front_hits, back_hits = (_cast(still, points, normal, random) for points in (front, behind))
    tree = scipy.spatial.KDTree(behind.p)
    nearest = []
    for hits in (front_hits, back_hits):
        met = hits.back & (hits.prim >= 0) & open_back[hits.prim]
        index = np.full(hits.prim.shape, -1)
        index[met] = tree.query(hits.p[met])[1]
        nearest.append(index)
    fair = back_hits.prim < 0
    fair |= ~back_hits.back
    is_open = np.zeros(len(behind.p), bool)
    for _ in range(ROUNDS):
        is_open = (fair | ((nearest[1] >= 0) & is_open[nearest[1]])).mean(axis=1) >= OPEN
    lit = (~front_hits.back | (front_hits.prim < 0) | ((nearest[0] >= 0) & is_open[nearest[0]])).mean(axis=1) >= OPEN
    # Count what open fronts, and cameras, see of each part: its fronts and its backs.
    prims, backs = front_hits.prim[lit], front_hits.back[lit]
    eyes = np.array([camera.eye for camera in (*still.host.data.cameras, *still.host.data.flight)], np.float64)
    if len(eyes):
        around = np.repeat(eyes.reshape(-1, 3), 64, axis=0)
        seen = _cast(still, _Sample(np.zeros(len(around), np.int64), around, np.zeros_like(around)), normal, random)
        prims, backs = np.concatenate([prims, seen.prim]), np.concatenate([backs, seen.back])
    count = int(part.max()) + 1
    of_back, of_front = (
        np.bincount(part[prims[(prims >= 0) & (backs == side)]], minlength=count) for side in (True, False)
    )
    held = np.bincount(part[behind.prim], minlength=count)
    openness = np.bincount(part[behind.prim], weights=is_open, minlength=count) / np.maximum(held, 1)
    # A part too small for a point of its own goes by what is seen of it.
    return ((openness >= BURIED) | (held == 0)) & (of_back >= VOTE_HITS) & (of_back > SEEN_SHARE * of_front)


@dataclass
class _Sample:
    """Points spread over triangles by area, and the directions they face (zero: all around)."""

    prim: np.ndarray
    p: np.ndarray
    n: np.ndarray


@dataclass
class _Hits:
    """What `VOTE_RAYS` rays from each point met: triangle (-1: none), whether its back, and where."""

    prim: np.ndarray
    back: np.ndarray
    p: np.ndarray


def _sample(
    corners: np.ndarray, normal: np.ndarray, area: np.ndarray, epsilon: float, random: np.random.Generator
) -> _Sample:
    prim = random.choice(len(area), VOTE_POINTS, p=area / area.sum())
    u, v = np.sqrt(random.random(VOTE_POINTS)), random.random(VOTE_POINTS)
    weights = np.stack([1.0 - u, u * (1.0 - v), u * v], axis=1)
    p = (corners[prim] * weights[..., None]).sum(axis=1) + normal[prim] * epsilon
    return _Sample(prim, p, normal[prim])


def _cast(still: Scene, sample: _Sample, normal: np.ndarray, random: np.random.Generator) -> _Hits:
    """Cast each point's rays by the cosine about its normal, or all around."""
    count = len(sample.p)
    lane = dr.arange(mi.UInt32, count * VOTE_RAYS)
    point = lane // VOTE_RAYS
    origin = dr.gather(mi.Point3f, mi.Point3f(np.ascontiguousarray(sample.p.T, np.float32)), point)
    about = dr.gather(mi.Vector3f, mi.Vector3f(np.ascontiguousarray(sample.n.T, np.float32)), point)
    turn = random.integers(0, 4096, count).astype(np.uint32)
    step = (lane % VOTE_RAYS) * 4096 + dr.gather(mi.UInt32, mi.UInt32(turn), point)
    # A point of the sphere added to the normal follows the cosine.
    direction = dr.normalize(fibonacci_direction(step, mi.UInt32(VOTE_RAYS * 4096)) + 0.999 * about)
    hit = trace_closest(still, origin, direction, mi.Bool(True))
    where = np.array(origin + direction * dr.select(hit.valid, hit.t, 0.0)).T
    prim = np.where(np.array(hit.valid), np.array(hit.prim_id).astype(np.int64), -1)
    back = (normal[np.maximum(prim, 0)] * np.array(direction).T).sum(axis=1) > 0.0
    shape = (count, VOTE_RAYS)
    return _Hits(prim.reshape(shape), (back & (prim >= 0)).reshape(shape), where.reshape(*shape, 3))
