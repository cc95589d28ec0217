"""The record of a sampled place of a light, and lights without a surface: lamps, spots and suns.

What a light brings to a surface is radiance times the surface's response times the sample's weight. The density is
there for other samplers that may find the same light (multiple importance sampling, Veach and Guibas 1995).
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from luxel.kernels.sun_disc import disc_light, sample_disc
from luxel.scene.device import Scene
from luxel.scene.lights import ENTRY_IS_DELTA

FAR = 1e10
"""Metres that a ray must be free to meet what is infinitely far away."""


@dataclass
class LightSample:
    """A place of a light, as seen from a surface, before anything is asked of the surface or of what is in the way."""

    source: mi.UInt32
    """A triangle, or a row of the delta lights with `ENTRY_IS_DELTA`, as in `LightTables.entries`."""
    point: mi.Point3f
    """Where shadow rays end: the place itself, or just off its own triangle; nowhere for a light that `is_far`."""
    direction: mi.Vector3f
    """Unit, from the surface to the light."""
    is_far: mi.Bool
    radiance: mi.Color3f
    """W/(m^2 sr), towards the surface. Of a light without size: the irradiance of a plane that faces it, W/m^2."""
    density: mi.Float
    """Per steradian, of one draw. 0: no ray can meet the light, so that the weight stands alone."""
    weight: mi.Float
    """What radiance times response counts for: one over the density, or the probability of a light without size."""


def no_sample() -> LightSample:
    """Return a sample that brings nothing."""
    zero = mi.Float(0.0)
    nowhere, up = mi.Point3f(0.0), mi.Vector3f(0.0, 1.0, 0.0)
    return LightSample(mi.UInt32(0), nowhere, up, mi.Bool(False), mi.Color3f(0.0), zero, mi.Float(0.0))


def balance(density: mi.Float, other: mi.Float) -> mi.Float:
    """Return what a sample of `density` counts for beside a sampler of density `other`: the balance heuristic.

    A light sample of density 0 counts whole: nobody else finds its light.
    """
    return dr.select(density > 0.0, density / dr.fmax(density + other, 1e-30), 1.0)


def sample_delta(scene: Scene, row: mi.UInt32, p: mi.Point3f, sample: mi.Point2f, active: mi.Bool) -> LightSample:
    """Return delta light `row` from the point `p`; `sample` chooses a direction where a sun is wider than one."""
    position, axis, color, cone = (dr.gather(mi.Vector4f, scene.lights.delta, 4 * row + i, active) for i in range(4))
    axis_out, target = mi.Vector3f(axis.x, axis.y, axis.z), mi.Point3f(position.x, position.y, position.z)
    offset = mi.Vector3f(target - p)
    squared = dr.fmax(dr.squared_norm(offset), 1e-24)
    is_far = position.w < 0.5
    to_sun, per_irradiance = -axis_out, mi.Float(1.0)
    density, weight = mi.Float(0.0), mi.Float(1.0)
    if scene.lights.soft_suns:
        versine = dr.select(is_far, cone.x, 0.0)
        to_sun, solid_angle = sample_disc(to_sun, versine, sample)
        is_soft = versine > 0.0
        per_irradiance = dr.select(is_soft, disc_light(versine), 1.0)
        weight = dr.select(is_soft, solid_angle, 1.0)
        # Rays meet the discs that the sky shows, and no others.
        density = dr.select(is_soft & (color.w > 0.0), dr.rcp(dr.fmax(solid_angle, 1e-30)), 0.0)
    direction = mi.Vector3f(dr.select(is_far, to_sun, offset / dr.sqrt(squared)))
    falloff = _falloff(position.w, dr.dot(-direction, axis_out), axis.w, cone, squared)
    strength = dr.select(is_far, per_irradiance, falloff) * scene.lights.scale
    return LightSample(
        source=row | ENTRY_IS_DELTA,
        point=target,
        direction=direction,
        is_far=is_far,
        radiance=dr.select(active, mi.Color3f(color.x, color.y, color.z) * strength, mi.Color3f(0.0)),
        density=density,
        weight=weight,
    )


def _falloff(kind: mi.Float, along: mi.Float, reach: mi.Float, cone: mi.Vector4f, squared: mi.Float) -> mi.Float:
    """Return irradiance over intensity at a distance, `along` being the cosine with the axis: KHR_lights_punctual.

    Inverse square, a window at the range, a squared ramp between the cone's cosines.
    """
    window = dr.square(dr.clip(1.0 - dr.square(squared / dr.square(reach)), 0.0, 1.0))
    ramp = dr.square(dr.clip((along - cone.y) / dr.fmax(cone.x - cone.y, 1e-4), 0.0, 1.0))
    # Mitsuba's spot falls off with the angle itself.
    by_angle = dr.clip((cone.w - dr.safe_acos(along)) / dr.fmax(cone.w - cone.z, 1e-4), 0.0, 1.0)
    spot = dr.select(kind > 1.5, dr.select(cone.w > 0.0, by_angle, ramp), 1.0)
    return window * spot / squared
