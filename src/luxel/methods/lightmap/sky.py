"""The sky as surfels on a sphere around the scene: cells of the octahedral map, each a leaf of a tree of its own."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.kernels.octahedral import direction_to_square
from luxel.kernels.sky import sky_radiance
from luxel.methods.lightmap.tree import Items, Tree, TreeDials, merge_pairs, order_tree
from luxel.scene.device import Scene

SIDE_SAMPLES = 4
"""Directions along a cell's side that its solid angle is summed over."""
LEAST_ROWS = 768
"""Rows of directions, from pole to pole, that the sky's image is read along at least; whole ones a pixel."""
AT_ONCE = 1 << 22
"""Directions in one go: bounds memory."""


def cell_of_direction(direction: mi.Vector3f, resolution: int) -> mi.UInt32:
    """Return the sky cell of each unit direction."""
    square = direction_to_square(direction)
    x, y = ((c * 0.5 + 0.5) * resolution for c in (square.x, square.y))
    x, y = (mi.UInt32(dr.clip(c, 0.0, resolution - 1.0)) for c in (x, y))
    return y * resolution + x


def make_sky_tree(resolution: int) -> tuple[Tree, np.ndarray, np.ndarray]:
    """Return the tree of the sky's cells, their middle directions (R R, 3) and their solid angles (R R,)."""
    cell = np.arange(resolution * resolution)
    steps = (np.arange(SIDE_SAMPLES) + 0.5) / SIDE_SAMPLES
    x = (cell % resolution)[:, None, None] + steps[None, :, None] + 0.0 * steps[None, None, :]
    y = (cell // resolution)[:, None, None] + steps[None, None, :] + 0.0 * steps[None, :, None]
    x, y = 2.0 * x / resolution - 1.0, 2.0 * y / resolution - 1.0
    z = 1.0 - np.abs(x) - np.abs(y)
    fold = np.maximum(-z, 0.0)
    flat = np.stack([x - np.copysign(fold, x), y - np.copysign(fold, y), z], axis=-1)
    length = np.linalg.norm(flat, axis=-1)
    # A cell's solid angle goes with the inverse cube of the octahedron's distance.
    angle = (length**-3.0).mean(axis=(1, 2))
    middle = (flat / length[..., None]).mean(axis=(1, 2))
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    angle *= 4.0 * np.pi / angle.sum()
    dials = TreeDials(normal=0.0, chart=0.0, outlook=0.0, balance=0.5)
    items = Items(middle, np.zeros_like(middle), angle, np.zeros(len(cell), np.int64), np.zeros((len(cell), 4)))
    return order_tree(merge_pairs(items, dials), len(cell)), middle, angle


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
    return mi.Color3f(np.ascontiguousarray(mean.T, np.float32))


def light_sky(scene: Scene, mean: mi.Color3f) -> mi.Color3f:
    """Return pi times the mean radiance of each sky cell (R R,): what it would send as a surface of that radiosity."""
    return mean * scene.lights.sky_color * (scene.lights.scale * dr.pi)
