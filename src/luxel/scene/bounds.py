"""Robust bounds: the box and area of what matters in a scene, which no stray, dome or wide ground stretches.

    rays from the cameras (or triangles) -> what is near, by weight -> its core -> whole triangles around it

Every length that a method or a viewer takes from "the scene" comes from here, none from the box of all triangles.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from luxel.scene.axes import camera_axes
from luxel.scene.model import Camera, SceneData
from luxel.scene.triangles import Box, Triangles, area_within

SEED = 0xB0B5
RAYS = 4096
"""Rays from all cameras together."""
BOUNCES = 3
"""Times that each goes on from what it met, by the cosine: what lies behind the camera lights what it sees."""
TIMES = 8
"""Moments of an animation at which a moving camera looks."""
ASPECT = 16.0 / 9.0
"""Of the pictures: a file does not say it."""
FEW = 64
"""Hits under which the cameras are taken to look past the scene."""
SHARE = 0.95
"""Of the hits, by weight: what lies in the core along each axis."""
AROUND = 1.0
"""Diagonals of the core around it in which whole triangles belong to the scene: the room next door, the wall behind."""
MOST_AREA = 3.0
"""Times the area in the core that counts at most."""
VAST = (4.0, 32.0)
"""Without cameras: how many times a triangle is as long as all that is smaller is wide, and how many times the whole
scene is, from where it counts as surroundings: a dome, a ground."""
VAST_METRES = 50.0
"""Nothing shorter is surroundings: a lamp of two centimetres on a plain cupboard is a detail of it, no scene; and light
that goes farther at once leaves the place that a camera looks at."""
FEW_TRIANGLES = 8
"""Smaller triangles than this are no scene of their own."""

Look = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Origins and unit directions (N, 3) -> distance (N,), infinite for a miss, and triangle (N,)."""


@dataclass(frozen=True)
class Bounds:
    """The box and the area of what matters."""

    lower: np.ndarray
    """(3,) float64, world space, over the animation."""
    upper: np.ndarray
    area: float
    """Surface area in the box, m^2, at most `MOST_AREA` times that in its core."""
    complete: bool
    """Nothing lies beyond the box but what moves away."""


def find_bounds(data: SceneData, triangles: Triangles, look: Look, moved: np.ndarray) -> Bounds:
    """Return the robust bounds of a scene, by rays from its cameras. The same every time.

    `moved` (K, 2, 3) are boxes that moving parts take up over the animation. Without cameras, or where they see hardly
    anything, the triangles decide.
    """
    found = look_around(data, triangles, look)
    return _settle(*(found or _spread_over(triangles)), triangles, moved)


def triangle_bounds(triangles: Triangles) -> Bounds:
    """Return the robust bounds of triangles, whatever cameras see of them."""
    return _settle(*_spread_over(triangles), triangles, np.zeros((0, 2, 3)))


# --- what is there -------------------------------------------------------------------------------------------------


@dataclass
class _Hits:
    """What the rays from the cameras met, on all their ways."""

    points: np.ndarray
    """(N, 3)."""
    apart: np.ndarray
    """(N,) distance from the eye, metres."""
    owner: np.ndarray
    """(N,) the view."""
    triangle: np.ndarray
    """(N,)."""
    onward: np.ndarray
    """(M,) how far each bounce got, metres; infinite for a miss. Only of those that set out near the eye."""
    onward_owner: np.ndarray


def look_around(data: SceneData, triangles: Triangles, look: Look) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the points (N, 3) that rays from the cameras meet on their way, and their weights (N,); None: hardly any.

    A hit counts by one over its distance from the eye, as far things need less detail, and once more by one over its
    distance from the middle of what that camera sees, so that surroundings do not count by the sky that they fill.
    Within the room that the camera looks at (`_find_room`) all count alike: a close-up is lit by all of it.
    """
    rng = np.random.default_rng(SEED)
    times = np.linspace(0.0, data.duration, TIMES) if data.duration > 0.0 else np.zeros(1)
    views = [(cam, time) for cam in data.cameras for time in (times if cam.motion is not None else times[:1])]
    if not views:
        return None
    count = max(RAYS // len(views), 1)
    chosen = views if len(views) <= RAYS else [views[i] for i in rng.choice(len(views), RAYS, replace=False)]
    rays = [_camera_rays(cam, float(time), count, rng) for cam, time in chosen]
    eyes, directions = (np.concatenate(part) for part in zip(*rays, strict=True))
    hits = _follow(eyes, directions, np.repeat(np.arange(len(chosen)), count), triangles.corners, look, rng)
    if hits is None or _sees_nothing(hits, triangles):
        return None
    return hits.points, _weigh(hits)


def _sees_nothing(hits: _Hits, triangles: Triangles) -> bool:
    """Return whether the cameras see hardly anything, but for surroundings: a dome through a window."""
    if np.count_nonzero(hits.apart <= VAST_METRES) >= FEW:
        return False
    return bool(np.count_nonzero(_without_surroundings(triangles)[hits.triangle]) < FEW)


def _follow(
    eyes: np.ndarray,
    directions: np.ndarray,
    owner: np.ndarray,
    corners: np.ndarray,
    look: Look,
    rng: np.random.Generator,
) -> _Hits | None:
    """Return what the rays (R, 3) of the views `owner` (R,) meet, and what they meet going on from there."""
    origins = eyes
    met, onward = [], []
    for bounce in range(1 + BOUNCES):
        t, prim = look(origins, directions)
        if bounce:
            near = np.linalg.norm(origins - eyes, axis=1) <= VAST_METRES
            onward.append((t[near], owner[near]))
        hit = np.isfinite(t)
        if not hit.any():
            break
        origins, directions, t, prim, eyes, owner = (part[hit] for part in (origins, directions, t, prim, eyes, owner))
        p = origins + t[:, None] * directions
        met.append((p, np.linalg.norm(p - eyes, axis=1), owner, prim))
        normals = _normals(corners[prim])
        normals *= -np.sign((normals * directions).sum(axis=1, keepdims=True))
        # Off the surface by what single precision cannot tell from it.
        origins = p + normals * (1e-4 * t[:, None] + 1e-6 * np.abs(p).max(axis=1, keepdims=True))
        directions = _cosine_directions(normals, rng)
    if not met:
        return None
    return _Hits(*(np.concatenate(part) for part in (*zip(*met, strict=True), *zip(*onward, strict=True))))


def _weigh(hits: _Hits) -> np.ndarray:
    """Return the weights (N,) of `hits`, view by view."""
    weights = np.empty(len(hits.points))
    order = np.argsort(hits.owner, kind="stable")
    for members in np.split(order, np.flatnonzero(np.diff(hits.owner[order])) + 1):
        points, apart = hits.points[members], hits.apart[members]
        room = _find_room(hits.onward[hits.onward_owner == hits.owner[members[0]]])
        by_eye = 1.0 / np.maximum(apart, max(room, 1e-3 * float(np.median(apart)), 1e-30))
        middle = np.array([_percentile(points[:, axis], by_eye, 0.5) for axis in range(3)])
        away = np.linalg.norm(points - middle, axis=1)
        weights[members] = by_eye / np.maximum(away, max(room, _percentile(away, by_eye, 0.5), 1e-30))
    return weights


def _find_room(onward: np.ndarray) -> float:
    """Return how wide the place is that lights what a camera sees, metres: the root mean square of how far light goes.

    Ways into the open, or to surroundings, count as nothing: the less a place is shut in, the less it says.
    """
    lengths = np.where(onward <= VAST_METRES, onward, 0.0)
    return float(np.sqrt(np.mean(lengths * lengths))) if len(lengths) else 0.0


def _camera_rays(camera: Camera, time: float, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return origins and unit directions (R, 3) of rays through the picture of `camera`."""
    eye, right, up, forward = camera_axes(camera, time)
    x, y = rng.uniform(-1.0, 1.0, (2, count, 1))
    x, y = x + camera.lens_shift[0], y + camera.lens_shift[1]
    if camera.orthographic_width > 0.0:
        height = camera.orthographic_height or camera.orthographic_width / ASPECT
        spread = 0.5 * camera.orthographic_width * x * right + 0.5 * height * y * up
        return eye + spread, np.tile(forward, (count, 1))
    half = np.tan(np.deg2rad(camera.fov) / 2.0)
    directions = forward + half * (x * right + y / ASPECT * up)
    return np.tile(eye, (count, 1)), directions / np.linalg.norm(directions, axis=1, keepdims=True)


def _normals(corners: np.ndarray) -> np.ndarray:
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).astype(np.float64)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)


def _cosine_directions(normals: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return unit directions about `normals` (N, 3), by the cosine: a point of the unit sphere on top of the normal."""
    on_sphere = rng.normal(size=normals.shape)
    on_sphere /= np.maximum(np.linalg.norm(on_sphere, axis=1, keepdims=True), 1e-12)
    directions = normals + on_sphere
    return directions / np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-12)


def _spread_over(triangles: Triangles) -> tuple[np.ndarray, np.ndarray]:
    """Return points (N, 3) on triangles and their weights (N,): each triangle counts by the root of its area.

    Triangles that surround all others by far (`VAST`) are left out.
    """
    kept = np.flatnonzero(_without_surroundings(triangles))
    weights = np.sqrt(triangles.areas[kept].astype(np.float64))
    if not weights.sum() > 0.0:
        weights = np.ones(len(kept))
    if len(kept) > RAYS:
        # Even steps along the weights: large triangles come several times.
        heap = np.cumsum(weights)
        steps = (np.arange(RAYS) + 0.5) / RAYS * heap[-1]
        kept, weights = kept[np.minimum(np.searchsorted(heap, steps), len(kept) - 1)], np.ones(RAYS)
    return triangles.corners[kept].reshape(-1, 3).astype(np.float64), np.repeat(weights, 3)


def _without_surroundings(triangles: Triangles) -> np.ndarray:
    """Return which triangles (F,) are no surroundings of the others."""
    length = np.linalg.norm(triangles.high - triangles.low, axis=1)
    order = np.argsort(length, kind="stable")
    whole = float(np.linalg.norm(triangles.high.max(axis=0) - triangles.low.min(axis=0)))
    for split in _leaps(length[order]):
        inner = order[:split]
        # Strays must not widen what is within.
        lower, upper = _core(0.5 * (triangles.low + triangles.high)[inner], np.sqrt(triangles.areas[inner]) + 1e-30)
        width = float(np.linalg.norm(upper - lower))
        vast = length[order[split]] > max(VAST[0] * width, VAST_METRES) and whole > VAST[1] * width
        if width > 0.0 and vast:
            kept = np.zeros(len(length), bool)
            kept[inner] = True
            return kept
    return np.ones(len(length), bool)


def _leaps(length: np.ndarray) -> list[int]:
    """Return after how many of the ascending lengths (F,) the next is at least twice as long, the longest first."""
    leaps = np.flatnonzero(length[1:] > 2.0 * length[:-1]) + 1
    return [int(leap) for leap in leaps[::-1] if leap >= FEW_TRIANGLES]


# --- their box -----------------------------------------------------------------------------------------------------


def _core(points: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the box (lower, upper) of the shortest stretch along each axis that holds `SHARE` of the points' weight.

    The shortest one, not that between two percentiles: strays mostly lie on one side.
    """
    ends = []
    for axis in range(3):
        order = np.argsort(points[:, axis], kind="stable")
        values, heap = points[order, axis], np.concatenate([[0.0], np.cumsum(weights[order])])
        last = np.searchsorted(heap[1:], heap[:-1] + (SHARE - 1e-9) * heap[-1])
        first = np.flatnonzero(last < len(values))
        best = first[np.argmin(values[last[first]] - values[first])]
        ends.append((values[best], values[last[best]]))
    lower, upper = np.array(ends, np.float64).T
    return lower, upper


def _percentile(values: np.ndarray, weights: np.ndarray, share: float) -> float:
    order = np.argsort(values, kind="stable")
    heap = np.cumsum(weights[order])
    return float(values[order[min(int(np.searchsorted(heap, share * heap[-1])), len(order) - 1)]])


def _settle(points: np.ndarray, weights: np.ndarray, triangles: Triangles, moved: np.ndarray) -> Bounds:
    """Return the bounds of what the points tell of the triangles and of the boxes `moved`.

    Where the triangles around the core end near it, the box ends with them, so a scene without strays keeps all of
    itself; a triangle that goes on beyond them, such as a ground, ends with the core.
    """
    lower, upper = _core(points, weights)
    core = area_within(triangles, lower, upper)
    margin = AROUND * float(np.linalg.norm(upper - lower))
    around = Box(lower - margin, upper + margin)
    # Hits lie off their triangles by round-off.
    lower = np.maximum(lower, triangles.low.min(axis=0))
    upper = np.maximum(np.minimum(upper, triangles.high.max(axis=0)), lower)
    complete = bool(around.holds(triangles.low, triangles.high).all())
    for low, high in ((triangles.low, triangles.high), (moved[:, 0], moved[:, 1])):
        whole = around.holds(low, high)
        if whole.any():
            lower, upper = np.minimum(lower, low[whole].min(axis=0)), np.maximum(upper, high[whole].max(axis=0))
    return Bounds(lower, upper, min(area_within(triangles, lower, upper), MOST_AREA * core), complete)
