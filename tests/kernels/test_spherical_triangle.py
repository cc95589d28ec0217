"""Directions towards triangles: solid angle and uniformity."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy.stats import chi2

from luxel.kernels.sampling import random_2d
from luxel.kernels.spherical_triangle import sample_direction, solid_angle

COUNT = 1 << 18
OCTANT = np.eye(3)
LARGE = np.array([[1.0, 0.1, 0.0], [-0.6, 0.7, 0.2], [-0.3, -0.9, 0.5]])
SLIM = np.array([[1.0, 0.0, 0.0], [0.9, 0.45, 0.0], [0.95, 0.2, 0.12]])


def corners(triangle: np.ndarray) -> list[mi.Vector3f]:
    unit = triangle / np.linalg.norm(triangle, axis=1, keepdims=True)
    return [mi.Vector3f(*(float(value) for value in corner)) for corner in unit]


def count_inside(triangle: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Return whether directions (N, 3) lie in the cone of the triangle, by the signs of three planes."""
    weights = directions @ np.linalg.inv(triangle)
    return np.asarray((weights > -1e-4).all(axis=1))


def test_an_octant_is_half_pi() -> None:
    assert float(solid_angle(*corners(OCTANT))[0]) == pytest.approx(np.pi / 2, rel=1e-5)


@pytest.mark.parametrize("triangle", [OCTANT, LARGE, SLIM])
def test_solid_angle_against_counting(triangle: np.ndarray) -> None:
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(1 << 21, 3))
    share = count_inside(triangle, directions).mean()
    assert float(solid_angle(*corners(triangle))[0]) == pytest.approx(4.0 * np.pi * share, rel=0.02)


@pytest.mark.parametrize("triangle", [OCTANT, LARGE, SLIM])
def test_directions_are_uniform_over_the_triangle(triangle: np.ndarray) -> None:
    """Split the triangle in four at its edges' midpoints: each part gets its share of the solid angle (chi-square)."""
    a, b, c = corners(triangle)
    omega = solid_angle(a, b, c)
    sample = random_2d(mi.UInt32(3), dr.arange(mi.UInt32, COUNT))
    found = np.array(sample_direction(a, b, c, omega, sample)).T.astype(float)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, atol=1e-4)
    assert count_inside(triangle, found).mean() > 0.9999
    middle = [(triangle[i] + triangle[j]) / 2.0 for i, j in ((0, 1), (1, 2), (2, 0))]
    parts = [
        np.array([triangle[0], middle[0], middle[2]]),
        np.array([triangle[1], middle[1], middle[0]]),
        np.array([triangle[2], middle[2], middle[1]]),
        np.array(middle),
    ]
    shares = np.array([float(solid_angle(*corners(part))[0]) for part in parts]) / float(omega[0])
    assert shares.sum() == pytest.approx(1.0, rel=1e-4)
    weights = np.stack([found @ np.linalg.inv(part) for part in parts])
    hits = np.bincount(weights.min(axis=2).argmax(axis=0), minlength=4)
    statistic = ((hits - COUNT * shares) ** 2 / (COUNT * shares)).sum()
    assert chi2.sf(statistic, 3) > 1e-4
