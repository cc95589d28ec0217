"""Where a scene that lies far from (0, 0, 0) is measured from.

Single precision holds some seven digits, whatever the distance: a room 100 km away has its walls on a grid of 8 mm. So
the loaders choose a point amid what is looked at, and `local.py` measures everything from there.
"""

from __future__ import annotations

import numpy as np

from luxel.errors import LuxelError
from luxel.scene.model import Colour, SceneData
from luxel.scene.rules import LARGEST

FAR = 64.0
"""How many of its own sizes what is looked at must lie from (0, 0, 0) to be measured from elsewhere: up to there,
single precision has steps of 1/130,000 of that size at most."""
CORNERS = np.array([(c & 1, (c >> 1) & 1, c >> 2) for c in range(8)])
"""Of a box: which end on each axis."""
SAMPLE = 200_000
"""Triangles that are looked at, in even steps through the scene."""
ROUGH = 1e-4
"""Share of a scene's size above which the rounding of its vertices is worth a warning."""


def choose_origin(data: SceneData) -> None:
    """Set `data.origin` where what the cameras see, or without cameras most triangles, lies far from (0, 0, 0).

    Each triangle counts by the angle that the nearest camera would see it under, or by the root of its area, and the
    middle half of that decides: strays far away have no say. Warns where vertices are too rough for their distance.
    Raises LuxelError for vertices beyond `LARGEST`.
    """
    origin, size, step = find_origin(data)
    data.origin = _triple(origin)
    warn_of_rounding(data, step, size)


def find_origin(data: SceneData) -> tuple[np.ndarray, float, float]:
    """Return the point (3,) to measure `data` from, the size of what is looked at, and the step that its vertices have.

    Both in metres; the step is that of single precision at the vertices' own numbers. Raises LuxelError for vertices
    beyond `LARGEST`.
    """
    check_places(data)
    corners, steps = _sample_triangles(data)
    if not len(corners):
        return np.zeros(3), 0.0, 0.0
    return *_find_far(corners, _weigh(data, corners)), float(np.median(steps))


def warn_of_rounding(data: SceneData, step: float, size: float) -> None:
    """Say where the file rounds vertices to a `step` that is rough for a scene of this `size`, both in metres."""
    if any(data.origin) and step > ROUGH * size:
        data.warnings.append(
            f"The scene lies {_distance(float(np.linalg.norm(data.origin)))} from its origin, and the file's single "
            f"precision rounds its vertices to {1e3 * step:.2g} mm there; let nodes or to_world carry it that far."
        )


def far_centre(points: np.ndarray) -> np.ndarray:
    """Return the middle (3,) of the box of points (N, 3) on the axes where it is far from 0 for the box's size.

    Zero elsewhere, and rounded so that single precision holds it and what is left.
    """
    if not len(points):
        return np.zeros(3)
    low, high = points.min(axis=0).astype(np.float64), points.max(axis=0).astype(np.float64)
    return _round_where_far(0.5 * (low + high), float(np.linalg.norm(high - low)))


def check_places(data: SceneData) -> None:
    """Raise LuxelError for vertices further away than single precision can measure."""
    boxes: dict[int, np.ndarray] = {}
    for item in data.objects:
        for mesh in item.meshes:
            if not len(mesh.positions):
                continue
            if id(mesh) not in boxes:
                ends = np.stack([mesh.positions.min(axis=0), mesh.positions.max(axis=0)]).astype(np.float64)
                boxes[id(mesh)] = ends[CORNERS, np.arange(3)]
            with np.errstate(over="ignore", invalid="ignore"):
                placed = boxes[id(mesh)] @ item.to_world[:3, :3].T + item.to_world[:3, 3]
            if not np.abs(placed).max() < LARGEST:
                raise LuxelError(
                    f"{data.name}: object '{item.name}' has vertices that are NaN, infinite or beyond "
                    f"{LARGEST:.0e} m: repair the file"
                )


def _sample_triangles(data: SceneData) -> tuple[np.ndarray, np.ndarray]:
    """Return corners (N, 3, 3) float64 of triangles at time 0, and the step (N,), metres, that their file rounds to."""
    count = sum(len(mesh.faces) for item in data.objects for mesh in item.meshes)
    stride = max(-(-count // SAMPLE), 1)
    corners, steps = [np.zeros((0, 3, 3))], [np.zeros(0)]
    for item in data.objects:
        matrix = np.asarray(item.to_world if item.motion is None else item.motion(0.0), np.float64)
        for mesh in item.meshes:
            faces = mesh.faces[::stride].astype(np.int64)
            own = mesh.positions[faces].astype(np.float64)
            corners.append(own @ matrix[:3, :3].T + matrix[:3, 3])
            grid = np.spacing(np.abs(own).max(axis=(1, 2), initial=0.0).astype(np.float32)).astype(np.float64)
            steps.append(grid * np.linalg.norm(matrix[:3, :3], axis=0).max())
    return np.concatenate(corners), np.concatenate(steps)


def _weigh(data: SceneData, corners: np.ndarray) -> np.ndarray:
    """Return what each triangle counts, (N,)."""
    areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    if not data.cameras:
        return np.sqrt(areas)
    middles, nearest = corners.mean(axis=1), np.full(len(corners), np.inf)
    for camera in data.cameras:
        eye = camera.eye if camera.motion is None else np.asarray(camera.motion(0.0), np.float64)[:3, 3]
        nearest = np.minimum(nearest, ((middles - eye) ** 2).sum(axis=1))
    return areas / np.maximum(nearest + areas, 1e-300)


def _find_far(corners: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the point (3,) to measure (N, 3, 3) corners from, zero where they are near, and the size of their middle.

    The point has few digits, so that it subtracts without loss.
    """
    weights = weights if weights.any() else np.ones(len(corners))
    middle = _quantile(corners.mean(axis=1), weights, 0.5)
    spread = _quantile(corners.max(axis=1), weights, 0.75) - _quantile(corners.min(axis=1), weights, 0.25)
    size = float(np.linalg.norm(spread))
    return _round_where_far(middle, size), size


def _round_where_far(middle: np.ndarray, size: float) -> np.ndarray:
    """Return `middle` (3,) on the axes where it is far for a thing of this `size`, in steps of a power of two below."""
    far = np.abs(middle) > FAR * size
    if not far.any() or size == 0.0:
        return np.zeros(3)
    step = 2.0 ** np.floor(np.log2(size))
    return np.where(far, np.round(middle / step) * step, 0.0)


def _quantile(values: np.ndarray, weights: np.ndarray, share: float) -> np.ndarray:
    """Return for each column of `values` (N, C) the value below which `share` of the weight lies, (C,)."""
    found = np.zeros(values.shape[1])
    for column in range(values.shape[1]):
        order = np.argsort(values[:, column], kind="stable")
        total = np.cumsum(weights[order])
        found[column] = values[order[np.searchsorted(total, share * total[-1])], column]
    return found


def _distance(metres: float) -> str:
    return f"{metres / 1e3:.3g} km" if metres >= 1e3 else f"{metres:.3g} m"


def _triple(vector: np.ndarray) -> Colour:
    # Adding zero turns -0.0 into 0.0.
    x, y, z = (float(axis) + 0.0 for axis in vector)
    return x, y, z
