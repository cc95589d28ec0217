"""Octaves of distance from the scene's robust bounds: what lies in them, and triangles cut where they end.

A ground of two triangles reaches from under a house to the horizon: what is so near counts for more than what is far.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from luxel.methods.lightmap.flatten.cuts import cut_triangle
from luxel.scene.triangles import Box

NEAR = 0.1
"""How far around the bounds the first octave ends, in their diagonals: a ground is brightest to a house just beside it,
and may lie a hair below its lowest floor."""
STEPS = 40
"""Octaves at most: more than single precision tells apart from the bounds."""
FALL = 1.5
"""Exponent of the distance by which density falls. A ground without end then takes about as much as a surface as large
as the bounds; at 1 it would take ever more, with every octave of distance the same."""
RESOLVED = 1e5
"""How many times as long as the bounds a triangle may be for single precision to tell the texels there apart. Of longer
ones the near octaves, as many as fall short, are one."""
MOST_CUT = 1000
"""Triangles that are cut, at most: each takes some milliseconds."""


@dataclass
class Parts:
    """N parts of triangles, each with all its corners in one octave of distance, or small."""

    triangle: np.ndarray
    """(N,)."""
    inside: np.ndarray
    """(N, 3, 3) each corner by the weights of the triangle's; (0, 3, 3): all parts are whole triangles."""
    octave: np.ndarray
    """(N,); of a whole triangle, where it begins."""
    is_cut: np.ndarray
    """(N,) bool: the part is no whole triangle."""


def octave_boxes(bounds: Box, count: int) -> list[Box]:
    """Return the boxes that octaves 0 .. `count` - 1 end at, each in the next."""
    size = max(float(np.linalg.norm(bounds.upper - bounds.lower)), 1e-9)
    margins = [size * (2.0**step - 1.0 + NEAR) for step in range(count)]
    return [Box(bounds.lower - margin, bounds.upper + margin) for margin in margins]


def measure_octaves(corners: np.ndarray, bounds: Box) -> tuple[np.ndarray, np.ndarray]:
    """Return the octaves in which triangles (T, 3, 3) begin and end, (T,) each; small ones end where they begin."""
    size = max(float(np.linalg.norm(bounds.upper - bounds.lower)), 1e-9)
    low, high = corners.min(axis=1), corners.max(axis=1)
    away = np.maximum(np.maximum(bounds.lower - high, low - bounds.upper).max(axis=1), 0.0)
    furthest = np.maximum(np.maximum(bounds.lower - low, high - bounds.upper).max(axis=1), 0.0)
    first, last = (
        np.clip(np.ceil(np.log2(distance / size + 1.0 - NEAR)), 0, STEPS - 1).astype(np.int64)
        for distance in (away, furthest)
    )
    edge = np.linalg.norm(corners - corners[:, [1, 2, 0]], axis=2).max(axis=1)
    return first, np.where(edge > size + away, last, first)


def cut_triangles(corners: np.ndarray, bounds: Box, allowed: np.ndarray) -> Parts:
    """Return the parts of triangles (T, 3, 3), whole ones first.

    Large ones that reach over several octaves are cut, of those `allowed` (T,), the `MOST_CUT` longest at most.
    """
    first, last = measure_octaves(corners, bounds)
    edge = np.linalg.norm(corners - corners[:, [1, 2, 0]], axis=2).max(axis=1)
    size = max(float(np.linalg.norm(bounds.upper - bounds.lower)), 1e-9)
    least = np.ceil(np.log2(np.maximum(edge / (RESOLVED * size), 1.0)) / FALL).astype(np.int64)
    first = np.where(last > first, np.clip(least, first, last), first)
    large = np.flatnonzero(allowed & (last > first))
    if len(large) > MOST_CUT:
        large = np.sort(large[np.argsort(-edge[large], kind="stable")[:MOST_CUT]])
    if not len(large):
        return Parts(np.arange(len(first)), np.zeros((0, 3, 3)), first, np.zeros(len(first), bool))
    boxes = octave_boxes(bounds, int(last[large].max()) + 1)
    inside, octave = [], []
    for triangle in large:
        begin, end = int(first[triangle]), int(last[triangle])
        parts, number = cut_triangle(corners[triangle], boxes[begin:end], begin)
        inside.append(parts)
        octave.append(number)
    whole = np.setdiff1d(np.arange(len(first)), large)
    amount = [len(parts) for parts in inside]
    return Parts(
        triangle=np.concatenate([whole, np.repeat(large, amount)]),
        inside=np.concatenate([np.broadcast_to(np.eye(3), (len(whole), 3, 3)), *inside]),
        octave=np.concatenate([first[whole], *octave]),
        is_cut=np.repeat([False, True], [len(whole), sum(amount)]),
    )


def weigh_parts(parts: Parts, corners: np.ndarray) -> np.ndarray:
    """Return the area (N,) of parts of triangles with corners (T, 3, 3), less the farther off they lie."""
    placed = part_corners(parts, corners)
    cross = np.cross(placed[:, 1] - placed[:, 0], placed[:, 2] - placed[:, 0])
    return 0.5 * np.linalg.norm(cross, axis=1) * 4.0 ** (-FALL * parts.octave)


def part_corners(parts: Parts, corners: np.ndarray) -> np.ndarray:
    """Return values (N, 3, C) at the parts' corners, of values (T, 3, C) at those of the triangles."""
    held = corners[parts.triangle]
    return parts.inside @ held if len(parts.inside) else held


def on_triangle(inside: np.ndarray, face: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return points by the weights (n, 3) of their triangles' corners; `weights` (n, 3) are those of parts `face` (n,).

    `inside` (F, 3, 3) places the parts' corners; (0, 3, 3): parts are whole triangles.
    """
    return (weights[:, None] @ inside[face])[:, 0] if len(inside) else weights
