"""What each texel sees: cosine rays, and the surfel nearest to each hit.

Surfels are pieces of the charts, so the nearest one on the hit's own side is read from the atlas: a fine cell names it.
Rays that leave the scene meet a cell of the sky; those that meet the inside of things meet the void, which is black.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.kernels.sampling import cosine_hemisphere, hash_pair, sequence_2d, to_world
from luxel.kernels.trace import Hit, offset_origin, trace_closest
from luxel.kernels.triangle import face_vector, fetch_triangle
from luxel.methods.lightmap.atlas import FINE
from luxel.methods.lightmap.faces import NONE
from luxel.methods.lightmap.openness import BURIED
from luxel.methods.lightmap.sky import cell_of_direction
from luxel.methods.lightmap.state import AtlasTables, locate
from luxel.scene.device import Scene

RAYS_AT_ONCE = 1 << 22
"""Rays in flight: bounds memory."""
BURIAL_RAYS = 16
"""Rays a point that tell whether it lies inside geometry."""


@dataclass
class Origins:
    """Where rays start: N points."""

    p: mi.Point3f
    n_geometric: mi.Normal3f
    n_shading: mi.Normal3f


@dataclass
class Leaves:
    """From a hit to a leaf of the tree."""

    of_cell: mi.UInt32
    """By fine cell of the atlas."""
    of_sky: mi.UInt32
    """By sky cell."""
    sky_resolution: int
    """0: rays that leave the scene meet the void."""
    void: int


def make_origins(p: np.ndarray, n_geometric: np.ndarray, n_shading: np.ndarray) -> Origins:
    """Return points (N, 3) with unit normals (N, 3) as origins."""
    arrays = [np.ascontiguousarray(array.T, np.float32) for array in (p, n_geometric, n_shading)]
    return Origins(mi.Point3f(arrays[0]), mi.Normal3f(arrays[1]), mi.Normal3f(arrays[2]))


def find_buried(still: Scene, tables: AtlasTables, origins: Origins, seed: int) -> np.ndarray:
    """Return which origins (N,) lie inside geometry: most of their rays meet the inside of things."""
    count = dr.width(origins.p)
    share = np.zeros(count, np.float32)
    for start in range(0, count, RAYS_AT_ONCE // BURIAL_RAYS):
        stop = min(count, start + RAYS_AT_ONCE // BURIAL_RAYS)
        lane = dr.arange(mi.UInt32, (stop - start) * BURIAL_RAYS)
        point = lane // BURIAL_RAYS + start
        _, inside, _ = _cast(still, tables, origins, point, point, lane % BURIAL_RAYS, seed)
        share[start:stop] = np.array(dr.block_sum(dr.select(inside, mi.Float(1.0), 0.0), BURIAL_RAYS)) / BURIAL_RAYS
    return share > BURIED


def cast_rows(
    still: Scene,
    tables: AtlasTables,
    leaves: Leaves,
    origins: Origins,
    starts: np.ndarray,
    points: np.ndarray,
    rows: tuple[int, int],
    rays: int,
    seed: int,
) -> np.ndarray:
    """Return the leaf that each ray of rows `rows[0]` .. `rows[1]` meets, (rows, `rays`) uint32.

    Row m casts from the origins points[starts[m]:starts[m + 1]] in turn; a row without origins meets the void.
    """  # fmt: skip
    lane = dr.arange(mi.UInt32, (rows[1] - rows[0]) * rays)
    row, ray = lane // rays + rows[0], lane % rays
    first = dr.gather(mi.UInt32, mi.UInt32(starts.astype(np.uint32)), row)
    last = dr.gather(mi.UInt32, mi.UInt32(starts.astype(np.uint32)), row + 1)
    active = last > first
    chosen = first + ray % dr.select(active, last - first, 1)
    held = mi.UInt32(points.astype(np.uint32) if len(points) else np.zeros(1, np.uint32))
    point = dr.gather(mi.UInt32, held, chosen, active)
    hit, inside, direction = _cast(still, tables, origins, point, row, ray, seed, active)
    leaf = mi.UInt32(leaves.void)
    uv, found = locate(tables, hit.prim_id, hit.back, hit.barycentric, hit.valid & ~inside)
    x, y = (mi.UInt32(dr.fmax(dr.floor((c + 0.5) * FINE), 0.0)) for c in (uv.x, uv.y))
    x, y = dr.minimum(x, tables.width * FINE - 1), dr.minimum(y, tables.height * FINE - 1)
    met = dr.gather(mi.UInt32, leaves.of_cell, y * (tables.width * FINE) + x, found)
    leaf = dr.select(found & (met != NONE), met, leaf)
    if leaves.sky_resolution:
        away = active & ~hit.valid & ~hit.under
        cell = cell_of_direction(direction, leaves.sky_resolution)
        leaf = dr.select(away, dr.gather(mi.UInt32, leaves.of_sky, cell, away), leaf)
    return np.array(leaf).reshape(-1, rays)


@dataclass
class _Met:
    """What a ray met."""

    prim_id: mi.UInt32
    barycentric: mi.Point2f
    valid: mi.Bool
    back: mi.Bool
    under: mi.Bool
    """It left below its own surface, so it was not cast."""


def _cast(
    still: Scene, tables: AtlasTables, origins: Origins, point: mi.UInt32, row: mi.UInt32, ray: mi.UInt32, seed: int,
    active: mi.Bool | bool = True,
) -> tuple[_Met, mi.Bool, mi.Vector3f]:  # fmt: skip
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
    return _Met(hit.prim_id, hit.barycentric, hit.valid, back, under), inside, direction


def is_back(still: Scene, hit: Hit, direction: mi.Vector3f) -> mi.Bool:
    """Return whether rays met their triangle from behind, by its winding."""
    return dr.dot(face_vector(fetch_triangle(still, hit.prim_id, hit.valid).positions), direction) > 0.0
