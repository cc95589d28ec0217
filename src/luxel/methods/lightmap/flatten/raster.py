"""Which cells of a grid each triangle covers."""

from __future__ import annotations

import numpy as np

CHUNK = 1 << 22
"""Candidate cells looked at together: bounds memory."""
EDGE = 1e-6
"""Barycentric slack: cells on an edge that two triangles share belong to both."""


def cover(corners: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (cell, triangle, barycentric weights (N, 3)) of each cell whose middle lies in a triangle.

    `corners` (T, 3, 2) are in cells, whose middles lie at n + 1/2; `size` is (columns, rows); cells run row by row.
    """
    columns, rows = size
    low = np.clip(np.ceil(corners.min(axis=1) - 0.5 - 1e-6).astype(np.int64), 0, [columns - 1, rows - 1])
    high = np.clip(np.floor(corners.max(axis=1) - 0.5 + 1e-6).astype(np.int64), -1, [columns - 1, rows - 1])
    extent = np.maximum(high - low + 1, 0)
    amount = extent.prod(axis=1)
    ends = np.cumsum(amount)
    found: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    start = 0
    while start < len(corners):
        stop = max(start + 1, int(np.searchsorted(ends, (ends[start - 1] if start else 0) + CHUNK, "right")))
        found.append(_cover_some(corners, low, extent, amount, start, stop, columns))
        start = stop
    if not found:
        return np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 3))
    cell, triangle, weights = (np.concatenate(part) for part in zip(*found, strict=True))
    return cell, triangle, weights


def _cover_some(
    corners: np.ndarray, low: np.ndarray, extent: np.ndarray, amount: np.ndarray, start: int, stop: int, columns: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Do the triangles from `start` to `stop`: test every cell of each one's box."""
    triangle = np.repeat(np.arange(start, stop), amount[start:stop])
    first = np.cumsum(amount[start:stop]) - amount[start:stop]
    step = np.arange(len(triangle)) - np.repeat(first, amount[start:stop])
    wide = np.maximum(extent[triangle, 0], 1)
    x, y = low[triangle, 0] + step % wide, low[triangle, 1] + step // wide
    weights = barycentric(np.stack([x + 0.5, y + 0.5], axis=1), corners[triangle])
    inside = weights.min(axis=1) >= -EDGE
    return (y * columns + x)[inside], triangle[inside], weights[inside]


def barycentric(p: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return the weights (N, 3) of points (N, 2) in triangles (N, 3, 2); NaN-free, far outside where flat."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, ac, ap = b - a, c - a, p - a
    area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    usable = np.abs(area) > 1e-14
    safe = np.where(usable, area, 1.0)
    second = (ap[:, 0] * ac[:, 1] - ap[:, 1] * ac[:, 0]) / safe
    third = (ab[:, 0] * ap[:, 1] - ab[:, 1] * ap[:, 0]) / safe
    second, third = np.where(usable, second, -1.0), np.where(usable, third, -1.0)
    return np.stack([1.0 - second - third, second, third], axis=1)
