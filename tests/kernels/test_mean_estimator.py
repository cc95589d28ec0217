"""The estimator from cold against the published steps in NumPy; the properties of the warm start."""

from __future__ import annotations

from dataclasses import dataclass, field

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.kernels.mean_estimator import Estimate, EstimatorDials, measure_drift, new_estimate, update_estimate

LUMA = np.array([0.299, 0.587, 0.114])
WARM = 64


def dials(warm: float = WARM, blend: float = 0.08, window: float = 2048) -> EstimatorDials:
    return EstimatorDials(*(dr.opaque(mi.Float, float(value)) for value in (blend, warm, window)))


def feed(
    estimate: Estimate, samples: np.ndarray, settings: EstimatorDials, scale: float = 1.0, active: bool = True
) -> Estimate:
    """Feed (frames, items, 3) samples, one frame after the other."""
    unit = dr.opaque(mi.Float, scale)
    lanes = mi.Bool(np.full(samples.shape[1], active))
    for frame in samples:
        sample = mi.Color3f(frame.T.astype(np.float32))
        drift = measure_drift(estimate, settings, lanes)
        estimate = update_estimate(estimate, sample, scale=unit, drift=drift, dials=settings, active=lanes)
        dr.eval(estimate)
    return estimate


def mean_of(estimate: Estimate) -> np.ndarray:
    return np.array(estimate.mean).T


@dataclass
class Published:
    """The steps of Ray Tracing Gems, chapter 25, for (items, 3) samples in float64."""

    items: int
    blend: float
    mean: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.mean, self.short, self.variance = (np.zeros((self.items, 3)) for _ in range(3))
        self.inconsistency, self.reduction = np.ones(self.items), np.zeros(self.items)

    def update(self, y: np.ndarray) -> None:
        y = np.minimum(y, 0.1 + self.short + 8.0 * np.sqrt(np.maximum(1e-5, self.variance)))
        delta = y - self.short
        self.short = self.short + self.blend * delta
        self.variance = self.variance + 0.5 * self.blend * (delta * (y - self.short) - self.variance)
        deviation = np.maximum(1e-5, np.sqrt(np.maximum(1e-5, self.variance)))
        relative = (np.abs(self.mean - self.short) / deviation) @ LUMA
        self.inconsistency += 0.08 * (relative - self.inconsistency)
        fresh = np.clip((0.5 * self.short / deviation) @ LUMA, 1 / 32, 1.0)
        x = np.clip(relative * np.maximum(0.02, self.inconsistency - 0.2), 0.0, 1.0)
        catch_up = np.clip(np.clip(x * x * (3.0 - 2.0 * x), 1 / 256, 1.0) * self.reduction, 0.0, 1.0)
        self.reduction += 0.1 * (fresh - self.reduction)
        self.mean = self.mean + catch_up[:, None] * (y - self.mean)


@pytest.mark.parametrize("blend", [0.08, 0.03])
def test_cold_start_follows_the_published_steps(blend: float) -> None:
    rng = np.random.default_rng(1)
    samples = rng.gamma(1.5, [0.4, 0.7, 1.1], (240, 50, 3))
    samples[120:] *= 4.0
    samples[60, ::7] += 200.0  # fireflies meet the cap
    reference = Published(50, blend)
    estimate, settings = new_estimate(50), dials(0, blend)
    for index in range(0, 240, 40):
        for frame in samples[index : index + 40]:
            reference.update(frame)
        estimate = feed(estimate, samples[index : index + 40], settings)
        np.testing.assert_allclose(mean_of(estimate), reference.mean, rtol=2e-3, atol=1e-4)
        np.testing.assert_allclose(np.array(estimate.short).T, reference.short, rtol=2e-3, atol=1e-4)
        np.testing.assert_allclose(np.array(estimate.variance).T, reference.variance, rtol=5e-3, atol=1e-3)
        np.testing.assert_allclose(np.array(estimate.inconsistency), reference.inconsistency, rtol=1e-2, atol=1e-3)
        np.testing.assert_allclose(np.array(estimate.reduction), reference.reduction, rtol=1e-2, atol=1e-3)


def test_constant_input_is_exact_from_the_first_sample() -> None:
    value = np.array([0.3, 2.0, 17.0])
    settings = dials()
    for frames in (1, 10, 200):
        estimate = feed(new_estimate(4), np.broadcast_to(value, (frames, 4, 3)), settings)
        np.testing.assert_allclose(mean_of(estimate), np.tile(value, (4, 1)), rtol=1e-5)


@pytest.mark.parametrize("warm", [0, WARM])
@pytest.mark.parametrize("factor", [1e-3, 1e4])
def test_scale_invariance(warm: int, factor: float) -> None:
    """Light k times as strong in a unit k times as large gives k times the mean: nothing but the unit sets a level."""
    samples = np.random.default_rng(2).gamma(1.0, 1.0, (150, 32, 3))
    samples[100:] *= 3.0
    plain = mean_of(feed(new_estimate(32), samples, dials(warm)))
    scaled = mean_of(feed(new_estimate(32), factor * samples, dials(warm), scale=factor))
    np.testing.assert_allclose(scaled / factor, plain, rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("after", [0.1, 4.0])
def test_it_follows_a_step(after: float) -> None:
    """After 400 calm samples a running mean would need thousands; 90 % of the step must come within 100."""
    rng = np.random.default_rng(3)
    noise = rng.gamma(4.0, 0.25, (500, 256, 3))
    settings = dials()
    before = feed(new_estimate(256), noise[:400], settings)
    assert mean_of(before).mean() == pytest.approx(1.0, abs=0.02)
    later = feed(before, after * noise[400:], settings)
    assert abs(mean_of(later).mean() - after) < 0.1 * abs(after - 1.0)


def test_stationary_noise_leaves_no_bias_and_averages_out() -> None:
    noise = np.random.default_rng(4).exponential(1.0, (600, 2048, 3))
    settings = dials()
    early = feed(new_estimate(2048), noise[:150], settings)
    late = feed(early, noise[150:], settings)
    assert mean_of(early).mean() == pytest.approx(1.0, abs=0.006)
    assert mean_of(late).mean() == pytest.approx(1.0, abs=0.006)
    # An exponential mean of the short blend would keep sqrt(b / (2 - b)) = 0.2 of the noise.
    assert mean_of(late).std() < 0.09
    assert mean_of(late).std() < 0.8 * mean_of(early).std()


def test_inactive_items_stay_as_they_are() -> None:
    samples = np.random.default_rng(5).gamma(1.0, 1.0, (20, 8, 3))
    before = feed(new_estimate(8), samples, dials())
    after = feed(before, 100.0 * samples, dials(), active=False)
    np.testing.assert_array_equal(mean_of(before), mean_of(after))
    np.testing.assert_array_equal(np.array(before.count), np.array(after.count))


def test_light_switched_off_is_forgotten_and_nothing_is_nan() -> None:
    lit = np.random.default_rng(6).gamma(1.0, 1.0, (100, 16, 3))
    estimate = feed(new_estimate(16), lit, dials())
    dark = mean_of(feed(estimate, np.zeros((300, 16, 3)), dials()))
    assert np.isfinite(dark).all() and dark.max() < 0.01
