"""Points in a pixel: the first in its centre, all spread as the filter weighs."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy import stats

from luxel.kernels.pixel_filter import filter_offset


def offsets(name: str, count: int) -> np.ndarray:
    """Return (2, count)."""
    return np.array(filter_offset(name, dr.arange(mi.UInt32, count)))


@pytest.mark.parametrize("name", ["box", "gaussian"])
def test_the_first_is_the_centre_and_none_is_far(name: str) -> None:
    points = offsets(name, 1 << 16)
    assert points[:, 0].tolist() == [0.0, 0.0]
    assert np.isfinite(points).all() and np.abs(points).max() <= (0.5 if name == "box" else 2.0)


@pytest.mark.parametrize("count", [4, 16, 64, 256])
def test_each_strip_and_each_box_gets_one(count: int) -> None:
    unit = offsets("box", count) + 0.5
    columns = 1
    while columns <= count:
        rows = count // columns
        place = (unit[0] * columns).astype(int) * rows + (unit[1] * rows).astype(int)
        assert sorted(place) == list(range(count)), f"{columns} x {rows}"
        columns *= 2


@pytest.mark.parametrize(("name", "wanted"), [("box", stats.uniform(-0.5, 1.0)), ("gaussian", stats.norm(0.0, 0.5))])
def test_they_are_spread_as_the_filter_weighs(name: str, wanted: stats.rv_continuous) -> None:
    for axis in wanted.cdf(offsets(name, 256)):
        # Random points would be ten times as far off.
        assert stats.kstest(axis, "uniform").statistic < 1.5 / 256
