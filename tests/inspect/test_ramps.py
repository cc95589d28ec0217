"""Ramps that read in grey too, and colours of ids that can be told apart."""

from __future__ import annotations

import numpy as np
import pytest

from luxel.inspect.ramps import colorize, from_oklab, id_colors, ramp_table
from luxel.scene.colours import luminance

REC709 = np.array((0.2126, 0.7152, 0.0722))


def linear(display: np.ndarray) -> np.ndarray:
    return np.where(display <= 0.04045, display / 12.92, ((display + 0.055) / 1.055) ** 2.4)


def lightness(display: np.ndarray) -> np.ndarray:
    """CIE L* of displayed colours."""
    y = linear(display.astype(np.float64)) @ REC709
    return np.where(y > 0.008856, 116.0 * np.cbrt(y) - 16.0, 903.3 * y)


def test_oklab_of_known_colours() -> None:
    """White, and sRGB's own red, as Ottosson's page gives them."""
    np.testing.assert_allclose(from_oklab(np.array((1.0, 0.0, 0.0))), 1.0, atol=2e-3)
    np.testing.assert_allclose(from_oklab(np.array((0.62796, 0.22486, 0.12585))), (1.0, 0.0, 0.0), atol=4e-3)
    np.testing.assert_allclose(from_oklab(np.array((0.45201, -0.03246, -0.31153))), (0.0, 0.0, 1.0), atol=4e-3)


@pytest.mark.parametrize("ramp", ["field", "heat"])
def test_a_ramp_grows_lighter_evenly(ramp: str) -> None:
    light = lightness(ramp_table(ramp))
    steps = np.diff(light)
    assert (steps > 0.0).all() and light[0] < 25.0 and light[-1] > 85.0
    # No step is over three times the mean: bands that the numbers do not have would show.
    assert steps.max() < 3.0 * steps.mean()


def test_the_signed_ramp_is_dark_in_the_middle_and_unlike_at_the_ends() -> None:
    low, middle, high = colorize(np.array((0.0, 0.5, 1.0)), "signed")
    assert middle.max() < 0.1 and min(luminance(low), luminance(high)) > 0.5
    assert low[2] > low[0] and high[0] > high[2]
    light = lightness(ramp_table("signed"))
    assert (np.diff(light[: len(light) // 2]) < 0.0).all() and (np.diff(light[len(light) // 2 :]) > 0.0).all()


def test_values_beyond_the_ends_and_nan_are_taken() -> None:
    values = colorize(np.array([[-1.0, 0.0], [2.0, np.nan]]))
    assert values.shape == (2, 2, 3) and values.dtype == np.float32
    np.testing.assert_array_equal(values[0, 0], values[0, 1])
    np.testing.assert_array_equal(values[1, 0], colorize(np.array(1.0)))
    np.testing.assert_array_equal(values[1, 1], values[0, 0])


def test_ids_that_follow_each_other_look_unlike() -> None:
    colors = id_colors(np.arange(1, 64))
    assert ((colors >= 0.0) & (colors <= 1.0)).all()
    assert np.linalg.norm(np.diff(colors, axis=0), axis=1).min() > 0.25
    near = np.linalg.norm(colors[:12, None] - colors[None, :12], axis=2) + 9.0 * np.eye(12)
    assert near.min() > 0.06
    # Any word is an id: seeds are hashes.
    assert np.isfinite(id_colors(np.array([0, 2**32 - 1], np.uint32))).all()
