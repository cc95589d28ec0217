"""The hemi-octahedral map both ways, against the published formula, with and without the warp."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from luxel.kernels.hemi_octahedral import hemisphere_to_square, point_in_texel, square_to_hemisphere, texel_of


def directions() -> np.ndarray:
    d = np.random.default_rng(1).normal(size=(20000, 3))
    d[:, 2] = np.abs(d[:, 2]) + 1e-4
    return (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)


@pytest.mark.parametrize("warp", [1.0, 4.0])
def test_the_map_is_the_published_one(warp: float) -> None:
    """Cigolle et al. 2014: (x + y, x - y) on |x| + |y| + |z| = 1, after z has been stretched."""
    d = directions().astype(float)
    q = d * [1.0, 1.0, warp]
    q /= np.abs(q).sum(axis=1, keepdims=True)
    wanted = np.stack([q[:, 0] + q[:, 1], q[:, 0] - q[:, 1]])
    found = np.array(hemisphere_to_square(mi.Vector3f(directions().T), warp))
    np.testing.assert_allclose(found, wanted, atol=1e-6)


@pytest.mark.parametrize("warp", [1.0, 4.0])
def test_there_and_back(warp: float) -> None:
    d = directions()
    back = square_to_hemisphere(hemisphere_to_square(mi.Vector3f(d.T), warp), warp)
    np.testing.assert_allclose(np.array(back).T, d, atol=1e-5)
    p = np.random.default_rng(2).uniform(-0.999, 0.999, (20000, 2)).astype(np.float32)
    again = hemisphere_to_square(square_to_hemisphere(mi.Point2f(p.T), warp), warp)
    np.testing.assert_allclose(np.array(again).T, p, atol=1e-5)


def test_what_is_below_the_horizon_lies_on_the_border() -> None:
    d = directions() * np.array([1, 1, -1], np.float32)
    found = np.abs(np.array(hemisphere_to_square(mi.Vector3f(d.T), 4.0))).max(axis=0)
    np.testing.assert_allclose(found, 1.0, atol=1e-5)


@pytest.mark.parametrize("side", [4, 8])
def test_texels_are_counted_by_rows(side: int) -> None:
    texel = np.arange(side * side, dtype=np.uint32)
    for place in ((0.01, 0.99), (0.5, 0.5)):
        p = point_in_texel(mi.UInt32(texel), side, mi.Point2f(*place))
        column, row = texel % side, texel // side
        wanted = np.stack([column + place[0], row + place[1]]) * 2.0 / side - 1.0
        np.testing.assert_allclose(np.array(p), wanted, atol=1e-5)
        np.testing.assert_array_equal(np.array(texel_of(p, side)), texel)
    corners = mi.Point2f([-1.0, 1.0, 1.0], [-1.0, -1.0, 1.0])
    np.testing.assert_array_equal(np.array(texel_of(corners, side)), [0, side - 1, side * side - 1])
