"""Where surfaces were a frame before, by arithmetic: walls that the camera passes and things that pass it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from luxel.kernels.film import Film
from luxel.render.motion_path import FRAME_RATE, MotionPath
from luxel.render.motion_taps import trace_surfaces, trace_taps
from luxel.scene.device import upload
from luxel.scene.model import Camera, Material, Mesh, Object, SceneData, Sky

SIZE = (48, 32)
DISTANCE, FOV = 4.0, 60.0
PIXELS_A_METRE = SIZE[0] / (2.0 * DISTANCE * np.tan(np.deg2rad(FOV / 2.0)))
FRONT = Camera((0.0, 0.0, 0.0), (0.0, 0.0, -1.0), fov=FOV)


def make_wall(half: float = 50.0, motion: float | None = None) -> Object:
    """Return a square that faces the camera 4 m before it; `motion` is its speed to the right, m/s."""
    corners = np.array([[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]], np.float32)
    mesh = Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]], np.uint32), 0)
    place = np.eye(4)
    place[2, 3] = -DISTANCE
    if motion is None:
        return Object("wall", [mesh], place)

    def move(time: float) -> np.ndarray:
        moved = place.copy()
        moved[0, 3] = motion * time
        return moved

    return Object("wall", [mesh], place, motion=move)


def make_scene(*objects: Object, duration: float = 0.0) -> SceneData:
    return SceneData("wall", list(objects), [Material()], sky=Sky((1.0, 1.0, 1.0)), cameras=[FRONT], duration=duration)


def slide(metres: float) -> list[Camera]:
    """Return views of which each stands so much to the right of the one before."""
    return [
        replace(FRONT, eye=(metres * index, 0.0, 0.0), target=(metres * index, 0.0, -1.0)) for index in range(6)
    ]  # fmt: skip


def test_a_wall_moves_against_the_camera() -> None:
    pixels = 2.0
    views = slide(pixels / PIXELS_A_METRE)
    taps = trace_taps(upload(make_scene(make_wall())), MotionPath(tuple(views), FRONT), SIZE)
    assert len(taps) == 1
    column = np.broadcast_to(np.arange(SIZE[0], dtype=float)[None, :, None], (SIZE[1], SIZE[0], 1))
    # What is at column 10 now was two columns further right; the last two came into the picture.
    valid = taps[0].valid
    np.testing.assert_allclose(taps[0].fetch(column)[valid][:, 0], (column + pixels)[valid][:, 0], atol=0.01)
    assert valid[:, :-3].all() and not valid[:, -1].any()


def test_distances_are_those_from_where_the_eye_was() -> None:
    views = slide(0.5)
    seen = trace_surfaces(upload(make_scene(make_wall())), Film(*SIZE), (views[0], views[1]), 6)
    x = (np.arange(SIZE[0]) + 0.5 - SIZE[0] / 2) / PIXELS_A_METRE
    y = (np.arange(SIZE[1]) + 0.5 - SIZE[1] / 2) / PIXELS_A_METRE
    wanted = np.sqrt(DISTANCE**2 + (x[None, :] + 0.5) ** 2 + y[:, None] ** 2)
    np.testing.assert_allclose(seen.depth_before, wanted, rtol=1e-5)
    np.testing.assert_allclose(seen.depth, np.sqrt(DISTANCE**2 + x[None, :] ** 2 + y[:, None] ** 2), rtol=1e-5)


def test_parallel_rays_are_followed_too() -> None:
    """Of an orthographic camera each pixel's distance is counted along its own ray: 4 m to all of the wall."""
    pixels, width = 2.0, 8.0
    views = [replace(view, orthographic_width=width) for view in slide(pixels * width / SIZE[0])]
    scene = upload(make_scene(make_wall()))
    seen = trace_surfaces(scene, Film(*SIZE), (views[0], views[1]), 6)
    np.testing.assert_allclose(seen.depth_before, DISTANCE, rtol=1e-5)
    valid = trace_taps(scene, MotionPath(tuple(views), views[0]), SIZE)[0].valid
    assert valid[:, :-3].all() and not valid[:, -1].any()


def test_what_moves_is_followed() -> None:
    speed = 3.0 / PIXELS_A_METRE * FRAME_RATE  # three pixels a frame
    scene = upload(make_scene(make_wall(0.5, speed), make_wall(0.1), duration=10.0))
    seen = trace_surfaces(scene, Film(*SIZE), (FRONT, FRONT), 1 - 48 + 5)
    moving = seen.object_id == seen.object_id.max()
    still = (seen.object_id > 0) & ~moving
    found = {number: seen.motion[seen.object_id == number] for number in np.unique(seen.object_id) if number}
    speeds = sorted(round(float(np.abs(field[:, 0]).mean()), 2) for field in found.values())
    assert moving.any() and still.any() and speeds == pytest.approx([0.0, 3.0], abs=0.02)
    assert not seen.object_id[0, 0] and not np.isfinite(seen.depth[0, 0])
