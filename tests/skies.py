"""Sky images looked up by NumPy, for tests that judge the device's look-up and sums."""

from __future__ import annotations

import numpy as np


def look_up(image: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Return the bilinear look-up of `image` in directions (N, 3), as `Sky` documents it."""
    height, width = image.shape[:2]
    x = (np.arctan2(d[:, 0], -d[:, 2]) / (2.0 * np.pi) + 0.5) * width - 0.5
    y = np.arccos(np.clip(d[:, 1], -1.0, 1.0)) / np.pi * height - 0.5
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    found = np.zeros((len(d), 3))
    for i in (0, 1):
        for j in (0, 1):
            weight = (1.0 - np.abs(x - x0 - i)) * (1.0 - np.abs(y - y0 - j))
            found += weight[:, None] * image[np.clip(y0 + j, 0, height - 1), (x0 + i) % width]
    return found
