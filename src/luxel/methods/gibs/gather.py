"""Light from the surfels around a point (Ekberg 2022, section 4.4).

The weighted average of the irradiance of all surfels in the point's cell; those of another cell in the same slot are
too far away to have a weight. Where surfels have sizes, each level of the grid is read in turn, the finest first, until
the point is covered: coarser surfels fill what finer ones leave.

A surfel counts as farther when the point is off its plane, its weight falls smoothly to zero at the radius (both
Lehtinen et al. 2008), and it has the less weight the more its normal differs. The sum of the weights is the coverage,
which tells where surfels are missing.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from luxel.kernels.grid import finest_level, levels_at, slot_of_point
from luxel.kernels.packing import unpack_flag, unpack_normal
from luxel.methods.gibs.sizes import in_radii
from luxel.methods.gibs.surfels import GibsState

LEAST_WEIGHT = 1e-20
"""What weighs less says nothing: the mean would be a quotient of numbers so small that threads round them otherwise."""


@dataclass
class Gathered:
    """What the surfels around a point answer."""

    irradiance: mi.Color3f
    coverage: mi.Float
    """Sum of the weights; 0 where no surfel answers."""
    confidence: mi.Float
    """The same, each by what its surfel knows: newborn surfels count little, those without a sample nothing. Of surfels
    on a coarser level no more counts than finer ones leave to 1."""
    fine: mi.Float
    """The coverage by surfels that are small enough for whoever asks."""


@dataclass
class Sums:
    """What the surfels of one level around a point add up to."""

    light: mi.Color3f
    """Irradiance times weight times confidence."""
    confidence: mi.Float
    coverage: mi.Float
    fine: mi.Float


@dr.syntax
def gather_irradiance(
    state: GibsState, p: mi.Point3f, n: mi.Normal3f, active: mi.Bool, largest: mi.UInt32 | None = None
) -> Gathered:
    """Return irradiance and coverage at world points `p` with unit geometric normals `n`.

    `largest` is the size of the largest surfels that are small enough; None: all are.
    """
    if dr.hint(state.lattice.levels == 1, mode="scalar"):
        only = read_level(state, None, p, n, active, largest)
        light = only.light / dr.fmax(only.confidence, LEAST_WEIGHT)
        return Gathered(light, only.coverage, only.confidence, only.fine)
    levels = levels_at(state.lattice, state.grid, p, active)
    total = mi.Color3f(0.0)
    confidence, coverage, fine = mi.Float(0.0), mi.Float(0.0), mi.Float(0.0)
    going = active & (levels != 0)
    while going:
        level = finest_level(levels)
        found = read_level(state, level, p, n, going, largest)
        # Finer surfels have the first say; coarser ones answer as far as those do not cover the point.
        left = 1.0 - dr.fmin(confidence, 1.0)
        share = dr.select(confidence > 0.0, left * dr.fmin(1.0 / dr.fmax(found.confidence, LEAST_WEIGHT), 1.0), 1.0)
        total += found.light * share
        confidence += found.confidence * share
        coverage += found.coverage
        fine += found.fine
        levels = levels & ~(mi.UInt32(1) << level)
        # Whoever asks for the coverage by fine surfels needs no coarse ones either once those cover the point.
        going = going & (levels != 0) & (confidence < 1.0)
    return Gathered(total / dr.fmax(confidence, LEAST_WEIGHT), coverage, confidence, fine)


@dr.syntax
def read_level(
    state: GibsState, level: mi.UInt32 | None, p: mi.Point3f, n: mi.Normal3f, active: mi.Bool, largest: mi.UInt32 | None
) -> Sums:
    """Return the sums over the surfels of one level; None where all have one."""
    slot = slot_of_point(state.lattice, p, level)
    item = dr.gather(mi.UInt32, state.grid.starts, slot, active)
    end = dr.gather(mi.UInt32, state.grid.starts, slot + 1, active)
    total = mi.Color3f(0.0)
    confidence = mi.Float(0.0)
    coverage = mi.Float(0.0)
    fine = mi.Float(0.0)
    going = active & (item < end)
    while going:
        surfel = dr.gather(mi.UInt32, state.grid.items, item, going)
        weight = surfel_weight(state, surfel, p, n, going, level)
        counts = going & (weight > 0.0)
        light = dr.gather(mi.Vector4f, state.light, surfel, counts)
        coverage += dr.select(counts, weight, 0.0)
        if dr.hint(largest is not None, mode="scalar"):
            small = dr.gather(mi.UInt32, state.surfels.size, surfel, counts) >= largest
            fine += dr.select(counts & small, weight, 0.0)
        weight = dr.select(counts, weight * light.w, 0.0)
        total += mi.Color3f(light.x, light.y, light.z) * weight
        confidence += weight
        item += 1
        going &= item < end
    return Sums(total, confidence, coverage, coverage if largest is None else fine)


def surfel_weight(
    state: GibsState, surfel: mi.UInt32, p: mi.Point3f, n: mi.Normal3f, active: mi.Bool, level: mi.UInt32 | None = None
) -> mi.Float:
    """Return the weight of a surfel at a point: smooth fall-off of the stretched distance times the normals' factor.

    `level`: weigh it as one of that level, and as nothing where it is of another one whose cell shares the slot; None:
    as what it is.
    """
    d2, normal = stretched_distance(state, surfel, p, active, level)
    falloff = dr.fma(d2, dr.fma(2.0, dr.sqrt(d2), -3.0), 1.0)
    agreement = dr.fmax(dr.dot(normal, mi.Vector3f(n)), 0.0)
    power = state.settings.normal_power
    while power > 1:
        agreement = dr.square(agreement)
        power //= 2
    weight = falloff * agreement
    counts = active & (d2 < 1.0) & (weight > LEAST_WEIGHT)
    if level is not None:
        counts &= dr.gather(mi.UInt32, state.surfels.size, surfel, counts) >> 1 == level
    return dr.select(counts, weight, 0.0)


def stretched_distance(
    state: GibsState, surfel: mi.UInt32, p: mi.Point3f, active: mi.Bool, level: mi.UInt32 | None = None
) -> tuple[mi.Float, mi.Vector3f]:
    """Return the squared distance of a point to a surfel, in radii, and the surfel's normal.

    The direction of the normal is stretched (Mahalanobis distance), so points off the plane are farther away.
    """
    row = dr.gather(mi.Vector4f, state.geometry, surfel, active)
    normal = mi.Vector3f(unpack_normal(row.w))
    offset = p - mi.Point3f(row.x, row.y, row.z)
    squared = dr.squared_norm(offset) + state.dials.plane_stretch * dr.square(dr.dot(offset, normal))
    size = None
    if state.lattice.levels > 1:
        # The row holds the half of the level; which level, whoever reads a list knows.
        size = dr.gather(mi.UInt32, state.surfels.size, surfel, active) if level is None else 2 * level
        size = size if level is None else size + unpack_flag(row.w)
    return in_radii(state, squared, size), normal
