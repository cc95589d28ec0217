"""Where surfaces were a frame before, by arithmetic: walls that the camera passes and things that pass it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from luxel.kernels.film import Film
from luxel.render.motion_path import FRAME_RATE, MotionPath
from luxel.render.motion_taps import taps_between, trace_taps
from luxel.scene.device import upload
from luxel.scene.library.shapes import quad
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


def test_parallel_rays_are_followed_too() -> None:
    """Of an orthographic camera each pixel's distance is counted along its own ray: 4 m to all of the wall."""
    pixels, width = 2.0, 8.0
    views = [replace(view, orthographic_width=width) for view in slide(pixels * width / SIZE[0])]
    scene = upload(make_scene(make_wall()))
    valid = trace_taps(scene, MotionPath(tuple(views), views[0]), SIZE)[0].valid
    assert valid[:, :-3].all() and not valid[:, -1].any()


def test_what_moves_is_followed() -> None:
    speed = 3.0 / PIXELS_A_METRE * FRAME_RATE  # three pixels a frame
    scene = upload(make_scene(make_wall(0.5, speed), make_wall(0.1), duration=10.0))
    # A frame in which the moving board has just left the still one behind it.
    taps = taps_between(scene, Film(*SIZE), (FRONT, FRONT), 1 - 48 + 9)
    columns = np.broadcast_to(np.arange(SIZE[0], dtype=float)[None, :, None], (SIZE[1], SIZE[0], 1))
    moved = (columns - taps.fetch(columns))[..., 0]
    found = np.unique(np.round(moved[taps.valid], 2))
    assert set(found) == {0.0, 3.0} and (moved[taps.valid] > 2.9).sum() > 10
    assert not taps.valid[0, 0], "the sky has no light that could flicker"


def look_along(height: float, z: float) -> Camera:
    return Camera((0.0, height, z), (0.0, height - 0.2, z - 10.0), fov=FOV)


def test_a_grazing_floor_keeps_its_taps() -> None:
    """From 0.3 m above it a row of pixels is farther than the next by up to a half: no fixed share of the distance
    tells the floor from what is not, but its own plane does. Each tap is where the point was, by arithmetic."""
    film, step = Film(96, 64), 0.05
    floor = quad((-200, 0, 200), (200, 0, 200), (200, 0, -200), (-200, 0, -200), 0)
    scene = upload(make_scene(Object("floor", [floor])))
    before, now = look_along(0.3, 0.0), look_along(0.3, -step)
    taps = taps_between(scene, film, (before, now), 6)
    # Where the rays through the pixels' centres meet y = 0, and where the eye of before had seen that.
    half = np.tan(np.deg2rad(FOV / 2.0))
    rows, columns = np.mgrid[: film.height, : film.width] + 0.5
    tilt = np.arctan2(0.2, 10.0)
    right = (columns / film.width * 2.0 - 1.0) * half
    up = (1.0 - rows / film.height * 2.0) * half * film.height / film.width
    fall = up * np.cos(tilt) - np.sin(tilt)
    ahead = np.cos(tilt) + up * np.sin(tilt)
    reach = np.where(fall < 0.0, -0.3 / np.minimum(fall, -1e-9), np.nan)
    x, z = right * reach, ahead * reach + step
    forward = z * np.cos(tilt) + 0.3 * np.sin(tilt)
    y_before = (z * np.sin(tilt) - 0.3 * np.cos(tilt)) / forward / (half * film.height / film.width)
    row, column = (1.0 - y_before) * film.height / 2.0, (x / forward / half + 1.0) * film.width / 2.0
    with np.errstate(invalid="ignore"):
        inside = (row > 1.0) & (row < film.height - 1) & (column > 1.0) & (column < film.width - 1) & (reach < 20.0)
    neighbours = np.abs(np.diff(np.linalg.norm(np.stack([x, z, 0.3 + 0.0 * x]), axis=0), axis=0)[:, film.width // 2])
    assert np.nanmax(neighbours[inside[:-1, film.width // 2]] / z[:-1][inside[:-1]].min()) > 0.05
    assert inside.sum() > 1500 and taps.valid[inside].all()
    places = np.stack([rows, columns], axis=-1)
    found = taps.fetch(places)[inside]
    np.testing.assert_allclose(found, np.stack([row, column], axis=-1)[inside], atol=0.02)
