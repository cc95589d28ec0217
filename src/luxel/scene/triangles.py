"""The triangles of a whole scene in world space, as one array, and how much of them a box holds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from luxel.scene.model import SceneData


@dataclass(frozen=True)
class Box:
    """An axis-aligned box."""

    lower: np.ndarray
    """(3,)."""
    upper: np.ndarray

    def holds(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Return which boxes (N, 3) lie in it as a whole, (N,)."""
        x, y, z = ((low >= self.lower) & (high <= self.upper)).T
        return x & y & z

    def touches(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Return which boxes (N, 3) share a point with it, (N,)."""
        x, y, z = ((high >= self.lower) & (low <= self.upper)).T
        return x & y & z


class Triangles:
    """The triangles of a scene in world space, and what is asked of them more than once."""

    def __init__(self, corners: np.ndarray, areas: np.ndarray | None = None) -> None:
        """`corners` (F, 3, 3), F >= 1; `areas` (F,) m^2 where they are known already."""
        self.corners = corners
        a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
        self.low, self.high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
        """(F, 3) each: the box of each."""
        self.areas = triangle_areas(corners) if areas is None else areas


def world_corners(data: SceneData, time: float = 0.0) -> np.ndarray:
    """Return the corners of all triangles at `time` seconds, (F, 3, 3) float64, object by object.

    One array for all objects: with tens of thousands of them, a step of NumPy for each would take seconds.
    """
    points, faces, counts, matrices = [], [], [], []
    start = 0
    for item in data.objects:
        matrices.append(item.to_world if item.motion is None else item.motion(time))
        deformed = None if item.deform is None else item.deform(time)
        count = 0
        for index, mesh in enumerate(item.meshes):
            positions = mesh.positions if deformed is None else deformed[index][0]
            points.append(positions)
            faces.append((mesh.faces, start + count))
            count += len(positions)
        counts.append(count)
        start += count
    if not any(len(face) for face, _ in faces):
        return np.zeros((0, 3, 3))
    owner = np.repeat(np.arange(len(counts)), counts)
    rows = np.asarray(matrices, np.float64)[:, :3]
    local = np.concatenate(points).astype(np.float64)
    world = rows[owner, :, 3]
    for axis in range(3):
        world += rows[owner, :, axis] * local[:, axis, None]
    shifts = np.repeat([shift for _, shift in faces], [len(face) for face, _ in faces])
    return world[np.concatenate([face for face, _ in faces]).astype(np.int64) + shifts[:, None]]


def area_within(triangles: Triangles, lower: np.ndarray, upper: np.ndarray) -> float:
    """Return the area of the triangles inside a box, m^2; those that cross its border are cut."""
    return float(areas_within(triangles, Box(lower, upper)).sum())


def areas_within(triangles: Triangles, box: Box) -> np.ndarray:
    """Return the area (F,) of each triangle inside a box, m^2; those that cross its border are cut."""
    # What lies in the border itself is inside.
    slack = 1e-6 * np.maximum(np.abs(box.lower), np.abs(box.upper)) + 1e-6 * float(np.max(box.upper - box.lower))
    box = Box(box.lower - slack, box.upper + slack)
    inside = box.holds(triangles.low, triangles.high)
    crossing = ~inside & box.touches(triangles.low, triangles.high)
    areas = np.where(inside, triangles.areas, 0.0).astype(np.float64)
    areas[crossing] = _cut_areas(triangles.corners[crossing], box)
    return areas


def _cut_areas(corners: np.ndarray, box: Box) -> np.ndarray:
    """Return the area (F,) of triangles (F, 3, 3) inside a box. Source: Sutherland and Hodgman 1974."""
    if not len(corners):
        return np.zeros(0)
    polygons = corners.astype(np.float64)
    rows = np.arange(len(polygons))[:, None]
    for axis in range(3):
        for sign, limit in ((1.0, box.lower[axis]), (-1.0, box.upper[axis])):
            ahead = sign * (polygons[..., axis] - limit)
            behind, following = np.roll(ahead, -1, axis=1), np.roll(polygons, -1, axis=1)
            crosses = ahead * behind < 0.0
            share = np.where(crosses, ahead, 0.0) / np.where(crosses, ahead - behind, 1.0)
            # Each edge gives its start, if that is inside, and the point where it crosses, if it does.
            points = np.stack([polygons, polygons + share[..., None] * (following - polygons)], axis=2)
            kept = np.stack([ahead >= 0.0, crosses], axis=2).reshape(len(polygons), -1)
            points = points.reshape(len(polygons), -1, 3)
            # A plane adds one corner at most; free places repeat the first, which takes no area.
            order = np.argsort(~kept, axis=1, kind="stable")[:, : polygons.shape[1] + 1]
            order = np.where(kept[rows, order], order, order[:, :1])
            polygons = np.where(np.logical_or.reduce(kept, axis=1)[:, None, None], points[rows, order], 0.0)
    fan = np.cross(polygons[:, 1:-1] - polygons[:, :1], polygons[:, 2:] - polygons[:, :1])
    return 0.5 * np.linalg.norm(fan.sum(axis=1), axis=1)


def triangle_areas(corners: np.ndarray) -> np.ndarray:
    """Return the areas (F,) float64 of triangles with `corners` (F, 3, 3)."""
    # Squares of squares: in single precision a kilometre's would pass its range at 10^9 m.
    corners = corners.astype(np.float64)
    return 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
