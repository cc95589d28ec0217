"""Radiance from infinitely far away: indirect light by luxel's rule, so rays that miss bring it."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from luxel.scene.device import Scene


def sky_radiance(scene: Scene, direction: mi.Vector3f, active: mi.Bool) -> mi.Color3f:
    """Return the sky's radiance along `direction` (unit, world); black where the lane is inactive."""
    lights = scene.lights
    if not lights.has_sky:
        return mi.Color3f(0.0)
    color = lights.sky_color * lights.scale
    if lights.sky_width > 1 or lights.sky_height > 1:
        # The image's centre column looks along -Z; columns to its right turn towards +X.
        phi = dr.atan2(direction.x, -direction.z) - lights.sky_rotation
        u = phi * dr.inv_two_pi + 0.5
        u -= dr.floor(u)
        v = dr.safe_acos(direction.y) * dr.inv_pi
        color *= _bilinear(lights.sky_image, lights.sky_width, lights.sky_height, u, v, active)
    return dr.select(active, color, mi.Color3f(0.0))


def _bilinear(image: mi.Float, width: int, height: int, u: mi.Float, v: mi.Float, active: mi.Bool) -> mi.Color3f:
    x, y = u * width - 0.5, v * height - 0.5
    x0, y0 = dr.floor(x), dr.floor(y)
    result = mi.Vector4f(0.0)
    for i in (0, 1):
        for j in (0, 1):
            column = mi.Int32(x0) + i
            column = dr.select(column < 0, width - 1, dr.select(column >= width, 0, column))
            row = dr.clip(mi.Int32(y0) + j, 0, height - 1)
            weight = (1.0 - dr.abs(x - x0 - i)) * (1.0 - dr.abs(y - y0 - j))
            result += weight * dr.gather(mi.Vector4f, image, mi.UInt32(row * width + column), active)
    return mi.Color3f(result.x, result.y, result.z)
