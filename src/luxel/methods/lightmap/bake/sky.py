"""The sky as surfels on a sphere around the scene: cells of the octahedral map, each a leaf of a tree of its own."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.kernels.octahedral import direction_to_square
from luxel.methods.lightmap.bake.tree import Items, MergeWeights, Tree, merge_pairs, order_tree

SIDE_SAMPLES = 4
"""Directions along a cell's side that its solid angle is summed over."""


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
    weights = MergeWeights(normal=0.0, chart=0.0, view=0.0, balance=0.5)
    items = Items(middle, np.zeros_like(middle), angle, np.zeros(len(cell), np.int64), np.zeros((len(cell), 4)))
    return order_tree(merge_pairs(items, weights), len(cell)), middle, angle
