"""Suns that are wider than one direction: how shadow rays sample their discs, and how cameras see them.

A disc of angular radius r and one radiance L gives the irradiance E = pi L sin^2 r on a plane that faces it. Tables
hold 1 - cos r in place of the angle: single precision would lose a small sun's cosine.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from luxel.scene.device import Scene


def sample_disc(to_sun: mi.Vector3f, versine: mi.Float, sample: mi.Point2f) -> tuple[mi.Vector3f, mi.Float]:
    """Return a direction of the disc, uniform by solid angle, and what the sun's E is multiplied by before the cosine.

    `to_sun` is its middle (unit), `versine` 1 - cos of its angular radius; at 0 the middle and 1 come back.
    """
    height = sample.x * versine
    radius = dr.safe_sqrt(height * (2.0 - height))
    sine, cosine = dr.sincos(dr.two_pi * sample.y)
    local = mi.Vector3f(radius * cosine, radius * sine, 1.0 - height)
    # L / density = E / (pi sin^2 r) * 2 pi (1 - cos r) = E * 2 / (1 + cos r).
    return mi.Frame3f(to_sun).to_world(local), 2.0 / (2.0 - versine)


def disc_radiance(scene: Scene, direction: mi.Vector3f, active: mi.Bool) -> mi.Color3f:
    """Return what the discs of the sky's suns send along `direction` (unit), for rays that see the sky directly.

    Only a camera's own rays ask: everywhere else the suns' light comes by the light sampler.
    """
    lights = scene.lights
    total = mi.Color3f(0.0)
    for index in range(lights.disc_count):
        middle, light = (dr.gather(mi.Vector4f, lights.discs, mi.UInt32(2 * index + i), active) for i in (0, 1))
        # |d - s|^2 = 2 (1 - cos): precise where the cosine itself is not.
        apart = dr.squared_norm(direction - mi.Vector3f(middle.x, middle.y, middle.z))
        inside = active & (apart < 2.0 * middle.w)
        total += dr.select(inside, mi.Color3f(light.x, light.y, light.z) * lights.scale, mi.Color3f(0.0))
    return total
