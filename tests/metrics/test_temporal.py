"""Flicker, lag and drift against values worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from luxel.metrics.temporal import drift, flicker, lag_frames


def test_flicker_by_hand() -> None:
    # Three channels change by 0.1, then by 0.3, in half of the pixels; the images' means are 0.5, 0.55, 0.4.
    first = np.full((4, 4, 3), 0.5)
    second, third = first.copy(), first.copy()
    second[:2] += 0.1
    third[:2] -= 0.2
    result = flicker([first, second, third])
    assert result.absolute == pytest.approx((0.15 + 0.45) / 2)
    assert result.relative == pytest.approx(0.3 / ((0.5 + 0.55 + 0.4) / 3))


def test_a_still_run_does_not_flicker_and_a_generator_will_do() -> None:
    assert flicker(np.full((2, 2, 3), 0.3) for _ in range(5)) == (0.0, 0.0)


def test_flicker_needs_two_images_and_light() -> None:
    assert math.isnan(flicker([np.ones((2, 2, 3))]).absolute)
    black = flicker([np.zeros((2, 2, 3))] * 3)
    assert black.absolute == 0.0 and math.isnan(black.relative)


@pytest.mark.parametrize(
    ("series", "expected"),
    [
        ([0.5, 0.5, 0.5], 1),  # no memory
        ([0.8, 0.6, 0.55, 0.52, 0.5], 3),  # 90 % of the step is 0.55
        ([0.8, 0.5, 0.7, 0.5, 0.5], 4),  # it has to stay there
        ([0.9, 0.8, 0.7, 0.6], None),  # never within the series
        ([0.5, 0.5, 0.9], None),  # not at the end
        ([1.0, 1.0, 1.0], None),  # does not follow
        ([], None),
    ],
)
def test_lag_by_hand(series: list[float], expected: int | None) -> None:
    assert lag_frames(1.0, [value - 1e-9 for value in series]) == expected


def test_lag_of_lights_turned_up_and_of_no_light() -> None:
    assert lag_frames(1.0, [1.5, 1.95, 2.0], scale=2.0) == 2
    assert lag_frames(0.0, [0.0, 0.0]) is None
    assert lag_frames(float("nan"), [0.5]) is None


def test_drift_by_hand_and_deaf_to_spikes() -> None:
    assert drift([10.0] * 50) == 0.0
    run = [100.0 + 0.1 * frame for frame in range(101)]
    assert drift(run) == pytest.approx(10.0 / 105.0)
    run[::10] = [1000.0] * len(run[::10])
    assert drift(run) == pytest.approx(10.0 / 105.0, rel=0.2)
    assert drift([2.0, 1.0]) == pytest.approx(-1.0 / 1.5)
    assert math.isnan(drift([1.0]))


def test_drift_of_a_long_run_is_that_of_a_thinned_one() -> None:
    assert drift([1.0 + 1e-4 * frame for frame in range(10_001)]) == pytest.approx(1.0 / 1.5, rel=1e-3)
