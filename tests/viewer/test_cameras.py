"""The browser's camera and ours."""

from __future__ import annotations

import numpy as np
import pytest
from viser.transforms import SO3

from luxel.kernels.camera import camera_axes
from luxel.scene.library.shapes import rotation, scaling, translation
from luxel.scene.model import Camera
from luxel.viewer import cameras

VIEWS = [
    Camera((0.0, 0.0, 3.9), (0.0, 0.0, 0.0), fov=39.3),
    Camera((-9.0, 2.0, 0.5), (5.0, 2.5, -1.0), fov=65.0),
    Camera((1.0, 5.0, 1.0), (1.2, 0.0, 0.7), fov=90.0),
]


def pose_of(camera: Camera) -> tuple[tuple[float, ...], np.ndarray]:
    """Return wxyz and position as viser would: +Z ahead, +Y down."""
    eye, right, up, forward = camera_axes(camera)
    return tuple(SO3.from_matrix(np.stack([right, -up, forward], axis=1)).wxyz), eye


@pytest.mark.parametrize("camera", VIEWS, ids=lambda view: f"{view.fov:g}")
@pytest.mark.parametrize("aspect", [1.0, 16 / 9, 0.6])
def test_a_view_survives_the_way_to_the_browser_and_back(camera: Camera, aspect: float) -> None:
    wxyz, eye = pose_of(camera)
    back = cameras.camera_from_pose(wxyz, eye, cameras.vertical_fov(camera.fov, aspect), aspect, 2.0)
    for given, wanted in zip(camera_axes(back), camera_axes(camera), strict=True):
        np.testing.assert_allclose(given, wanted, atol=1e-6)
    assert back.fov == pytest.approx(camera.fov)


def test_look_of_a_camera_names_where_it_looks() -> None:
    position, look_at, up = cameras.look_of_camera(VIEWS[0], 0.0, 1.0)
    np.testing.assert_allclose(position, (0.0, 0.0, 3.9))
    np.testing.assert_allclose(look_at, (0.0, 0.0, 0.0), atol=1e-12)
    np.testing.assert_allclose(up, (0.0, 1.0, 0.0))


def test_a_moving_camera_is_taken_at_its_time() -> None:
    camera = Camera(motion=lambda time: translation(time, 0.0, 0.0))
    position, look_at, _ = cameras.look_of_camera(camera, 2.0, 5.0)
    np.testing.assert_allclose(position, (2.0, 0.0, 0.0))
    np.testing.assert_allclose(look_at, (2.0, 0.0, -5.0))


def test_a_window_cuts_nothing_off_a_square_camera() -> None:
    wide = cameras.vertical_fov_in_window(39.3, 1.8)
    assert np.rad2deg(wide) == pytest.approx(39.3)
    assert cameras.vertical_fov_in_window(80.0, 1.0) == pytest.approx(np.deg2rad(80.0))


@pytest.mark.parametrize("angles", [(0, 0), (180, 0), (30, 70), (180, 180), (-120, 45)])
def test_quaternions_are_vis_own(angles: tuple[float, float]) -> None:
    turn = (rotation("y", angles[0]) @ rotation("x", angles[1]))[:3, :3]
    np.testing.assert_allclose(cameras.rotation_matrix(cameras.quaternion(turn)), turn, atol=1e-9)
    np.testing.assert_allclose(cameras.rotation_matrix(SO3.from_matrix(turn).wxyz), turn, atol=1e-6)


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_a_matrix_comes_apart_and_together(mirror: float) -> None:
    matrix = translation(1.0, 2.0, 3.0) @ rotation("y", 40.0) @ scaling(0.5, mirror * 2.0, 1.0)
    position, turn, rest = cameras.split_matrix(matrix)
    assert np.linalg.det(turn) == pytest.approx(1.0)
    np.testing.assert_allclose(cameras.join_matrix(position, turn, rest), matrix, atol=1e-12)
