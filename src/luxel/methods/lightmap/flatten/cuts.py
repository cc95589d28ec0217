"""Triangles cut along nested boxes into convex pieces, and those into triangles that meet corner to corner."""

from __future__ import annotations

import numpy as np

from luxel.scene.triangles import Box

ON_PLANE = 1e-7
"""Corners this near to a plane or an edge lie on it, as a share of the innermost box's diagonal."""


def cut_triangle(corners: np.ndarray, boxes: list[Box], first: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the parts of a triangle (3, 3): corners (P, 3, 3) by the triangle's weights, and the box (P,) of each.

    `boxes`, each in the next, are numbered from `first`; what lies in none of them has the number after the last. Parts
    run the way round that the triangle does.
    """
    slack = ON_PLANE * float(np.linalg.norm(boxes[0].upper - boxes[0].lower))
    rest, pieces = np.eye(3), []
    for number in range(len(boxes) - 1, -1, -1):
        for axis in range(3):
            for sign, limit in ((1.0, boxes[number].lower[axis]), (-1.0, boxes[number].upper[axis])):
                rest, out = _split(rest, sign * (rest @ corners[:, axis] - limit), slack)
                if len(out):
                    pieces.append((first + number + 1, out))
    if len(rest):
        pieces.append((first, rest))
    polygons = _share_corners([piece for _, piece in pieces], corners, slack)
    parts = [_fan(polygon) for polygon in polygons]
    return np.concatenate(parts), np.repeat([number for number, _ in pieces], [len(part) for part in parts])


def _split(polygon: np.ndarray, ahead: np.ndarray, slack: float) -> tuple[np.ndarray, np.ndarray]:
    """Return what of a convex polygon (n, 3) lies ahead of a plane and what behind; (0, 3): nothing.

    `ahead` (n,) is the distance of its corners. Both share the very same new corners.
    """
    if not (ahead < -slack).any():
        return polygon, polygon[:0]
    if not (ahead > slack).any():
        return polygon[:0], polygon
    front, behind = [], []
    for i, here in enumerate(ahead):
        j = (i + 1) % len(ahead)
        if here >= -slack:
            front.append(polygon[i])
        if here <= slack:
            behind.append(polygon[i])
        if min(here, ahead[j]) < -slack and max(here, ahead[j]) > slack:
            corner = polygon[i] + here / (here - ahead[j]) * (polygon[j] - polygon[i])
            front.append(corner)
            behind.append(corner)
    return np.array(front), np.array(behind)


def _share_corners(polygons: list[np.ndarray], corners: np.ndarray, slack: float) -> list[np.ndarray]:
    """Return the polygons with the others' corners put in where they lie on their edges, so that no gaps show."""
    every = np.unique(np.concatenate(polygons), axis=0)
    placed = every @ corners
    found = []
    for polygon in polygons:
        p, ring = polygon @ corners, []
        for i, start in enumerate(p):
            along = p[(i + 1) % len(p)] - start
            length = float(np.linalg.norm(along))
            t = (placed - start) @ along / max(length, 1e-300)
            off = np.linalg.norm(placed - start - t[:, None] * (along / max(length, 1e-300)), axis=1)
            between = np.flatnonzero((off < 2.0 * slack) & (t > 2.0 * slack) & (t < length - 2.0 * slack))
            ring += [polygon[i], *every[between[np.argsort(t[between])]]]
        found.append(np.array(ring))
    return found


def _fan(polygon: np.ndarray) -> np.ndarray:
    """Return the triangles (P, 3, 3) of a convex polygon (n, 3), about its middle where it has over three corners."""
    if len(polygon) == 3:
        return polygon[None]
    middle = np.broadcast_to(polygon.mean(axis=0), polygon.shape)
    return np.stack([middle, polygon, np.roll(polygon, -1, axis=0)], axis=1)
