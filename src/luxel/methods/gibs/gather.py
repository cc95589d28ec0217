"""Light from the surfels around a point (Ekberg 2022, section 4.4).

The weighted average of the irradiance of all surfels in the point's cell; those of another cell in the same slot are
too far away to have a weight. A surfel counts as farther when the point is off its plane, its weight falls smoothly to
zero at the radius (both Lehtinen et al. 2008), and it has the less weight the more its normal differs. The sum of the
weights is the coverage, which tells where surfels are missing.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from luxel.kernels.grid import slot_of_point
from luxel.kernels.packing import unpack_normal
from luxel.methods.gibs.depth import visibility
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
    """The same, each by what its surfel knows: newborn surfels count little, those without a sample nothing."""


@dr.syntax
def gather_irradiance(state: GibsState, p: mi.Point3f, n: mi.Normal3f, active: mi.Bool) -> Gathered:
    """Return irradiance and coverage at world points `p` with unit geometric normals `n`."""
    slot = slot_of_point(state.lattice, p)
    item = dr.gather(mi.UInt32, state.grid.starts, slot, active)
    end = dr.gather(mi.UInt32, state.grid.starts, slot + 1, active)
    total = mi.Color3f(0.0)
    confidence = mi.Float(0.0)
    coverage = mi.Float(0.0)
    going = active & (item < end)
    while going:
        surfel = dr.gather(mi.UInt32, state.grid.items, item, going)
        weight = surfel_weight(state, surfel, p, n, going)
        # A branch leaves out the work where no lane asks: most surfels of a cell are out of reach.
        if going & (weight > 0.0):
            light = dr.gather(mi.Vector4f, state.light, surfel)
            knows, covered = dr.abs(light.w), mi.Float(weight)
            if dr.hint(state.depth is not None, mode="scalar"):
                if light.w < 0.0:
                    share, whole = visibility(state, surfel, p, n)
                    weight *= share
                    covered *= whole
            coverage += covered
            weight *= knows
            total += mi.Color3f(light.x, light.y, light.z) * weight
            confidence += weight
        item += 1
        going &= item < end
    return Gathered(total / dr.fmax(confidence, LEAST_WEIGHT), coverage, confidence)


def surfel_weight(state: GibsState, surfel: mi.UInt32, p: mi.Point3f, n: mi.Normal3f, active: mi.Bool) -> mi.Float:
    """Return the weight of a surfel at a point: smooth fall-off of the stretched distance times the normals' factor."""
    row = dr.gather(mi.Vector4f, state.geometry, surfel, active)
    normal = unpack_normal(row.w)
    offset = p - mi.Point3f(row.x, row.y, row.z)
    off_plane = dr.dot(offset, mi.Vector3f(normal))
    # Mahalanobis distance: the normal direction is stretched, so points off the plane are farther away.
    squared = dr.squared_norm(offset) + state.dials.plane_stretch * dr.square(off_plane)
    d2 = squared / dr.square(state.dials.radius)
    falloff = dr.fma(d2, dr.fma(2.0, dr.sqrt(d2), -3.0), 1.0)
    agreement = dr.fmax(dr.dot(mi.Vector3f(normal), mi.Vector3f(n)), 0.0)
    power = state.settings.normal_power
    while power > 1:
        agreement = dr.square(agreement)
        power //= 2
    weight = falloff * agreement
    return dr.select((d2 < 1.0) & (weight > LEAST_WEIGHT), weight, 0.0)
