"""The sky: constant, and an image the way `Sky` documents it."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from luxel.kernels.sky import sky_radiance
from luxel.scene.device import upload
from luxel.scene.library.shapes import quad
from luxel.scene.model import Material, Object, SceneData, Sky


def radiance(sky: Sky, directions: np.ndarray, active: np.ndarray | None = None) -> np.ndarray:
    floor = Object("floor", [quad((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), 0)])
    scene = upload(SceneData("sky", [floor], [Material()], sky=sky))
    lanes = mi.Bool(np.ones(len(directions), bool) if active is None else active)
    found = np.array(sky_radiance(scene, mi.Vector3f(directions.T.astype(np.float32)), lanes))
    return np.broadcast_to(found.T, (len(directions), 3))


def sphere_directions(count: int) -> np.ndarray:
    d = np.random.default_rng(1).normal(size=(count, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def test_constant_sky_and_inactive_lanes() -> None:
    d = sphere_directions(100)
    active = np.arange(100) % 2 == 0
    found = radiance(Sky((0.5, 1.0, 2.0)), d, active)
    np.testing.assert_allclose(found[active], [[0.5, 1.0, 2.0]] * 50)
    assert not found[~active].any()
    assert not radiance(Sky(), d).any()


def marked_image() -> np.ndarray:
    """Return an image whose channels are column, row and one, so that a look-up tells where it read."""
    height, width = 32, 64
    v, u = np.mgrid[:height, :width]
    return np.stack([(u + 0.5) / width, (v + 0.5) / height, np.ones((height, width))], axis=2).astype(np.float32)


def test_image_orientation() -> None:
    """Row 0 is the zenith; the centre looks along -Z, the left edge along +Z, right of the centre towards +X."""
    axes = {"-z": (0, 0, -1), "+x": (1, 0, 0), "-x": (-1, 0, 0), "+y": (0, 1, 0), "-y": (0, -1, 0)}
    found = radiance(Sky((1.0, 1.0, 1.0), marked_image()), np.array(list(axes.values()), float))
    column = dict(zip(axes, found[:, 0], strict=True))
    row = dict(zip(axes, found[:, 1], strict=True))
    assert column["-z"] == pytest.approx(0.5, abs=1e-4)
    assert column["+x"] == pytest.approx(0.75, abs=1e-4)
    assert column["-x"] == pytest.approx(0.25, abs=1e-4)
    assert row["-z"] == pytest.approx(0.5, abs=1e-4)
    assert row["+y"] < 0.02 and row["-y"] > 0.98
    almost_back = np.array([[-0.05, 0.0, 1.0], [0.05, 0.0, 1.0]])
    left, right = radiance(Sky((1.0, 1.0, 1.0), marked_image()), almost_back / np.linalg.norm(almost_back[0]))
    assert left[0] < 0.02 and right[0] > 0.98


def test_image_is_filtered_and_wraps_round() -> None:
    rng = np.random.default_rng(2)
    image = rng.random((8, 16, 3)).astype(np.float32)
    d = sphere_directions(3000)
    u = (np.arctan2(d[:, 0], -d[:, 2]) / (2.0 * np.pi) + 0.5) * 16 - 0.5
    v = np.arccos(d[:, 1]) / np.pi * 8 - 0.5
    u0, v0 = np.floor(u).astype(int), np.floor(v).astype(int)
    expected = np.zeros((len(d), 3))
    for i in (0, 1):
        for j in (0, 1):
            weight = (1.0 - np.abs(u - u0 - i)) * (1.0 - np.abs(v - v0 - j))
            expected += weight[:, None] * image[np.clip(v0 + j, 0, 7), (u0 + i) % 16]
    color = (2.0, 1.0, 0.5)
    np.testing.assert_allclose(radiance(Sky(color, image), d), expected * color, atol=2e-4)


def test_rotation_moves_the_centre_the_way_columns_run() -> None:
    centre = {0: (0, 0, -1), 90: (1, 0, 0), 180: (0, 0, 1), 270: (-1, 0, 0)}
    for rotation, direction in centre.items():
        sky = Sky((1.0, 1.0, 1.0), marked_image(), rotation=float(rotation))
        assert radiance(sky, np.array([direction], float))[0, 0] == pytest.approx(0.5, abs=1e-3)
