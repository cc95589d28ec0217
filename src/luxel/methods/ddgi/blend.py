"""From rays to texels: irradiance and depth (Roháček 2022, section 2.5.2).

Irradiance is the cosine-weighted mean radiance of the rays, times pi. Its estimator is unbiased and takes what the
texel already knows as a control variate, so that only the difference to it is noise: in a furnace there is none.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from luxel.kernels.direct import luminance
from luxel.kernels.mean_estimator import Estimate, drift_terms, follow_luminance, judge_drift, update_estimate
from luxel.kernels.reduce import sum_columns
from luxel.methods.base import Frame
from luxel.methods.ddgi.atlas import lobe, texel_direction, write_rows
from luxel.methods.ddgi.cascades import inherit
from luxel.methods.ddgi.params import FAR_DEPTHS
from luxel.methods.ddgi.planes import FADED, NEAREST_PLANE, join_sums, sum_planes
from luxel.methods.ddgi.sky_rays import sum_sky
from luxel.methods.ddgi.state import AWAKE, DEAD, DdgiSettings, DdgiState, DepthMoments, PlaneSums, ProbeRayResults
from luxel.methods.ddgi.trace import AT_ONCE, SETTLED, span_of_probe
from luxel.scene.device import Scene

STILL_WINDOW = 4096.0
"""Weight that a depth texel of a scene where nothing moves gathers at most."""
SETTLED_DEPTH_PERIOD = 4
"""Frames in which the settled depth of every probe is updated once, where nothing moves."""
MISS_DISTANCE = 1000.0
"""Metres that stand for a miss where depth is kept whole (the thesis's TMax)."""
LOBES = 4
"""Texels of a probe whose errors are independent: cosine lobes of a sphere, of which four hardly overlap."""
REJECT, CLAMP, KEEP = (FAR_DEPTHS.index(name) for name in ("reject", "clamp", "keep"))


@dataclass
class Blended:
    """The texels after a frame."""

    irradiance: Estimate
    depth: DepthMoments | PlaneSums
    scale: mi.Float
    drift: mi.Float
    noise: mi.Float
    """Of each probe: relative deviation of its light, and how far its means are apart."""


def blend_irradiance(state: DdgiState, results: ProbeRayResults) -> Estimate:
    """Return the irradiance texels with this frame's rays blended in."""
    settings = state.settings
    texels = settings.irradiance_resolution**2
    lane = dr.arange(mi.UInt32, settings.total * texels)
    probe = lane // texels
    active = dr.gather(mi.UInt32, state.probes.status, probe) == AWAKE
    first, count = span_of_probe(state, probe)
    direction = texel_direction(lane % texels, settings.irradiance_resolution)
    before = replace(state.irradiance, count=dr.select(is_newborn(state, probe), 0.0, state.irradiance.count))
    if settings.guided > 0:
        before = inherit(state, before, probe, direction)
    known = dr.select(before.count < 0.5, mi.Color3f(0.0), before.mean * dr.inv_pi)
    total, weights = _sum_light(results, direction, known, first, count, active)
    if results.sky is not None:
        total += sum_sky(results.sky, direction, probe, active)
    # The weights' expected sum is a quarter of the rays; a texel that knows nothing yet divides by what it got.
    fresh = before.count < 0.5
    norm = dr.select(fresh, weights, 0.25 * mi.Float(count))
    # A sample may fall short of zero: to clip it would be a bias. Look-ups read the mean, clipped when packed.
    sample = dr.pi * (known + total / dr.fmax(norm, 1e-6))
    active &= weights > 0.0
    if settings.adaptive:
        unit = dr.select(state.scale > 0.0, state.scale, 1.0)
        return update_estimate(before, sample, unit, state.drift, state.dials.estimator, active)
    return _blend_fixed(before, sample, state.dials.hysteresis, active)


def is_newborn(state: DdgiState, probe: mi.UInt32) -> mi.Bool:
    """Return whether probes have just been placed or moved, so that what their texels hold is of somewhere else."""
    return dr.gather(mi.UInt32, state.probes.age, probe) == 0


@dr.syntax
def _sum_light(
    results: ProbeRayResults,
    direction: mi.Vector3f,
    known: mi.Color3f,
    first: mi.UInt32,
    count: mi.UInt32,
    active: mi.Bool,
) -> tuple[mi.Color3f, mi.Float]:
    """Return the sums over a probe's rays of cosine times (radiance - known), and of the cosines."""
    total, weights = mi.Color3f(0.0), mi.Float(0.0)
    ray, end = mi.UInt32(first), first + count
    going = active & (ray < end)
    while going:
        row = dr.gather(mi.Vector4f, results.direction_depth, ray, going)
        w = dr.fmax(direction.x * row.x + direction.y * row.y + direction.z * row.z, 0.0)
        light = dr.gather(mi.Vector4f, results.radiance, ray, going)
        total += (mi.Color3f(light.x, light.y, light.z) - known) * w
        weights += w
        ray += 1
        going &= ray < end
    return total, weights


def _blend_fixed(estimate: Estimate, sample: mi.Color3f, hysteresis: mi.Float, active: mi.Bool) -> Estimate:
    """Blend by a fixed hysteresis, the first frame whole (Roháček 2022, equation 2.6)."""
    alpha = dr.select(estimate.count < 0.5, 1.0, 1.0 - hysteresis)
    before = sample - estimate.mean
    mean = dr.lerp(estimate.mean, sample, alpha)
    variance = dr.lerp(estimate.variance, before * (sample - mean), 0.05)
    updated = replace(estimate, mean=mean, short=mean, variance=variance, count=estimate.count + 1.0)
    return dr.select(active, updated, estimate)


def blend_depth(scene: Scene, state: DdgiState, results: ProbeRayResults, frame: Frame) -> DepthMoments | PlaneSums:
    """Return the depth texels with this frame's rays blended in: a running weighted mean and variance.

    Rays beyond the reach of a cage tell nothing about who sees whom in it; taken whole they raise the variance until
    light leaks through walls (Roháček 2022, section 3.3.2).
    """
    settings = state.settings
    texels = settings.depth_resolution**2
    lane = dr.arange(mi.UInt32, settings.total * texels)
    probe = lane // texels
    active = dr.gather(mi.UInt32, state.probes.status, probe) == AWAKE
    if not settings.detect_dead:
        active |= dr.gather(mi.UInt32, state.probes.status, probe) == DEAD
    first, count = span_of_probe(state, probe)
    direction = texel_direction(lane % texels, settings.depth_resolution)
    reach = reach_of(state, probe)
    fresh = is_newborn(state, probe)
    old = replace(state.depth, weight=dr.select(fresh, 0.0, state.depth.weight))
    changes = not settings.adaptive or scene.features.moving or scene.features.deforming
    if not changes:
        # Where nothing moves, depth that has settled is looked at again now and then.
        young = dr.gather(mi.UInt32, state.probes.age, probe) < SETTLED
        active &= young | ((probe + frame.index) % SETTLED_DEPTH_PERIOD == 0)
    if isinstance(old, PlaneSums):
        limit = reach if settings.far_depth != KEEP else mi.Float(MISS_DISTANCE)
        reject = settings.far_depth == REJECT
        limits = (NEAREST_PLANE * reach, limit)
        now = sum_planes(results, direction, settings.depth_sharpness, limits, reject, (first, count), active)
        keep = state.dials.hysteresis if changes else mi.Float(1.0)
        # An awake probe asks in every direction; what it no longer finds fades where things move.
        return join_sums(old, now, keep, STILL_WINDOW, active, active if changes else None)
    reference = dr.select(old.weight > 0.0, old.mean, 0.5 * reach)
    total, square, weights = _sum_depth(state, results, direction, reference, reach, (first, count), active)

    # Join the frame's moments with those of before (pairwise update of a weighted mean and variance).
    counts = active & (weights > 1e-4)
    mean_now = total / dr.fmax(weights, 1e-8)
    variance_now = dr.fmax(square / dr.fmax(weights, 1e-8) - mean_now * mean_now, 0.0)
    share = weights / (old.weight + weights)
    if changes:
        share = dr.select(old.weight > 0.0, dr.fmax(share, 1.0 - state.dials.hysteresis), 1.0)
    now = reference + mean_now
    known = old.weight > 0.0
    step = now - dr.select(known, old.mean, now)
    mean = dr.select(known, old.mean, now) + share * step
    variance = dr.lerp(dr.select(known, old.variance, variance_now), variance_now, share)
    variance += share * (1.0 - share) * step * step
    updated = DepthMoments(mean, variance, dr.fmin(old.weight + weights, STILL_WINDOW))
    if changes:
        faded = old.weight * state.dials.hysteresis
        old = replace(old, weight=dr.select(active & ~counts, dr.select(faded > FADED, faded, 0.0), old.weight))
    return dr.select(counts, updated, old)


@dr.syntax
def _sum_depth(
    state: DdgiState,
    results: ProbeRayResults,
    direction: mi.Vector3f,
    reference: mi.Float,
    reach: mi.Float,
    span: tuple[mi.UInt32, mi.UInt32],
    active: mi.Bool,
) -> tuple[mi.Float, mi.Float, mi.Float]:
    """Return the weighted sums over a probe's rays of (distance - reference), of its square, and of the weights."""
    settings = state.settings
    total, square, weights = mi.Float(0.0), mi.Float(0.0), mi.Float(0.0)
    ray, end = mi.UInt32(span[0]), span[0] + span[1]
    going = active & (ray < end)
    while going:
        row = dr.gather(mi.Vector4f, results.direction_depth, ray, going)
        w = lobe(direction.x * row.x + direction.y * row.y + direction.z * row.z, settings.depth_sharpness)
        distance, w = _classify_depth(settings, row.w, w, reach)
        away = distance - reference
        total += dr.select(w > 0.0, w * away, 0.0)
        square += dr.select(w > 0.0, w * away * away, 0.0)
        weights += w
        ray += 1
        going &= ray < end
    return total, square, weights


def _classify_depth(settings: DdgiSettings, depth: mi.Float, w: mi.Float, reach: mi.Float) -> tuple[mi.Float, mi.Float]:
    """Return the distance that a ray stands for, and its weight."""
    # A ray that a back stopped counts as depth zero: nothing is seen through it.
    distance = dr.fmax(depth, 0.0)
    if settings.far_depth == REJECT:
        return distance, dr.select(distance > reach, 0.0, w)
    return dr.fmin(distance, reach if settings.far_depth == CLAMP else MISS_DISTANCE), w


def blend(scene: Scene, state: DdgiState, results: ProbeRayResults, frame: Frame) -> Blended:
    """Blend this frame's rays into all texels."""
    settings = state.settings
    irradiance = blend_irradiance(state, results)
    depth = blend_depth(scene, state, results, frame)
    rows = _texel_rows(state, irradiance)
    dr.eval(irradiance, depth, rows)

    # What all texels have in common: their unit of light, and whether it changes.
    texels = settings.irradiance_resolution**2
    awake = state.probes.status == AWAKE
    light, apart, deviation, mean = _sum_rows(rows, texels, awake)
    columns = [light, apart, dr.square(deviation) / LOBES, mean, dr.select(awake, mi.Float(texels), 0.0)]
    light, apart, noise, total, count = sum_columns(columns)
    scale = follow_luminance(state.scale, light, count)
    drift = judge_drift(apart, noise, total) if settings.adaptive else mi.Float(0.0)
    return Blended(irradiance, depth, scale, drift, _noise_of_probes(state, irradiance, scale))


def _texel_rows(state: DdgiState, irradiance: Estimate) -> mi.Float:
    """Return (texels, 4) rows: luminance of the short mean, and the terms of the common drift."""
    row = mi.Vector4f(luminance(irradiance.short), *drift_terms(irradiance, state.dials.estimator, young=True))
    lane = dr.arange(mi.UInt32, dr.width(irradiance.count))
    return write_rows(row, lane, half=False)


@dr.syntax
def _sum_rows(rows: mi.Float, texels: int, active: mi.Bool) -> tuple[mi.Float, mi.Float, mi.Float, mi.Float]:
    """Return the sums over each probe's rows. One kernel, where a sum of each column would take eight."""
    total, texel = mi.Vector4f(0.0), mi.UInt32(0)
    first = dr.arange(mi.UInt32, dr.width(active)) * texels
    going = mi.Bool(active)
    while going:
        for step in range(AT_ONCE):
            total += dr.gather(mi.Vector4f, rows, first + texel + step, going & (texel + step < texels))
        texel += AT_ONCE
        going &= texel < texels
    return total.x, total.y, total.z, total.w


def _noise_of_probes(state: DdgiState, irradiance: Estimate, scale: mi.Float) -> mi.Float:
    """Return the probes' running noise, which only a ray budget by variance asks for."""
    settings = state.settings
    if not settings.variance_budget:
        return state.probes.noise
    texels = settings.irradiance_resolution**2
    value = dr.block_sum(luminance(irradiance.mean), texels)
    deviation = dr.block_sum(dr.sqrt(dr.fmax(luminance(irradiance.variance), 0.0)), texels)
    young = dr.select(state.probes.age < 8, mi.Float(2.0), 0.0)
    return dr.lerp(state.probes.noise, deviation / dr.fmax(value, 0.05 * texels * scale) + young, 0.2)


def reach_of(state: DdgiState, probe: mi.UInt32) -> mi.Float:
    """Return how far a point of each probe's cages can be; probes held back serve the last box."""
    reach = mi.Float(state.volumes[-1].reach)
    for volume in state.volumes:
        reach = dr.select(volume.owns(probe), volume.reach, reach)
    return reach
