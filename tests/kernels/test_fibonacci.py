"""Even directions: on the sphere, without a tilt, and turned by what is truly a uniformly random rotation."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.kernels.fibonacci import fibonacci_direction, random_rotation, rotate


def lattice(count: int) -> np.ndarray:
    return np.array(fibonacci_direction(dr.arange(mi.UInt32, count), mi.UInt32(count))).T.astype(float)


def rotations(count: int) -> np.ndarray:
    return np.array(random_rotation(dr.arange(mi.UInt32, count), mi.UInt32(7))).T.astype(float)


@pytest.mark.parametrize("count", [8, 32, 64, 256, 4096])
def test_the_lattice_is_on_the_sphere_and_even(count: int) -> None:
    d = lattice(count)
    np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1.0, atol=2e-6)
    assert np.abs(d.mean(axis=0)).max() < 1.5 / count
    np.testing.assert_allclose(d.T @ d / count, np.eye(3) / 3.0, atol=2.5 / count)


@pytest.mark.parametrize("count", [16, 64, 1024])
def test_no_two_points_are_near(count: int) -> None:
    """The nearest neighbours of the lattice are about sqrt(4 pi / n) apart, those of random points are not."""
    d = lattice(count)
    cosine = np.clip(d @ d.T - 2.0 * np.eye(count), -1.0, 1.0)
    assert np.arccos(cosine.max(axis=1)).min() > 0.7 * np.sqrt(4.0 * np.pi / count)


def test_a_band_around_any_axis_holds_its_share() -> None:
    d = lattice(4096)
    axes = np.random.default_rng(1).normal(size=(200, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    share = (d @ axes.T > 0.5).mean(axis=0)
    np.testing.assert_allclose(share, 0.25, atol=0.004)


def test_the_turn_is_orthonormal_and_the_quaternions_matrix() -> None:
    q = rotations(500)
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, atol=1e-6)
    turn = mi.Vector4f(q.T)
    matrix = np.stack([np.array(rotate(turn, mi.Vector3f(axis))).T for axis in np.eye(3).tolist()], axis=2)
    np.testing.assert_allclose(np.swapaxes(matrix, 1, 2) @ matrix, np.broadcast_to(np.eye(3), (500, 3, 3)), atol=2e-6)
    np.testing.assert_allclose(np.linalg.det(matrix), 1.0, atol=3e-6)
    x, y, z, w = q.T
    expected = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    ).transpose(2, 0, 1)
    np.testing.assert_allclose(matrix, expected, atol=2e-6)


def test_the_turn_is_uniform() -> None:
    """Each quaternion component has mean 0 and square 1/4; a turned vector is uniform; the angle has its density."""
    count = 40000
    q = rotations(count)
    error = 4.0 / np.sqrt(count)
    assert np.abs(q.mean(axis=0)).max() < 0.5 * error
    np.testing.assert_allclose(q.T @ q / count, np.eye(4) / 4.0, atol=0.4 * error)
    np.testing.assert_allclose((q**4).mean(axis=0), 1.0 / 8.0, atol=0.3 * error)
    turned = np.array(rotate(mi.Vector4f(q.T), mi.Vector3f(0.6, 0.0, 0.8))).T
    bins = np.histogram(turned[:, 2], 20, (-1.0, 1.0))[0]
    assert ((bins - count / 20) ** 2 / (count / 20)).sum() < 45.0  # chi-square, 19 degrees of freedom
    # Haar measure: the turn's angle has the density (1 - cos) / pi.
    angle = 2.0 * np.arccos(np.clip(np.abs(q[:, 3]), 0.0, 1.0))
    edges = np.linspace(0.0, np.pi, 11)
    expected = np.diff(edges - np.sin(edges)) / np.pi * count
    assert ((np.histogram(angle, edges)[0] - expected) ** 2 / expected).sum() < 30.0


def test_frames_and_probes_turn_independently() -> None:
    index = dr.arange(mi.UInt32, 20000)
    first = np.array(rotate(random_rotation(index, mi.UInt32(3)), mi.Vector3f(0, 0, 1))).T
    for other in (random_rotation(index, mi.UInt32(4)), random_rotation(index + 1, mi.UInt32(3))):
        second = np.array(rotate(other, mi.Vector3f(0, 0, 1))).T
        assert np.abs(first.T @ second / 20000).max() < 0.012
