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
from luxel.methods.gibs.depth import visibility
from luxel.methods.gibs.normal_light import NormalLightSum, add_normal_light, light_for_normal
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
    bent: NormalLightSum
    """What the points' own normals change."""


@dr.syntax
def gather_irradiance(
    state: GibsState, p: mi.Point3f, n: mi.Normal3f, active: mi.Bool, n_light: mi.Normal3f | None = None,
    largest: mi.UInt32 | None = None,
) -> Gathered:  # fmt: skip
    """Return irradiance and coverage at world points `p` with unit geometric normals `n`.

    `n_light` are the normals that are lit, where surfels keep light for other normals than their own; None: `n`.
    `largest` is the size of the largest surfels that are small enough; None: all are.
    """
    n_light = n if n_light is None else n_light
    if dr.hint(state.lattice.levels == 1, mode="scalar"):
        only = read_level(state, None, p, n, n_light, active, largest)
        return conclude(state, only, n, n_light)
    levels = levels_at(state.lattice, state.grid, p, active)
    total = no_sums()
    going = active & (levels != 0)
    while going:
        level = finest_level(levels)
        found = read_level(state, level, p, n, n_light, going, largest)
        # Finer surfels have the first say; coarser ones answer as far as those do not cover the point.
        left = 1.0 - dr.fmin(total.confidence, 1.0)
        fills = left * dr.fmin(1.0 / dr.fmax(found.confidence, LEAST_WEIGHT), 1.0)
        total = add_level(total, found, dr.select(total.confidence > 0.0, fills, 1.0))
        levels = levels & ~(mi.UInt32(1) << level)
        # Whoever asks for the coverage by fine surfels needs no coarse ones either once those cover the point.
        going = going & (levels != 0) & (total.confidence < 1.0)
    return conclude(state, total, n, n_light)


@dr.syntax
def read_level(
    state: GibsState, level: mi.UInt32 | None, p: mi.Point3f, n: mi.Normal3f, n_light: mi.Normal3f, active: mi.Bool,
    largest: mi.UInt32 | None,
) -> Sums:  # fmt: skip
    """Return the sums over the surfels of one level; None where all have one."""
    rows = state.normal_light
    slot = slot_of_point(state.lattice, p, level)
    item = dr.gather(mi.UInt32, state.grid.starts, slot, active)
    end = dr.gather(mi.UInt32, state.grid.starts, slot + 1, active)
    total = mi.Color3f(0.0)
    confidence = mi.Float(0.0)
    coverage = mi.Float(0.0)
    fine = mi.Float(0.0)
    bent = NormalLightSum(mi.Color3f(0.0), mi.Float(0.0), mi.Float(0.0))
    going = active & (item < end)
    while going:
        surfel = dr.gather(mi.UInt32, state.grid.items, item, going)
        weight = surfel_weight(state, surfel, p, n, going, level)
        counts = going & (weight > 0.0)
        light = dr.gather(mi.Vector4f, state.light, surfel, counts)
        covering = mi.Float(weight)
        if dr.hint(state.depth is not None, mode="scalar"):
            # A branch, unlike a mask, leaves out the work where no lane asks.
            if counts & (light.w < 0.0):
                share, covered = visibility(state, surfel, p, n)
                weight *= share
                covering *= covered
            light = dr.abs(light)
        coverage += dr.select(counts, covering, 0.0)
        if dr.hint(largest is not None, mode="scalar"):
            small = dr.gather(mi.UInt32, state.surfels.size, surfel, counts) >= largest
            fine += dr.select(counts & small, covering, 0.0)
        weight = dr.select(counts, weight * light.w, 0.0)
        total += mi.Color3f(light.x, light.y, light.z) * weight
        confidence += weight
        if dr.hint(rows is not None, mode="scalar"):
            normal = surfel_normal(state, surfel, going)
            bent = add_normal_light(bent, rows, surfel, normal, n_light, weight, counts)
        item += 1
        going &= item < end
    return Sums(total, confidence, coverage, coverage if largest is None else fine, bent)


def no_sums() -> Sums:
    """Return sums over nothing."""
    bent = NormalLightSum(mi.Color3f(0.0), mi.Float(0.0), mi.Float(0.0))
    return Sums(mi.Color3f(0.0), mi.Float(0.0), mi.Float(0.0), mi.Float(0.0), bent)


def add_level(total: Sums, found: Sums, share: mi.Float) -> Sums:
    """Return the sums with those of a level added, of whose light only a share counts."""
    bent, more = total.bent, found.bent
    return Sums(
        total.light + found.light * share,
        total.confidence + found.confidence * share,
        total.coverage + found.coverage,
        total.fine + found.fine,
        NormalLightSum(
            bent.turned + more.turned * share, bent.cosine + more.cosine * share, bent.horizon + more.horizon * share
        ),
    )


def conclude(state: GibsState, sums: Sums, n: mi.Normal3f, n_light: mi.Normal3f) -> Gathered:
    """Return the mean that the sums stand for, under the normals `n_light`."""
    irradiance = sums.light / dr.fmax(sums.confidence, LEAST_WEIGHT)
    if state.normal_light is not None:
        # Beside a surface the normals are no numbers, and must not reach the means that `fill.py` takes over pixels.
        to_geometric = dr.dot(mi.Vector3f(n), mi.Vector3f(n_light))
        turned = light_for_normal(irradiance, sums.bent, sums.confidence, to_geometric)
        irradiance = dr.select(sums.confidence > 0.0, turned, irradiance)
    return Gathered(irradiance, sums.coverage, sums.confidence, sums.fine)


def surfel_normal(state: GibsState, surfel: mi.UInt32, active: mi.Bool) -> mi.Vector3f:
    """Return the normal of a surfel, one long within 2e-3."""
    return unpack_normal(dr.gather(mi.Vector4f, state.geometry, surfel, active).w)


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
