"""What each texel sees: cosine rays, and the surfel nearest to each hit.

Surfels are pieces of the charts, so the nearest one on the hit's own side is read from the atlas: a fine cell names it.
Rays that leave the scene meet a cell of the sky; those that meet the inside of things meet the void, which is black.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.methods.lightmap.bake.sky import cell_of_direction
from luxel.methods.lightmap.flatten.atlas import SUBTEXELS
from luxel.methods.lightmap.flatten.faces import NONE
from luxel.methods.lightmap.flatten.origins import Origins, cast_cosine_rays
from luxel.methods.lightmap.flatten.tables import AtlasTables, locate
from luxel.scene.arrays import from_numpy
from luxel.scene.device import Scene


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
    first = dr.gather(mi.UInt32, from_numpy(mi.UInt32, starts), row)
    last = dr.gather(mi.UInt32, from_numpy(mi.UInt32, starts), row + 1)
    active = last > first
    chosen = first + ray % dr.select(active, last - first, 1)
    held = from_numpy(mi.UInt32, points if len(points) else np.zeros(1))
    point = dr.gather(mi.UInt32, held, chosen, active)
    hit, inside, direction = cast_cosine_rays(still, tables, origins, point, row, ray, seed, active)
    leaf = mi.UInt32(leaves.void)
    uv, found = locate(tables, hit.prim_id, hit.back, hit.barycentric, hit.valid & ~inside)
    x, y = (mi.UInt32(dr.fmax(dr.floor((c + 0.5) * SUBTEXELS), 0.0)) for c in (uv.x, uv.y))
    x, y = dr.minimum(x, tables.width * SUBTEXELS - 1), dr.minimum(y, tables.height * SUBTEXELS - 1)
    met = dr.gather(mi.UInt32, leaves.of_cell, y * (tables.width * SUBTEXELS) + x, found)
    leaf = dr.select(found & (met != NONE), met, leaf)
    if leaves.sky_resolution:
        away = active & ~hit.valid & ~hit.under
        cell = cell_of_direction(direction, leaves.sky_resolution)
        leaf = dr.select(away, dr.gather(mi.UInt32, leaves.of_sky, cell, away), leaf)
    return np.array(leaf).reshape(-1, rays)
