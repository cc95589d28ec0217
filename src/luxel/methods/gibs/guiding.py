"""Rays where the light comes from: maps of it that neighbouring surfels share (Ekberg 2022, section 3.1.3).

The document gives each surfel a map of its hemisphere. Learned from the few rays of one surfel such a map adds noise
(measured: docs/methods/gibs.md), so here all surfels of one size in a cell of `POOL_RADII` radii, whose normals lie
about one of 26 directions, share one. It is a map over the unit square from which directions are made, so whatever
spreads the rays otherwise goes on doing so, and the density of a direction is that of the spread times the map's.

Cells have no box around them: a hash says which map is whose. Two cells that share one learn from each other, which is
noise and no error: each ray counts by one over the density by which it was chosen, whatever a map says.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from luxel.kernels.direct import luminance
from luxel.kernels.grid import power_of_two
from luxel.kernels.sampling import mix
from luxel.kernels.square_maps import SquareMaps, learn_samples, refresh_maps
from luxel.methods.gibs.sizes import level_of_size
from luxel.methods.gibs.surfels import GibsState

POOL_RADII = 8.0
"""Width of the cells that share maps, in radii of the larger surfels of a level."""
DOUBT = 512.0
"""Rays from which a map must have learned for half of its full share of guided rays."""
SURFELS_A_MAP = 8
"""There is one map for so many surfels of the pool, or more."""
LEAST_SAMPLES = 4.0
"""Samples that a surfel must have for its rays to teach: they are told in units of its mean."""
STEEP = 0.41421356
"""Tangent of 22.5 degrees: where the nearest of 26 directions changes, next to an axis."""
FARTHEST = float(1 << 30)
"""Cell coordinates at most."""


@dataclass
class SharedMap:
    """Whose map rays follow, and the frame in which its square is folded to their hemisphere."""

    maps: SquareMaps
    index: mi.UInt32
    """Of the map."""
    s: mi.Vector3f
    t: mi.Vector3f
    n: mi.Vector3f


@dataclass
class GuidedCell:
    """Where on a map a ray went, for the map to learn from it."""

    index: mi.UInt32
    """Of the map."""
    cell: mi.UInt32
    gain: mi.Float
    """Its density over the one that it would have had without a map."""


def map_count(capacity: int) -> int:
    """Return how many maps a pool of surfels has: a power of two."""
    return 1 << max(6, (capacity // SURFELS_A_MAP - 1).bit_length())


def find_guide(state: GibsState, p: mi.Point3f, n: mi.Normal3f, size: mi.UInt32) -> SharedMap | None:
    """Return the guide of surfels at `p` with unit normals `n`; None where rays go by no maps.

    Neighbours with normals alike have frames alike, or a shared map would say another thing to each: the frame is that
    of the nearest of 26 directions, turned to `n` by the shortest way.
    """
    if state.guide is None:
        return None
    q = nearest_of_26(n)
    level = level_of_size(state, size)
    width = POOL_RADII * state.dials.radius
    in_cells = p / width if level is None else p * (power_of_two(level) / width)
    x, y, z = (mi.Int32(dr.clip(dr.floor(value), -FARTHEST, FARTHEST)) for value in in_cells)
    words = mi.UInt32(x) * 0xD1B54A33 + mi.UInt32(y) * 0xABC98389 + mi.UInt32(z) * 0x8CB92BA7
    facing = mi.UInt32(mi.Int32(9.0 * q.x + 3.0 * q.y + q.z) + 13)
    key = mix(words + (facing if level is None else facing + 27 * level) * 0x9E3779B1)
    s, t = turned_axes(q, n)
    return SharedMap(state.guide, key & (dr.width(state.guide.fresh) - 1), s, t, mi.Vector3f(n))


def nearest_of_26(n: mi.Normal3f) -> mi.Vector3f:
    """Return which of the 26 neighbours of a cube's middle lies along `n`, about: coordinates of -1, 0 and 1."""
    least = STEEP * dr.max(dr.abs(mi.Vector3f(n)))
    # Written so that zero has no sign.
    return mi.Vector3f(*(dr.select(c > least, 1.0, dr.select(c < -least, mi.Float(-1.0), 0.0)) for c in n))


def turned_axes(q: mi.Vector3f, n: mi.Normal3f) -> tuple[mi.Vector3f, mi.Vector3f]:
    """Return two axes at right angles to the unit normal `n`: those of `q`, turned to `n` by the shortest way."""
    q = dr.normalize(q)
    s, t = mi.coordinate_system(q)
    between = (q + mi.Vector3f(n)) * dr.rcp(1.0 + dr.dot(q, mi.Vector3f(n)))
    return s - between * dr.dot(s, mi.Vector3f(n)), t - between * dr.dot(t, mi.Vector3f(n))


def learn(
    state: GibsState, rays: GuidedCell | None, surfel: mi.UInt32, irradiance: mi.Color3f, active: mi.Bool
) -> SquareMaps | None:
    """Return the maps, taught by what rays of `surfel` brought: their share of its irradiance, weight applied."""
    if state.guide is None or rays is None:
        return None
    estimate = state.surfels.estimate
    mean = luminance(dr.gather(mi.Color3f, estimate.mean, surfel, active))
    teaches = active & (mean > 0.0) & (dr.gather(mi.Float, estimate.count, surfel, active) >= LEAST_SAMPLES)
    # The same light counts the same for dark and for bright surfels.
    brought = luminance(irradiance) / dr.fmax(mean, 1e-30)
    return learn_samples(state.guide, rays.index, rays.cell, dr.square(brought) * rays.gain, teaches)


def refresh(state: GibsState, maps: SquareMaps) -> SquareMaps:
    """Return the maps ready for the next frame; while the cache's light changes they forget half a frame."""
    return refresh_maps(maps, state.dials.guide_share, DOUBT, state.drift > 0.0)
