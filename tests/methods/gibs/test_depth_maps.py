"""Texels of depth maps against NumPy, and Chebyshev's bound against arithmetic."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from luxel.methods.gibs.depth_maps import blend_depth, chebyshev, pack_texel, unpack_texel


def test_two_texels_share_a_word() -> None:
    rng = np.random.default_rng(3)
    mean, deviation = rng.uniform(0.0, 1.0, (2, 4000)), rng.uniform(0.0, 0.5, (2, 4000))
    half = mi.Point2f(0.5, 0.5)
    word = mi.UInt32(0)
    for part in range(2):
        word |= pack_texel(mi.Float(mean[part]), mi.Float(deviation[part]), part, half)
    bits = np.array(word).astype(np.uint64)
    for part in range(2):
        low, high = (bits >> (16 * part)) & 255, (bits >> (16 * part + 8)) & 255
        assert np.abs(low - 255.0 * mean[part]).max() <= 0.501 and np.abs(high - 510.0 * deviation[part]).max() <= 0.501
        found = [np.array(v) for v in unpack_texel(word, part)]
        np.testing.assert_allclose(found, [low / 255.0, high / 510.0], atol=1e-6)


def test_the_dither_keeps_the_mean() -> None:
    """A value between two steps is rounded to either, as often as it is near: 0.3 steps up from 100."""
    dither = np.random.default_rng(4).uniform(0.0, 1.0, (2, 200_000)).astype(np.float32)
    word = pack_texel(mi.Float(100.3 / 255.0), mi.Float(20.7 / 510.0), 1, mi.Point2f(dither))
    mean, deviation = (np.array(v).astype(float) for v in unpack_texel(word, 1))
    assert mean.mean() * 255.0 == pytest.approx(100.3, abs=0.01)
    assert deviation.mean() * 510.0 == pytest.approx(20.7, abs=0.01)


@pytest.mark.parametrize(
    ("distance", "mean", "deviation", "bound"),
    [
        (0.3, 0.4, 0.0, 1.0),  # nearer than what is there
        (0.5, 0.4, 0.1, 0.5),  # one deviation beyond: 1 / (1 + 1)
        (0.6, 0.4, 0.1, 0.2),  # two: 1 / (1 + 4)
        (0.42, 0.4, 0.0, 0.2),  # the deviation is 0.01 at least: two of them
        (0.5, 0.4, 0.0, 1.0 / 101.0),  # ten
    ],
)
def test_chebyshev(distance: float, mean: float, deviation: float, bound: float) -> None:
    wanted = max((bound**3 - 0.05) / 0.95, 0.0)
    assert chebyshev(mi.Float(distance), mi.Float(mean), mi.Float(deviation))[0] == pytest.approx(wanted, abs=1e-5)


def test_the_running_moments_are_those_of_the_samples() -> None:
    """Of uniform samples in 0.4 to 0.6: mean 0.5, deviation 0.2 / sqrt(12); the window of 1/8 wavers around them."""
    samples = np.random.default_rng(5).uniform(0.4, 0.6, (400, 20_000)).astype(np.float32)
    mean, deviation = mi.Float(samples[0]), mi.Float(0.0577)
    for row in samples[1:]:
        mean, deviation = blend_depth(mean, deviation, mi.Float(row), mi.Float(8.0))
    assert np.array(mean).mean() == pytest.approx(0.5, abs=2e-3)
    assert np.sqrt((np.array(deviation).astype(float) ** 2).mean()) == pytest.approx(0.2 / 12**0.5, rel=0.08)


def test_what_moved_away_is_forgotten_soon() -> None:
    """Each sample far from the mean halves the way to it: after 8 of them less than 1 % is left of it."""
    mean, deviation = mi.Float(0.2), mi.Float(0.0)
    for _ in range(8):
        mean, deviation = blend_depth(mean, deviation, mi.Float(1.0), mi.Float(8.0))
    assert mean[0] > 0.75
