"""The pinhole: rays and projection undo each other; the field of view is the horizontal one."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from luxel.kernels import camera as kernel
from luxel.scene.library.shapes import rotation, translation
from luxel.scene.model import Camera

CAMERAS = [
    Camera((1.0, 2.0, 3.0), (-0.5, 0.3, -1.0), fov=70.0),
    Camera((0.0, 5.0, 0.0), (0.0, 0.0, 0.0), fov=40.0),  # straight down, along its up
    Camera((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (1.0, 1.0, 0.0), fov=120.0),
]

PARALLEL = Camera((1.0, 2.0, 3.0), (-0.5, 0.3, -1.0), orthographic_width=6.0)

SHIFTED = Camera((1.0, 2.0, 3.0), (-0.5, 0.3, -1.0), fov=70.0, lens_shift=(0.4, -0.7))


def rays(pinhole: kernel.Pinhole, xy: np.ndarray) -> np.ndarray:
    x, y = (mi.Float(column.astype(np.float32)) for column in xy.T)
    return np.array(kernel.camera_ray(pinhole, x, y)[1]).T


def origins(pinhole: kernel.Pinhole, xy: np.ndarray) -> np.ndarray:
    x, y = (mi.Float(column.astype(np.float32)) for column in xy.T)
    return np.broadcast_to(np.array(kernel.camera_ray(pinhole, x, y)[0]).T, (len(xy), 3))


@pytest.mark.parametrize("camera", [*CAMERAS, PARALLEL, SHIFTED])
@pytest.mark.parametrize(("width", "height"), [(64, 64), (160, 90)])
def test_project_undoes_camera_ray(camera: Camera, width: int, height: int) -> None:
    rng = np.random.default_rng(1)
    xy = rng.uniform(-1.0, 1.0, (500, 2))
    pinhole = kernel.make_pinhole(camera, width, height)
    d = rays(pinhole, xy)
    np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1.0, atol=1e-6)
    points = origins(pinhole, xy) + d * rng.uniform(0.1, 20.0, (500, 1))
    x, y, in_front = kernel.project(pinhole, mi.Point3f(points.T.astype(np.float32)))
    np.testing.assert_allclose(np.stack([np.array(x), np.array(y)], axis=1), xy, atol=2e-4)
    assert np.array(in_front).all()
    behind = origins(pinhole, xy) - d
    assert not np.array(kernel.project(pinhole, mi.Point3f(behind.T.astype(np.float32)))[2]).any()


@pytest.mark.parametrize("camera", CAMERAS)
def test_field_of_view(camera: Camera) -> None:
    pinhole = kernel.make_pinhole(camera, 160, 90)
    left, right, top, bottom, middle = rays(pinhole, np.array([(-1, 0), (1, 0), (0, 1), (0, -1), (0, 0)]))
    assert np.degrees(np.arccos(left @ right)) == pytest.approx(camera.fov, abs=1e-3)
    vertical = 2.0 * np.degrees(np.arctan(np.tan(np.radians(camera.fov / 2)) * 90 / 160))
    assert np.degrees(np.arccos(top @ bottom)) == pytest.approx(vertical, abs=1e-3)
    towards = np.asarray(camera.target) - camera.eye
    np.testing.assert_allclose(middle, towards / np.linalg.norm(towards), atol=1e-6)
    # A right-handed view: right x up looks back at the viewer.
    assert np.cross(right - left, top - bottom) @ middle < 0.0


def test_image_x_goes_right_and_y_up() -> None:
    pinhole = kernel.make_pinhole(Camera((0, 0, 5), (0, 0, 0)), 32, 32)
    x, y, _ = kernel.project(pinhole, mi.Point3f([1.0, 0.0], [0.0, 1.0], [0.0, 0.0]))
    assert np.array(x)[0] > 0.1 and abs(np.array(x)[1]) < 1e-6
    assert np.array(y)[1] > 0.1 and abs(np.array(y)[0]) < 1e-6


def test_a_moving_camera_looks_along_minus_z_of_its_matrix() -> None:
    def motion(time: float) -> np.ndarray:
        return translation(time, 1.0, -2.0) @ rotation("y", 90.0 * time) @ rotation("x", 20.0)

    camera = Camera(motion=motion)
    for time in (0.0, 0.7, 2.0):
        eye, right, up, forward = kernel.camera_axes(camera, time)
        matrix = motion(time)
        np.testing.assert_allclose(eye, matrix[:3, 3])
        np.testing.assert_allclose(forward, -matrix[:3, 2], atol=1e-12)
        np.testing.assert_allclose(up, matrix[:3, 1], atol=1e-12)
        np.testing.assert_allclose(right, matrix[:3, 0], atol=1e-12)


def test_an_orthographic_camera_sees_its_width() -> None:
    pinhole = kernel.make_pinhole(PARALLEL, 160, 90)
    left, right, top, bottom = origins(pinhole, np.array([(-1, 0), (1, 0), (0, 1), (0, -1)]))
    assert np.linalg.norm(right - left) == pytest.approx(6.0, rel=1e-5)
    assert np.linalg.norm(top - bottom) == pytest.approx(6.0 * 90 / 160, rel=1e-5)
    directions = rays(pinhole, np.array([(-1, 0), (1, 0), (0, 1), (0, -1)]))
    towards = np.asarray(PARALLEL.target) - PARALLEL.eye
    np.testing.assert_allclose(directions, np.tile(towards / np.linalg.norm(towards), (4, 1)), atol=1e-6)


@pytest.mark.parametrize("camera", [CAMERAS[0], PARALLEL])
def test_a_shift_looks_through_other_points(camera: Camera) -> None:
    """Shifting by (0.3, -0.2) shows at the centre what stood at (0.3, -0.2)."""
    plain = kernel.make_pinhole(camera, 160, 90)
    moved = kernel.make_pinhole(camera, 160, 90, shift=(0.3, -0.2))
    there, here = np.array([(0.3, -0.2)]), np.array([(0.0, 0.0)])
    np.testing.assert_allclose(origins(moved, here), origins(plain, there), atol=1e-6)
    np.testing.assert_allclose(rays(moved, here), rays(plain, there), atol=1e-6)


@pytest.mark.parametrize("camera", [*CAMERAS, SHIFTED])
def test_a_pixels_width_is_that_of_its_solid_angle(camera: Camera) -> None:
    """Against the quadrilateral between the rays through its corners, across which the rays hardly spread."""
    size, distance = (4000, 1000), 3.0
    half = np.tan(np.radians(camera.fov / 2.0)) * np.array([1.0, size[1] / size[0]])
    for place in ((0.0, 0.0), (0.9, -0.2), (-0.6, 1.0)):
        middle = np.array(place)
        corners = [middle + np.array(step) / size for step in ((-1, -1), (1, -1), (-1, 1))]
        first, right, up = (np.array([*((corner + camera.lens_shift) * half), 1.0]) for corner in corners)
        first, right, up = (ray / np.linalg.norm(ray) for ray in (first, right, up))
        wanted = distance * np.sqrt(np.linalg.norm(np.cross(right - first, up - first)))
        pinhole = kernel.make_pinhole(camera, *size)
        found = kernel.pixel_width(pinhole, size, mi.Float(place[0]), mi.Float(place[1]), mi.Float(distance))
        assert np.array(found)[0] == pytest.approx(wanted, rel=2e-3)


def test_pixels_of_parallel_rays_are_as_wide_everywhere() -> None:
    flat = Camera((0.0, 0.0, 3.0), (0.0, 0.0, 0.0), orthographic_width=6.0, orthographic_height=1.5)
    for camera, wanted in ((PARALLEL, 6.0 / 160), (flat, np.sqrt(6.0 / 160 * 1.5 / 90))):
        pinhole = kernel.make_pinhole(camera, 160, 90)
        found = kernel.pixel_width(pinhole, (160, 90), mi.Float(0.5), mi.Float(-0.9), mi.Float([0.1, 70.0]))
        np.testing.assert_allclose(np.array(found), wanted, rtol=1e-5)
