"""Points that rays start at, rays by the cosine from them, and which points lie inside geometry."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.kernels.sampling import cosine_hemisphere, hash_pair, sequence_2d, to_world
from luxel.kernels.trace import Hit, offset_origin, trace_closest
from luxel.kernels.triangle import face_vector, fetch_triangle
from luxel.methods.lightmap.flatten.openness import INSIDE_SHARE
from luxel.methods.lightmap.flatten.tables import AtlasTables, locate
from luxel.scene.arrays import vectors_from_numpy
from luxel.scene.device import Scene

RAYS_AT_ONCE = 1 << 22
"""Rays in flight: bounds memory."""
INSIDE_RAYS = 16
"""Rays a point that tell whether it lies inside geometry."""


@dataclass
class Origins:
    """Where rays start: N points."""

    p: mi.Point3f
    n_geometric: mi.Normal3f
    n_shading: mi.Normal3f


def make_origins(p: np.ndarray, n_geometric: np.ndarray, n_shading: np.ndarray) -> Origins:
    """Return points (N, 3) with unit normals (N, 3) as origins."""
    normals = (vectors_from_numpy(mi.Normal3f, normal) for normal in (n_geometric, n_shading))
    return Origins(vectors_from_numpy(mi.Point3f, p), *normals)


def find_inside_geometry(still: Scene, tables: AtlasTables, origins: Origins, seed: int) -> np.ndarray:
    """Return which origins (N,) lie inside geometry: most of their rays meet the inside of things."""
    count = dr.width(origins.p)
    share = np.zeros(count, np.float32)
    for start in range(0, count, RAYS_AT_ONCE // INSIDE_RAYS):
        stop = min(count, start + RAYS_AT_ONCE // INSIDE_RAYS)
        lane = dr.arange(mi.UInt32, (stop - start) * INSIDE_RAYS)
        point = lane // INSIDE_RAYS + start
        _, inside, _ = cast_cosine_rays(still, tables, origins, point, point, lane % INSIDE_RAYS, seed)
        share[start:stop] = np.array(dr.block_sum(dr.select(inside, mi.Float(1.0), 0.0), INSIDE_RAYS)) / INSIDE_RAYS
    return share > INSIDE_SHARE


@dataclass
class CosineHit:
    """What a ray by the cosine met."""

    prim_id: mi.UInt32
    barycentric: mi.Point2f
    valid: mi.Bool
    back: mi.Bool
    under: mi.Bool
    """It left below its own surface, so it was not cast."""


def cast_cosine_rays(
    still: Scene, tables: AtlasTables, origins: Origins, point: mi.UInt32, row: mi.UInt32, ray: mi.UInt32, seed: int,
    active: mi.Bool | bool = True,
) -> tuple[CosineHit, mi.Bool, mi.Vector3f]:  # fmt: skip
    """Cast ray number `ray` of row `row` from origin `point`; return what it met and whether that is inside things."""
    active = mi.Bool(active)
    p = dr.gather(mi.Point3f, origins.p, point, active)
    n_geometric = dr.gather(mi.Normal3f, origins.n_geometric, point, active)
    n_shading = dr.gather(mi.Normal3f, origins.n_shading, point, active)
    # Each row has its own shift of one well-spread sequence.
    shift = hash_pair(row, mi.UInt32((seed * 0x9E3779B1 + 11) & 0xFFFFFFFF))
    direction = to_world(n_shading, cosine_hemisphere(sequence_2d(ray, shift)))
    under = dr.dot(direction, n_geometric) <= 0.0
    hit = trace_closest(still, offset_origin(still, p, n_geometric), direction, active & ~under)
    back = is_back(still, hit, direction)
    _, placed = locate(tables, hit.prim_id, back, hit.barycentric, hit.valid & back)
    inside = hit.valid & back & ~placed
    return CosineHit(hit.prim_id, hit.barycentric, hit.valid, back, under), inside, direction


def is_back(still: Scene, hit: Hit, direction: mi.Vector3f) -> mi.Bool:
    """Return whether rays met their triangle from behind, by its winding."""
    return dr.dot(face_vector(fetch_triangle(still, hit.prim_id, hit.valid).positions), direction) > 0.0
