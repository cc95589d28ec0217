"""Surfels as large as views ask for: one radius on the screen, whatever the distance.

`observe_surfels` leaves with each surfel that a view sees the size that this view wants, and when; several views leave
the smallest. `resize`, in the update, which knows no camera, lets surfels shrink to what is wanted, after some frames
in which smaller ones have come up around them, and grow again after more; of those that grow, as many are given back as
their larger neighbours make needless. Beyond a limit, surfels that no view has seen for long are given back too.

Brinck et al. 2021 (Ekberg 2022, section 3.1.1.2) keep surfels of one size on the screen; the rules here are ours.
"""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi

from luxel.kernels.camera import pixel_width, project
from luxel.kernels.gbuffer import GBuffer
from luxel.kernels.reduce import sum_columns
from luxel.kernels.sampling import hash_pair, mix, to_unit
from luxel.methods.gibs.recycle import RAY_SHARE, REST, give_back, nearest_look, rays_lack
from luxel.methods.gibs.sizes import size_for_radius
from luxel.methods.gibs.surfels import FreeList, GibsState, Sight, Surfels

TOO_LARGE = 1
"""Sizes by which a surfel may be larger than wanted, and still serve."""
SHRINK_AFTER, GROW_AFTER, GROW_SPREAD = 16, 64, 32
"""Frames of patience, in a row before it grows; that takes up to a spread more, by chance, so that not all do it at
once."""
DEPTH_SLACK = 0.02
"""Share of the distance by which a surfel may lie behind what a pixel shows, and still be seen."""
SALT = 0x51F15E11
"""Keeps the choice of those that grow apart from the surfels' other dice."""


def pixel_sizes(state: GibsState, gbuffer: GBuffer, pixels: mi.Float) -> mi.UInt32:
    """Return the size of surfel that each pixel wants, where the view's radius is so many pixels."""
    x, y = gbuffer.film.image_coordinates(gbuffer.pixel)
    return dr.select(gbuffer.surface.active, wanted_size(state, gbuffer, pixels, x, y, gbuffer.depth), 0)


def largest_served(size: mi.UInt32) -> mi.UInt32:
    """Return the size of the largest surfels that serve where `size` is wanted."""
    return dr.select(size > TOO_LARGE, size - TOO_LARGE, 0)


def wanted_size(
    state: GibsState, gbuffer: GBuffer, pixels: mi.Float, x: mi.Float, y: mi.Float, distance: mi.Float
) -> mi.UInt32:  # fmt: skip
    """Return the size that is nearest to a radius in the view's pixels, at `x`, `y` and a distance in metres."""
    size = gbuffer.film.width, gbuffer.film.height
    return size_for_radius(state, pixels * pixel_width(gbuffer.camera, size, x, y, distance))


def observe_surfels(state: GibsState, index: mi.UInt32, gbuffer: GBuffer, pixels: mi.Float) -> Sight:
    """Return the surfels' sight with what this view sees; `index` is the frame's, `pixels` the view's radius."""
    surfels, sight, film, camera = state.surfels, state.surfels.sight, gbuffer.film, gbuffer.camera
    x, y, in_front = project(camera, surfels.p)
    column = mi.Int32(dr.floor(dr.clip((x + 1.0) * (0.5 * film.width), -1.0, film.width)))
    row = mi.Int32(dr.floor(dr.clip((1.0 - y) * (0.5 * film.height), -1.0, film.height)))
    lane, inside = film.lane_of_pixel(column, row)
    # Who has seen nothing but sky so far asks for no size.
    candidate = (surfels.object_id != 0) & in_front & inside & (pixels > 0.0)
    depth = dr.gather(mi.Float, gbuffer.depth, lane, candidate)
    distance = dr.norm(surfels.p - (camera.eye + x * camera.across + y * camera.upwards))
    size = wanted_size(state, gbuffer, pixels, x, y, distance)
    seen = candidate & (distance < depth * (1.0 + DEPTH_SLACK))
    return Sight(
        seen=dr.select(seen, index, sight.seen),
        wanted=dr.select(seen, dr.maximum(sight.wanted, size + 1), sight.wanted),
        patience=sight.patience,
        near=None if sight.near is None else nearest_look(sight.near, distance),
    )


def resize(state: GibsState, index: mi.UInt32, recycled: mi.Bool | None = None) -> tuple[Surfels, FreeList]:
    """Return the surfels in the sizes that views wanted in the last frame, and the free ids; `index` is the frame's.

    `recycled` are given back beside those that have become needless; None: those that no view has seen for too long.
    """
    surfels, sight = state.surfels, state.surfels.sight
    alive = surfels.object_id != 0
    asked = alive & (sight.wanted > 0)
    wanted = sight.wanted - 1
    too_large = asked & (wanted > surfels.size + TOO_LARGE)
    too_small = asked & (surfels.size > wanted + TOO_LARGE)
    # A view that is content takes back nobody's wish for smaller ones, but that for larger ones: views may take turns.
    for_larger, for_smaller = sight.patience & 0xFFFF, sight.patience >> 16
    for_larger = dr.select(asked, dr.select(too_small, for_larger + 1, 0), for_larger)
    for_smaller = dr.select(too_large, for_smaller + 1, for_smaller)
    chance = mix(surfels.seed ^ SALT)
    shrinks = too_large & (for_smaller >= SHRINK_AFTER)
    grows = too_small & (for_larger >= GROW_AFTER + chance % GROW_SPREAD)
    changes = shrinks | grows
    size = dr.select(changes, wanted, surfels.size)

    # A step up doubles what a surfel covers, so half of them go; those that stay are the same whichever way sizes went.
    fewer = (mi.UInt32(1) << dr.minimum(dr.select(grows, surfels.size - wanted, 0), 31)) - 1
    needless = grows & (((chance >> 5) & fewer) != 0)
    freed = needless | (_unseen_too_long(state, index, alive) if recycled is None else recycled)
    free = give_back(state, freed)
    # An array and no plain zero, which a second look in the same frame would record anew.
    patience = dr.select(changes, 0, for_smaller << 16 | for_larger)
    sight = Sight(sight.seen, dr.select(alive, 0, sight.wanted), patience, sight.near)
    placed = dr.select(freed, 0, surfels.object_id)
    return replace(surfels, object_id=placed, size=size, sight=sight), free


def _unseen_too_long(state: GibsState, index: mi.UInt32, alive: mi.Bool) -> mi.Bool:
    """Return which surfels are given back because there are too many: by chance, the likelier the longer unseen.

    Those as large as rays place them are the last to go: they serve what only rays see. Their own share never goes.
    """
    surfels = state.surfels
    # A cache from a file may have seen frames that this run has not.
    seen = dr.minimum(surfels.sight.seen, index)
    unseen = mi.Float(index - seen) - REST
    share = dr.select(alive & (unseen > 0.0), dr.square(unseen), 0.0)
    share *= dr.select(surfels.size > state.eyes.ray_size, 1.0, dr.select(rays_lack(state) > 0.0, 0.0, RAY_SHARE))
    (shares,) = sum_columns([share])
    excess = dr.fmax(mi.Float(state.settings.capacity - state.free.count) - state.dials.surfel_limit, 0.0)
    dice, _ = hash_pair(surfels.seed, index)
    return to_unit(dice) * shares < excess * share
