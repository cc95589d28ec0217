"""How large each surfel is: its size counts steps of a half level down from the largest, a factor of sqrt(2) each.

Two sizes make a level of the grid: cells are as wide as the radius of the larger one.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from luxel.kernels.grid import power_of_two
from luxel.methods.gibs.params import VIEW_SHARE
from luxel.methods.gibs.surfels import GibsState

LEVELS = 12
"""Levels of the grid where surfels have a size each: radii down to a 3,000th of the largest."""
SMALLEST = 2 * LEVELS - 1
"""The size of the smallest surfels."""


def level_of_size(state: GibsState, size: mi.UInt32) -> mi.UInt32 | None:
    """Return the grid level of surfels of a size; None where all have one."""
    return None if state.lattice.levels == 1 else size >> 1


def radius_of_size(state: GibsState, size: mi.UInt32) -> mi.Float:
    """Return the radius in metres of surfels of a size."""
    if state.lattice.levels == 1:
        return state.dials.radius
    # An odd size is sqrt(2) below the even one; whole levels are exact.
    return state.dials.radius * dr.select((size & 1) == 1, 0.5**0.5, 1.0) / power_of_two(size >> 1)


def even_radius(state: GibsState) -> mi.Float:
    """Return the radius in metres that surfels would have if all had one: a length of the scene, not of a view."""
    return state.dials.radius * (1.0 - VIEW_SHARE) ** 0.5 if state.settings.by_view else state.dials.radius


def in_radii(state: GibsState, squared: mi.Float, size: mi.UInt32 | None) -> mi.Float:
    """Return squares of metres in squares of the radius of surfels of a size; None for the largest."""
    whole = squared / dr.square(state.dials.radius)
    return whole if size is None else whole * power_of_two(size)


def size_for_radius(state: GibsState, radius: mi.Float) -> mi.UInt32:
    """Return the size whose radius is nearest to `radius` metres, by ratio."""
    steps = 2.0 * dr.log2(state.dials.radius / dr.fmax(radius, 1e-20))
    return mi.UInt32(dr.clip(dr.round(steps), 0.0, float(SMALLEST)))
