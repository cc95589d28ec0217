"""Errors of baked texels against a truth that is itself noisy: NumPy alone.

The truth comes in two independent halves. The mean of (value - one half) times (value - other half) is the squared
error without the truth's own noise, which is independent in the two and so cancels on average.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

PATCH = 8
"""Texels along a patch's side."""
PATCH_LEAST = 16
"""Compared texels that a patch needs to count."""

FALLS = 0.1
"""Power of the samples by which errors must fall for more of them to help; noise alone falls by a half."""


@dataclass
class Halves:
    """A truth of M texels, twice: (M, 3) irradiance each, from samples of their own."""

    a: np.ndarray
    b: np.ndarray

    @property
    def mean(self) -> np.ndarray:
        """The better estimate, (M, 3)."""
        return 0.5 * (self.a + self.b)

    def take(self, chosen: np.ndarray) -> Halves:
        """Return the truth of the texels `chosen` (M,) bool or indices."""
        return Halves(self.a[chosen], self.b[chosen])

    def noise(self) -> float:
        """Return the noise of the mean of both halves, relative to the mean light: the root of its mean square."""
        return 0.5 * float(np.sqrt(((self.a - self.b) ** 2).mean())) / float(self.mean.mean())


def relative_rmse(values: np.ndarray, truth: Halves) -> float:
    """Return the root mean squared error of `values` (M, 3) over the truth's mean, the truth's own noise taken out.

    Zero where that noise leaves nothing.
    """
    square = float(((values - truth.a) * (values - truth.b)).mean())
    return math.sqrt(max(square, 0.0)) / float(truth.mean.mean())


def relative_bias(values: np.ndarray, truth: Halves) -> float:
    """Return the mean of `values` (M, 3) over the truth's, minus one."""
    return float(values.mean()) / float(truth.mean.mean()) - 1.0


def patch_of_texels(x: np.ndarray, y: np.ndarray, chart: np.ndarray) -> np.ndarray:
    """Return the patch (M,) of texels at (x, y) of the atlas: squares of `PATCH` of one chart; -1: too few in it."""
    keys = np.stack([chart, x // PATCH, y // PATCH])
    _, patch, amount = np.unique(keys, axis=1, return_inverse=True, return_counts=True)
    patch = patch.ravel()
    return np.where(amount[patch] >= PATCH_LEAST, patch, -1)


def patch_means(values: np.ndarray, patch: np.ndarray) -> np.ndarray:
    """Return means (K, 3) of `values` (M, 3) over the patches that `patch` (M,) names."""
    _, number = np.unique(patch[patch >= 0], return_inverse=True)
    held = values[patch >= 0]
    sums = np.stack([np.bincount(number, weights=held[:, channel]) for channel in range(values.shape[1])], axis=1)
    return sums / np.bincount(number)[:, None]


def judge(values: np.ndarray, truth: Halves, patch: np.ndarray) -> dict[str, float]:
    """Return `rmse` by texels, `patch_rmse` by patches, `bias`: all relative to the truth's mean."""
    patches = Halves(patch_means(truth.a, patch), patch_means(truth.b, patch))
    return {
        "rmse": relative_rmse(values, truth),
        "patch_rmse": relative_rmse(patch_means(values, patch), patches),
        "bias": relative_bias(values, truth),
    }


def samples_for_time(samples: list[int], seconds: list[float], budget: float) -> int:
    """Return how many samples take `budget` seconds, by the straight line through measured bakes; at least 1."""
    slope, start = np.polyfit(np.asarray(samples, float), np.asarray(seconds, float), 1)
    return max(1, round((budget - float(start)) / max(float(slope), 1e-12)))


def samples_for_error(samples: list[int], errors: list[float], wanted: float) -> int | None:
    """Return how many samples bring the error to `wanted`; None where more of them hardly help.

    Errors fall as a power of the samples, taken from the two bakes that came nearest.
    """
    count, error = np.asarray(samples, float), np.asarray(errors, float)
    if (error <= 0.0).any():
        return None
    first, second = np.argsort(np.abs(np.log(error / wanted)), kind="stable")[:2]
    power = -np.log(error[second] / error[first]) / np.log(count[second] / count[first])
    if power < FALLS:
        return None
    return max(1, round(float(count[first] * (error[first] / wanted) ** (1.0 / power))))
