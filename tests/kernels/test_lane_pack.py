"""Packing of lanes that go on, against NumPy's `flatnonzero`."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.kernels.lane_pack import pack_lanes, take_record
from luxel.scene.arrays import from_numpy


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 1.0])
def test_those_that_go_on_come_first_in_their_order(share: float) -> None:
    alive = np.random.default_rng(7).random(1000) < share
    order, active = pack_lanes(from_numpy(mi.Bool, alive))
    count = int(alive.sum())
    assert dr.width(order) == dr.width(active) == 1000
    assert np.array_equal(np.array(order)[:count], np.flatnonzero(alive))
    assert np.array_equal(np.array(active), np.arange(1000) < count)


@dataclass
class Inner:
    value: mi.Float


@dataclass
class Outer:
    inner: Inner
    point: mi.Point3f
    same: mi.Float


def test_records_are_taken_by_their_rows_and_one_value_for_all_stays() -> None:
    rows = np.arange(4, dtype=np.float32)
    outer = Outer(Inner(mi.Float(rows)), mi.Point3f(mi.Float(rows), 1.0, 2.0), dr.opaque(mi.Float, 9.0))
    taken = take_record(outer, mi.UInt32([3, 1, 1, 0]))
    assert np.array_equal(np.array(taken.inner.value), [3.0, 1.0, 1.0, 0.0])
    assert np.array_equal(np.array(taken.point.x), [3.0, 1.0, 1.0, 0.0])
    assert np.array_equal(np.array(taken.same), [9.0])
