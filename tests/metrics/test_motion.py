"""Figures of a flight on made-up frames, against arithmetic."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from luxel.image.layers import Layers
from luxel.metrics.error import bias, regional
from luxel.metrics.motion import (
    PixelTaps,
    flicker_between,
    judge_by_sums,
    judge_frame,
    motion_figures,
    sum_truth,
    sums_irradiance,
)

SHAPE = (24, 40)


def make_layers(indirect: float = 1.0, albedo: float = 0.5, direct: float = 2.0) -> Layers:
    """Return a frame that is the same everywhere."""

    def colour(value: float) -> np.ndarray:
        return np.full((*SHAPE, 3), value, np.float32)

    hit = np.ones(SHAPE, bool)
    return Layers(colour(albedo), colour(0.0), colour(direct), colour(indirect), colour(0.0), hit * 1.0, hit)


def make_taps(right: int = 0, down: int = 0) -> PixelTaps:
    """Return the taps of what moved by whole pixels; what came into the picture has none."""
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    rows, columns = rows - down, columns - right
    inside = (rows >= 0) & (rows < SHAPE[0]) & (columns >= 0) & (columns < SHAPE[1])
    pixel, weight = np.zeros((*SHAPE, 4), int), np.zeros((*SHAPE, 4), np.float32)
    pixel[..., 0], weight[..., 0] = np.where(inside, rows * SHAPE[1] + columns, 0), inside
    return PixelTaps(pixel, weight)


def shown(radiance: float) -> float:
    """Return sRGB's curve, from its standard."""
    return 12.92 * radiance if radiance <= 0.0031308 else 1.055 * radiance ** (1 / 2.4) - 0.055


# ---------- A truth in sums ----------


def test_sums_of_a_truth_are_those_of_its_blocks() -> None:
    truth = make_layers(indirect=3.0)
    truth.albedo[:16, :16] = 0.01  # too dark to be divided by
    truth.hit[20:] = False
    sums = sum_truth(truth)
    assert sums.light.shape == sums.albedo.shape == (2, 3, 3)
    assert (sums.light[0, 0] == 0.0).all() and (sums.albedo[0, 0] == 0.0).all()
    # The second row of blocks has 8 rows, of which 4 hit; the third column has 8 columns.
    np.testing.assert_allclose(sums.albedo[1, 2], 0.5 * 4 * 8, rtol=1e-6)
    np.testing.assert_allclose(sums.light[1, 2], 0.5 / np.pi * 3.0 * 4 * 8, rtol=1e-6)
    np.testing.assert_allclose(sums.total, 3.0 / np.pi * (0.5 * (20 * 40 - 256) + 0.01 * 256), rtol=1e-6)


def test_sums_judge_as_arithmetic_does() -> None:
    truth = make_layers(indirect=3.0)
    test = make_layers(indirect=3.0)
    test.indirect[:16, :16] = 6.0
    found = judge_by_sums(test, sum_truth(truth))
    # One of six blocks is twice as bright: sqrt(1 / 6) of the mean; 256 of 960 pixels are.
    assert found["regional"] == pytest.approx(np.sqrt(1 / 6), rel=1e-5)
    assert found["bias"] == pytest.approx(256 / 960, rel=1e-5)


def test_sums_judge_any_frame_as_its_layers_do() -> None:
    random = np.random.default_rng(3)
    truth, test = make_layers(), make_layers()
    truth.albedo[:] = test.albedo[:] = random.uniform(0.0, 0.9, truth.albedo.shape)
    truth.hit[:] = test.hit[:] = random.random(SHAPE) < 0.8
    truth.indirect[:], test.indirect[:] = random.uniform(0.0, 2.0, (2, *truth.indirect.shape))
    found = judge_by_sums(test, sum_truth(truth))
    assert found["regional"] == pytest.approx(regional(test, truth), rel=1e-5)
    assert found["bias"] == pytest.approx(bias(test, truth), abs=1e-6)


def test_a_black_truth_leaves_the_figures_undefined() -> None:
    assert all(np.isnan(value) for value in judge_by_sums(make_layers(), sum_truth(make_layers(indirect=0.0))).values())


def test_the_one_irradiance_of_a_flight_gives_its_total() -> None:
    bright, dark = make_layers(indirect=4.0, albedo=0.75), make_layers(indirect=1.0, albedo=0.25)
    # (4 x 0.75 + 1 x 0.25) / (0.75 + 0.25)
    assert sums_irradiance([sum_truth(bright), sum_truth(dark)]) == pytest.approx((3.25,) * 3, rel=1e-5)
    assert sums_irradiance([sum_truth(make_layers(albedo=0.0))]) == (0.0, 0.0, 0.0)


# ---------- A frame ----------


def test_noise_of_direct_light_has_no_say() -> None:
    truth = make_layers()
    noisy = replace(truth, direct=np.random.default_rng(1).uniform(0.0, 9.0, truth.direct.shape).astype(np.float32))
    assert judge_frame(noisy, truth) == pytest.approx({"regional": 0.0, "bias": 0.0, "flip": 0.0}, abs=1e-6)
    darker = judge_frame(replace(noisy, indirect=0.5 * truth.indirect), truth)
    assert darker["regional"] == pytest.approx(0.5, rel=1e-5) and darker["bias"] == pytest.approx(-0.5, rel=1e-5)
    assert 0.0 < darker["flip"] < 1.0


def test_frames_of_full_materials_are_judged_as_displayed_alone() -> None:
    assert judge_frame(make_layers(), make_layers(), split=False).keys() == {"flip"}


# ---------- PixelTaps ----------


def test_taps_fetch_by_their_weights() -> None:
    taps = make_taps(3, -2)
    ramp = np.arange(np.prod(SHAPE), dtype=float).reshape(*SHAPE, 1)
    # What is at (10, 20) now was three pixels to the left and two below.
    assert taps.fetch(ramp)[10, 20, 0] == ramp[12, 17, 0]
    assert taps.valid.sum() == (40 - 3) * (24 - 2)
    taps.pixel[10, 20], taps.weight[10, 20] = [0, 1, 40, 41], [0.1, 0.2, 0.3, 0.4]
    assert taps.fetch(ramp)[10, 20, 0] == pytest.approx(0.2 * 1 + 0.3 * 40 + 0.4 * 41)


# ---------- Flicker ----------


def test_light_that_stays_on_its_surface_does_not_flicker() -> None:
    random = np.random.default_rng(5)
    before, now = make_layers(), make_layers()
    before.indirect[:] = random.uniform(0.0, 2.0, before.indirect.shape)
    now.indirect[:, 2:] = before.indirect[:, :-2]
    # A texture that moves with its surface by no whole pixel is sampled elsewhere, which is not the light's doing.
    now.albedo[:] = random.uniform(0.2, 0.8, now.albedo.shape)
    taps = make_taps(2)
    assert flicker_between(now, before, taps, 1.0) == pytest.approx(0.0, abs=1e-6)
    # Without the motion it would.
    assert flicker_between(now, before, make_taps(), 1.0) > 0.05


def test_flicker_is_the_displayed_change_summed_over_channels() -> None:
    before, now = make_layers(indirect=1.0), make_layers(indirect=1.0)
    now.indirect[:12, :, 1] = 2.0  # one channel of half the pixels
    taps = make_taps()
    wanted = 0.5 * (shown(1.5 * 0.5 / np.pi * 2.0) - shown(1.5 * 0.5 / np.pi * 1.0))
    assert flicker_between(now, before, taps, 1.5) == pytest.approx(wanted, rel=1e-5)
    # Pixels without taps have no say.
    taps.weight[12:] = 0.0
    assert flicker_between(now, before, taps, 1.5) == pytest.approx(2 * wanted, rel=1e-5)


def test_flicker_without_a_tap_is_undefined() -> None:
    taps = make_taps(100)
    assert np.isnan(flicker_between(make_layers(), make_layers(), taps, 1.0))


# ---------- The flight ----------


def test_figures_of_a_flight() -> None:
    frames = [{"regional": 0.1, "bias": 0.2, "flip": 0.01}, {"regional": 0.3, "bias": -0.4, "flip": 0.03}]
    cuts = [{"regional": 0.9, "bias": 0.0}, {"regional": 0.6, "bias": 0.0}, {"regional": 0.3, "bias": 0.0}]
    assert motion_figures(frames, [0.01, 0.02, float("nan")], cuts) == pytest.approx(
        {
            "motion_regional": 0.2,
            "motion_regional_worst": 0.3,
            "motion_flip": 0.02,
            "motion_bias": 0.3,
            "motion_flicker": 0.015,
            "cut_regional": 0.6,
        }
    )


def test_what_no_frame_has_is_none() -> None:
    found = motion_figures([{"flip": 0.5}], [], [{"regional": float("nan")}])
    assert found.pop("motion_flip") == 0.5
    assert set(found.values()) == {None}
