"""Exposure and the sRGB curve."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from luxel.errors import LuxelError
from luxel.image.tonemap import mean_exposure, to_display, write_image
from luxel.scene.colours import luminance


def test_known_points_of_the_srgb_curve() -> None:
    light = np.array([0.0, 0.0031308, 0.18, 0.5, 1.0, 3.0])
    shown = to_display(np.repeat(light[:, None, None], 3, axis=2))
    expected = [0.0, 0.04045, 0.46135, 0.73536, 1.0, 1.0]
    np.testing.assert_allclose(shown[:, 0, 0], expected, atol=2e-5)
    assert shown.dtype == np.float32


def test_exposure_multiplies_light_before_the_curve() -> None:
    image = np.full((2, 2, 3), 0.09)
    np.testing.assert_allclose(to_display(image, 2.0), to_display(image * 2.0))
    assert to_display(image, 2.0)[0, 0, 0] != pytest.approx(2.0 * to_display(image)[0, 0, 0], abs=1e-2)


def test_mean_exposure_brings_the_mean_luminance_to_middle_grey() -> None:
    image = np.random.default_rng(3).random((8, 9, 3)) * 40.0
    assert luminance(image * mean_exposure(image)).mean() == pytest.approx(0.18)
    assert luminance(np.array([[[1.0, 0.0, 0.0]]]))[0, 0] == pytest.approx(0.2126)


def test_black_and_broken_pixels_do_not_break_the_exposure() -> None:
    assert mean_exposure(np.zeros((4, 4, 3))) == 1.0
    image = np.full((4, 4, 3), 0.36)
    image[0, 0] = np.nan
    assert mean_exposure(image) == pytest.approx(0.5)
    assert np.isfinite(to_display(image)).all()


def test_an_unknown_suffix_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(LuxelError, match=r"\.png or \.exr"):
        write_image(tmp_path / "image.bmp", np.zeros((2, 2, 3)))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["image.png", "image.exr"])
@pytest.mark.parametrize(
    ("image", "exposure", "words"),
    [
        ("hi", 1.0, "array of numbers"),
        (np.zeros((2, 2)), 1.0, "not one of shape 2x2"),
        (np.zeros((2, 2, 4)), 1.0, "not one of shape 2x2x4"),
        (np.zeros((0, 2, 3)), 1.0, "not one of shape 0x2x3"),
        (None, 1.0, "array"),
        (np.zeros((2, 2, 3)), "+1ev", "exposure is a number"),
        (np.zeros((2, 2, 3)), None, "exposure is a number"),
        (np.zeros((2, 2, 3)), float("nan"), "exposure is a number"),
    ],
)
def test_what_is_no_image_is_one_sentence(tmp_path: Path, name: str, image: Any, exposure: Any, words: str) -> None:
    with pytest.raises(LuxelError, match=words):
        write_image(tmp_path / name, image, exposure)
    assert not list(tmp_path.iterdir())
