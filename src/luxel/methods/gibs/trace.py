"""Rays from the surfels, and the irradiance they bring (Ekberg 2022, section 4.3).

A surfel's sample is pi times the mean radiance of its rays, by the weights of their directions (`directions.py`). What
a ray brings is the direct light at its hit plus the surfels' own irradiance there: bounces without end, one a frame. A
miss brings the sky.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from luxel.kernels.direct import direct_irradiance
from luxel.kernels.mean_estimator import advance_estimate, measure_drift, running_luminance
from luxel.kernels.sampling import hash_pair, mix, sequence_words
from luxel.kernels.sky import sky_radiance
from luxel.kernels.square_maps import SquareMaps
from luxel.kernels.surface import surface_at_hit
from luxel.kernels.trace import offset_origin, trace_closest
from luxel.methods.gibs.budget import RayPlan, ray_owners
from luxel.methods.gibs.directions import choose_direction
from luxel.methods.gibs.gather import gather_irradiance
from luxel.methods.gibs.guiding import find_guide, learn
from luxel.methods.gibs.normal_light import (
    NormalLight,
    add_ray,
    blend_normal_light,
    moments_of_ray,
    sample_of_no_ray,
)
from luxel.methods.gibs.surfels import GibsState, Surfels
from luxel.methods.path_tracer import trace_indirect
from luxel.scene.device import Scene

PATH_PERIOD = 4
"""Of rays that met what is too far off for surfels, one in so many goes on as a path, and counts for all."""
BOUNDS_MARGIN, NEAR_REACH = 0.05, 0.2
"""Diagonals of the scene's bounds: how far around them, and how far from a surfel beyond them, hits get surfels."""


@dataclass
class SurfelRayResults:
    """What each ray brought: as many lanes as rays at most, a surfel's rays side by side."""

    irradiance: mi.Color3f
    """pi times the radiance along the ray, times its weight."""
    weight: mi.Float
    """Cosine over pi and over the density of its direction: 1 on average, and where all rays follow the cosine."""
    control: mi.Float
    """1 on average: what the irradiance's control variate goes by."""
    prim_id: mi.UInt32
    barycentric: mi.Point2f
    on_back: mi.Bool
    coverage: mi.Float
    """Of the surfels at the hit; infinite where nothing was hit, or what is too far off to be worth a surfel."""
    moments: mi.Vector3f | None
    """What it counts for in the light for other normals, where the surfels keep that."""
    guide: SquareMaps | None
    """The maps, taught by the rays."""


def trace_surfels(scene: Scene, state: GibsState, plan: RayPlan) -> SurfelRayResults:
    """Cast the rays of this frame's plan."""
    settings, surfels = state.settings, state.surfels
    rays = settings.rays_per_surfel
    surfel, ray, alive = ray_owners(state, plan)
    p = dr.gather(mi.Point3f, surfels.p, surfel, alive)
    n = dr.gather(mi.Normal3f, surfels.n, surfel, alive)
    seed = dr.gather(mi.UInt32, surfels.seed, surfel, alive)
    index = dr.gather(mi.UInt32, surfels.ray_index, surfel, alive) + ray

    # Choose directions: each surfel has its own shift of one well-spread sequence.
    seed_a, seed_b = hash_pair(seed, state.seed)
    word_a, word_b = (
        sequence_words(index, (seed_a, seed_b)) if settings.low_discrepancy else hash_pair(seed_a + index, seed_b)
    )
    guide = find_guide(state, p, n, dr.gather(mi.UInt32, surfels.size, surfel, alive))
    chosen = choose_direction(scene, state, n, word_a, word_b, alive, guide)
    direction, weight = chosen.direction, chosen.weight
    casts = alive & (weight > 0.0)

    # Trace, and light what was hit.
    hit = trace_closest(scene, offset_origin(scene, p, n), direction, casts)
    surface = surface_at_hit(scene, hit, direction)
    direct = direct_irradiance(scene, surface, seed_a + index * 0x3C6EF372, seed_b, hit.valid)
    # What asks the surfels is a kernel of its own: one that also traces leaves a GPU fewer threads at a time.
    dr.eval(hit, surface, direct, chosen, casts)
    around = gather_irradiance(state, surface.p, surface.n_geometric, hit.valid, surface.n_shading)
    indirect = around.irradiance
    if settings.fill_bare:
        # Where nothing answers, the surfel that sees the place lends its own light: what it sees is in the same room.
        own = dr.fmax(dr.gather(mi.Color3f, surfels.estimate.mean, surfel, alive), 0.0)
        indirect = dr.select(around.confidence > 0.0, indirect, own)
    coverage = dr.select(hit.valid, around.coverage, dr.inf)
    if scene.features.surrounded:
        # Far surroundings would take the whole pool, a surfel a hit that no second ray finds: they do without.
        far = hit.valid & ~is_near(scene, surface.p, hit.t)
        coverage = dr.select(far, dr.inf, coverage)
        if settings.fill_bare:
            # Nor does it get the light of the surfel that sees it: a dome far off is not in the room.
            bare = far & ~(around.confidence > 0.0)
            seed_there = (word_a ^ 0x5BF03635) + index * 0x2545F491
            # One of so many rays goes on for all of them. Chance says which: every fourth point of the sequence is far
            # from even, it moves on by 0.02 along one axis.
            period = min(PATH_PERIOD, rays)
            goes_on = bare & (index % period == mix(index // period + seed_b) % period)
            outside = trace_indirect(scene, surface, seed_there, word_b, goes_on, state.settings.looks_for_sky)
            indirect = dr.select(bare, dr.select(goes_on, float(period) * outside, 0.0), indirect)
    reflected = surface.albedo * (direct + indirect)
    sky = dr.pi * sky_radiance(scene, direction, casts & ~hit.valid)
    irradiance = dr.select(hit.valid, reflected, sky) * weight
    return SurfelRayResults(
        irradiance=irradiance,
        weight=weight,
        control=chosen.control,
        prim_id=hit.prim_id,
        barycentric=hit.barycentric,
        on_back=~surface.front,
        coverage=coverage,
        moments=moments_of_ray(n, direction, casts) if settings.normal_light else None,
        guide=learn(state, chosen.guided, surfel, irradiance, alive),
    )


def is_near(scene: Scene, p: mi.Point3f, t: mi.Float) -> mi.Bool:
    """Return whether what rays of length `t` met at `p` is worth a surfel: in the scene's bounds, or close to them."""
    size = dr.norm(scene.upper - scene.lower)
    within = dr.all((p >= scene.lower - BOUNDS_MARGIN * size) & (p <= scene.upper + BOUNDS_MARGIN * size))
    return within | (t <= NEAR_REACH * size)


def integrate(
    state: GibsState, plan: RayPlan, results: SurfelRayResults, weighted: bool
) -> tuple[Surfels, mi.Float, mi.Float]:
    """Blend the rays into the surfels' estimates; return the surfels, the cache's running luminance and its drift.

    `weighted`: the rays have weights other than 1.
    """
    surfels = state.surfels
    alive, served = surfels.object_id != 0, plan.count > 0
    sums = sum_rays(state, plan, results, weighted)
    rays = mi.Float(dr.maximum(plan.count, 1))
    sample = sums.irradiance / rays
    if weighted:
        # What is known already is a control variate: that a frame's weights are not 1 on average is no noise then.
        sample += surfels.estimate.mean * (1.0 - sums.control / rays)
    scale = dr.select(state.luminance > 0.0, state.luminance, 1.0)
    # A sample counts by its rays, in units of the usual number.
    worth = rays / state.settings.rays_per_surfel if state.settings.share_rays else None
    dials = state.dials.estimator
    estimate, blend = advance_estimate(surfels.estimate, sample, scale, state.drift, dials, served, worth)
    luminance = running_luminance(state.luminance, estimate, alive)
    normal_light = surfels.normal_light
    if normal_light is not None:
        normal_light = blend_normal_light(normal_light, sums.normal_light, blend, served)
    drift = measure_drift(estimate, dials, alive)
    ray_index = surfels.ray_index + plan.count
    surfels = replace(surfels, ray_index=ray_index, estimate=estimate, normal_light=normal_light)
    return surfels, luminance, drift


@dataclass
class RaySums:
    """What the rays of each surfel add up to."""

    irradiance: mi.Color3f
    control: mi.Float
    normal_light: NormalLight
    """The rays' sample of it, a mean."""


@dr.syntax
def sum_rays(state: GibsState, plan: RayPlan, results: SurfelRayResults, weighted: bool) -> RaySums:
    """Return the sums over each surfel's rays."""
    mean = state.surfels.estimate.mean
    irradiance, total, ray = mi.Color3f(0.0), mi.Float(0.0), mi.UInt32(0)
    beside, share = sample_of_no_ray(mean), 1.0 / mi.Float(dr.maximum(plan.count, 1))
    while ray < plan.count:
        lane = plan.first + ray
        light = dr.gather(mi.Color3f, results.irradiance, lane)
        irradiance += light
        weight = dr.gather(mi.Float, results.weight, lane) if weighted else mi.Float(1.0)
        total += dr.gather(mi.Float, results.control, lane) if weighted else mi.Float(1.0)
        if dr.hint(results.moments is not None, mode="scalar"):
            beside = add_ray(beside, mean, light, weight, dr.gather(mi.Vector3f, results.moments, lane), share)
        ray += 1
    return RaySums(irradiance, total, beside)
