"""Suns that are wider than one direction: how shadow rays sample their discs, and what rays that meet them see.

A disc of angular radius r and one radiance L gives the irradiance E = pi L sin^2 r on a plane that faces it. Tables
hold 1 - cos r in place of the angle: single precision would lose a small sun's cosine.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from luxel.scene.device import Scene


def sample_disc(to_sun: mi.Vector3f, versine: mi.Float, sample: mi.Point2f) -> tuple[mi.Vector3f, mi.Float]:
    """Return a direction of the disc, uniform by solid angle, and the disc's solid angle in steradians.

    `to_sun` is its middle (unit), `versine` 1 - cos of its angular radius; at 0 the middle and 0 come back.
    """
    height = sample.x * versine
    radius = dr.safe_sqrt(height * (2.0 - height))
    sine, cosine = dr.sincos(dr.two_pi * sample.y)
    local = mi.Vector3f(radius * cosine, radius * sine, 1.0 - height)
    return mi.Frame3f(to_sun).to_world(local), dr.two_pi * versine


def disc_light(versine: mi.Float) -> mi.Float:
    """Return the radiance of a disc whose irradiance on a facing plane is 1; `versine` is 1 - cos of its radius."""
    # sin^2 r = (1 - cos r) (1 + cos r).
    return dr.inv_pi / dr.fmax(versine * (2.0 - versine), 1e-30)


def meet_disc(
    scene: Scene, index: int, direction: mi.Vector3f, active: mi.Bool
) -> tuple[mi.Color3f, mi.UInt32, mi.Float]:
    """Return what disc `index` of the sky sends along `direction` (unit), its row of delta lights and its solid angle.

    Black where the direction misses the disc.
    """
    lights = scene.lights
    middle, light = (dr.gather(mi.Vector4f, lights.discs, mi.UInt32(2 * index + i), active) for i in (0, 1))
    # |d - s|^2 = 2 (1 - cos): precise where the cosine itself is not.
    apart = dr.squared_norm(direction - mi.Vector3f(middle.x, middle.y, middle.z))
    inside = active & (apart < 2.0 * middle.w)
    radiance = dr.select(inside, mi.Color3f(light.x, light.y, light.z) * lights.scale, mi.Color3f(0.0))
    return radiance, mi.UInt32(light.w), dr.two_pi * middle.w


def disc_radiance(scene: Scene, direction: mi.Vector3f, active: mi.Bool) -> mi.Color3f:
    """Return what the discs of the sky's suns send along `direction` (unit), for rays that see the sky directly.

    Only a camera's own rays ask: everywhere else the suns' light comes by the light sampler.
    """
    total = mi.Color3f(0.0)
    for index in range(scene.lights.disc_count):
        total += meet_disc(scene, index, direction, active)[0]
    return total
