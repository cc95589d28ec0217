"""Which probes are read, which sleep, where the camera has gone, and where a place needs a probe of its own."""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from luxel.kernels.records import Surface
from luxel.kernels.sampling import mix
from luxel.methods.base import Frame
from luxel.methods.ddgi.state import (
    ASLEEP,
    AWAKE,
    REQUEST_COUNT,
    DdgiState,
    ExtraProbes,
    PlacementRequests,
    ProbeRayResults,
    Probes,
)
from luxel.methods.ddgi.volume import (
    Volume,
    cage_of,
    grid_coordinates,
    is_inside,
    node_of_probe,
    probe_of_node,
    world_position,
)
from luxel.methods.ddgi.weights import biased_point, octant_index

PIXELS_PER_VIEW_SAMPLE = 16
"""Pixels of which one speaks for the view, another one each frame."""
MAX_VIEW_SAMPLES = 32768
"""Pixels that speak for a large view; that many find all that it shows within seconds."""
NO_LANE = 0xFFFFFFFF


def mark_octants_read(state: DdgiState, read: mi.UInt32, p: mi.Point3f, active: mi.Bool) -> mi.UInt32:
    """Return the marks `read` with those of the eighths of cells that world points `p` lie in."""
    places = [grid_coordinates(volume, p) for volume in state.volumes]
    holds = [is_inside(volume, g) for volume, g in zip(state.volumes, places, strict=True)]
    outside_all = mi.Bool(True)
    for held in holds:
        outside_all &= ~held
    for number, (volume, g) in enumerate(zip(state.volumes, places, strict=True)):
        # A box that goes where the view looks is asked about what it holds, or about what no box does.
        asks = active & (holds[number] | outside_all) if number < state.settings.guided else active
        dr.scatter(read, mi.UInt32(1), octant_index(state, volume, *cage_of(volume, g)), asks)
    return read


@dataclass
class ViewSamples:
    """The pixels that speak for the view in one frame."""

    p: mi.Point3f
    n: mi.Normal3f
    wo: mi.Vector3f
    unseen: mi.Bool
    """No probe sees the point."""
    seen: mi.Bool
    """The pixel shows a surface."""


def sample_view(frame: Frame, surface: Surface, eye: mi.Point3f, weight: mi.Float) -> ViewSamples:
    """Return a share of the pixels, others each frame; `weight` is the look-up's answer there."""
    width = dr.width(surface.active)
    every = max(PIXELS_PER_VIEW_SAMPLE, -(-width // MAX_VIEW_SAMPLES))
    index = dr.arange(mi.UInt32, -(-width // every))
    lane = dr.minimum(index * every + mix(index + frame.index * 0x9E3779B9) % every, width - 1)
    seen = dr.gather(mi.Bool, surface.active, lane)
    p = dr.gather(mi.Point3f, surface.p, lane, seen)
    return ViewSamples(
        p=p,
        n=dr.gather(mi.Normal3f, surface.n_geometric, lane, seen),
        # Not gathered: nothing else of the frame needs the directions of all pixels in memory.
        wo=dr.normalize(eye - p),
        unseen=seen & (dr.gather(mi.Float, weight, lane, seen) < 0.5),
        seen=seen,
    )


def update_sleep(state: DdgiState) -> Probes:
    """Return the probes after those unread for long have fallen asleep, and those read again have woken."""
    probes, limit = state.probes, state.settings.sleep_after
    if limit == 0:
        return probes
    unread = dr.select(_was_read(state), 0, probes.unread + 1)
    alive = (probes.status == AWAKE) | (probes.status == ASLEEP)
    # A young probe has not been asked for long enough to be called unread.
    sleeps = alive & (unread > limit) & (probes.age > limit)
    wakes = (probes.status == ASLEEP) & (unread <= limit)
    status = dr.select(sleeps, mi.UInt32(ASLEEP), dr.select(wakes, mi.UInt32(AWAKE), probes.status))
    # Newly awake, it takes to its rays as it did in its first frames: what it knows may be long out of date. But it
    # knows something, and may be asked.
    return replace(probes, unread=unread, status=status, age=dr.select(wakes, 1, probes.age))


def _was_read(state: DdgiState) -> mi.Bool:
    """Return whose answer somebody wanted: marked is the eighth of a cell, a probe belongs to the cells around it."""
    settings, index = state.settings, dr.arange(mi.UInt32, state.settings.total)
    read = mi.Bool(False)
    for volume in state.volumes:
        mine = volume.owns(index)
        node = node_of_probe(volume, index - volume.first, volume.low)
        for corner in range(8):
            cell = probe_of_node(volume, node - mi.Vector3i(corner & 1, (corner >> 1) & 1, corner >> 2))
            for half in range(2):
                read |= mine & dr.any(dr.gather(mi.Vector4u, state.read, 2 * cell + half, mine) > 0)
    if settings.extra_count > 0:
        extra = index >= settings.probe_count
        read |= extra & (dr.gather(mi.UInt32, state.read, state.probes.part, extra) > 0)
    return read


def scroll_volumes(state: DdgiState, eye: mi.Point3f) -> tuple[tuple[Volume, ...], mi.Bool, Probes]:
    """Move every box by whole cells so that its middle stays with the camera; return boxes, entering probes, probes."""
    index = dr.arange(mi.UInt32, state.settings.total)
    entering = mi.Bool(False)
    probes = state.probes
    p, volumes = mi.Point3f(probes.p), []
    for volume in state.volumes:
        g = grid_coordinates(volume, eye)
        half = mi.Point3f(0.5 * (volume.nx - 1), 0.5 * (volume.ny - 1), 0.5 * (volume.nz - 1))
        # A camera that rests on the edge of a cell must not move the box to and fro: a tenth of a cell is slack.
        # And the box never leaves the scene behind: a camera outside looks at what is inside.
        lower, upper = scene_nodes(state, volume)
        span = mi.Point3f(volume.nx - 1.0, volume.ny - 1.0, volume.nz - 1.0)
        nearest, farthest = dr.minimum(lower, upper - span), dr.maximum(lower, upper - span)
        wish = dr.clip(g - half, nearest, farthest)
        stays = dr.abs(wish - mi.Point3f(volume.low)) < 0.6
        low = dr.select(stays, volume.low, mi.Vector3i(dr.round(wish)))
        mine = volume.owns(index)
        before = node_of_probe(volume, index - volume.first, volume.low)
        after = node_of_probe(volume, index - volume.first, low)
        new = mine & dr.any(before != after)
        p = dr.select(new, world_position(volume, mi.Point3f(after)), p)
        entering |= new
        volumes.append(replace(volume, low=low))
    return tuple(volumes), entering, replace(probes, p=p)


def reset_probes(probes: Probes, entering: mi.Bool) -> Probes:
    """Return the probes, of which those `entering` know nothing of their new place yet."""
    return replace(
        probes,
        offset=dr.select(entering, mi.Vector3f(0.0), probes.offset),
        status=dr.select(entering, mi.UInt32(AWAKE), probes.status),
        dead=dr.select(entering, 0.0, probes.dead),
        unfit=dr.select(entering, 0.0, probes.unfit),
        age=dr.select(entering, 0, probes.age),
        unread=dr.select(entering, 0, probes.unread),
        tries=dr.select(entering, 0, probes.tries),
    )


def scene_nodes(state: DdgiState, volume: Volume) -> tuple[mi.Point3f, mi.Point3f]:
    """Return the lattice coordinates of the box around all that there is."""
    a, b = grid_coordinates(volume, state.guide.lower), grid_coordinates(volume, state.guide.upper)
    return dr.minimum(a, b), dr.maximum(a, b)


def request_placements(state: DdgiState, view: ViewSamples) -> PlacementRequests:
    """Return where the view wants probes: at samples that no probe sees, one an eighth of a cell.

    The eighths share `REQUEST_COUNT` slots; of several samples of one slot the lowest wins, whatever the order of
    threads, and the others ask again in later frames.
    """
    volume, lane = state.volumes[-1], dr.arange(mi.UInt32, dr.width(view.unseen))
    place = grid_coordinates(volume, biased_point(state, volume, view.p, view.n, view.wo))
    part = octant_index(state, volume, *cage_of(volume, place))
    unseen = view.unseen
    if len(state.volumes) > 1:
        # Those held back serve the last box; who is asked in another one would not find them.
        unseen &= is_inside(volume, grid_coordinates(volume, view.p))
    wanted = unseen & (dr.gather(mi.UInt32, state.extras.of_part, part, unseen) == 0)
    winner = dr.full(mi.UInt32, NO_LANE, REQUEST_COUNT)
    dr.scatter_reduce(dr.ReduceOp.Min, winner, lane, mix(part) % REQUEST_COUNT, wanted)
    # The winners are read by their number: in memory they are not gathered from the picture again.
    dr.eval(winner, view.p, view.n, part)
    found = winner != NO_LANE
    new = PlacementRequests(
        dr.gather(mi.Point3f, view.p, winner, found),
        dr.gather(mi.Normal3f, view.n, winner, found),
        dr.gather(mi.UInt32, part, winner, found),
        found,
    )
    # Another view of the same frame may have asked before.
    requests = dr.select(found, new, state.wishes)
    return replace(requests, wanted=found | state.wishes.wanted)


def place_extra_probes(state: DdgiState, results: ProbeRayResults) -> tuple[Probes, ExtraProbes]:
    """Place probes held back where they were requested: half-way into the open, at most a cell's quarter away."""
    settings, extras, requests, probes = state.settings, state.extras, state.wishes, state.probes
    slot = dr.arange(mi.UInt32, REQUEST_COUNT)
    before, all_requests = _count_requests(requests.wanted, slot)
    left = settings.extra_count - extras.count
    granted = requests.wanted & (before < left)
    slot_of_rank, of_part = dr.zeros(mi.UInt32, REQUEST_COUNT), mi.UInt32(extras.of_part)
    dr.scatter(slot_of_rank, slot, before, granted)
    dr.scatter(of_part, settings.probe_count + extras.count + before, requests.part, granted)
    new = dr.minimum(all_requests, left)
    dr.eval(slot_of_rank, of_part, new)

    # Each new one takes its place, knowing nothing yet.
    number = dr.arange(mi.UInt32, settings.total) - settings.probe_count - extras.count
    new = dr.gather(mi.UInt32, new, 0)
    placed = number < new
    slot = dr.gather(mi.UInt32, slot_of_rank, number, placed)
    at, up = (
        dr.gather(mi.Point3f, requests.p, slot, placed),
        mi.Vector3f(dr.gather(mi.Normal3f, requests.n, slot, placed)),
    )
    ray = settings.total * settings.rays_per_probe + slot
    room = dr.abs(dr.gather(mi.Float, results.direction_depth, 4 * ray + 3, placed))
    place = mi.Point3f(at + up * dr.fmin(0.5 * room, 0.25 * state.volumes[-1].side))
    settled = replace(
        probes,
        p=dr.select(placed, place, probes.p),
        status=dr.select(placed, mi.UInt32(AWAKE), probes.status),
        age=dr.select(placed, 0, probes.age),
        unread=dr.select(placed, 0, probes.unread),
        part=dr.select(placed, dr.gather(mi.UInt32, requests.part, slot, placed), probes.part),
    )
    return settled, ExtraProbes(of_part, extras.count + new)


@dr.syntax
def _count_requests(wanted: mi.Bool, slot: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32]:
    """Return how many requests stand before each slot, and how many there are; so few that each counts for itself."""
    before, total, other = mi.UInt32(0), mi.UInt32(0), mi.UInt32(0)
    while other < REQUEST_COUNT:
        one = dr.select(dr.gather(mi.Bool, wanted, other), mi.UInt32(1), 0)
        before += dr.select(other < slot, one, 0)
        total += one
        other += 1
    return before, total
