"""The light of the sky's cells: the mean of the sky's image over each, times its colour and scale of now."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.kernels.sky import sky_radiance
from luxel.methods.lightmap.bake.sky import cell_of_direction
from luxel.scene.arrays import vectors_from_numpy
from luxel.scene.device import Scene

LEAST_ROWS = 768
"""Rows of directions, from pole to pole, that the sky's image is read along at least; whole ones a pixel."""
AT_ONCE = 1 << 22
"""Directions in one go: bounds memory."""


def average_sky(scene: Scene, resolution: int) -> mi.Color3f:
    """Return the mean of the sky's image over each cell (R R,), 1 where the sky has none: of its colour and scale, 1.

    Every pixel counts by its solid angle, in the cells that it covers: a sun of one pixel brings what it brings.
    """
    if scene.lights.sky_width == scene.lights.sky_height == 1:
        return dr.ones(mi.Color3f, resolution * resolution)
    plain = replace(scene.lights, sky_color=mi.Color3f(1.0), scale=mi.Float(1.0), has_sky=True)
    rows, columns = (
        n * -(-least // n) for n, least in ((plain.sky_height, LEAST_ROWS), (plain.sky_width, 2 * LEAST_ROWS))
    )
    sums = np.zeros((resolution * resolution, 4))
    for first in range(0, rows, max(1, AT_ONCE // columns)):
        count = min(max(1, AT_ONCE // columns), rows - first)
        lane = dr.arange(mi.UInt32, count * columns)
        theta = (mi.Float(lane // columns + first) + 0.5) * (dr.pi / rows)
        phi = (mi.Float(lane % columns) + 0.5) * (dr.two_pi / columns)
        sine, cosine = dr.sincos(theta)
        direction = mi.Vector3f(sine * dr.sin(phi), cosine, sine * dr.cos(phi))
        color = sky_radiance(replace(scene, lights=plain), direction, mi.Bool(True))
        cell, weight = np.array(cell_of_direction(direction, resolution)), np.array(sine).astype(np.float64)
        for channel, part in enumerate((color.x, color.y, color.z, mi.Float(1.0))):
            value = np.broadcast_to(np.array(part), weight.shape)
            sums[:, channel] += np.bincount(cell, weights=weight * value, minlength=len(sums))
    mean = sums[:, :3] / np.maximum(sums[:, 3:], 1e-300)
    return vectors_from_numpy(mi.Color3f, mean)


def light_sky(scene: Scene, mean: mi.Color3f) -> mi.Color3f:
    """Return pi times the mean radiance of each sky cell (R R,): what it would send as a surface of that radiosity."""
    return mean * scene.lights.sky_color * (scene.lights.scale * dr.pi)
