"""Dead probes: found by the back faces they see, and moved to where they are of use (Roháček 2022, section 3.3.1)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from luxel.kernels.reduce import sum_columns
from luxel.methods.base import Frame
from luxel.methods.ddgi.params import MAX_OFFSET
from luxel.methods.ddgi.state import AWAKE, DEAD, UNUSED, DdgiState, ProbeRayResults, Probes
from luxel.methods.ddgi.trace import AT_ONCE, MISS, is_in_a_box, span_of_probe, who_casts
from luxel.methods.ddgi.volume import grid_coordinates, node_of_probe, world_position
from luxel.scene.device import Scene

THESIS_BACK_SHARE = 0.5
"""The thesis's rule: a probe more than half of whose rays meet backs is inside something."""
ONE_SIDED_SHARE = 0.25
"""Luxel's rule: the share of rays that meet the back of a one-sided surface, from which it is."""
BACK_SHARE = 0.65
"""The same where surfaces have two sides, of the rays that hit anything: from outside a room, or within a wall, most of
what a probe sees is backs, but beside a cloth there is always something else."""
MIN_HIT_SHARE = 0.04
"""Share of rays that must hit something for that to count."""
FLIPPED_WINDING_SHARE = 0.5
"""Share of all hits that are backs, from which the triangles turn the wrong way and two-sided backs say nothing."""
DEAD_CERTAINTY, ALIVE_CERTAINTY = 0.5, 0.25
"""Certainty from which a probe is dead, and below which a dead one comes back to life."""
FRAMES_BEFORE_MOVE = 4
"""Frames at one place before a probe may move again."""
MAX_MOVES = 24
"""Places that a probe tries; then it stays until it has been calm for long."""
FRAMES_BEFORE_NEW_SEARCH = 128
"""Frames at one place after which a probe may search again."""
SLACK = 0.7
"""Share of the distance to keep under which a probe steps back, where it steps just as far as it has to."""
NO_HIT = 0xFFFFFFFFFFFFFFFF
AXIS_STEPS = 4
"""Distances that the axis pattern tries in each of its six directions."""


@dataclass
class ProbeHits:
    """What each probe's rays of one frame met."""

    hits: mi.UInt32
    backs: mi.UInt32
    """Hits on the back of a triangle."""
    stopped: mi.UInt32
    """Of those, the ones that stopped the ray."""
    outside: mi.UInt32
    """Hits that lie in no box."""
    nearest_back: mi.UInt64
    """Distance and number of the ray that met the nearest back."""
    nearest_front: mi.UInt64


@dataclass
class ProbeClassification:
    """What those hits say of the probe's place."""

    cast: mi.Bool
    inside: mi.Bool
    """The rays of this frame say that it is inside something."""
    near: mi.Bool
    """They say that it is too near to a surface."""
    back_distance: mi.Float
    back_direction: mi.Vector3f
    """To the nearest back face."""
    front_distance: mi.Float
    front_direction: mi.Vector3f


@dr.syntax
def gather_probe_hits(state: DdgiState, results: ProbeRayResults) -> ProbeHits:
    """Return what the rays of each probe met: a lane a probe, since one pass beats the launches of a reduction."""
    probe = dr.arange(mi.UInt32, state.settings.total)
    first, count = span_of_probe(state, probe)
    p = mi.Point3f(state.probes.p)
    hits, backs, stopped, outside = mi.UInt32(0), mi.UInt32(0), mi.UInt32(0), mi.UInt32(0)
    nearest_back, nearest_front = mi.UInt64(NO_HIT), mi.UInt64(NO_HIT)
    ray, end = mi.UInt32(first), first + count
    going = (state.probes.status == AWAKE) | (state.probes.status == DEAD)
    going &= ray < end
    while going:
        for step in range(AT_ONCE):
            now, here = ray + step, going & (ray + step < end)
            row = dr.gather(mi.Vector4f, results.direction_depth, now, here)
            back = dr.gather(mi.Float, results.radiance, 4 * now + 3, here) > 0.5
            t = dr.abs(row.w)
            hit = here & (t < 0.5 * MISS)
            hits += dr.select(hit, mi.UInt32(1), 0)
            backs += dr.select(hit & back, mi.UInt32(1), 0)
            stopped += dr.select(here & (row.w < 0.0), mi.UInt32(1), 0)
            held = is_in_a_box(state, p + mi.Vector3f(row.x, row.y, row.z) * t)
            outside += dr.select(hit & ~held, mi.UInt32(1), 0)
            key = (mi.UInt64(dr.reinterpret_array(mi.UInt32, t)) << 32) | mi.UInt64(now)
            nearest_back = dr.select(hit & back, dr.minimum(nearest_back, key), nearest_back)
            nearest_front = dr.select(hit & ~back, dr.minimum(nearest_front, key), nearest_front)
        ray += AT_ONCE
        going &= ray < end
    return ProbeHits(hits, backs, stopped, outside, nearest_back, nearest_front)


def update_hit_shares(scene: Scene, state: DdgiState, probe_hits: ProbeHits) -> tuple[mi.Float, mi.Float]:
    """Return two running shares: of hits that are backs, and of hits that lie in no box.

    Backs are counted by all probes within the scene's bounds, dead ones too: outside them, probes see backs where all
    is well. The first frame counts whole: who is dead is decided by it.
    """
    p = state.probes.p
    within, awake = dr.all((p > scene.lower) & (p < scene.upper)), state.probes.status == AWAKE
    counts = [
        dr.select(within, probe_hits.hits, 0),
        dr.select(within, probe_hits.backs, 0),
        dr.select(awake, probe_hits.hits, 0),
        dr.select(awake, probe_hits.outside, 0),
    ]
    hits, backs, hits_awake, outside = sum_columns([mi.Float(count) for count in counts])
    backs /= dr.fmax(hits, 1.0)
    blended = dr.select(state.backs < 0.0, backs, dr.lerp(state.backs, backs, 0.2))
    backs = dr.select(hits > 0.0, blended, state.backs)
    return backs, dr.lerp(state.outside, outside / dr.fmax(hits_awake, 1.0), 0.2)


def classify_probes(
    state: DdgiState, results: ProbeRayResults, probe_hits: ProbeHits, frame: Frame
) -> ProbeClassification:
    """Return what the rays say of each probe's place."""
    back_distance, back_direction = _unpack_nearest(results, probe_hits.nearest_back)
    front_distance, front_direction = _unpack_nearest(results, probe_hits.nearest_front)
    probe = dr.arange(mi.UInt32, state.settings.total)
    _, count = span_of_probe(state, probe)
    inside = is_inside_geometry(state, probe_hits, mi.Float(count))
    near = front_distance < (SLACK if state.settings.step_through else 1.0) * min_surface_distance(state)
    cast = who_casts(state.probes.status, state.probes.age, probe, frame)
    return ProbeClassification(cast, inside, near, back_distance, back_direction, front_distance, front_direction)


def is_inside_geometry(state: DdgiState, probe_hits: ProbeHits, rays: mi.Float) -> mi.Bool:
    """Return whether what the `rays` of each probe met says that it is inside something, by the state's rule."""
    hits, backs, stopped = mi.Float(probe_hits.hits), mi.Float(probe_hits.backs), mi.Float(probe_hits.stopped)
    if state.settings.thesis_backs:
        return stopped > THESIS_BACK_SHARE * rays
    only_backs = (backs > BACK_SHARE * hits) & (hits > MIN_HIT_SHARE * rays) & (state.backs < FLIPPED_WINDING_SHARE)
    return (stopped > ONE_SIDED_SHARE * rays) | only_backs


def min_surface_distance(state: DdgiState) -> mi.Float:
    """Return the metres that each probe is to keep from surfaces; none for those held back, which never move."""
    index = dr.arange(mi.UInt32, state.settings.total)
    least, wanted = mi.Float(0.0), state.dials.dead_threshold
    for volume in state.volumes:
        least = dr.select(volume.owns(index), dr.select(wanted < 0.0, 0.1 * volume.side, wanted), least)
    return least


def _unpack_nearest(results: ProbeRayResults, key: mi.UInt64) -> tuple[mi.Float, mi.Vector3f]:
    """Return distance and direction of the ray that `key` names; `MISS` where there was none."""
    found = key != NO_HIT
    row = dr.gather(mi.Vector4f, results.direction_depth, mi.UInt32(key & 0xFFFFFFFF), found)
    return dr.select(found, dr.abs(row.w), MISS), mi.Vector3f(row.x, row.y, row.z)


def update_probes(state: DdgiState, results: ProbeRayResults, probe_hits: ProbeHits, frame: Frame) -> Probes:
    """Return the probes with their states and places of the next frame."""
    settings, probes = state.settings, state.probes
    age = probes.age + 1
    if not settings.detect_dead:
        return replace(probes, age=age)
    found = classify_probes(state, results, probe_hits, frame)
    keep = dr.select((probes.age == 0) & (probes.tries == 0) & (probes.dead == 0.0), 0.0, state.dials.dead_hysteresis)
    dead = _blend_certainty(probes.dead, found.inside, keep, found.cast)
    unfit = _blend_certainty(probes.unfit, found.inside | found.near, keep, found.cast)
    used = probes.status != UNUSED
    inside = used & ((dead > DEAD_CERTAINTY) | ((probes.status == DEAD) & (dead > ALIVE_CERTAINTY)))
    status = dr.select(inside, mi.UInt32(DEAD), probes.status)
    status = dr.select(used & ~inside & (probes.status == DEAD), mi.UInt32(AWAKE), status)
    revived = (status == AWAKE) & (probes.status == DEAD)
    probes = replace(probes, status=status, dead=dead, unfit=unfit, age=dr.select(revived, 0, age))
    if not settings.offset_dead:
        return probes
    # A search is over where a probe has been calm for long: the next one starts anew.
    calm = (probes.status == AWAKE) & (probes.age > FRAMES_BEFORE_NEW_SEARCH)
    probes = replace(probes, tries=dr.select(calm, 0, probes.tries))
    offset, p, moved = _choose_offsets(state, probes, found, inside)
    moved &= found.cast & used
    return replace(
        probes,
        offset=dr.select(moved, offset, probes.offset),
        p=dr.select(moved, p, probes.p),
        age=dr.select(moved, 0, probes.age),
        tries=probes.tries + dr.select(moved, mi.UInt32(1), 0),
        # The new place is looked at without prejudice.
        dead=dr.select(moved, 0.0, probes.dead),
        unfit=dr.select(moved, 0.0, probes.unfit),
        status=dr.select(moved, mi.UInt32(AWAKE), probes.status),
    )


def _blend_certainty(before: mi.Float, now: mi.Bool, keep: mi.Float, cast: mi.Bool) -> mi.Float:
    """Return how certain something is by the rays of this frame and those before, for the probes that cast any."""
    return dr.select(cast, dr.lerp(dr.select(now, mi.Float(1.0), 0.0), before, keep), before)


def _choose_offsets(
    state: DdgiState, probes: Probes, found: ProbeClassification, inside: mi.Bool
) -> tuple[mi.Vector3f, mi.Point3f, mi.Bool]:
    """Return the offset and position that each probe would like, and whether it goes there."""
    settings = state.settings
    index = dr.arange(mi.UInt32, settings.total)
    patient = (probes.age >= FRAMES_BEFORE_MOVE) & (probes.tries < MAX_MOVES)
    near, least = ~inside & (probes.unfit > DEAD_CERTAINTY) & found.near, min_surface_distance(state)
    offset, p, moved = mi.Vector3f(probes.offset), mi.Point3f(probes.p), mi.Bool(False)
    for volume in state.volumes:
        mine = volume.owns(index)
        node = node_of_probe(volume, index - volume.first, volume.low)
        if settings.step_through:
            # Through the nearest back face and as far beyond as the distance to keep; off a front face too near.
            through = probes.p + found.back_direction * (found.back_distance + least)
            away = probes.p - found.front_direction * (least - found.front_distance)
            target = dr.select(inside, through, away)
            wish = inside & (found.back_distance < MISS) | near
        else:
            target = world_position(volume, mi.Point3f(node) + _axis_offset(probes.tries))
            wish = inside | near
        wanted = grid_coordinates(volume, target) - mi.Point3f(node)
        fits = dr.all(dr.abs(wanted) <= MAX_OFFSET + 1e-4)
        goes = mine & wish & patient & fits
        offset = dr.select(goes, mi.Vector3f(wanted), offset)
        p = dr.select(goes, target, p)
        moved |= goes
    return offset, p, moved


def _axis_offset(tries: mi.UInt32) -> mi.Point3f:
    """Return the offset that comes after `tries` others: six directions in turn, then the same ones farther out."""
    direction, ring = tries % 6, (tries // 6) % AXIS_STEPS
    length = (mi.Float(ring) + 1.0) * (MAX_OFFSET / AXIS_STEPS)
    signed = dr.select(direction & 1 == 1, -length, length)
    axis = direction >> 1
    return mi.Point3f(
        dr.select(axis == 0, signed, 0.0), dr.select(axis == 1, signed, 0.0), dr.select(axis == 2, signed, 0.0)
    )
