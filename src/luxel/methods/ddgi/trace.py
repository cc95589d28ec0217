"""Rays from the probes, and the radiance they bring (Roháček 2022, sections 3.2.5 and 3.2.6).

Directions are a spherical Fibonacci lattice under a fresh random turn for each probe and frame. What a ray brings is
the direct light that its hit reflects, plus the bounces: read from the probes there, or traced as a path. A miss
brings the sky, or its share of it beside rays that look for the sky (`sky_rays.py`). Some backs end a ray
(`backface_rule`): it brings no light, counts as depth zero, and tells that the probe may be inside something.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from luxel.kernels.direct import direct_irradiance
from luxel.kernels.fibonacci import fibonacci_direction, random_rotation, rotate
from luxel.kernels.records import Surface
from luxel.kernels.sampling import hash_pair
from luxel.kernels.sky import sky_radiance
from luxel.kernels.surface import reflects_back, surface_at_hit
from luxel.kernels.trace import offset_origin, trace_closest
from luxel.methods.base import Frame
from luxel.methods.ddgi.query import query_probes
from luxel.methods.ddgi.sky_rays import trace_sky, weight_of_miss
from luxel.methods.ddgi.state import AWAKE, DEAD, DdgiState, ProbeRayResults
from luxel.methods.ddgi.volume import grid_coordinates, is_inside
from luxel.methods.path_tracer import trace_indirect
from luxel.scene.device import Scene

DEAD_RAY_PERIOD = 16
"""A dead probe that has settled casts rays every so many frames, to see whether it has come free."""
SETTLED = 64
MISS = 1e30
AT_ONCE = 4
"""Entries that a lane reads in one turn where it goes through all of a probe's: it waits for memory once for all."""


def ray_owner(state: DdgiState, lane: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32, mi.UInt32, mi.Bool]:
    """Return each ray's probe, its number among the probe's rays, their count, and whether it belongs to one."""
    settings = state.settings
    if not settings.variance_budget:
        probe = lane // settings.rays_per_probe
        return probe, lane % settings.rays_per_probe, mi.UInt32(settings.rays_per_probe), mi.Bool(True)
    # Mark where each probe's rays begin, and carry the mark along.
    marks = dr.zeros(mi.UInt32, dr.width(lane))
    index = dr.arange(mi.UInt32, settings.total)
    dr.scatter_reduce(dr.ReduceOp.Max, marks, index, state.rays.first, state.rays.count > 0)
    probe = dr.prefix_reduce(dr.ReduceOp.Max, marks, exclusive=False)
    number = lane - dr.gather(mi.UInt32, state.rays.first, probe)
    count = dr.gather(mi.UInt32, state.rays.count, probe)
    return probe, number, count, number < count


def trace_probes(scene: Scene, state: DdgiState, frame: Frame) -> ProbeRayResults:
    """Cast the probes' rays of this frame."""
    settings = state.settings
    ray_count = settings.total * settings.rays_per_probe
    lane = dr.arange(mi.UInt32, ray_count + settings.request_count)
    probe, number, count, owned = ray_owner(state, lane)
    owned &= lane < ray_count
    status = dr.gather(mi.UInt32, state.probes.status, probe, owned)
    age = dr.gather(mi.UInt32, state.probes.age, probe, owned)
    awake = status == AWAKE
    casts = owned & who_casts(status, age, probe, frame)
    origin = dr.gather(mi.Point3f, state.probes.p, probe, casts)

    # Choose directions: an even lattice under this probe's random turn of this frame.
    word_a, word_b = hash_pair(probe + state.seed, frame.index)
    direction = rotate(random_rotation(word_a, word_b), fibonacci_direction(number, count))

    # The last rays look how much room there is at the places that want a probe.
    wishes, wish = state.wishes, lane >= ray_count
    wish &= dr.gather(mi.Bool, wishes.wanted, lane - ray_count, wish)
    up = dr.gather(mi.Normal3f, wishes.n, lane - ray_count, wish)
    origin = dr.select(wish, offset_origin(scene, dr.gather(mi.Point3f, wishes.p, lane - ray_count, wish), up), origin)
    direction = dr.select(wish, mi.Vector3f(up), direction)

    # Trace, and light what was hit; only probes that are of use need the light.
    hit = trace_closest(scene, origin, direction, casts | wish)
    surface = surface_at_hit(scene, hit, direction)
    behind = hit.valid & ~surface.front
    stopped = behind if settings.thesis_backs else behind & ~reflects_back(scene, hit.prim_id, behind)
    lit = hit.valid & ~stopped & casts & awake
    direct = direct_irradiance(scene, surface, word_a + number * 0x3C6EF372, word_b, lit)
    reads = lit
    if settings.feedback:
        # Beyond the boxes it is another world: a dome far off does not get the light of the room.
        if settings.paths_outside:
            reads = lit & is_in_a_box(state, surface.p)
        around = query_probes(state, surface.p, surface.n_geometric, surface.n_shading, surface.wo, reads)
        bounced = around.irradiance
        if settings.paths_outside:
            bounced += trace_on(scene, state, surface, word_a, number, word_b, lit & ~reads)
    else:
        bounced = trace_on(scene, state, surface, word_a, number, word_b, lit)
    reflected = surface.albedo * (direct + bounced) * dr.inv_pi
    missed = awake & casts & ~hit.valid
    sky = sky_radiance(scene, direction, missed) * weight_of_miss(scene, state, direction, count, missed)
    radiance = dr.select(lit, reflected, sky)
    depth = dr.select(hit.valid, dr.select(stopped, -hit.t, hit.t), MISS)
    width = dr.width(lane)
    rows, light = dr.empty(mi.Float, 4 * width), dr.empty(mi.Float, 4 * width)
    dr.scatter(rows, mi.Vector4f(direction.x, direction.y, direction.z, depth), lane)
    back = dr.select(behind, mi.Float(1.0), 0.0)
    dr.scatter(light, mi.Vector4f(radiance.x, radiance.y, radiance.z, back), lane)
    return ProbeRayResults(
        direction_depth=rows,
        radiance=light,
        p=surface.p,
        hit=reads,
        sky=trace_sky(scene, state, frame),
    )


def trace_on(
    scene: Scene, state: DdgiState, surface: Surface, word_a: mi.UInt32, number: mi.UInt32, word_b: mi.UInt32,
    active: mi.Bool,
) -> mi.Color3f:  # fmt: skip
    """Return what a path on from where ray `number` of a probe hit says of the irradiance there."""
    seed = word_a + number * 0x2545F491
    return trace_indirect(scene, surface, seed, word_b, active, look_for_sky=state.settings.sky_rays > 0)


def is_in_a_box(state: DdgiState, p: mi.Point3f) -> mi.Bool:
    """Return whether world points lie in any box."""
    held = mi.Bool(False)
    for volume in state.volumes:
        held |= is_inside(volume, grid_coordinates(volume, p))
    return held


def who_casts(status: mi.UInt32, age: mi.UInt32, probe: mi.UInt32, frame: Frame) -> mi.Bool:
    """Return which probes cast rays in this frame: those awake, and dead ones at first and then in turn."""
    turn = (age < SETTLED) | ((probe + frame.index) % DEAD_RAY_PERIOD == 0)
    return (status == AWAKE) | ((status == DEAD) & turn)


def span_of_probe(state: DdgiState, probe: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32]:
    """Return first ray and number of rays of each probe."""
    settings = state.settings
    if not settings.variance_budget:
        return probe * settings.rays_per_probe, state.rays_of(probe)
    return dr.gather(mi.UInt32, state.rays.first, probe), state.rays_of(probe)


def plan_rays(state: DdgiState) -> tuple[mi.UInt32, mi.UInt32]:
    """Return first ray and number of rays of each probe: the frame's total, shared out by how noisy each probe is.

    What a probe gets depends on what it knew before, never on this frame's rays: that would be a bias.
    """
    settings, probes = state.settings, state.probes
    total = settings.total * settings.rays_per_probe
    awake = probes.status == AWAKE
    ask = dr.select(awake, dr.clip(probes.noise, 0.1, 4.0), 0.0)
    ask = dr.select(probes.status == DEAD, 0.1, ask)
    ask_sum = dr.fmax(dr.sum(ask), 1e-6)
    asking = awake | (probes.status == DEAD)
    least = dr.select(asking, mi.UInt32(4), 0)
    spare = mi.Float(dr.fmax(mi.Float(total) - mi.Float(dr.sum(least)), 0.0))
    count = least + mi.UInt32(dr.fmin(ask / ask_sum * spare, 1020.0))
    return dr.prefix_reduce(dr.ReduceOp.Add, count), count
