"""Random numbers by chi-square, the low-discrepancy sequence by discrepancy, the warps by their densities."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy import stats
from scipy.stats import qmc

from luxel.kernels import sampling

COUNT = 1 << 18
BINS = 16
UNLIKELY = 1e-4
"""Least p-value that passes; the numbers are fixed, so a pass stays a pass."""


def p_value(x: np.ndarray, y: np.ndarray) -> float:
    """Return the p-value of the chi-square test that (x, y) fill the unit square evenly."""
    counts, _, _ = np.histogram2d(x, y, BINS, [[0.0, 1.0], [0.0, 1.0]])
    return float(stats.chisquare(counts.ravel()).pvalue)


def draw(a: mi.UInt32, b: mi.UInt32) -> tuple[np.ndarray, np.ndarray]:
    point = sampling.random_2d(a, b)
    return np.array(point.x), np.array(point.y)


def test_scrambling_leaves_the_callers_numbers_alone() -> None:
    words = dr.arange(mi.UInt32, 8)
    scrambled = sampling.mix(words)
    np.testing.assert_array_equal(np.array(words), np.arange(8))
    assert len(set(np.array(scrambled))) == 8


def counting(start: int = 0) -> mi.UInt32:
    return dr.arange(mi.UInt32, COUNT) + mi.UInt32(start)


@pytest.mark.parametrize("seed", [0, 1, 12345, 0xFFFFFFFF])
def test_random_2d_is_even_over_lanes(seed: int) -> None:
    assert p_value(*draw(mi.UInt32(seed), counting())) > UNLIKELY


@pytest.mark.parametrize("lane", [0, 7, 0x80000001])
def test_random_2d_is_even_over_sequential_seeds(lane: int) -> None:
    assert p_value(*draw(counting(), mi.UInt32(lane))) > UNLIKELY


@pytest.mark.parametrize("step", [1, 2, 16, 256, 4099])
def test_consecutive_counters_are_independent(step: int) -> None:
    """Pairs of numbers `step` counters apart fill the square evenly, over seeds, over lanes, and across the two."""
    x0, y0 = draw(counting(), mi.UInt32(5))
    x1, y1 = draw(counting(step), mi.UInt32(5))
    for first, second in ((x0, x1), (y0, y1), (x0, y1), (y0, x1)):
        assert p_value(first, second) > UNLIKELY
    x0, y0 = draw(mi.UInt32(5), counting())
    x1, y1 = draw(mi.UInt32(5), counting(step))
    for first, second in ((x0, x1), (y0, y1), (x0, y1), (y0, x1)):
        assert p_value(first, second) > UNLIKELY
    x1, y1 = draw(mi.UInt32(5 + step), counting())
    for first, second in ((x0, x1), (y0, y1), (x0, y1), (y0, x1)):
        assert p_value(first, second) > UNLIKELY


def test_the_test_can_fail() -> None:
    lane = np.arange(COUNT)
    assert p_value((lane * 0.6180339887) % 1.0, ((lane + 1) * 0.6180339887) % 1.0) < UNLIKELY


def test_the_two_words_are_uncorrelated_with_each_other_and_with_their_neighbours() -> None:
    limit = 5.0 / np.sqrt(COUNT)
    words = [np.array(sampling.to_unit(word)) for word in sampling.hash_pair(counting(), mi.UInt32(3))]
    others = [np.array(sampling.to_unit(word)) for word in sampling.hash_pair(counting(1), mi.UInt32(3))]
    across = [np.array(sampling.to_unit(word)) for word in sampling.hash_pair(counting(), mi.UInt32(4))]
    columns = np.corrcoef(np.array(words + others + across))
    assert np.abs(columns - np.eye(6)).max() < limit


def test_to_unit_stays_below_one() -> None:
    ends = np.array(sampling.to_unit(mi.UInt32([0, 0xFFFFFFFF, 0x80000000])))
    assert ends[0] == 0.0 and ends[1] < 1.0 and ends[2] == 0.5


@pytest.mark.parametrize("start", [0, 5000])
def test_the_sequence_is_more_even_than_random(start: int) -> None:
    count = 1024
    shift = mi.UInt32(0x12345678), mi.UInt32(0x9ABCDEF0)
    index = dr.arange(mi.UInt32, count) + start
    points = np.array(sampling.sequence_2d(index, shift)).T.astype(float)
    random = [qmc.discrepancy(np.random.default_rng(seed).random((count, 2))) for seed in range(8)]
    assert qmc.discrepancy(points) < 0.1 * float(np.mean(random))


def test_the_sequence_stays_exact_for_any_index() -> None:
    """Float arithmetic would have lost all digits by then."""
    root = 1.0
    for _ in range(60):
        root = (1.0 + root) ** (1.0 / 3.0)  # x^3 = x + 1
    indices = [0, 1, 1000, 0x7FFFFFFF, 0xFFFFFFFE]
    points = np.array(sampling.sequence_2d(mi.UInt32(indices), (mi.UInt32(0), mi.UInt32(0)))).T
    for row, index in zip(points, indices, strict=True):
        steps = [round(root ** -(axis + 1) * 2**32) for axis in range(2)]
        expected = np.array([(index * step % 2**32) / 2**32 for step in steps])
        away = np.abs(row - expected)
        # A step is right to one unit of 2^-32, which the index multiplies.
        assert np.minimum(away, 1.0 - away).max() < 2e-7 + index * 2.0**-32 * (0 if index < 2 else 1e-3)


def test_cosine_hemisphere_has_density_cos_over_pi() -> None:
    x, y = np.random.default_rng(1).random((2, 40000))
    d = np.array(sampling.cosine_hemisphere(mi.Point2f(x, y))).T.astype(float)
    np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1.0, atol=1e-5)
    assert (d[:, 2] >= 0.0).all()
    # The projection to the disc is uniform: z^2 and the azimuth are.
    assert stats.kstest(d[:, 2] ** 2, "uniform").pvalue > 1e-3
    azimuth = np.arctan2(d[:, 1], d[:, 0]) / (2.0 * np.pi) + 0.5
    assert p_value(np.clip(d[:, 2] ** 2, 0.0, 1.0), azimuth) > UNLIKELY


def test_uniform_triangle_is_uniform_by_area() -> None:
    point = sampling.random_2d(mi.UInt32(9), counting())
    b = np.array(sampling.uniform_triangle(point)).T.astype(float)
    third = 1.0 - b.sum(axis=1)
    assert b.min() >= 0.0 and third.min() >= -1e-6
    # Lines through the weights cut the triangle into n^2 equal ones.
    n = 8
    cells = np.stack([np.floor(np.clip(w, 0, 1 - 1e-9) * n) for w in (b[:, 0], b[:, 1], third)], axis=1)
    _, counts = np.unique(cells, axis=0, return_counts=True)
    counts = counts[counts > 16]  # slivers where rounding put a point on a line
    assert len(counts) == n * n
    assert stats.chisquare(counts).pvalue > UNLIKELY


def test_to_world_turns_z_to_the_normal_and_keeps_angles() -> None:
    rng = np.random.default_rng(2)
    n, v, w = rng.normal(size=(3, 1000, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    n[:2] = (0, 0, 1), (0, 0, -1)
    normal = mi.Normal3f(n.T.astype(np.float32))
    turned = [np.array(sampling.to_world(normal, mi.Vector3f(a.T.astype(np.float32)))).T for a in (v, w)]
    np.testing.assert_allclose((turned[0] * n).sum(axis=1), v[:, 2], atol=1e-5)
    np.testing.assert_allclose((turned[0] * turned[1]).sum(axis=1), (v * w).sum(axis=1), atol=1e-4)
