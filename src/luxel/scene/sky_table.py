"""A sky image as a lamp: directions in proportion to what the sky sends, as an alias table over cells of the image.

A cell's weight is the light of its bilinear look-up times its solid angle, so the density is positive wherever the
sky shines. Most of it goes to what is far brighter than the sky's mean: a sampler that follows the cosine finds the
rest as well (MIS compensation, Karlík et al. 2019).
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.scene.alias import build_alias_table
from luxel.scene.arrays import from_numpy
from luxel.scene.colours import LUMINANCE

MOST_ROWS, MOST_COLUMNS = 256, 512
"""Cells at most. Single precision chooses well among so many; whiter spots are suns, which are lamps of their own."""
BRIGHT = 2.0
"""Times the sky's mean from which a place is bright. Cosine rays go to one half of the sphere, so below that they serve
as well: a sky that is even above a black ground has no bright place."""
EVEN_SHARE = 0.05
"""What all light counts for, beside what is above that."""
LEAST_FOCUS = 0.02
"""Share of the light in bright places below which rays of their own are not worth their time."""


@dataclass
class SkyTable:
    """What `sample_sky` and `sky_density` read."""

    cells: mi.Float
    """(rows * columns, 4): the alias method's threshold and partner; densities per steradian of both."""
    rows: int
    columns: int
    focus: mi.Float
    """Share of the sky's light that is above `BRIGHT` means: 0 for an even sky, towards 1 for one of small spots."""
    is_sampled: bool
    """False for a sky without bright places (no image, one value, black, mild): the cosine serves best there."""


def build_sky_table(image: np.ndarray | None) -> SkyTable:
    """Return the table of a (H, W, 3) latitude-longitude image; None: a sky of one colour, which is not sampled."""
    if image is None or _is_even(image):
        return SkyTable(mi.Float([1.0, 0.0, 0.0, 0.0]), 1, 1, dr.opaque(mi.Float, 0.0), False)
    light, angle = _light_of_cells(image)
    bright = BRIGHT * light.sum() / angle.sum()
    above = np.maximum(light - bright * angle, 0.0)
    weight = (1.0 - EVEN_SHARE) * above + EVEN_SHARE * light
    share = (weight / weight.sum()).ravel()
    table = build_alias_table(share)
    density = share / angle.ravel()
    cells = np.column_stack([table, density, density[table[:, 1].astype(np.int64)]])
    rows, columns = light.shape
    focus = float(above.sum() / light.sum())
    cells = from_numpy(mi.Float, cells)
    return SkyTable(cells, rows, columns, dr.opaque(mi.Float, focus), focus >= LEAST_FOCUS)


def _is_even(image: np.ndarray) -> bool:
    """Return whether a sky's image is the same all over; a black one is."""
    # The first row says no of most images.
    return bool((image[0] == image[0, 0]).all()) and bool((image == image[:1, :1]).all())


def _light_of_cells(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return each cell's luminance times solid angle, and its solid angle, both (rows, columns)."""
    luminance = sum(np.float32(weight) * image[..., channel] for channel, weight in enumerate(LUMINANCE))
    light = np.nan_to_num(luminance, posinf=65504.0) * _row_angles(image.shape[0]).astype(np.float32)[:, None]
    rows, columns = min(image.shape[0], MOST_ROWS), min(image.shape[1], MOST_COLUMNS)
    light = _merge(_merge(light, rows).T, columns).T * (2.0 * np.pi / image.shape[1])
    angle = np.broadcast_to(_row_angles(rows)[:, None] * (2.0 * np.pi / columns), light.shape)

    # A pixel's light reaches into its neighbours: the look-up is straight between centres. Columns go round, rows end.
    mean = light / angle
    mean = 0.75 * mean + 0.125 * (np.roll(mean, 1, axis=1) + np.roll(mean, -1, axis=1))
    above, below = np.vstack([mean[:1], mean[:-1]]), np.vstack([mean[1:], mean[-1:]])
    return (0.75 * mean + 0.125 * (above + below)) * angle, angle


def _row_angles(rows: int) -> np.ndarray:
    """Return the solid angle of each row over that of its turn: the difference of the cosines at its edges."""
    edges = np.arange(rows + 1) * (np.pi / rows)
    # The product form keeps its digits at the poles.
    return 2.0 * np.sin(0.5 * (edges[1:] + edges[:-1])) * np.sin(0.5 * (edges[1:] - edges[:-1]))


def _merge(values: np.ndarray, count: int) -> np.ndarray:
    """Return `values` (N, ...) summed to (count, ...) even shares of the first axis; a pixel on an edge is divided."""
    size = len(values)
    if size % count == 0:
        return values.reshape(count, size // count, *values.shape[1:]).sum(axis=1, dtype=np.float64)
    edges = np.arange(count + 1) * (size / count)
    whole = np.minimum(edges.astype(np.int64), size)
    sums = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0, dtype=np.float64)])
    part = values[np.minimum(whole, size - 1)] * (edges - whole)[:, None]
    return np.maximum(np.diff(sums[whole] + part, axis=0), 0.0)
