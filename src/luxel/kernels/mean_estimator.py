"""A running mean that is quick after a change and calm otherwise: the multi-scale mean estimator with a warm start.

Source: Barré-Brisebois et al. 2019, "Hybrid rendering for real-time ray tracing", Ray Tracing Gems ch. 25 (the
estimator); the warm start is ours. Under feedback, where the cache lights itself, a plain running mean closes its gap
like n^-(1 - albedo) and a cold estimator trails it by 10 %; weighting recent samples more until warm does neither.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from luxel.kernels.direct import luminance
from luxel.kernels.reduce import sum_columns

LUMA = (0.299, 0.587, 0.114)
"""The weights that the source uses to bring a colour to one number."""
NOISE_FLOOR = 1e-5
LEAST_SCALE = 1e-15
FIREFLY_SLACK = 0.1
FIREFLY_DEVIATIONS = 8.0
INCONSISTENCY_BLEND = 0.08
REDUCTION_BLEND = 0.1
REDUCTION_MIN = 1.0 / 32.0
CATCH_UP_MIN = 1.0 / 256.0


@dataclass
class Estimate:
    """Per item; values in the caller's units, the estimator works on values over `scale`."""

    mean: mi.Color3f
    """The answer: the long-term mean."""
    short: mi.Color3f
    """Exponential mean over about 1 / blend samples."""
    variance: mi.Color3f
    reduction: mi.Float
    """Variance-based blend reduction."""
    inconsistency: mi.Float
    """How far short and long mean are apart in units of noise; 1 at birth."""
    count: mi.Float
    """Samples since birth, or since the last change that the estimator reacted to."""


@dataclass
class EstimatorDials:
    """The estimator's constants, as opaque values."""

    short_blend: mi.Float
    """Blend of the short mean: low is calm and slow to notice, high is nervous."""
    warm_samples: mi.Float
    """Samples during which recent ones weigh more; 0 starts cold, as the source does."""
    longest_window: mi.Float
    """Samples that the mean spans at most when nothing changes."""


def new_estimate(width: int) -> Estimate:
    """Return `width` newborn estimates."""
    return Estimate(
        mean=dr.zeros(mi.Color3f, width),
        short=dr.zeros(mi.Color3f, width),
        variance=dr.zeros(mi.Color3f, width),
        reduction=dr.zeros(mi.Float, width),
        inconsistency=dr.full(mi.Float, 1.0, width),
        count=dr.zeros(mi.Float, width),
    )


def update_estimate(
    estimate: Estimate, sample: mi.Color3f, scale: mi.Float, drift: mi.Float, dials: EstimatorDials, active: mi.Bool
) -> Estimate:
    """Return the estimates after one sample each.

    `scale` (> 0) is the unit in which the floors are meant; `drift` what `measure_drift` said of all items after the
    last sample (only warm-started estimates use it).
    """
    return advance_estimate(estimate, sample, scale, drift, dials, active)[0]


def advance_estimate(
    estimate: Estimate, sample: mi.Color3f, scale: mi.Float, drift: mi.Float, dials: EstimatorDials, active: mi.Bool,
    worth: mi.Float | None = None,
) -> tuple[Estimate, mi.Float]:  # fmt: skip
    """Return what `update_estimate` returns, and the sample's share of the mean, for means of its companions.

    `worth`: for how many usual samples each one counts in the long mean; None: all for one.
    """
    # After a long night the unit is next to nothing, and its square would be nothing.
    scale = dr.fmax(scale, LEAST_SCALE)
    inverse = 1.0 / scale
    y = sample * inverse
    mean, short, variance = estimate.mean * inverse, estimate.short * inverse, estimate.variance * dr.square(inverse)
    first = estimate.count < 0.5
    warm = estimate.count < dials.warm_samples

    # Cap fireflies, as the source does; a warm-started mean is long enough to do without, and a cap is a bias
    # (3 % of the light in a dark room that a small bright patch lights).
    started_warm = dials.warm_samples > 0.5
    deviation = dr.sqrt(dr.fmax(variance, NOISE_FLOOR))
    apart_before = _luma(dr.abs(mean - short) / dr.fmax(NOISE_FLOOR, deviation))
    y = dr.select(started_warm, y, dr.fmin(y, FIREFLY_SLACK + short + FIREFLY_DEVIATIONS * deviation))

    # Follow with the short mean and the variance around it.
    blend = dr.select(warm, dr.fmax(dials.short_blend, 1.0 / (estimate.count + 1.0)), dials.short_blend)
    before = y - short
    short = dr.lerp(short, y, blend)
    variance = dr.lerp(variance, before * (y - short), 0.5 * blend)
    variance = dr.select(first & started_warm, mi.Color3f(0.0), variance)
    deviation = dr.sqrt(dr.fmax(variance, NOISE_FLOOR))

    # Compare short and long mean in units of noise.
    apart = _luma(dr.abs(mean - short) / dr.fmax(NOISE_FLOOR, deviation))
    inconsistency = dr.lerp(estimate.inconsistency, apart, INCONSISTENCY_BLEND)
    calm = dr.clip(_luma(0.5 * short / dr.fmax(NOISE_FLOOR, deviation)), REDUCTION_MIN, 1.0)
    reduction = dr.lerp(estimate.reduction, calm, REDUCTION_BLEND)

    # Let the long mean catch up as fast as the disagreement asks.
    # A warm-started estimate goes by what it knew before this sample: a blend that depends on the sample it weighs is a
    # bias (0.3 % in the furnace after 800 frames).
    doubt = dr.select(started_warm, estimate.inconsistency, inconsistency)
    apart = dr.select(started_warm, apart_before, apart)
    eager = _smoothstep(apart * dr.fmax(0.02, doubt - 0.2))
    catch_up = dr.clip(dr.clip(eager, CATCH_UP_MIN, 1.0) * estimate.reduction, 0.0, 1.0)
    schedule = _warm_schedule(estimate.count, dials, worth)
    alarm = dr.fmax(_alarm_of_one(apart, dials), _alarm_of_all(drift))
    # The floor of the catch-up is one of a usual sample.
    followed = catch_up if worth is None else catch_up * dr.fmin(worth, 1.0)
    reaction = dr.fmax(dr.select(warm, 0.0, followed), alarm)
    alpha = dr.select(started_warm, dr.fmax(reaction, schedule), catch_up)
    mean = dr.lerp(mean, y, alpha)

    # After an alarm go on as an estimate of that age would, so that the mean settles again instead of idling.
    aged = estimate.count + (1.0 if worth is None else worth)
    restarted = dr.fmin(aged, dr.fmax(4.0 / dr.fmax(alpha, 1e-6) - 3.0, 4.0))
    count = dr.select(started_warm & (alarm > schedule), restarted, aged)

    updated = Estimate(mean * scale, short * scale, variance * dr.square(scale), reduction, inconsistency, count)
    return dr.select(active, updated, estimate), alpha


def measure_drift(estimate: Estimate, dials: EstimatorDials, active: mi.Bool) -> mi.Float:
    """Return by which share the short means of all items differ from their long means, beyond chance; 0 or more.

    A light that changes moves all items the same way long before each one's noise lets it notice alone.
    """
    apart, deviation, mean = (dr.select(active, term, 0.0) for term in drift_terms(estimate, dials, young=False))
    return judge_drift(*sum_columns([apart, dr.square(deviation), mean]))


def drift_terms(estimate: Estimate, dials: EstimatorDials, young: bool) -> tuple[mi.Float, mi.Float, mi.Float]:
    """Return for each item what a common drift is judged by: short less long mean, its deviation, and the long mean.

    `young` counts the noise of young long means too: with few samples an item they waver, and must not keep their own
    alarm going.
    """
    spread = dials.short_blend / (2.0 - dials.short_blend)
    if young:
        alpha = _warm_schedule(estimate.count, dials)
        spread = spread + alpha / (2.0 - alpha)
    deviation = _luma(dr.sqrt(dr.fmax(estimate.variance, 0.0))) * dr.sqrt(spread)
    return _luma(estimate.short - estimate.mean), deviation, _luma(estimate.mean)


def judge_drift(apart: mi.Float, noise: mi.Float, total: mi.Float) -> mi.Float:
    """Return the common drift as a share, from the sums over all items of apart, deviation squared and mean.

    Shares under 1 %, and under three standard errors of the common mean, count as chance.
    """
    apart = dr.abs(apart)
    beyond = dr.fmax(apart - dr.fmax(3.0 * dr.sqrt(noise), 0.01 * total), 0.0)
    return dr.select(total > 0.0, beyond / dr.fmax(total, 1e-30), dr.select(apart > 0.0, mi.Float(1.0), 0.0))


def running_luminance(before: mi.Float, estimate: Estimate, active: mi.Bool) -> mi.Float:
    """Return the mean luminance of the active items, blended over some frames; as before where none is."""
    columns = [dr.select(active, luminance(estimate.short), 0.0), dr.select(active, mi.Float(1.0), 0.0)]
    return follow_luminance(before, *sum_columns(columns))


def follow_luminance(before: mi.Float, total: mi.Float, count: mi.Float) -> mi.Float:
    """Return the running mean after a frame in which `count` items had `total` luminance."""
    now = total / dr.fmax(count, 1.0)
    return dr.select(count > 0.0, dr.select(before > 0.0, dr.lerp(before, now, 0.1), now), before)


def _alarm_of_all(drift: mi.Float) -> mi.Float:
    """Return the blend that a common drift asks for, at most 0.3. The feedback keeps a drift small while it lasts."""
    return dr.clip(30.0 * drift, 0.0, 0.3)


def _alarm_of_one(apart: mi.Float, dials: EstimatorDials) -> mi.Float:
    """Return the blend that one item's own disagreement asks for, in standard errors of its short mean.

    An exponential mean of blend b has sqrt(b / (2 - b)) of a sample's deviation; beyond 3 of those it is no chance.
    """
    errors = apart * dr.rsqrt(dials.short_blend / (2.0 - dials.short_blend))
    return dr.clip((errors - 3.0) * 0.1, 0.0, 0.3)


def _warm_schedule(count: mi.Float, dials: EstimatorDials, worth: mi.Float | None = None) -> mi.Float:
    """Return the blend of sample number `count`: 4 / (n + 4) while warm, then 1 / n counted from a later start.

    The later start makes the two meet: about half of the warm samples weigh nothing in the end.
    """
    start = 0.55 * dials.warm_samples
    if worth is None:
        later = 1.0 / dr.fmin(dr.fmax(count - start, 1.0), dials.longest_window)
        return dr.select(count < dials.warm_samples, 4.0 / (count + 4.0), later)
    later = worth / dr.fmin(dr.fmax(count - start - 1.0 + worth, worth), dr.fmax(dials.longest_window, worth))
    return dr.select(count < dials.warm_samples, 4.0 * worth / (count + 4.0 * worth), later)


def _luma(color: mi.Color3f) -> mi.Float:
    return color.x * LUMA[0] + color.y * LUMA[1] + color.z * LUMA[2]


def _smoothstep(x: mi.Float) -> mi.Float:
    x = dr.clip(x, 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)
