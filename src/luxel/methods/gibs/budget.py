"""The ray budget: how many rays each surfel casts in a frame, so that all together never cast more than is allowed.

After Ekberg 2022, section 3.1.3 (GIBS): surfels in view, young ones and those whose short and long means disagree get
more rays. What they ask for is counted first; then everybody is scaled, by one prefix sum in whole 128ths of a ray, so
that the launch has one width whatever happens. Beside that each surfel has its turn, at the latest after some frames.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from luxel.kernels.reduce import sum_columns
from luxel.kernels.sampling import hash_pair
from luxel.methods.gibs.params import VIEW_TURN
from luxel.methods.gibs.surfels import GibsState

LOOK = 8
"""Frames for which a look counts: visitors may take turns."""
OTHER_TURN = 64
"""Frames within which each surfel that no view sees casts a ray."""
PARTS = 128
"""What demand is counted in: so many to a ray."""
MARGIN = 1.0 - 2.0**-12
"""Keeps what sums of floats round off from costing anybody a ray."""
OTHER_SHARE = 0.25
"""Rays of a surfel that no view sees, over those of one in view."""
YOUNG, YOUNG_FACTOR = 16.0, 4.0
"""Samples up to which a surfel asks for more, and how many times as much at first."""
SURE, UNSURE = 0.25, 0.5
"""Inconsistency from which on a surfel wakes, and with which it gets as many rays as one in view."""
SETTLED = 256.0
"""Samples from which on it asks for less."""
ALARMING = 1.0 / 30.0
"""Common drift at which all get as many rays as one in view."""


@dataclass
class RayPlan:
    """Which rays each surfel casts in a frame: from number `first` on, `count` of them, side by side."""

    first: mi.UInt32
    count: mi.UInt32
    total: mi.UInt32
    """Of all surfels."""


def plan_rays(state: GibsState, index: mi.UInt32) -> RayPlan:
    """Return this frame's rays; `index` is the frame's."""
    settings = state.settings
    number = dr.arange(mi.UInt32, settings.capacity)
    alive = state.surfels.object_id != 0
    if not settings.share_rays:
        count = dr.select(alive, mi.UInt32(settings.rays_per_surfel), 0)
        return RayPlan(number * settings.rays_per_surfel, count, mi.UInt32(settings.ray_lanes))
    in_view = is_in_view(state, index, alive)
    # Turns go by ids, which no two surfels share: in no frame it is the turn of more than an eighth of the pool.
    turn = dr.select(in_view, mi.UInt32(VIEW_TURN), OTHER_TURN)
    due = alive & ((index + number) % turn == 0)
    wanted = demand(state, alive, in_view)
    asked, owed = sum_columns([wanted, dr.select(due, mi.Float(1.0), 0.0)])
    scale = dr.fmin((float(settings.ray_lanes) - owed) * MARGIN / dr.fmax(asked, 1e-6), 1.0)
    parts = mi.UInt32(wanted * scale * PARTS) + dr.select(due, mi.UInt32(PARTS), 0)
    return share_out(parts, hash_pair(index, state.seed)[0] % PARTS, settings.ray_lanes)


def share_out(parts: mi.UInt32, shift: mi.UInt32, most: int) -> RayPlan:
    """Return whole rays for so many 128ths each: on average as many, and never more than `most` together.

    `shift` (0 to 127) says where the rounding begins: at random, each gets its own on average.
    """
    before = dr.prefix_reduce(dr.ReduceOp.Add, parts)
    first = dr.minimum((before + shift) // PARTS, most)
    end = dr.minimum((before + parts + shift) // PARTS, most)
    return RayPlan(first, end - first, dr.max(end))


def is_in_view(state: GibsState, index: mi.UInt32, alive: mi.Bool) -> mi.Bool:
    """Return which surfels a view has seen of late; all, where no view has seen any."""
    seen = dr.minimum(state.surfels.sight.seen, index)
    in_view = alive & (index - seen <= LOOK)
    (count,) = sum_columns([dr.select(in_view, mi.Float(1.0), 0.0)])
    return alive & (in_view | (count == 0.0))


def demand(state: GibsState, alive: mi.Bool, in_view: mi.Bool) -> mi.Float:
    """Return how many rays each surfel asks for.

    The noise of a surfel's own samples has no say: where rare rays bring most of the light it is known badly, and
    those that met them would get rays, not those that missed them.
    """
    estimate = state.surfels.estimate
    youth = dr.clip(1.0 - estimate.count * (1.0 / YOUNG), 0.0, 1.0)
    doubt = dr.clip((estimate.inconsistency - SURE) * (1.0 / (UNSURE - SURE)), 0.0, 1.0)
    # Who has many samples sleeps the deeper the more there are; common alarms wake all.
    settled = dr.clip(SETTLED / dr.fmax(estimate.count, 1.0), 0.0, 1.0)
    usual = dr.select(in_view, mi.Float(1.0), OTHER_SHARE) * settled
    factor = dr.fmax(usual, dr.fmax(YOUNG_FACTOR * youth, doubt))
    alarm = dr.clip(state.drift * (1.0 / ALARMING), 0.0, 1.0)
    return dr.select(alive, state.settings.rays_per_surfel * dr.fmax(factor, alarm), 0.0)


def ray_owners(state: GibsState, plan: RayPlan) -> tuple[mi.UInt32, mi.UInt32, mi.Bool]:
    """Return for each lane its surfel, which of the surfel's rays it is, and whether it is one at all."""
    if state.settings.share_rays:
        return owners(plan, state.settings.ray_lanes)
    rays = state.settings.rays_per_surfel
    lane = dr.arange(mi.UInt32, state.settings.ray_lanes)
    surfel = lane // rays
    return surfel, lane % rays, dr.gather(mi.UInt32, plan.count, surfel) > 0


def plan_of(cast: mi.UInt32) -> RayPlan:
    """Return the plan by which surfels cast so many rays each."""
    return RayPlan(dr.prefix_reduce(dr.ReduceOp.Add, cast), cast, dr.sum(cast))


@dr.syntax
def owners(plan: RayPlan, lanes: int) -> tuple[mi.UInt32, mi.UInt32, mi.Bool]:
    """Return for each lane its surfel, which of the surfel's rays it is, and whether it is one at all."""
    owner = dr.zeros(mi.UInt32, lanes)
    surfel = dr.arange(mi.UInt32, dr.width(plan.count))
    ray = mi.UInt32(0)
    while ray < plan.count:
        dr.scatter(owner, surfel, plan.first + ray)
        ray += 1
    lane = dr.arange(mi.UInt32, lanes)
    active = lane < plan.total
    return owner, lane - dr.gather(mi.UInt32, plan.first, owner, active), active
