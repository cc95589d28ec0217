"""Radiance from infinitely far away, and directions in proportion to it.

Indirect light by luxel's rule, so rays that miss bring it. Where the sky has bright places, rays towards them
(`sample_sky`) join those that follow the cosine; each direction is weighted by how likely all of them were to take it
(the balance heuristic, Veach and Guibas 1995), so nothing is counted twice.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from luxel.kernels.sampling import hash_pair, to_unit
from luxel.scene.device import Scene

SKY_DISTANCE = 1e10
"""Metres that a ray must be free to meet the sky."""


def sky_radiance(scene: Scene, direction: mi.Vector3f, active: mi.Bool) -> mi.Color3f:
    """Return the sky's radiance along `direction` (unit, world); black where the lane is inactive."""
    lights = scene.lights
    if not lights.has_sky:
        return mi.Color3f(0.0)
    color = lights.sky_color * lights.scale
    if lights.sky_width > 1 or lights.sky_height > 1:
        u, v = _to_image(scene, direction)
        color *= _bilinear(lights.sky_image, lights.sky_width, lights.sky_height, u, v, active)
    return dr.select(active, color, mi.Color3f(0.0))


def is_sky_sampled(scene: Scene) -> bool:
    """Return whether the sky has bright places that rays of their own should look for."""
    return scene.lights.has_sky and scene.lights.sky_table.is_sampled


def sample_sky(scene: Scene, sample: mi.Point2f, active: mi.Bool) -> tuple[mi.Vector3f, mi.Float]:
    """Return directions (unit, world) towards the sky's bright places, and their density per steradian.

    Only where `is_sky_sampled`. `sample` are uniform numbers in [0, 1).
    """
    table, lights = scene.lights.sky_table, scene.lights
    count = table.rows * table.columns
    cell = dr.minimum(mi.UInt32(sample.x * count), count - 1)
    row = dr.gather(mi.Vector4f, table.cells, cell, active)
    own = sample.y < row.x
    cell, density = dr.select(own, cell, mi.UInt32(row.y)), dr.select(own, row.z, row.w)

    # Choosing has used up the numbers' digits, so the place in the cell comes from a hash of them.
    bits = (dr.reinterpret_array(mi.UInt32, number) for number in (sample.x, sample.y))
    across, down = (to_unit(word) for word in hash_pair(*bits))
    phi = ((mi.Float(cell % table.columns) + across) / table.columns - 0.5) * dr.two_pi + lights.sky_rotation
    top = mi.Float(cell // table.columns) * (dr.pi / table.rows)
    cosine = dr.lerp(dr.cos(top), dr.cos(top + dr.pi / table.rows), down)
    sine = dr.safe_sqrt(1.0 - dr.square(cosine))
    return mi.Vector3f(sine * dr.sin(phi), cosine, -sine * dr.cos(phi)), density


def sky_density(scene: Scene, direction: mi.Vector3f, active: mi.Bool) -> mi.Float:
    """Return the density per steradian with which `sample_sky` takes `direction` (unit, world)."""
    table = scene.lights.sky_table
    u, v = _to_image(scene, direction)
    column = dr.minimum(mi.UInt32(u * table.columns), table.columns - 1)
    row = dr.minimum(mi.UInt32(v * table.rows), table.rows - 1)
    return dr.gather(mi.Float, table.cells, 4 * (row * table.columns + column) + 2, active)


def _to_image(scene: Scene, direction: mi.Vector3f) -> tuple[mi.Float, mi.Float]:
    """Return the place in the sky's image, 0..1 to the right and down, that lies in `direction`."""
    # The image's centre column looks along -Z; columns to its right turn towards +X.
    phi = dr.atan2(direction.x, -direction.z) - scene.lights.sky_rotation
    u = phi * dr.inv_two_pi + 0.5
    return u - dr.floor(u), dr.safe_acos(direction.y) * dr.inv_pi


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
