"""The figures of error against values worked out by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from luxel.image.layers import Layers
from luxel.metrics import error
from luxel.metrics.error import all_errors, ambient_irradiance


def make_layers(
    indirect: np.ndarray | float,
    *,
    albedo: np.ndarray | float = 0.5,
    direct: float = 0.0,
    emission: float = 0.0,
    size: tuple[int, int] = (32, 32),
    hit: np.ndarray | None = None,
) -> Layers:
    def fill(value: np.ndarray | float) -> np.ndarray:
        return np.broadcast_to(np.asarray(value, np.float32), (*size, 3)).copy()

    hit = np.ones(size, bool) if hit is None else hit
    return Layers(
        albedo=np.where(hit[..., None], fill(albedo), 0.0),
        emission=fill(emission),
        direct=fill(direct),
        indirect=fill(indirect),
        glossy=fill(0.0),
        weight=np.ones(size, np.float32),
        hit=hit,
    )


def two_halves(left: float, right: float, size: tuple[int, int] = (32, 32)) -> np.ndarray:
    """An (H, W, 3) field: `left` in the left half, `right` in the right one."""
    field = np.full((*size, 3), left, np.float32)
    field[:, size[1] // 2 :] = right
    return field


def test_the_noise_of_an_image_is_its_distance_from_an_endless_one() -> None:
    """Two noisy halves of a picture that is known: what FLIP (its authors' evaluator) says of their mean, and ours."""
    rng, still = np.random.default_rng(3), np.broadcast_to(np.linspace(0.2, 0.8, 96)[:, None, None], (96, 96, 3))
    for strength in (0.02, 0.1):
        halves = [(still + rng.normal(0.0, strength, still.shape)).astype(np.float32) for _ in range(2)]
        known = error.image_errors(0.5 * (halves[0] + halves[1]), still.astype(np.float32), np.ones((96, 96), bool))
        assert error.image_noise(halves) == pytest.approx(known["flip"], rel=0.03)
    assert error.image_noise([still, still]) == 0.0


def test_regional_compares_block_means_not_pixels() -> None:
    # A checkerboard of 0 and 2 has the same block means as a constant 1, whatever its pixels do.
    checker = np.indices((32, 32)).sum(axis=0)[..., None] % 2 * 2.0
    truth = make_layers(1.0)
    assert error.regional(make_layers(np.broadcast_to(checker, (32, 32, 3))), truth) == pytest.approx(0.0, abs=1e-6)
    assert error.rmse_tonemapped(make_layers(np.broadcast_to(checker, (32, 32, 3))), truth) > 0.1


def test_regional_by_hand() -> None:
    # Blocks of the truth: E = 1 and 3, radiance over albedo 1/pi and 3/pi, mean 2/pi. Test: 2 everywhere.
    truth, test = make_layers(two_halves(1.0, 3.0)), make_layers(2.0)
    assert error.regional(test, truth) == pytest.approx(1.0 / 2.0)
    # None: sqrt((1 + 9) / 2) / 2.
    assert error.regional(make_layers(0.0), truth) == pytest.approx(np.sqrt(5.0) / 2.0)
    assert error.regional(make_layers(0.8 * truth.indirect), truth) == pytest.approx(0.2 * np.sqrt(5.0) / 2.0, rel=1e-5)


def test_regional_weighs_pixels_of_a_block_by_albedo() -> None:
    # One block: albedo 0.8 with E 1 on the left, albedo 0.2 with E 2 on the right: 1.2 instead of the plain 1.5.
    albedo = two_halves(0.8, 0.2, (16, 16))
    truth = make_layers(1.2, albedo=albedo, size=(16, 16))
    test = make_layers(two_halves(1.0, 2.0, (16, 16)), albedo=albedo, size=(16, 16))
    assert error.regional(test, truth) == pytest.approx(0.0, abs=1e-6)


def test_regional_leaves_out_background_and_dark_albedo() -> None:
    hit = np.ones((32, 32), bool)
    hit[:4] = False
    albedo = np.full((32, 32, 3), 0.5, np.float32)
    albedo[10:12] = 0.01
    albedo[..., 2] = 0.0
    truth, test = make_layers(1.0, albedo=albedo, hit=hit), make_layers(1.0, albedo=albedo, hit=hit)
    test.indirect[:4] = 50.0
    test.indirect[10:12] = 50.0
    test.indirect[..., 2] = 50.0
    assert error.regional(test, truth) == pytest.approx(0.0, abs=1e-6)


def test_regional_takes_smaller_blocks_at_the_edge() -> None:
    # 20 columns: a block of 16 and one of 4, each counts once.
    truth, test = make_layers(1.0, size=(16, 20)), make_layers(1.0, size=(16, 20))
    test.indirect[:, 16:] = 2.0
    assert error.regional(test, truth) == pytest.approx(np.sqrt(0.5))


def test_bias_by_hand() -> None:
    truth = make_layers(two_halves(1.0, 3.0))
    assert error.bias(make_layers(2.0), truth) == pytest.approx(0.0, abs=1e-6)
    assert error.bias(make_layers(1.5), truth) == pytest.approx(-0.25)
    assert error.bias(make_layers(0.0), truth) == -1.0


def test_ambient_has_the_truth_total_but_not_its_regions() -> None:
    albedo = two_halves(0.9, 0.3)
    truth = make_layers(two_halves(1.0, 3.0), albedo=albedo)
    # (0.9 * 1 + 0.3 * 3) / (0.9 + 0.3)
    irradiance = ambient_irradiance(truth)
    assert irradiance == pytest.approx((1.5, 1.5, 1.5))
    ambient = make_layers(np.asarray(irradiance), albedo=albedo)
    assert error.bias(ambient, truth) == pytest.approx(0.0, abs=1e-6)
    assert error.regional(ambient, truth) == pytest.approx(np.sqrt((0.5**2 + 1.5**2) / 2) / 2)


def test_ambient_is_a_colour_and_survives_black() -> None:
    albedo = np.zeros((32, 32, 3), np.float32)
    albedo[..., 0] = 0.5
    assert ambient_irradiance(make_layers(2.0, albedo=albedo)) == pytest.approx((2.0, 0.0, 0.0))


def test_relmse_by_hand() -> None:
    # Radiance 0.5 / pi * E; the scale cancels: truth 1, test 1.5, floor 0.01.
    assert error.relmse(make_layers(1.5), make_layers(1.0)) == pytest.approx(0.25 / 1.01, rel=1e-5)
    # Truth 0 and 2 (mean 1) against 1: (1 / 0.01 + 1 / 4.01) / 2.
    truth = make_layers(two_halves(0.0, 2.0))
    assert error.relmse(make_layers(1.0), truth) == pytest.approx((1 / 0.01 + 1 / 4.01) / 2, rel=1e-4)


def test_rmse_tonemapped_by_hand() -> None:
    # Truth scaled to 1 -> 1/2, nothing -> 0; three times as much -> 3/4.
    truth = make_layers(7.0)
    assert error.rmse_tonemapped(make_layers(0.0), truth) == pytest.approx(0.5)
    assert error.rmse_tonemapped(make_layers(21.0), truth) == pytest.approx(0.25)


def test_tone_map_divides_by_the_largest_channel() -> None:
    # Truth (2, 0.5, 0.5), mean 1 -> / 3; test black.
    truth = make_layers(np.array([2.0, 0.5, 0.5]))
    expected = np.sqrt(((2 / 3) ** 2 + 2 * (0.5 / 3) ** 2) / 3)
    assert error.rmse_tonemapped(make_layers(0.0), truth) == pytest.approx(expected)


def test_rmse_gi_tonemapped_counts_direct_light_and_no_albedo() -> None:
    # Direct 3 of 4: without the indirect part 0.75 instead of 1, so 3/7 instead of 1/2, on any albedo.
    truth = make_layers(1.0, direct=3.0, albedo=two_halves(0.9, 0.1))
    test = make_layers(0.0, direct=3.0, albedo=two_halves(0.9, 0.1))
    assert error.rmse_gi_tonemapped(test, truth) == pytest.approx(0.5 - 3.0 / 7.0)


def test_figures_of_indirect_light_ignore_the_direct_light() -> None:
    truth, test = make_layers(1.0, direct=1.0), make_layers(1.0, direct=9.0)
    for figure in (error.regional, error.bias, error.relmse, error.rmse_tonemapped):
        assert figure(test, truth) == pytest.approx(0.0, abs=1e-6)
    assert error.rmse_gi_tonemapped(test, truth) > 0.1


def test_absolute_error_is_that_of_the_displayed_images() -> None:
    # The truth's grey is shown at 0.18, encoded 0.4614; black differs by that in three channels.
    truth, test = make_layers(1.0, size=(64, 128)), make_layers(0.0, size=(64, 128))
    assert error.abs_error_mean(test, truth) == pytest.approx(3 * 0.46135, abs=1e-3)
    assert error.abs_error_max(test, truth) == pytest.approx(3 * 0.46135, abs=1e-3)
    assert error.block_error_max(test, truth) == pytest.approx(3 * 0.46135, abs=1e-3)


def test_block_error_is_the_worst_64x64_mean() -> None:
    truth, test = make_layers(1.0, size=(64, 128)), make_layers(1.0, size=(64, 128))
    test.indirect[:32, 64:] = 0.0
    grey = 3 * 0.46135
    assert error.abs_error_mean(test, truth) == pytest.approx(grey / 4, abs=1e-3)
    assert error.block_error_max(test, truth) == pytest.approx(grey / 2, abs=1e-3)
    assert error.abs_error_max(test, truth) == pytest.approx(grey, abs=1e-3)


def test_pixels_without_a_hit_do_not_count() -> None:
    hit = np.zeros((64, 64), bool)
    hit[:32] = True
    truth, test = make_layers(1.0, size=(64, 64), hit=hit), make_layers(1.0, size=(64, 64), hit=hit)
    truth.emission[~hit], test.emission[~hit] = 0.1, 5.0
    assert error.abs_error_mean(test, truth) == 0.0
    assert error.abs_error_max(test, truth) == 0.0
    assert error.block_error_max(test, truth) == 0.0
    assert error.bias(test, truth) == 0.0


def test_truth_noise_is_half_of_the_difference_between_the_halves() -> None:
    truth = make_layers(2.0)
    halves = (np.full((32, 32, 3), 1.9, np.float32), np.full((32, 32, 3), 2.1, np.float32))
    assert error.truth_noise(truth, halves) == pytest.approx(0.05, rel=1e-4)


def test_all_figures_together() -> None:
    truth = make_layers(two_halves(1.0, 3.0), direct=1.0)
    halves = (truth.indirect * 0.99, truth.indirect * 1.01)
    same = all_errors(truth, truth, halves)
    assert set(same) == {
        "regional", "bias", "relmse", "rmse_tonemapped", "rmse_gi_tonemapped", "abs_error_mean", "abs_error_max",
        "block_error_max", "flip", "truth_noise",
    }  # fmt: skip
    assert same.pop("truth_noise") > 0.0
    assert all(value == pytest.approx(0.0, abs=1e-6) for value in same.values())
    other = all_errors(replace(truth, indirect=truth.indirect * 0.5), truth, halves)
    assert all(value != pytest.approx(0.0, abs=1e-3) for value in other.values())
    for name in ("regional", "relmse", "abs_error_mean", "abs_error_max", "block_error_max"):
        alone = getattr(error, name)(replace(truth, indirect=truth.indirect * 0.5), truth)
        assert other[name] == pytest.approx(alone)


def test_doubling_all_light_changes_no_figure() -> None:
    truth, test = make_layers(two_halves(1.0, 3.0), direct=1.0), make_layers(2.0, direct=1.0)

    def brighten(layers: Layers, factor: float) -> Layers:
        return replace(layers, direct=layers.direct * factor, indirect=layers.indirect * factor)

    usual = all_errors(test, truth, (truth.indirect, test.indirect))
    for factor in (1e-3, 1e4):
        lit = brighten(truth, factor)
        figures = all_errors(brighten(test, factor), lit, (lit.indirect, test.indirect * factor))
        assert figures == pytest.approx(usual, rel=1e-3, abs=1e-6)


def test_a_truth_without_light_or_surfaces_leaves_the_figures_undefined() -> None:
    black = make_layers(0.0)
    empty = make_layers(1.0, hit=np.zeros((32, 32), bool))
    for figure in (error.regional, error.bias, error.relmse, error.rmse_tonemapped, error.rmse_gi_tonemapped):
        assert np.isnan(figure(black, black))
        assert np.isnan(figure(empty, empty))
    assert np.isnan(error.block_error_max(empty, empty))
