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
from luxel.methods.gibs.normal_light import NormalLightSum, add_normal_light, light_for_normal
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
def gather_irradiance(
    state: GibsState, p: mi.Point3f, n: mi.Normal3f, active: mi.Bool, n_light: mi.Normal3f | None = None
) -> Gathered:
    """Return irradiance and coverage at world points `p` with unit geometric normals `n`.

    `n_light` are the normals that are lit, where surfels keep light for other normals than their own; None: `n`.
    """
    n_light = n if n_light is None else n_light
    rows = state.normal_light
    slot = slot_of_point(state.lattice, p)
    item = dr.gather(mi.UInt32, state.grid.starts, slot, active)
    end = dr.gather(mi.UInt32, state.grid.starts, slot + 1, active)
    total = mi.Color3f(0.0)
    confidence = mi.Float(0.0)
    coverage = mi.Float(0.0)
    bent = NormalLightSum(mi.Color3f(0.0), mi.Float(0.0), mi.Float(0.0))
    going = active & (item < end)
    while going:
        surfel = dr.gather(mi.UInt32, state.grid.items, item, going)
        weight = surfel_weight(state, surfel, p, n, going)
        counts = going & (weight > 0.0)
        light = dr.gather(mi.Vector4f, state.light, surfel, counts)
        if dr.hint(state.depth is not None, mode="scalar"):
            weight *= visibility(state, surfel, p, n, counts & (light.w < 0.0))
            light = dr.abs(light)
        coverage += dr.select(counts, weight, 0.0)
        weight = dr.select(counts, weight * light.w, 0.0)
        total += mi.Color3f(light.x, light.y, light.z) * weight
        confidence += weight
        if dr.hint(rows is not None, mode="scalar"):
            normal = surfel_normal(state, surfel, going)
            bent = add_normal_light(bent, rows, surfel, normal, n_light, weight, counts)
        item += 1
        going &= item < end
    irradiance = total / dr.fmax(confidence, LEAST_WEIGHT)
    if dr.hint(rows is not None, mode="scalar"):
        to_geometric = dr.dot(mi.Vector3f(n), mi.Vector3f(n_light))
        # Beside a surface the normals are no numbers, and must not reach the means that `fill.py` takes over pixels.
        turned = light_for_normal(irradiance, bent, confidence, to_geometric)
        irradiance = dr.select(confidence > 0.0, turned, irradiance)
    return Gathered(irradiance, coverage, confidence)


def surfel_normal(state: GibsState, surfel: mi.UInt32, active: mi.Bool) -> mi.Vector3f:
    """Return the normal of a surfel, one long within 2e-3."""
    return unpack_normal(dr.gather(mi.Vector4f, state.geometry, surfel, active).w)


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
