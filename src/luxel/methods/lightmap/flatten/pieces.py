"""Pieces: where another surface cuts through a chart, its two sides are lit apart.

A rafter that is sunk into a roof has one chart a side, half in the room and half in the sun. No surfel and no texel may
mix the two. Neighbouring points of a chart belong together where a short ray from the one to the other, just above the
surface, is free.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import scipy

from luxel.kernels.fibonacci import fibonacci_direction
from luxel.kernels.trace import trace_closest, trace_occluded
from luxel.methods.lightmap.flatten.atlas import SUBTEXELS, Atlas, Points
from luxel.methods.lightmap.flatten.origins import is_back
from luxel.methods.lightmap.flatten.tables import AtlasTables, locate
from luxel.scene.arrays import vectors_from_numpy
from luxel.scene.device import Scene

EYE_RAYS = 16384
"""Rays from each camera that find the pieces it can see."""
HEIGHT = 0.25
"""How far above the surface the short rays run, in steps between points: gentle hollows do not block them."""
FAR = 8.0
"""Spacings of points from which neighbours in the atlas are none on the surface, as across a slit in a chart."""


def find_pieces(still: Scene, atlas: Atlas, points: Points, normal: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Return the piece (N,) of each dense point, with geometric `normal` (N, 3); those not `valid` stand alone."""
    count = len(points.cell)
    pairs = []
    for step in (1, atlas.width * SUBTEXELS):
        other = np.minimum(np.searchsorted(points.cell, points.cell + step), count - 1)
        beside = (points.cell[other] == points.cell + step) & (points.chart[other] == points.chart)
        first = np.flatnonzero(beside & valid & valid[other])
        pairs.append(np.stack([first, other[first]]))
    first, second = np.concatenate(pairs, axis=1)
    if not len(first):
        return np.arange(count)
    apart = np.linalg.norm(points.p[first] - points.p[second], axis=1)
    spacing = float(np.median(apart))
    near = apart <= FAR * np.maximum(spacing, np.sqrt(points.area[first]))
    near |= points.face[first] == points.face[second]
    first, second = first[near], second[near]
    raised = (points.p + normal * HEIGHT * spacing).astype(np.float32)
    start = vectors_from_numpy(mi.Point3f, raised[first])
    way = vectors_from_numpy(mi.Vector3f, raised[second] - raised[first])
    distance = dr.norm(way)
    blocked = trace_occluded(still, start, way / dr.fmax(distance, 1e-12), distance, distance > 0.0)
    free = ~np.array(blocked).astype(bool)
    graph = scipy.sparse.coo_array((np.ones(free.sum()), (first[free], second[free])), shape=(count, count))
    return scipy.sparse.csgraph.connected_components(graph, directed=False)[1]


def find_seen(still: Scene, tables: AtlasTables, points: Points, piece: np.ndarray) -> np.ndarray:
    """Return which dense points (N,) belong to a piece that some camera of the scene, or of its flight, can see."""
    eyes = np.array([camera.eye for camera in (*still.host.local.cameras, *still.host.local.flight)], np.float32)
    if not len(eyes):
        return np.ones(len(piece), bool)
    lane = dr.arange(mi.UInt32, len(eyes) * EYE_RAYS)
    eye = dr.gather(mi.Point3f, vectors_from_numpy(mi.Point3f, eyes), lane // EYE_RAYS)
    direction = fibonacci_direction(lane % EYE_RAYS, mi.UInt32(EYE_RAYS))
    hit = trace_closest(still, eye, direction, mi.Bool(True))
    back = is_back(still, hit, direction)
    uv, found = locate(tables, hit.prim_id, back, hit.barycentric, hit.valid)
    x, y = (np.floor((np.array(c) + 0.5) * SUBTEXELS).astype(np.int64) for c in (uv.x, uv.y))
    cell = (y * tables.width * SUBTEXELS + x)[np.array(found).astype(bool)]
    place = np.minimum(np.searchsorted(points.cell, cell), len(points.cell) - 1)
    seen = np.zeros(int(piece.max()) + 1, bool)
    seen[piece[place[points.cell[place] == cell]]] = True
    return seen[piece]
