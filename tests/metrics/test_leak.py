"""Leak: the ratio, and the points it is measured at."""

from __future__ import annotations

import math

import numpy as np
import pytest

from luxel.metrics.leak import box_points, leak_ratio


def test_ratio_by_hand() -> None:
    sealed = np.array([[0.0, 0.0, 0.3], [0.0, 0.0, 0.0]])
    assert leak_ratio(sealed, np.full((2, 3), 5.0)) == pytest.approx(0.05 / 5.0)
    assert leak_ratio(np.zeros((4, 3)), np.ones((4, 3))) == 0.0
    assert math.isnan(leak_ratio(sealed, np.zeros((2, 3))))


def test_points_lie_inside_the_faces_and_look_inwards() -> None:
    lower, upper = np.array([-1.0, 0.0, 2.0]), np.array([1.0, 3.0, 2.5])
    points, normals = box_points(lower, upper, 3)
    assert points.shape == normals.shape == (6 * 9, 3)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    centre = (lower + upper) / 2
    # On one face each, strictly inside it, and the normal leads to the middle.
    on_face = np.isclose(points, lower) | np.isclose(points, upper)
    assert (on_face.sum(axis=1) == 1).all()
    depth = ((centre - points) * normals).sum(axis=1)
    assert (depth > 0).all()
    for axis in range(3):
        chosen = np.abs(normals[:, axis]) > 0.5
        np.testing.assert_allclose(depth[chosen], (upper - lower)[axis] / 2, rtol=1e-6)
        assert len(np.unique(points[chosen], axis=0)) == 18
