"""Figures of a flight on made-up frames, against arithmetic."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from luxel.image.layers import Layers
from luxel.metrics.error import bias, regional
from luxel.metrics.motion import (
    SeenSurfaces,
    find_taps,
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


def make_surfaces(motion: tuple[float, float] = (0.0, 0.0)) -> SeenSurfaces:
    """Return a wall at 4 m that faces the viewer and moves by so many pixels, right and down."""
    depth = np.full(SHAPE, 4.0)
    normal = np.broadcast_to([0.0, 0.0, 1.0], (*SHAPE, 3)).copy()
    field = np.broadcast_to(motion, (*SHAPE, 2)).copy()
    return SeenSurfaces(depth, normal, np.ones(SHAPE, int), field, depth.copy())


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


def test_taps_of_whole_pixels_are_those_pixels() -> None:
    taps = find_taps(make_surfaces((3.0, -2.0)), make_surfaces())
    ramp = np.arange(np.prod(SHAPE), dtype=float).reshape(*SHAPE, 1)
    fetched = taps.fetch(ramp)
    # What is at (10, 20) now was three pixels to the left and two below.
    assert fetched[10, 20, 0] == ramp[12, 17, 0]
    # From beyond the picture's edge comes nothing: 3 columns and 2 rows.
    assert not taps.valid[:, :3].any() and not taps.valid[-2:].any()
    assert taps.valid.sum() == (40 - 3) * (24 - 2)


def test_taps_between_pixels_are_bilinear() -> None:
    taps = find_taps(make_surfaces((0.25, 0.5)), make_surfaces())
    column = np.broadcast_to(np.arange(40.0)[None, :, None], (*SHAPE, 1))
    row = np.broadcast_to(np.arange(24.0)[:, None, None], (*SHAPE, 1))
    assert taps.fetch(column)[5, 9, 0] == pytest.approx(8.75) and taps.fetch(row)[5, 9, 0] == pytest.approx(4.5)
    np.testing.assert_allclose(taps.weight.sum(axis=-1)[taps.valid], 1.0, rtol=1e-6)


@pytest.mark.parametrize("what", ["object", "depth", "normal", "nothing"])
def test_taps_on_another_surface_are_refused(what: str) -> None:
    now, before = make_surfaces((0.5, 0.0)), make_surfaces()
    half = np.s_[:, 20:]
    if what == "object":
        before.object_id[half] = 2
    elif what == "depth":
        before.depth[half] = 4.3
    elif what == "normal":
        before.normal[half] = [1.0, 0.0, 0.0]
    else:
        before.object_id[half], now.object_id[half], before.depth[half] = 0, 0, np.inf
    taps = find_taps(now, before)
    # Column 20 has one tap on either side of the edge: only the good one counts. Those beyond have none.
    assert not taps.valid[:, 21:].any() and taps.valid[:, 1:20].all()
    if what != "nothing":
        light = np.where(np.arange(40)[None, :, None] < 20, 1.0, 100.0) * np.ones((*SHAPE, 1))
        np.testing.assert_allclose(taps.fetch(light)[:, 20], 1.0)


def test_a_tap_is_looked_for_at_the_distance_that_the_point_had() -> None:
    now = make_surfaces()
    now.depth_before[:] = 5.0  # it came a metre nearer
    assert not find_taps(now, make_surfaces()).valid.any()
    before = make_surfaces()
    before.depth[:] = 5.0
    assert find_taps(now, before).valid.all()


# ---------- Flicker ----------


def test_light_that_stays_on_its_surface_does_not_flicker() -> None:
    random = np.random.default_rng(5)
    before, now = make_layers(), make_layers()
    before.indirect[:] = random.uniform(0.0, 2.0, before.indirect.shape)
    now.indirect[:, 2:] = before.indirect[:, :-2]
    # A texture that moves with its surface by no whole pixel is sampled elsewhere, which is not the light's doing.
    now.albedo[:] = random.uniform(0.2, 0.8, now.albedo.shape)
    taps = find_taps(make_surfaces((2.0, 0.0)), make_surfaces())
    assert flicker_between(now, before, taps, 1.0) == pytest.approx(0.0, abs=1e-6)
    # Without the motion it would.
    assert flicker_between(now, before, find_taps(make_surfaces(), make_surfaces()), 1.0) > 0.05


def test_flicker_is_the_displayed_change_summed_over_channels() -> None:
    before, now = make_layers(indirect=1.0), make_layers(indirect=1.0)
    now.indirect[:12, :, 1] = 2.0  # one channel of half the pixels
    taps = find_taps(make_surfaces(), make_surfaces())
    wanted = 0.5 * (shown(1.5 * 0.5 / np.pi * 2.0) - shown(1.5 * 0.5 / np.pi * 1.0))
    assert flicker_between(now, before, taps, 1.5) == pytest.approx(wanted, rel=1e-5)
    # Pixels without taps have no say.
    surfaces = make_surfaces()
    surfaces.object_id[12:] = 0
    assert flicker_between(now, before, find_taps(surfaces, make_surfaces()), 1.5) == pytest.approx(
        2 * wanted, rel=1e-5
    )


def test_flicker_without_a_tap_is_undefined() -> None:
    taps = find_taps(make_surfaces((100.0, 0.0)), make_surfaces())
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
