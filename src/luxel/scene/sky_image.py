"""Sky images as cameras and painters leave them: pixels that are no number take what is around them."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import distance_transform_edt

from luxel.errors import LuxelError

NEIGHBOURS = tuple((dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if dy or dx)
MOST_ROUNDS = 8
"""Holes deeper than so many pixels take their nearest sound pixel inside."""


def repair_sky_image(image: np.ndarray, label: str) -> tuple[np.ndarray, list[str]]:
    """Return the (H, W, 3) float32 latitude-longitude image with finite values of 0 or more, and what was mended.

    A pixel with a NaN or infinite channel takes the mean of the finite pixels around it, from the edge of a hole
    inwards; left and right edge are neighbours. Negative values become 0. Raises `LuxelError`, naming `label`, where
    no pixel is finite or none is positive.
    """
    pixels = np.array(image, dtype=np.float64)
    broken = np.asarray(~np.isfinite(pixels).all(axis=2))
    if broken.all():
        raise LuxelError(f"{label} has no pixel that is a finite number; it cannot light anything, so give another.")
    mended: list[str] = []
    if broken.any():
        count = int(broken.sum())
        pixels = _fill(pixels, broken)
        mended.append(f"{label} has {count} pixel(s) of NaN or infinity, which take the mean of those around them.")
    below = pixels < 0.0
    if below.any():
        mended.append(f"{label} has {int(below.any(axis=2).sum())} pixel(s) below zero, which are read as zero.")
        pixels[below] = 0.0
    if not pixels.any():
        raise LuxelError(f"{label} has no pixel above zero, so it gives no light; for a dark sky write --sky none.")
    return pixels.astype(np.float32), mended


def _fill(pixels: np.ndarray, broken: np.ndarray) -> np.ndarray:
    """Return `pixels` with those of the mask `broken` (H, W) filled from around."""
    height, width = broken.shape
    sound = ~broken
    pixels = np.where(sound[..., None], pixels, 0.0)
    for _ in range(MOST_ROUNDS):
        rows, columns = np.nonzero(~sound)
        if not len(rows):
            return pixels
        total, count = np.zeros((len(rows), 3)), np.zeros(len(rows))
        for dy, dx in NEIGHBOURS:
            row, column = rows + dy, (columns + dx) % width
            inside = (row >= 0) & (row < height)
            row = np.clip(row, 0, height - 1)
            taken = inside & sound[row, column]
            total += pixels[row, column] * taken[:, None]
            count += taken
        found = count > 0
        pixels[rows[found], columns[found]] = total[found] / count[found][:, None]
        sound[rows[found], columns[found]] = True
    # Three copies side by side, so that the nearest pixel may lie across the edge.
    nearest = distance_transform_edt(np.tile(~sound, (1, 3)), return_distances=False, return_indices=True)
    row, column = np.asarray(nearest)[:, :, width : 2 * width]
    return pixels[row, column % width]
