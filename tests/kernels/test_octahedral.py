"""The octahedral map both ways, and against the published formula."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from luxel.kernels import octahedral


def directions() -> np.ndarray:
    d = np.random.default_rng(1).normal(size=(20000, 3))
    special = [[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z]
    d = np.concatenate([d, special])
    return (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)


def angle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the angles between unit rows, exact for small ones."""
    return 2.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(a.astype(float) - b, axis=1), 0.0, 1.0))


def test_direction_to_square_and_back() -> None:
    d = directions()
    square = octahedral.direction_to_square(mi.Vector3f(d.T))
    assert np.abs(np.array(square)).max() <= 1.0 + 1e-6
    assert angle(np.array(octahedral.square_to_direction(square)).T, d).max() < 2e-6


def test_square_to_direction_and_back() -> None:
    p = np.random.default_rng(2).uniform(-0.999, 0.999, (20000, 2)).astype(np.float32)
    back = octahedral.direction_to_square(octahedral.square_to_direction(mi.Point2f(p.T)))
    np.testing.assert_allclose(np.array(back).T, p, atol=2e-6)


def test_the_map_is_the_published_one() -> None:
    """Cigolle et al. 2014: project to |x| + |y| + |z| = 1, fold the lower half over the diagonals."""
    d = directions().astype(float)
    p = d[:, :2] / np.abs(d).sum(axis=1, keepdims=True)
    sign = np.where(p >= 0.0, 1.0, -1.0)
    lower = (d[:, 2] < -1e-6)[:, None]
    expected = np.where(lower, (1.0 - np.abs(p[:, ::-1])) * sign, p)
    found = np.array(octahedral.direction_to_square(mi.Vector3f(directions().T))).T
    # On the fold lines a zero's sign decides between two names of one direction.
    clear = (np.abs(d) > 1e-6).all(axis=1)
    np.testing.assert_allclose(found[clear], expected[clear], atol=2e-6)
