"""Key views for a scene that names none: found by looking around, so that a flight sees most of what there is to see.

    where to start -> explore: rays find surfaces and free space -> which place sees what -> take the best views

Rays pass no wall, so all places lie in the air that the first camera stands in, and sealed rooms stay unseen.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import product

import mitsuba as mi
import numpy as np

from luxel.errors import LuxelError
from luxel.kernels.camera import camera_axes
from luxel.kernels.surface import surface_at_hit
from luxel.kernels.trace import trace_closest, trace_occluded
from luxel.scene.arrays import from_numpy, vectors_from_numpy
from luxel.scene.device import Scene
from luxel.scene.edit import default_camera
from luxel.scene.model import Camera
from luxel.scene.rounding import STEP
from luxel.scene.triangles import Box

SEED = 0xF11E
ROUNDS = 5
"""Times that rays go out, each from places that the one before has found."""
SOURCES, RAYS = 96, 64
"""Places of a round, and rays from each."""
FEW = 64
"""Surface points under which the first cameras are taken to look past the scene."""
CELLS = 28
"""Cells along the scene's size: each side of a surface in one counts once, however many rays meet it."""
EVEN = 0.25
"""Exponent of the rays that have met a cell, for what it counts: 0, all alike; 1, by rays."""
TARGETS, PLACES = 3000, 240
"""Surface points and places to look from that are judged."""
ROOMS = (3, 12)
"""Cells along the scene's size, coarse and fine, of which some send rays from one place in them a round."""
WITHIN, ENCLOSED = 0.4, 0.6
"""Share of rays all around that meet something, from which the first cameras stand within walls; and the part of it
below which another place counts as outside then."""
MARGIN = 0.1
"""Diagonals of the scene's bounds around them in which what rays meet counts: moving things may have left them."""
FAR = 8.0
"""Median distances from the middle beyond which a surface counts as a stray."""
CLEARANCE = 0.015
"""Free distance around an eye at least, over the scene's size."""
GRAZING = 0.08
"""Cosine under which a surface counts as unseen."""
FOV, ASPECT = 105.0, 16.0 / 9.0
"""Of the key views. A picture of another shape than this wide one sees more."""
VIEWS = 16
ENOUGH = 0.99
"""Share of the surface points, by weight, that need be seen."""
LEAST = 0.004
"""Share of them that a further view must add."""
DIRECTIONS = np.array([d for d in product((-1.0, 0.0, 1.0), repeat=3) if any(d)])
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)


@dataclass
class _Found:
    """What rays have met: surface points (T, 3) with unit normals towards who saw them, and free places (E, 3)."""

    p: np.ndarray
    n: np.ndarray
    places: np.ndarray
    weight: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """(T,) what each point counts for, once they are thinned out."""

    @property
    def size(self) -> float:
        """The diagonal of what was met, metres; strays have no say."""
        low, high = np.percentile(self.p, (5.0, 95.0), axis=0)
        return max(float(np.linalg.norm(high - low)), 1e-6)


def plan_flight(scene: Scene) -> list[Camera]:
    """Return at most `VIEWS` key views of `scene` as it stands, that of its first camera first. The same every time.

    They are measured as the device measures, from the scene's origin.
    Raises LuxelError where no surface is seen from its cameras, nor from one that fits it.
    """
    starts = scene.host.local.cameras or [_fitting_camera(scene)]
    found = _explore(scene, starts)
    if len(found.p) < FEW and scene.host.data.cameras:
        fitting = [_fitting_camera(scene)]
        better = _explore(scene, fitting)
        starts, found = (fitting, better) if len(better.p) > len(found.p) else (starts, found)
    if not len(found.p):
        raise LuxelError(f"{scene.host.data.name}: no surface is seen from its cameras, so there is no flight")
    found = _thin_out(found)
    eyes = _choose_places(scene, found, [camera_axes(camera, scene.host.time)[0] for camera in starts])
    sees = _find_visible(scene, eyes, found)
    views, covers = _frame_views(starts, scene.host.time, eyes, sees, found)
    chosen = _choose_views(covers, found.weight / found.weight.sum())
    return _put_in_order(scene, [views[index] for index in chosen], found.size)


def free_ways(scene: Scene, views: list[Camera]) -> np.ndarray:
    """Return for each of `views` (N,) whether the straight way from its eye to the next one's is free (N - 1,).

    The views are in the file's coordinates.
    """
    eyes = np.array([camera_axes(view, scene.host.time)[0] for view in views]) - scene.host.origin
    return ~_is_blocked(scene, eyes[:-1], eyes[1:])


# --- start ---------------------------------------------------------------------------------------------------------


def _fitting_camera(scene: Scene) -> Camera:
    """Return the default camera of the scene."""
    return default_camera(replace(scene.host.local, cameras=[]))


# --- explore -------------------------------------------------------------------------------------------------------


def _explore(scene: Scene, starts: list[Camera]) -> _Found:
    """Return what rays from the cameras meet, then rays from free places between, and so on."""
    rng = np.random.default_rng(SEED)
    eyes = np.array([camera_axes(camera, scene.host.time)[0] for camera in starts])
    directions = _first_rays(starts, scene.host.time, rng)
    found, open_air = _Found(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3))), 0.0
    for turn in range(ROUNDS):
        count = directions.shape[1]
        t, p, n = _trace(scene, np.repeat(eyes, count, axis=0), directions.reshape(-1, 3))
        t[~_within_bounds(scene, p)] = np.inf
        t, met = t.reshape(-1, count), np.isfinite(t).reshape(-1, count)
        # Who starts within walls does not go and look at the house from without.
        closed = met[:, 1::2].mean(axis=1)
        if turn == 0 and closed.min() > WITHIN:
            open_air = ENCLOSED * closed.min()
        kept = met & (closed >= open_air)[:, None]
        found.p = np.concatenate([found.p, p[kept.ravel()]])
        found.n = np.concatenate([found.n, n[kept.ravel()]])
        if not len(found.p):
            break
        # Along a ray all is free up to what it met; where it met nothing, as far as things are about its source.
        size = found.size
        usual = np.array([np.median(row[row < np.inf]) if (row < np.inf).any() else size for row in t])
        reach = rng.uniform(0.2, 0.9, t.shape) * np.minimum(np.where(met, t, usual[:, None]), FAR * size)
        places = (eyes[:, None] + reach[..., None] * directions)[closed >= open_air].reshape(-1, 3)
        found.places = np.concatenate([found.places, places])
        eyes = _spread_out(found, rng)
        directions = _next_rays(found, eyes, rng)
    return found


def _within_bounds(scene: Scene, p: np.ndarray) -> np.ndarray:
    """Return which points (N, 3) lie in the robust bounds, but for a margin: a dome beyond them is as good as sky."""
    lower, upper = scene.host.lower, scene.host.upper
    margin = MARGIN * float(np.linalg.norm(upper - lower))
    return Box(lower - margin, upper + margin).holds(p, p)


def _spread_out(found: _Found, rng: np.random.Generator) -> np.ndarray:
    """Return `SOURCES` of the places at most, (E, 3), one a cell: who is far off counts as much as the crowd.

    Half of them by coarse cells, which lead round things and out of corners, half by fine ones, which lead into them.
    """
    middle = np.median(found.p, axis=0)
    near = found.places[np.linalg.norm(found.places - middle, axis=1) < 3.0 * found.size]
    # Cameras far off that meet little: any place is better than none.
    near = near if len(near) else found.places
    chosen = []
    for rooms in ROOMS:
        near = near[rng.permutation(len(near))]
        _, first = np.unique(np.floor(near / (found.size / rooms)), axis=0, return_index=True)
        chosen.append(near[rng.permutation(np.sort(first))[: SOURCES // len(ROOMS)]])
    return np.concatenate(chosen)


def _first_rays(starts: list[Camera], time: float, rng: np.random.Generator) -> np.ndarray:
    """Return unit directions (E, R, 3), by turns through each camera's picture and anywhere."""
    count = max(SOURCES * RAYS // (2 * len(starts)), RAYS)
    rows = []
    for camera in starts:
        _, right, up, forward = camera_axes(camera, time)
        half = np.tan(np.deg2rad(camera.fov) / 2.0)
        x, y = rng.uniform(-half, half, (2, count, 1))
        through = forward + x * right + y / ASPECT * up
        through /= np.linalg.norm(through, axis=1, keepdims=True)
        rows.append(np.stack([through, _spread(count, rng)], axis=1).reshape(-1, 3))
    return np.array(rows)


def _next_rays(found: _Found, eyes: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return unit directions (E, R, 3), by turns towards what lies about the surfaces known, and anywhere."""
    directions = _spread(len(eyes) * RAYS, rng).reshape(len(eyes), RAYS, 3)
    aims = found.p[rng.integers(len(found.p), size=(len(eyes), RAYS // 2))]
    towards = aims + rng.normal(0.0, 0.1 * found.size, aims.shape) - eyes[:, None]
    directions[:, ::2] = towards / np.maximum(np.linalg.norm(towards, axis=2, keepdims=True), 1e-12)
    return directions


def _spread(count: int, rng: np.random.Generator) -> np.ndarray:
    """Return `count` unit directions, uniform over the sphere."""
    directions = rng.normal(size=(count, 3))
    return directions / np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-12)


def _thin_out(found: _Found) -> _Found:
    """Return `found` without strays, a surface point for each side of a surface in a cell, `TARGETS` at most.

    Each counts by a root of how many rays have met its cell: what is much seen more than what is seen through gaps.
    """
    apart = np.linalg.norm(found.p - np.median(found.p, axis=0), axis=1)
    kept = apart <= FAR * max(float(np.median(apart)), 1e-9)
    p, n = found.p[kept], found.n[kept]
    axis = np.abs(n).argmax(axis=1)
    side = 2 * axis + (n[np.arange(len(n)), axis] > 0.0)
    keys = np.column_stack([np.floor(p / (found.size / CELLS)).astype(np.int64), side])
    _, first, count = np.unique(keys, axis=0, return_index=True, return_counts=True)
    order = np.random.default_rng(SEED).permutation(len(first))[:TARGETS]
    return _Found(p[first[order]], n[first[order]], found.places, count[order] ** EVEN)


def _choose_places(scene: Scene, found: _Found, starts: list[np.ndarray]) -> np.ndarray:
    """Return places (E, 3) with free air around, those of the first cameras before the others."""
    order = np.random.default_rng(SEED + 1).permutation(len(found.places))[: 8 * PLACES]
    places = found.places[order]
    around = np.repeat(places, len(DIRECTIONS), axis=0)
    t, _, _ = _trace(scene, around, np.tile(DIRECTIONS, (len(places), 1)))
    free = t.reshape(len(places), -1).min(axis=1)
    # In a narrow scene the roomier half of the places has to do.
    roomy = places[free >= min(CLEARANCE * found.size, float(np.median(free)))]
    return np.concatenate([np.array(starts), roomy[:PLACES]])


# --- choose --------------------------------------------------------------------------------------------------------


def _find_visible(scene: Scene, eyes: np.ndarray, found: _Found) -> np.ndarray:
    """Return which of the surface points each eye could see, (E, T), were it to turn there."""
    towards = eyes[:, None] - found.p
    distance = np.linalg.norm(towards, axis=2)
    facing = (towards * found.n).sum(axis=2) > GRAZING * distance
    seen = facing & (distance < 2.0 * found.size)
    eye, target = np.nonzero(seen)
    lifted = found.p + 4.0 * STEP * np.abs(found.p).max(axis=1, keepdims=True) * found.n
    seen[eye, target] = ~_is_blocked(scene, lifted[target], eyes[eye])
    return seen


def _frame_views(
    starts: list[Camera], time: float, eyes: np.ndarray, sees: np.ndarray, found: _Found
) -> tuple[list[Camera], np.ndarray]:
    """Return the views that come into question, the first cameras' own first, and which points each shows (V, T)."""
    own = [_still_view(camera, time) for camera in starts]
    turns = [
        Camera(_three(np.zeros(3)), _three(towards), _up_of(towards), FOV, name="flight") for towards in DIRECTIONS
    ]
    axes = np.stack([camera_axes(turn)[1:] for turn in turns])
    views, covers = list(own), []
    for view, seen in zip(own, sees, strict=False):
        covers.append(seen & _are_framed(found.p - np.array(view.eye), np.stack([camera_axes(view)[1:]]), view.fov)[0])
    for eye, seen in zip(eyes, sees, strict=True):
        views += [replace(turn, eye=_three(eye), target=_three(eye + np.array(turn.target))) for turn in turns]
        covers += list(seen & _are_framed(found.p - eye, axes, FOV))
    return views, np.array(covers)


def _still_view(camera: Camera, time: float) -> Camera:
    """Return the view of a camera at a time, as one at rest."""
    eye, _, up, forward = camera_axes(camera, time)
    return Camera(_three(eye), _three(eye + forward), _three(up), camera.fov, name="flight")


def _up_of(towards: np.ndarray) -> tuple[float, float, float]:
    return (0.0, 1.0, 0.0) if abs(towards[1]) < 0.9 else (0.0, 0.0, -1.0)


def _are_framed(offset: np.ndarray, axes: np.ndarray, fov: float) -> np.ndarray:
    """Return which points (T, 3), relative to the eye, lie in pictures `fov` degrees wide, (V, T).

    `axes` (V, 3, 3) are right, up and forward of each picture.
    """
    half = np.tan(np.deg2rad(fov) / 2.0)
    right, up, forward = np.moveaxis(axes @ offset.T, 1, 0)
    return (forward > 0.0) & (np.abs(right) <= half * forward) & (np.abs(up) <= half / ASPECT * forward)


def _choose_views(covers: np.ndarray, weight: np.ndarray) -> list[int]:
    """Return views, by number, that together show most points: the first, then whichever adds most.

    `weight` (T,) is what the points count for, one in all.
    """
    chosen, missing = [0], np.where(covers[0], 0.0, weight)
    while len(chosen) < VIEWS and missing.sum() > 1.0 - ENOUGH:
        gain = covers[:, missing > 0.0] @ missing[missing > 0.0]
        best = int(gain.argmax())
        if gain[best] < LEAST:
            break
        chosen.append(best)
        missing[covers[best]] = 0.0
    return chosen


def _put_in_order(scene: Scene, views: list[Camera], size: float) -> list[Camera]:
    """Return `views` so that each is near the one before, and in its sight where that can be; the first stays first."""
    ordered, rest = views[:1], views[1:]
    while rest:
        eye, others = np.array(ordered[-1].eye), np.array([view.eye for view in rest])
        blocked = _is_blocked(scene, np.tile(eye, (len(rest), 1)), others)
        cost = np.linalg.norm(others - eye, axis=1) + 4.0 * size * blocked
        ordered.append(rest.pop(int(cost.argmin())))
    return ordered


# --- rays ----------------------------------------------------------------------------------------------------------


def _trace(scene: Scene, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return distance (infinite for a miss), place and geometric normal towards the eye of what rays (N, 3) meet."""
    ray = vectors_from_numpy(mi.Vector3f, directions)
    everyone = from_numpy(mi.Bool, np.full(len(origins), True))
    hit = trace_closest(scene, vectors_from_numpy(mi.Point3f, origins), ray, everyone)
    surface = surface_at_hit(scene, hit, ray)
    t = np.where(np.array(hit.valid), np.array(hit.t), np.inf).astype(np.float64)
    return t, np.array(surface.p).T.astype(np.float64), np.array(surface.n_geometric).T.astype(np.float64)


def _is_blocked(scene: Scene, origins: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Return whether anything stands between pairs of points (N, 3)."""
    if not len(origins):
        return np.zeros(0, bool)
    offset = ends - origins
    distance = np.linalg.norm(offset, axis=1)
    ray = vectors_from_numpy(mi.Vector3f, offset / np.maximum(distance, 1e-12)[:, None])
    reach, active = from_numpy(mi.Float, distance), from_numpy(mi.Bool, distance > 0.0)
    return np.array(trace_occluded(scene, vectors_from_numpy(mi.Point3f, origins), ray, reach, active))


def _three(vector: np.ndarray) -> tuple[float, float, float]:
    return float(vector[0]), float(vector[1]), float(vector[2])
