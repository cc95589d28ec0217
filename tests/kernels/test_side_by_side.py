"""Sums over samples side by side, against NumPy's of the same numbers, in one launch and in several."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.kernels import side_by_side
from luxel.kernels.records import PathLight
from luxel.kernels.side_by_side import sum_samples, take_lanes


def count_up(lane: mi.UInt32, number: mi.UInt32) -> mi.Color3f:
    """Return whole numbers, so that sums are exact: lane, its product with the sample's number, its square."""
    return mi.Color3f(mi.Float(lane), mi.Float(lane * number), mi.Float(number * number))


def expected(width: int, samples: int) -> np.ndarray:
    lane, number = np.arange(width)[:, None], np.arange(1, samples + 1)[None, :]
    parts = (lane + 0 * number, lane * number, number**2 + 0 * lane)
    return np.array([part.sum(axis=1) for part in parts], np.float32)


@pytest.mark.parametrize("limit", [1, 14, 35, 1000])
@pytest.mark.parametrize("samples", [1, 5, 8])
def test_each_lane_has_the_sum_of_its_own_samples(monkeypatch: pytest.MonkeyPatch, limit: int, samples: int) -> None:
    monkeypatch.setattr(side_by_side, "LANE_LIMIT", limit)
    widths = []

    def trace(lane: mi.UInt32, number: mi.UInt32) -> mi.Color3f:
        widths.append(dr.width(lane))
        return count_up(lane, number)

    total = sum_samples(mi.Color3f(0.0), 7, samples, trace)
    assert np.array_equal(np.array(total), expected(7, samples))
    assert max(widths) <= max(limit, 7) and sum(widths) == 7 * samples


def test_records_are_summed_by_their_parts() -> None:
    def trace(lane: mi.UInt32, number: mi.UInt32) -> PathLight:
        value = count_up(lane, number)
        return PathLight(*(value * float(part) for part in range(6)))

    total = sum_samples(dr.zeros(PathLight, 3), 3, 4, trace)
    for part, value in enumerate(vars(total).values()):
        assert np.array_equal(np.array(value), part * expected(3, 4))


def test_a_row_for_all_lanes_stays_one() -> None:
    lanes = mi.UInt32([2, 0, 2])
    assert np.array_equal(np.array(take_lanes(mi.Float([5.0, 6.0, 7.0]), lanes)), [7.0, 5.0, 7.0])
    assert dr.width(take_lanes(dr.opaque(mi.Float, 3.0), lanes)) == 1
