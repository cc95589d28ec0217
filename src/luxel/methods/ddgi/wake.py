"""Which probes are read, which sleep, where the camera has gone, and where a place needs a probe of its own."""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from luxel.kernels.records import Surface
from luxel.kernels.sampling import mix
from luxel.kernels.trace import trace_closest
from luxel.methods.base import Frame
from luxel.methods.ddgi.query import biased_point, part_of
from luxel.methods.ddgi.state import ASLEEP, AWAKE, DdgiState, Extras, Probes
from luxel.methods.ddgi.volume import Volume, cage_of, grid_coordinates, node_of_probe, probe_of_node, world_position
from luxel.scene.device import Scene

MARK_EVERY = 16
"""Pixels of which one marks the probes it read, another one each frame."""
SPAWNS_A_FRAME = 64
"""Probes held back that a frame places at most."""
NOBODY = 0xFFFFFFFF


def mark_read(state: DdgiState, unread: mi.UInt32, p: mi.Point3f, active: mi.Bool) -> mi.UInt32:
    """Return `unread` with zero for every probe of the cages around world points `p`."""
    for volume in state.volumes:
        base, inner = cage_of(volume, grid_coordinates(volume, p))
        for corner in range(8):
            bits = mi.Vector3i(corner & 1, (corner >> 1) & 1, corner >> 2)
            dr.scatter(unread, mi.UInt32(0), probe_of_node(volume, base + bits), active)
        if state.settings.extra_count:
            extra = dr.gather(mi.UInt32, state.extras.of_part, part_of(state, volume, base, inner), active)
            dr.scatter(unread, mi.UInt32(0), extra, active & (extra > 0))
    return unread


@dataclass
class Witnesses:
    """The pixels that speak for the view in one frame."""

    p: mi.Point3f
    n: mi.Normal3f
    wo: mi.Vector3f
    unseen: mi.Bool
    """No probe sees the point."""
    seen: mi.Bool
    """The pixel shows a surface."""


def call_witnesses(frame: Frame, surface: Surface, eye: mi.Point3f, weight: mi.Float) -> Witnesses:
    """Return one pixel in every `MARK_EVERY`, another one each frame; `weight` is the look-up's answer there."""
    width = dr.width(surface.active)
    index = dr.arange(mi.UInt32, -(-width // MARK_EVERY))
    lane = dr.minimum(index * MARK_EVERY + mix(index + frame.index * 0x9E3779B9) % MARK_EVERY, width - 1)
    seen = dr.gather(mi.Bool, surface.active, lane)
    p = dr.gather(mi.Point3f, surface.p, lane, seen)
    return Witnesses(
        p=p,
        n=dr.gather(mi.Normal3f, surface.n_geometric, lane, seen),
        # Not gathered: nothing else of the frame needs the directions of all pixels in memory.
        wo=dr.normalize(eye - p),
        unseen=seen & (dr.gather(mi.Float, weight, lane, seen) < 0.5),
        seen=seen,
    )


def fall_asleep(state: DdgiState) -> Probes:
    """Return the probes one frame later: those unread for long asleep, those read again awake."""
    probes, limit = state.probes, state.settings.sleep_after
    unread = probes.unread + 1
    if limit == 0:
        return replace(probes, unread=unread)
    alive = (probes.status == AWAKE) | (probes.status == ASLEEP)
    # A young probe has not been asked for long enough to be called unread.
    sleeps = alive & (unread > limit) & (probes.age > limit)
    wakes = (probes.status == ASLEEP) & (unread <= limit)
    status = dr.select(sleeps, mi.UInt32(ASLEEP), dr.select(wakes, mi.UInt32(AWAKE), probes.status))
    # Newly awake, it takes to its rays as it did in its first frames: what it knows may be long out of date.
    return replace(probes, unread=unread, status=status, age=dr.select(wakes, 0, probes.age))


def follow(scene: Scene, state: DdgiState, eye: mi.Point3f) -> tuple[tuple[Volume, ...], mi.Bool, Probes]:
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
        lower, upper = _scene_nodes(scene, volume)
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


def _scene_nodes(scene: Scene, volume: Volume) -> tuple[mi.Point3f, mi.Point3f]:
    """Return the lattice coordinates of the scene's bounds."""
    a, b = grid_coordinates(volume, scene.lower), grid_coordinates(volume, scene.upper)
    return dr.minimum(a, b), dr.maximum(a, b)


def clear_probes(state: DdgiState, gone: mi.Bool) -> DdgiState:
    """Return the state in which the probes of `gone` know nothing: their texels start anew with the next rays."""
    settings = state.settings
    light = dr.repeat(gone, settings.irradiance_resolution**2)
    far = dr.repeat(gone, settings.depth_resolution**2)
    estimate, depth = state.irradiance, state.depth
    return replace(
        state,
        irradiance=replace(estimate, count=dr.select(light, 0.0, estimate.count)),
        depth=replace(depth, weight=dr.select(far, 0.0, depth.weight)),
    )


def place_extras(
    scene: Scene, state: DdgiState, p: mi.Point3f, n: mi.Normal3f, wo: mi.Vector3f, unseen: mi.Bool
) -> tuple[Probes, Extras]:
    """Place probes held back where points `p` are `unseen`: half-way into the open, at most a cell's quarter away.

    One an eighth of a cell; the lowest lane wins, whatever the order of threads.
    """
    settings, volume = state.settings, state.volumes[-1]
    lane = dr.arange(mi.UInt32, dr.width(unseen))
    x = biased_point(state, volume, p, n, wo)
    part = part_of(state, volume, *cage_of(volume, grid_coordinates(volume, x)))
    wanted = unseen & (dr.gather(mi.UInt32, state.extras.of_part, part, unseen) == 0)
    winners = dr.full(mi.UInt32, NOBODY, dr.width(state.extras.of_part))
    dr.scatter_reduce(dr.ReduceOp.Min, winners, lane, part, wanted)
    dr.eval(winners)
    wanted &= dr.gather(mi.UInt32, winners, part, wanted) == lane
    rank = dr.prefix_reduce(dr.ReduceOp.Add, dr.select(wanted, mi.UInt32(1), 0))
    free = settings.extra_count - state.extras.count
    wanted &= (rank < free) & (rank < SPAWNS_A_FRAME)
    probe = settings.probe_count + state.extras.count + rank

    # Gather the chosen few, and look how far the open reaches along their normals.
    chosen = dr.full(mi.UInt32, NOBODY, SPAWNS_A_FRAME)
    dr.scatter(chosen, lane, rank, wanted)
    dr.eval(chosen)
    real = chosen != NOBODY
    at, up = dr.gather(mi.Point3f, p, chosen, real), mi.Vector3f(dr.gather(mi.Normal3f, n, chosen, real))
    start = at + up * scene.epsilon
    room = trace_closest(scene, start, up, real).t
    place = at + up * dr.fmin(0.5 * room, 0.25 * volume.side)
    slot = settings.probe_count + state.extras.count + dr.arange(mi.UInt32, SPAWNS_A_FRAME)
    x, y, z = (mi.Float(c) for c in (state.probes.p.x, state.probes.p.y, state.probes.p.z))
    status = mi.UInt32(state.probes.status)
    age, unread = mi.UInt32(state.probes.age), mi.UInt32(state.probes.unread)
    for target, value in ((x, place.x), (y, place.y), (z, place.z)):
        dr.scatter(target, value, slot, real)
    dr.scatter(status, mi.UInt32(AWAKE), slot, real)
    dr.scatter(age, mi.UInt32(0), slot, real)
    dr.scatter(unread, mi.UInt32(0), slot, real)
    of_part = mi.UInt32(state.extras.of_part)
    dr.scatter(of_part, probe, part, wanted)
    count = state.extras.count + dr.sum(dr.select(real, mi.UInt32(1), 0))
    probes = replace(state.probes, p=mi.Point3f(x, y, z), status=status, age=age, unread=unread)
    return probes, Extras(of_part, count)
