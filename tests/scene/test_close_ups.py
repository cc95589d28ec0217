"""Close-ups and views from within: the place that lights what a camera sees is the scene, what lies outside is not."""

from __future__ import annotations

import numpy as np
import pytest

from luxel.scene.model import Camera

from .test_bounds import INSIDE, ROOM, ROOM_AREA, assert_is_room, box, dome, ground, host_of, stray, windowed_room

TABLE = box(np.array([-0.6, 0.7, -0.4]), np.array([0.6, 0.75, 0.4]))
CUP = box(np.array([-0.04, 0.75, -0.04]), np.array([0.04, 0.84, 0.04]), without=(3,))
MACRO = Camera((0.12, 0.85, 0.15), (0.0, 0.8, 0.0), fov=40.0)
AROUND = {
    "nothing": [],
    "stray": [stray(300.0)],
    "dome": [dome(500.0)],
    "ground": [ground(1000.0)],
    "dome-and-ground": [dome(500.0), ground(500.0)],
    "fine-dome": [dome(200.0, 64, 128), ground(200.0)],
}
"""What may lie around a place; none of it is the place."""


def holds(host, lower: tuple[float, float, float], upper: tuple[float, float, float], slack: float = 0.02) -> bool:
    """Return whether the bounds hold a box, but for `slack` metres."""
    return bool((host.lower <= np.array(lower) + slack).all() and (host.upper >= np.array(upper) - slack).all())


def assert_ends(host, lower: tuple[float, float, float], upper: tuple[float, float, float]) -> None:
    """Raise unless the bounds are that box, to 2 cm."""
    np.testing.assert_allclose(host.lower, lower, atol=0.02)
    np.testing.assert_allclose(host.upper, upper, atol=0.02)


@pytest.mark.parametrize("outside", [[], [stray(300.0)], [dome(500.0)]], ids=["alone", "stray", "dome"])
@pytest.mark.parametrize("above", [0.02, 0.1, 0.3, 0.6])
def test_a_close_up_keeps_the_room_that_lights_it(above: float, outside: list[np.ndarray]) -> None:
    """A camera before a block, or just above the floor: all of a room of 2 m is in its bounds, and none of it dark."""
    room = box(np.array([-1.0, 0.0, -1.0]), np.array([1.0, 2.0, 1.0]))
    block = box(np.array([-0.3, 0.0, 0.0]), np.array([0.5, 0.6, 0.6]))
    camera = Camera((0.0, above, 0.8), (0.0, above, -1.0), fov=60.0)
    host = host_of(room, block, *outside, cameras=(camera,))
    assert_ends(host, (-1.0, 0.0, -1.0), (1.0, 2.0, 1.0))
    # Surfels are as many as the area says; the pool has room for twice as many.
    assert host.area > 0.5 * (2 * (4 + 4 + 4) + 2 * (0.8 * 0.6 + 0.8 * 0.6 + 0.6 * 0.6))


@pytest.mark.parametrize("outside", [[], [ground(1000.0)], [dome(500.0)]], ids=["alone", "ground", "dome"])
@pytest.mark.parametrize("away", [0.3, 0.03])
def test_camera_close_to_the_floor_keeps_what_lights_it(away: float, outside: list[np.ndarray]) -> None:
    """Of a close-up the walls and the ceiling of a long hall are the scene too, and what lies outside is still not."""
    hall = box(np.array([-30.0, 0.0, -2.0]), np.array([30.0, 4.0, 2.0]), without=(1,) if outside else ())
    host = host_of(hall, *outside, cameras=(Camera((0.0, away, 0.0), (0.5 * away, 0.0, 0.0), fov=40.0),))
    assert host.upper[1] > 3.9 and host.lower[2] < -1.9 and host.upper[2] > 1.9
    assert np.linalg.norm(host.upper - host.lower) < 70.0


# --- a cup in a picture of 20 cm ------------------------------------------------------------------------------------


@pytest.mark.parametrize("around", AROUND)
@pytest.mark.parametrize(("half", "height"), [(10.0, 6.0), (25.0, 12.0)])
def test_macro_shot_keeps_its_hall(half: float, height: float, around: str) -> None:
    """A hall of 20 or 50 m, with one end open where something lies around it."""
    lower, upper = (-half, 0.0, -half), (half, height, half)
    hall = box(np.array(lower), np.array(upper), without=(1,) if AROUND[around] else ())
    host = host_of(hall, TABLE, CUP, *AROUND[around], cameras=(MACRO,))
    assert holds(host, lower, upper)
    assert (host.upper - host.lower).max() < 2.2 * half
    assert host.area > 0.5 * (4 * half * half + 3 * 2 * half * height)


@pytest.mark.parametrize("around", AROUND)
def test_macro_shot_keeps_a_courtyard_under_the_sky(around: str) -> None:
    """A third of the light's ways end in the open; the rest is the yard."""
    lower, upper = (-12.0, 0.0, -12.0), (12.0, 9.0, 12.0)
    yard = box(np.array(lower), np.array(upper), without=(3,))
    host = host_of(yard, TABLE, CUP, *AROUND[around], cameras=(MACRO,))
    assert_ends(host, lower, upper)


@pytest.mark.parametrize("around", [name for name in AROUND if "ground" in name or "fine" in name])
def test_macro_shot_in_the_open_keeps_the_table(around: str) -> None:
    """Nothing stands around it: its bounds are the table's, neither a cup's nor those of a kilometre."""
    host = host_of(TABLE, CUP, *AROUND[around], cameras=(MACRO,))
    assert holds(host, (-0.6, 0.7, -0.4), (0.6, 0.84, 0.4))
    assert (host.upper - host.lower).max() < 5.0


@pytest.mark.parametrize("outside", [[], [stray(300.0)]], ids=["alone", "stray"])
def test_macro_shot_in_a_cathedral_of_120_metres(outside: list[np.ndarray]) -> None:
    """Longer than what counts as surroundings, but its walls are near enough."""
    nave = box(np.array([-60.0, 0.0, -30.0]), np.array([60.0, 30.0, 30.0]))
    host = host_of(nave, TABLE, CUP, *outside, cameras=(MACRO,))
    assert_ends(host, (-60.0, 0.0, -30.0), (60.0, 30.0, 30.0))


# --- from within ---------------------------------------------------------------------------------------------------


def house() -> list[np.ndarray]:
    """Return nine rooms of 5 m, three by three, 10 cm apart."""
    corners = [np.array([5.0 * i, 0.0, 5.0 * j]) for i in range(3) for j in range(3)]
    return [box(corner + 0.05, corner + (4.95, 2.65, 4.95)) for corner in corners]


def cupboard(*, closed: bool) -> np.ndarray:
    """Return a cupboard at the wall of the middle room, without a door unless it is closed."""
    return box(np.array([5.1, 0.06, 7.0]), np.array([5.7, 2.0, 8.0]), without=() if closed else (1,))


@pytest.mark.parametrize("outside", [[], [stray(300.0)], [ground(1000.0)]], ids=["alone", "stray", "ground"])
@pytest.mark.parametrize("towards", [5.2, 5.6], ids=["to-the-wall", "to-the-room"])
def test_camera_in_an_open_cupboard_keeps_its_room(towards: float, outside: list[np.ndarray]) -> None:
    camera = Camera((10.8 - towards, 1.0, 7.5), (towards, 1.0, 7.5), fov=60.0)
    host = host_of(*house(), cupboard(closed=False), *outside, cameras=(camera,))
    assert holds(host, (5.05, 0.05, 5.05), (9.95, 2.65, 9.95))
    assert (host.upper - host.lower).max() < 16.0 and host.area > 0.5 * 2 * (4.9 * 4.9 + 2 * 4.9 * 2.6)


def test_camera_in_a_closed_cupboard_does_not_take_the_house() -> None:
    camera = Camera((5.2, 1.0, 7.5), (5.6, 1.0, 7.5), fov=60.0)
    host = host_of(*house(), cupboard(closed=True), cameras=(camera,))
    assert holds(host, (5.1, 0.06, 7.0), (5.7, 2.0, 8.0)) and (host.upper - host.lower).max() < 6.0


@pytest.mark.parametrize("behind", [0.1, 1.0])
@pytest.mark.parametrize("around", ["nothing", "dome", "dome-and-ground"])
def test_camera_that_looks_out_of_a_window_keeps_its_room(behind: float, around: str) -> None:
    """Most of its rays never come back."""
    camera = Camera((0.0, 1.5, -2.0 + behind), (0.0, 1.4, -20.0), fov=60.0)
    host = host_of(windowed_room(), *AROUND[around], cameras=(camera,))
    assert holds(host, tuple(ROOM[0]), tuple(ROOM[1])) and (host.upper - host.lower).max() < 40.0


@pytest.mark.parametrize("behind", [0.1, 1.0])
def test_camera_that_looks_out_of_a_window_keeps_the_house_opposite(behind: float) -> None:
    opposite = (-8.0, 0.0, -30.0), (8.0, 12.0, -20.0)
    camera = Camera((0.0, 1.5, -2.0 + behind), (0.0, 1.4, -20.0), fov=60.0)
    host = host_of(
        windowed_room(), box(np.array(opposite[0]), np.array(opposite[1])), ground(1000.0), cameras=(camera,)
    )
    assert holds(host, *opposite) and holds(host, tuple(ROOM[0]), tuple(ROOM[1]))
    assert (host.upper - host.lower).max() < 60.0


# --- a wide camera and a close one ---------------------------------------------------------------------------------


@pytest.mark.parametrize("outside", [[], [stray(300.0)], [dome(500.0)]], ids=["alone", "stray", "dome"])
@pytest.mark.parametrize("cameras", [(INSIDE, MACRO), (MACRO, INSIDE), (MACRO,), (MACRO, MACRO, MACRO, INSIDE)])
def test_wide_and_close_cameras_agree_about_one_room(cameras: tuple[Camera, ...], outside: list[np.ndarray]) -> None:
    host = host_of(box(*ROOM), TABLE, CUP, *outside, cameras=cameras)
    assert_is_room(host)
    assert host.area > ROOM_AREA


def test_close_camera_does_not_take_the_say_from_a_wide_one_far_away() -> None:
    away = np.array([200.0, 0.0, 0.0])
    wide = Camera((200.5, 1.5, 1.5), (199.5, 1.4, -2.0), fov=70.0)
    host = host_of(box(*ROOM), TABLE, CUP, box(ROOM[0] + away, ROOM[1] + away), cameras=(MACRO, MACRO, wide))
    assert_ends(host, tuple(ROOM[0]), tuple(ROOM[1] + away))
