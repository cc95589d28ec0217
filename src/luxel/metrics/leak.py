"""Light where none can be: in a sealed room, over that in the lit room beside it."""

from __future__ import annotations

import numpy as np

WALL_POINTS = 8
"""Points along each side of a wall: 8 x 8 on each of a room's six faces."""


def leak_ratio(sealed: np.ndarray, lit: np.ndarray) -> float:
    """Return the mean irradiance in the sealed room over that in the lit one; NaN where the lit one is dark.

    Both are (N, 3) indirect irradiance, W/m^2, at fixed points on the rooms' surfaces.
    """
    outside = float(np.mean(lit, dtype=np.float64))
    return float(np.mean(sealed, dtype=np.float64)) / outside if outside > 0.0 else float("nan")


def box_points(lower: np.ndarray, upper: np.ndarray, count: int = WALL_POINTS) -> tuple[np.ndarray, np.ndarray]:
    """Return points on the six inner faces of a box and their normals, (6 count^2, 3) float32 each.

    The points lie in the middle of count x count equal cells a face, so none is on an edge; normals point inwards.
    """
    lower, upper = np.asarray(lower, np.float64), np.asarray(upper, np.float64)
    steps = (np.arange(count) + 0.5) / count
    first, second = (grid.ravel() for grid in np.meshgrid(steps, steps, indexing="ij"))
    points, normals = [], []
    for axis in range(3):
        for end in (0.0, 1.0):
            place = np.empty((count * count, 3))
            place[:, axis], place[:, (axis + 1) % 3], place[:, (axis + 2) % 3] = end, first, second
            normal = np.zeros_like(place)
            normal[:, axis] = 1.0 - 2.0 * end
            points.append(lower + place * (upper - lower))
            normals.append(normal)
    return np.concatenate(points).astype(np.float32), np.concatenate(normals).astype(np.float32)
