"""Which surfels are given back by need, and how their ids come back to the free list.

After Ekberg 2022, section 3.1.1.2 (GIBS): how many live, how long ago a view saw one, how far it is and how well its
surroundings are covered without it say how likely it goes; then chance decides, as of a crowd only some must go. Chance
is a hash of a surfel's birth and of the frame, so it falls alike in every run.
"""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi

from luxel.kernels.reduce import sum_columns
from luxel.kernels.sampling import hash_pair, to_unit
from luxel.kernels.transform import fetch_matrix
from luxel.methods.gibs.gather import gather_irradiance
from luxel.methods.gibs.sizes import radius_of_size
from luxel.methods.gibs.surfels import FreeList, GibsState, Surfels
from luxel.scene.device import Scene

REST = 32
"""Frames in which an unseen surfel is safe."""
PRESSED_REST = 8
"""The same where the pool is all but full: what a camera looks at now comes first."""
RAY_SHARE = 1.0 / 64.0
"""Chance to be given back of surfels that only rays see, over that of others unseen for as long."""
ROOM = 1.0 / 32.0
"""Share of the limit that is kept free, for what views and rays place in the next frame."""
NEAREST, FARTHEST = 0.5, 2.0
"""Least and most that chance is multiplied with, by the distance over that of an average surfel."""
BARE, COVERED = 0.5, 2.0
"""Least and most that chance is multiplied with, by the coverage that the others leave over an ordinary one."""
ORDINARY = 0.25
"""Coverage in the middle of a surfel by all others, where they cover a place just so (measured on `atrium`)."""
CROWD, CROWD_CHANCE, CROWD_TURN = 3.0, 1.0 / 8.0, 16
"""Coverage by others from which on a surfel goes whoever sees it, the chance, and every how many frames it is asked."""
LOOK_FADES = 1.05
"""Factor a look by which a surfel's distance may grow: the nearest of several visitors has the say."""
NOTHING_LEFT = 1e-15
"""Volume, in that of its own space, of an object that is gone: one scaled by 1e-5."""


def choose_recycled(scene: Scene, state: GibsState, index: mi.UInt32) -> mi.Bool:
    """Return which surfels are given back; `index` is the frame's. Reads the lists of the last frame."""
    surfels, alive = state.surfels, state.surfels.object_id != 0
    share = _urgency(state, index, alive)
    (shares,) = sum_columns([share])
    living = mi.Float(state.settings.capacity - state.free.count)
    # Below the limit, or rays, which place none beyond it, would have no turn.
    excess = dr.fmax(living - (1.0 - ROOM) * state.dials.surfel_limit, 0.0)
    dice = to_unit(hash_pair(surfels.seed, index)[0])
    asked = to_unit_below(dice, COVERED * excess * share, shares)
    number = dr.arange(mi.UInt32, state.settings.capacity)
    crowded = alive & ((index + number) % CROWD_TURN == 0) & (dice < CROWD_CHANCE)
    # Only of those whom the dice choose must be known who covers the place beside them: the look-up is the cost.
    around = gather_irradiance(state, surfels.p, surfels.n, asked | crowded).coverage - 1.0
    left = dr.clip(around * (1.0 / ORDINARY), BARE, COVERED)
    goes = (asked & to_unit_below(dice, left * excess * share, shares)) | (crowded & (around > CROWD))
    return goes | (alive & is_gone(scene, surfels.object_id, alive))


def to_unit_below(dice: mi.Float, chance: mi.Float, whole: mi.Float) -> mi.Bool:
    """Return whether dice in [0, 1) fall below `chance` / `whole`, also where that is 0 / 0."""
    return dice * whole < chance


def _urgency(state: GibsState, index: mi.UInt32, alive: mi.Bool) -> mi.Float:
    """Return what each surfel's chance to go is in proportion to: 0 where a view has seen it of late."""
    surfels = state.surfels
    # A cache from a file may have seen frames that this run has not.
    pressed = mi.Float(state.free.count) < ROOM * state.settings.capacity
    rest = dr.select(pressed, mi.Float(PRESSED_REST), REST)
    unseen = mi.Float(index - dr.minimum(surfels.sight.seen, index)) - rest
    share = dr.select(alive & (unseen > 0.0), dr.square(unseen), 0.0)
    if state.settings.by_view:
        of_rays = dr.select(rays_lack(state) > 0.0, 0.0, RAY_SHARE)
        share *= dr.select(surfels.size > state.eyes.ray_size, 1.0, of_rays)
    # In radii, as larger surfels serve farther off.
    far = surfels.sight.near / radius_of_size(state, surfels.size)
    known = alive & (far < 1e9)
    total, count = sum_columns([dr.select(known, far, 0.0), dr.select(known, mi.Float(1.0), 0.0)])
    relative = dr.select(known, far * count / dr.fmax(total, 1e-20), 1.0)
    return share * dr.clip(relative, NEAREST, FARTHEST)


def is_gone(scene: Scene, object_id: mi.UInt32, active: mi.Bool) -> mi.Bool:
    """Return which surfels lie on objects that have been scaled to nothing, as scenes take them away."""
    if not scene.features.moving:
        return mi.Bool(False)
    x, y, z = (mi.Vector3f(row.x, row.y, row.z) for row in fetch_matrix(scene.geometry.to_world, object_id, active))
    return dr.abs(dr.dot(x, dr.cross(y, z))) <= NOTHING_LEFT


def nearest_look(near: mi.Float, distance: mi.Float) -> mi.Float:
    """Return how far the nearest view is, after one more look from `distance` metres."""
    return dr.fmin(near * LOOK_FADES, distance)


def give_back(state: GibsState, freed: mi.Bool) -> FreeList:
    """Return the free list with the ids of those that are freed on top, in their order: by a prefix sum."""
    one = dr.select(freed, mi.UInt32(1), 0)
    rank = dr.prefix_reduce(dr.ReduceOp.Add, one)
    ids = mi.UInt32(state.free.ids)
    dr.scatter(ids, dr.arange(mi.UInt32, state.settings.capacity), state.free.count + rank, freed)
    return FreeList(ids, state.free.count + dr.sum(one))


def recycle(state: GibsState, recycled: mi.Bool | None) -> tuple[Surfels, FreeList]:
    """Return the surfels without those that are given back, and the free ids."""
    if recycled is None:
        return state.surfels, state.free
    placed = dr.select(recycled, 0, state.surfels.object_id)
    return replace(state.surfels, object_id=placed), give_back(state, recycled)


def rays_lack(state: GibsState) -> mi.Float:
    """Return how many surfels of the share that is for what only rays see are not placed; 0 where it is used up."""
    surfels = state.surfels
    theirs = (surfels.object_id != 0) & (surfels.size <= state.eyes.ray_size)
    return dr.fmax(state.dials.ray_surfels - mi.Float(dr.sum(dr.select(theirs, mi.UInt32(1), 0))), 0.0)
