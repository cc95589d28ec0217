"""Which sides of surfaces lie in the open: rays from surfaces, lamps and cameras tell.

Points on backs lie in the open where most of their rays leave the scene, meet fronts, or backs that lie in the open:
settled in a few rounds. So the two sides of a cloth do, and the inside of a column without lids does not.

A closed surface parts the open from the inside of a thing, and its winding should say which is which. Where its backs
are what others see, its winding is reversed: its fronts lie inside, unless something in the open sees them too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np
import scipy

from luxel.kernels.fibonacci import fibonacci_direction
from luxel.kernels.ray_origin import clear_points
from luxel.kernels.trace import trace_closest
from luxel.methods.lightmap.flatten.octaves import Parts, on_triangle
from luxel.scene.arrays import from_numpy, vectors_from_numpy
from luxel.scene.device import Scene
from luxel.scene.lights import ENTRY_IS_DELTA

VOTE_POINTS, VOTE_RAYS, ROUNDS = 8192, 16, 3
"""Points on either side and rays a point that look for backs, and rounds in which their openness settles."""
EYE_POINTS = 64
"""Times that a camera or a lamp without a surface counts as a point."""
VOTE_HITS, SEEN_SHARE = 3, 0.02
"""Rays that must meet a part's side, and their share of those that meet the other, for it to count."""
OPEN = 0.65
"""Share of a point's rays that must find open space for it to lie there."""
INSIDE_SHARE = 0.5
"""Share of rays that meet the inside of things from which a point lies inside geometry."""


@dataclass
class Shells:
    """T triangles, of P connected parts."""

    corners: np.ndarray
    """(T, 3, 3) world positions."""
    normal: np.ndarray
    """(T, 3) unit normal of the front."""
    parts: Parts
    """What points are spread over: a ground to the horizon would take them all."""
    weight: np.ndarray
    """(N,) the parts' shares of the points."""
    two_sided: np.ndarray
    """(T,) bool: the back reflects too."""
    part: np.ndarray
    """(T,)."""
    closed: np.ndarray
    """(P,) bool: the part is a closed surface."""


def orient_shells(still: Scene, shells: Shells) -> tuple[Shells, np.ndarray, np.ndarray]:
    """Return the shells with reversed ones turned, which parts (P,) those are, and which carry light on their backs.

    Fronts and backs are those after the turn; fronts carry light.
    """
    turned = np.zeros(len(shells.closed), bool)
    front, back = find_open_sides(still, shells)
    for _ in range(ROUNDS):
        wrong = back & ~front
        if not wrong.any():
            break
        # What stands in a room of reversed winding shows only when the room is turned.
        turned ^= wrong
        shells = replace(shells, normal=np.where(wrong[shells.part][:, None], -shells.normal, shells.normal))
        front, back = find_open_sides(still, shells)
    return shells, turned, back


def find_open_sides(still: Scene, shells: Shells) -> tuple[np.ndarray, np.ndarray]:
    """Return which parts (P,) carry light on their fronts, and which on their backs.

    The back of a closed surface does where surfaces, cameras or lamps see it more than its front; then its front does
    where they see that as well. The back of a sheet does where it lies in the open and they see it.
    """
    random = np.random.default_rng(7)
    part, sheet = shells.part, ~shells.closed[shells.part]
    front = _sample(shells, 1.0, np.ones(len(part), bool), VOTE_POINTS, random)
    behind = _sample(shells, -1.0, sheet & shells.two_sided, VOTE_POINTS, random)
    front_hits, back_hits = _cast(still, front, shells, random), _cast(still, behind, shells, random)
    known = [_cast(still, viewers, shells, random) for viewers in (_cameras(still), _lamps(still, shells, random))]
    known_votes = [_count_seen(hits, shells) for hits in known]
    nearest = [_find_nearest(hits, behind, sheet & shells.two_sided) for hits in (front_hits, back_hits)]
    can_turn = shells.closed & (np.bincount(part, weights=shells.two_sided, minlength=len(shells.closed)) > 0)
    is_open = np.zeros(len(behind.p), bool)
    on_front, on_back = np.ones(len(shells.closed), bool), np.zeros(len(shells.closed), bool)

    def is_fair(hits: _ViewerHits, near: np.ndarray) -> np.ndarray:
        """Return which rays found open space: the sky, or a side that lies in the open."""
        of = part[np.maximum(hits.prim, 0)]
        of_sheet = np.append(is_open, False)[near]
        return (hits.prim < 0) | np.where(hits.back, of_sheet | on_back[of], on_front[of])

    votes = np.zeros((3, 2, len(shells.closed)))
    for _ in range(ROUNDS):
        is_open = is_fair(back_hits, nearest[1]).mean(axis=1) >= OPEN
        lit = is_fair(front_hits, nearest[0]).mean(axis=1) >= OPEN
        votes = np.stack([_count_seen(front_hits, shells, lit), *known_votes])
        found = ~on_back & can_turn & ((votes[:, 1] >= VOTE_HITS) & (votes[:, 1] > votes[:, 0])).any(axis=0)
        on_back |= found
        # What a closed surface hides must not speak for its hidden side: that begins as no open space.
        seen = ((votes[:, 0] >= VOTE_HITS) & (votes[:, 0] > SEEN_SHARE * votes[:, 1])).any(axis=0)
        on_front = ~on_back | (seen & ~found)
    of_front, of_back = votes.sum(axis=0)
    held = np.bincount(part[behind.prim], minlength=len(shells.closed))
    openness = np.bincount(part[behind.prim], weights=is_open, minlength=len(held)) / np.maximum(held, 1)
    # A part too small for a point of its own goes by what is seen of it.
    of_sheets = ((openness >= INSIDE_SHARE) | (held == 0)) & (of_back >= VOTE_HITS) & (of_back > SEEN_SHARE * of_front)
    return on_front, np.where(shells.closed, on_back, of_sheets)


@dataclass
class _Viewers:
    """Points that look around."""

    prim: np.ndarray
    """The triangle that each lies on; -1: on none."""
    p: np.ndarray
    n: np.ndarray
    """The way each faces; zero: all around."""


@dataclass
class _ViewerHits:
    """What `VOTE_RAYS` rays from each point met: triangle (-1: none), whether its back, and where."""

    sample: _Viewers
    prim: np.ndarray
    back: np.ndarray
    p: np.ndarray


def _sample(shells: Shells, side: float, chosen: np.ndarray, count: int, random: np.random.Generator) -> _Viewers:
    """Return `count` points spread over the fronts (`side` 1) or backs (-1) of `chosen` (T,) triangles."""
    weight = shells.weight * chosen[shells.parts.triangle]
    if not weight.any():
        return _Viewers(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3)))
    piece = random.choice(len(weight), count, p=weight / weight.sum())
    prim = shells.parts.triangle[piece]
    u, v = np.sqrt(random.random(count)), random.random(count)
    weights = np.stack([1.0 - u, u * (1.0 - v), u * v], axis=1)
    weights = on_triangle(shells.parts.inside, piece, weights)
    normal = side * shells.normal[prim]
    corners = shells.corners[prim]
    p = clear_points((corners * weights[..., None]).sum(axis=1), normal, corners)
    return _Viewers(prim, p, normal)


def _cameras(still: Scene) -> _Viewers:
    data = still.host.local
    return _look_around([camera.eye for camera in (*data.cameras, *data.flight)])


def _lamps(still: Scene, shells: Shells, random: np.random.Generator) -> _Viewers:
    """Return points on the fronts that shine, and the places of lamps without a surface."""
    entries = np.array(still.lights.entries).astype(np.int64)
    shines = np.zeros(len(shells.part), bool)
    shines[entries[entries < min(ENTRY_IS_DELTA, len(shines))]] = True
    points = _look_around([light.position for light in still.host.local.lights if light.kind != "directional"])
    panels = _sample(shells, 1.0, shines, VOTE_POINTS // 8, random)
    return _Viewers(*(np.concatenate(pair) for pair in zip(vars(points).values(), vars(panels).values(), strict=True)))


def _look_around(places: list[tuple[float, float, float]]) -> _Viewers:
    p = np.repeat(np.array(places, np.float64).reshape(-1, 3), EYE_POINTS, axis=0)
    return _Viewers(np.full(len(p), -1), p, np.zeros_like(p))


def _count_seen(hits: _ViewerHits, shells: Shells, chosen: np.ndarray | None = None) -> np.ndarray:
    """Return how many rays of the `chosen` points met each part's front and back, (2, P); a closed surface's own do not
    count."""
    viewer, prim = np.broadcast_to(hits.sample.prim[:, None], hits.prim.shape), hits.prim
    of, own = shells.part[np.maximum(prim, 0)], shells.part[np.maximum(viewer, 0)]
    counts = (prim >= 0) & ~((viewer >= 0) & (own == of) & shells.closed[of])
    if chosen is not None:
        counts &= chosen[:, None]
    return np.stack([np.bincount(of[counts & (hits.back == s)], minlength=len(shells.closed)) for s in (False, True)])


def _find_nearest(hits: _ViewerHits, behind: _Viewers, is_held: np.ndarray) -> np.ndarray:
    """Return the point of `behind` nearest to each ray's end on a back of the triangles held; -1: it ends elsewhere."""
    index = np.full(hits.prim.shape, -1)
    met = hits.back & (hits.prim >= 0) & is_held[hits.prim]
    if met.any():
        index[met] = scipy.spatial.KDTree(behind.p).query(hits.p[met])[1]
    return index


def _cast(still: Scene, sample: _Viewers, shells: Shells, random: np.random.Generator) -> _ViewerHits:
    """Cast each point's rays by the cosine about its normal, or all around."""
    count, shape = len(sample.p), (len(sample.p), VOTE_RAYS)
    if not count:
        return _ViewerHits(sample, np.zeros(shape, np.int64), np.zeros(shape, bool), np.zeros((*shape, 3)))
    lane = dr.arange(mi.UInt32, count * VOTE_RAYS)
    point = lane // VOTE_RAYS
    origin = dr.gather(mi.Point3f, vectors_from_numpy(mi.Point3f, sample.p), point)
    about = dr.gather(mi.Vector3f, vectors_from_numpy(mi.Vector3f, sample.n), point)
    turn = random.integers(0, 4096, count).astype(np.uint32)
    step = (lane % VOTE_RAYS) * 4096 + dr.gather(mi.UInt32, from_numpy(mi.UInt32, turn), point)
    # A point of the sphere added to the normal follows the cosine.
    direction = dr.normalize(fibonacci_direction(step, mi.UInt32(VOTE_RAYS * 4096)) + 0.999 * about)
    hit = trace_closest(still, origin, direction, mi.Bool(True))
    where = np.array(origin + direction * dr.select(hit.valid, hit.t, 0.0)).T
    prim = np.where(np.array(hit.valid), np.array(hit.prim_id).astype(np.int64), -1)
    back = (shells.normal[np.maximum(prim, 0)] * np.array(direction).T).sum(axis=1) > 0.0
    return _ViewerHits(sample, prim.reshape(shape), (back & (prim >= 0)).reshape(shape), where.reshape(*shape, 3))
