"""The running mean, against NumPy's."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from luxel.kernels.history import equal_share, frames_kept, running_mean
from luxel.kernels.records import PathLight


def test_it_is_the_mean_of_all_frames() -> None:
    frames = np.random.default_rng(3).random((7, 5)).astype(np.float32)
    mean = mi.Float(np.full(5, np.nan, np.float32))  # what stood there before counts for nothing
    for index, frame in enumerate(frames):
        mean = running_mean(mean, mi.Float(frame), mi.UInt32(index))
    np.testing.assert_allclose(np.array(mean), frames.mean(axis=0), rtol=1e-6)


def test_a_view_that_moved_starts_anew() -> None:
    count = frames_kept(mi.Bool([False, True]), mi.UInt32([4, 4]))
    np.testing.assert_array_equal(np.array(count), [0, 4])
    mean = running_mean(mi.Float(2.0), mi.Float(7.0), count)
    np.testing.assert_allclose(np.array(mean), [7.0, 3.0])


def test_another_share_and_records() -> None:
    names = ("throughput", "albedo", "emission", "direct", "indirect", "glossy")
    before = PathLight(*(mi.Color3f(float(index)) for index in range(6)))
    fresh = PathLight(*(mi.Color3f(10.0) for _ in names))
    mixed = running_mean(before, fresh, mi.UInt32(3), mi.Float(0.25))
    for index, name in enumerate(names):
        np.testing.assert_allclose(np.array(getattr(mixed, name)).ravel(), 0.75 * index + 2.5)
    np.testing.assert_allclose(np.array(equal_share(mi.UInt32(3))), 0.25)
