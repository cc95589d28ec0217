"""What the camera sees: depth, misses, and motion vectors against projected differences."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from luxel.kernels.camera import camera_axes, make_pinhole
from luxel.kernels.film import Film
from luxel.kernels.gbuffer import GBuffer, trace_gbuffer
from luxel.scene.device import Scene, set_time, upload
from luxel.scene.library.shapes import box, quad, rotation, translation
from luxel.scene.model import Camera, Material, Object, SceneData, Sky

FILM = Film(48, 33)
CAMERA = Camera((0.2, 1.5, 4.0), (0.0, 0.8, 0.0), fov=65.0)
FLOOR = quad((-3, 0, 3), (3, 0, 3), (3, 0, -3), (-3, 0, -3), 0)


def turn(time: float) -> np.ndarray:
    return translation(0.3 * time, 0.4 * time, 0.2) @ rotation("y", 40.0 * time)


def stage() -> Scene:
    block = box((-0.7, 0.1, -0.5), (0.6, 1.2, 0.5), 0)
    objects = [Object("floor", [FLOOR]), Object("block", [block], turn(0.0), turn)]
    return upload(SceneData("stage", objects, [Material()], sky=Sky((0.25, 0.5, 1.0)), duration=2.0))


def image(value: object) -> np.ndarray:
    array = np.array(value)
    array = array.T if array.ndim == 2 else array
    return np.broadcast_to(array, (FILM.lane_count, *array.shape[1:]))[FILM.lanes_of_image()]


def look(scene: Scene, camera: Camera, before: Camera) -> GBuffer:
    return trace_gbuffer(scene, FILM, make_pinhole(camera, FILM.width, FILM.height), make_pinhole(before, 48, 33))


def to_pixels(points: np.ndarray, camera: Camera) -> np.ndarray:
    """Return (N, 2) pixel positions (column, row) of world points, by hand."""
    eye, right, up, forward = camera_axes(camera)
    offset = points - eye
    depth = offset @ forward
    half = np.tan(np.radians(camera.fov) / 2.0)
    x, y = offset @ right / depth / half, offset @ up / depth / (half * FILM.height / FILM.width)
    return np.stack([(x + 1.0) * FILM.width / 2.0, (1.0 - y) * FILM.height / 2.0], axis=-1)


def test_rays_go_through_pixel_centres() -> None:
    seen = look(stage(), CAMERA, CAMERA)
    hit = image(seen.surface.active)
    rows, columns = np.mgrid[: FILM.height, : FILM.width]
    centres = np.stack([columns + 0.5, rows + 0.5], axis=-1)
    np.testing.assert_allclose(to_pixels(image(seen.surface.p)[hit], CAMERA), centres[hit], atol=2e-3)


def test_depth_and_background() -> None:
    seen = look(stage(), CAMERA, CAMERA)
    hit, depth = image(seen.surface.active), image(seen.depth)
    assert 0.2 < hit.mean() < 0.9
    distance = np.linalg.norm(image(seen.surface.p) - CAMERA.eye, axis=-1)
    np.testing.assert_allclose(depth[hit], distance[hit], rtol=1e-4)
    assert np.isinf(depth[~hit]).all()
    background = image(seen.background)
    np.testing.assert_allclose(background[~hit], np.tile((0.25, 0.5, 1.0), ((~hit).sum(), 1)))
    assert not background[hit].any()


def test_nothing_moves_in_a_still_view() -> None:
    seen = look(stage(), CAMERA, CAMERA)
    np.testing.assert_allclose(image(seen.motion), 0.0, atol=2e-3)


def test_motion_of_the_camera() -> None:
    before = Camera((0.0, 1.7, 4.3), (0.1, 0.7, 0.0), fov=65.0)
    seen = look(stage(), CAMERA, before)
    hit = image(seen.surface.active)
    points = image(seen.surface.p)[hit]
    expected = to_pixels(points, CAMERA) - to_pixels(points, before)
    assert np.abs(expected).max() > 1.0
    np.testing.assert_allclose(image(seen.motion)[hit], expected, atol=5e-3)
    assert np.abs(image(seen.motion)[~hit]).min() > 0.3  # the sky turns with the camera


@pytest.mark.parametrize("camera_moves", [False, True])
def test_motion_of_an_object(camera_moves: bool) -> None:
    before = Camera((0.0, 1.7, 4.3), (0.1, 0.7, 0.0), fov=65.0) if camera_moves else CAMERA
    scene = stage()
    set_time(scene, 0.5)
    set_time(scene, 0.8)
    seen = look(scene, CAMERA, before)
    points = image(seen.surface.p).astype(float)
    on_block = image(seen.surface.object_id) == 2
    hit = image(seen.surface.active)
    assert on_block.sum() > 100
    back = turn(0.5) @ np.linalg.inv(turn(0.8))
    old = np.where(on_block[..., None], points @ back[:3, :3].T + back[:3, 3], points)
    expected = to_pixels(points[hit], CAMERA) - to_pixels(old[hit], before)
    np.testing.assert_allclose(image(seen.motion)[hit], expected, atol=1e-2)
    # Once it rests, so do its motion vectors.
    set_time(scene, 0.8)
    rested = image(look(scene, CAMERA, CAMERA).motion)
    np.testing.assert_allclose(rested, 0.0, atol=5e-3)


def test_motion_of_a_deforming_object() -> None:
    cloth = quad((-1, 0, 1), (1, 0, 1), (1, 2, 0), (-1, 2, 0), 0)

    def deform(time: float) -> list[tuple[np.ndarray, np.ndarray | None]]:
        stretched = cloth.positions * np.array([1.0 + 0.2 * time, 1.0 - 0.1 * time, 1.0])
        return [(stretched.astype(np.float32), None)]

    objects = [Object("floor", [FLOOR]), Object("cloth", [cloth], deform=deform)]
    scene = upload(SceneData("cloth", objects, [Material()], duration=2.0))
    set_time(scene, 0.4)
    set_time(scene, 1.0)
    seen = look(scene, CAMERA, CAMERA)
    on_cloth = image(seen.surface.object_id) == 2
    points = image(seen.surface.p)[on_cloth].astype(float)
    old = points * (1.08 / 1.2, 0.96 / 0.9, 1.0)
    expected = to_pixels(points, CAMERA) - to_pixels(old, CAMERA)
    assert np.abs(expected).max() > 0.5
    np.testing.assert_allclose(image(seen.motion)[on_cloth], expected, atol=1e-2)


def test_a_point_that_was_behind_the_camera_has_no_motion() -> None:
    before = Camera((0.2, 1.5, -30.0), (0.2, 1.5, -40.0), fov=65.0)
    seen = look(stage(), CAMERA, before)
    hit = image(seen.surface.active)
    assert np.isfinite(image(seen.motion)).all() and not image(seen.motion)[hit].any()
    np.testing.assert_array_equal(image(seen.tracked), ~hit)


def test_every_lane_is_named_once() -> None:
    np.testing.assert_array_equal(np.array(mi.UInt32(look(stage(), CAMERA, CAMERA).lane)), np.arange(FILM.lane_count))
