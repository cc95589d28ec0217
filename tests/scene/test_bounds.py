"""What lengths come from: strays, domes and wide grounds have no say, and a clean scene keeps all of itself."""

from __future__ import annotations

import numpy as np
import pytest

from luxel.scene import load
from luxel.scene.bounds import triangle_bounds
from luxel.scene.device import upload
from luxel.scene.model import Camera, Material, Mesh, Object, SceneData
from luxel.scene.triangles import Triangles, area_within, world_corners

ROOM = (np.array([-2.0, 0.0, -2.0]), np.array([2.0, 3.0, 2.0]))
ROOM_AREA = 2 * (4 * 4 + 4 * 3 + 4 * 3)
INSIDE = Camera((0.5, 1.5, 1.5), (-0.5, 1.4, -2.0), fov=70.0)


def quad(*corners: tuple[float, float, float]) -> np.ndarray:
    a, b, c, d = (np.array(corner, float) for corner in corners)
    return np.array([[a, b, c], [a, c, d]])


def box(lower: np.ndarray, upper: np.ndarray, without: tuple[int, ...] = ()) -> np.ndarray:
    """Return the triangles (F, 3, 3) of a box; sides go -x, +x, -y, +y, -z, +z."""
    ends = np.array(
        [[(lower, upper)[i >> 2][0], (lower, upper)[i >> 1 & 1][1], (lower, upper)[i & 1][2]] for i in range(8)]
    )
    order = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    return np.concatenate([quad(*ends[list(side)]) for i, side in enumerate(order) if i not in without])


def dome(radius: float, rings: int = 12, parts: int = 32) -> np.ndarray:
    """Return a hemisphere of triangles about the origin."""
    v, u = np.meshgrid(np.linspace(0, np.pi / 2, rings + 1), np.linspace(0, 2 * np.pi, parts + 1), indexing="ij")
    p = radius * np.stack([np.cos(v) * np.cos(u), np.sin(v), np.cos(v) * np.sin(u)], axis=-1)
    first = np.stack([p[:-1, :-1], p[1:, :-1], p[1:, 1:]], axis=2)
    second = np.stack([p[:-1, :-1], p[1:, 1:], p[:-1, 1:]], axis=2)
    return np.concatenate([first.reshape(-1, 3, 3), second.reshape(-1, 3, 3)])


def ground(half: float, cells: int = 1, height=lambda x, z: 0.0 * x - 0.01) -> np.ndarray:
    """Return a square ground of `cells` squares a side."""
    x, z = np.meshgrid(np.linspace(-half, half, cells + 1), np.linspace(-half, half, cells + 1), indexing="ij")
    p = np.stack([x, height(x, z), z], axis=-1)
    first = np.stack([p[:-1, :-1], p[1:, 1:], p[1:, :-1]], axis=2)
    second = np.stack([p[:-1, :-1], p[:-1, 1:], p[1:, 1:]], axis=2)
    return np.concatenate([first.reshape(-1, 3, 3), second.reshape(-1, 3, 3)])


def stray(distance: float, size: float = 0.1) -> np.ndarray:
    return np.array([[[distance] * 3, [distance + size, distance, distance], [distance, distance + size, distance]]])


def windowed_room() -> np.ndarray:
    """Return the room with a window of 1 by 1 m in its -z wall."""
    (x0, y0, z0), (x1, y1, _) = ROOM
    wall = [
        quad((x0, y0, z0), (x1, y0, z0), (x1, 1.0, z0), (x0, 1.0, z0)),
        quad((x0, 2.0, z0), (x1, 2.0, z0), (x1, y1, z0), (x0, y1, z0)),
        quad((x0, 1.0, z0), (-0.5, 1.0, z0), (-0.5, 2.0, z0), (x0, 2.0, z0)),
        quad((0.5, 1.0, z0), (x1, 1.0, z0), (x1, 2.0, z0), (0.5, 2.0, z0)),
    ]
    return np.concatenate([box(*ROOM, without=(4,)), *wall])


def scene(*parts: np.ndarray, cameras: tuple[Camera, ...] = (INSIDE,), **fields) -> SceneData:
    meshes = [
        Mesh(part.reshape(-1, 3).astype(np.float32), np.arange(3 * len(part), dtype=np.uint32).reshape(-1, 3))
        for part in parts
    ]
    return SceneData("test", [Object("all", meshes)], [Material()], cameras=list(cameras), **fields)


def host_of(*parts: np.ndarray, **fields):
    return upload(scene(*parts, **fields)).host


def assert_is_room(host, slack: float = 1e-5) -> None:
    assert np.allclose(host.lower, ROOM[0], atol=slack) and np.allclose(host.upper, ROOM[1], atol=slack)


# --- area in a box -------------------------------------------------------------------------------------------------


def test_area_of_cut_triangles() -> None:
    """A square of 10 m lies in a box of 2 by 3 m: 6 m^2; a slanted one is longer by its slope."""
    low, high = np.array([-1.0, -5.0, -1.0]), np.array([1.0, 5.0, 2.0])
    flat = ground(5.0, height=lambda x, z: 0.0 * x)
    assert area_within(Triangles(flat), low, high) == pytest.approx(6.0, rel=1e-4)
    assert area_within(Triangles(ground(5.0, 7, lambda x, z: 0.0 * x)), low, high) == pytest.approx(6.0, rel=1e-4)
    slanted = ground(5.0, height=lambda x, z: 0.75 * x)
    assert area_within(Triangles(slanted), low, high) == pytest.approx(6.0 * 1.25, rel=1e-4)
    assert area_within(Triangles(flat + 20.0), low, high) == 0.0
    assert area_within(Triangles(box(low, high)), low, high) == pytest.approx(2 * (20 + 6 + 30), rel=1e-6)
    assert area_within(Triangles(ground(5000.0)), low, high) == pytest.approx(6.0, rel=1e-4)


# --- with cameras --------------------------------------------------------------------------------------------------


def test_clean_room_keeps_all_of_itself() -> None:
    host = host_of(box(*ROOM))
    assert_is_room(host)
    assert host.area == pytest.approx(ROOM_AREA, rel=1e-5)


@pytest.mark.parametrize("distance", [30.0, 300.0, 1e6])
def test_stray_triangle_has_no_say(distance: float) -> None:
    host = host_of(box(*ROOM), stray(distance))
    assert_is_room(host)
    assert host.area == pytest.approx(ROOM_AREA, rel=1e-5)


@pytest.mark.parametrize("radius", [60.0, 500.0, 20_000.0])
def test_dome_beyond_a_window_has_no_say(radius: float) -> None:
    host = host_of(windowed_room(), dome(radius))
    assert_is_room(host)
    assert host.area == pytest.approx(ROOM_AREA - 1.0, rel=1e-5)


def test_dome_all_around_an_open_view_has_no_say() -> None:
    """A block on a ground, under a dome that fills half the picture."""
    block = box(np.array([-1.0, 0.0, -1.0]), np.array([1.0, 2.0, 1.0]))
    camera = Camera((4.0, 1.7, 6.0), (0.0, 1.5, 0.0), fov=70.0)
    host = host_of(block, dome(500.0), ground(500.0), cameras=(camera,))
    assert (host.upper - host.lower).max() < 40.0 and host.upper[1] < 10.0
    assert (host.lower <= -1.0).all() or host.lower[1] <= 0.0
    assert (host.upper >= 1.0).all()


@pytest.mark.parametrize("half", [100.0, 1000.0])
def test_wide_ground_ends_where_the_view_needs_it(half: float) -> None:
    block = box(np.array([-2.0, 0.0, -2.0]), np.array([2.0, 3.0, 2.0]))
    camera = Camera((5.0, 1.7, 8.0), (0.0, 1.5, 0.0), fov=60.0)
    host = host_of(block, ground(half), cameras=(camera,))
    assert (host.upper - host.lower).max() < 60.0
    assert (host.lower[[0, 2]] <= -2.0).all() and (host.upper >= (2.0, 3.0, 2.0)).all()
    assert ROOM_AREA < host.area < 3600.0


def test_terrain_that_the_view_is_about_counts_as_a_whole() -> None:
    """From 300 m above, 2 km of hills are the scene."""
    hills = ground(1000.0, 60, lambda x, z: 50.0 * np.sin(x / 130.0) * np.cos(z / 170.0))
    camera = Camera((0.0, 300.0, 1300.0), (0.0, 0.0, 0.0), fov=70.0)
    host = host_of(hills, cameras=(camera,))
    assert np.allclose(host.upper - host.lower, hills.max(axis=(0, 1)) - hills.min(axis=(0, 1)), rtol=0.05)


def test_room_next_door_belongs_to_the_scene() -> None:
    """What a wall hides from the camera is near: probes and surfels must reach there."""
    beyond = (ROOM[0] + (4.2, 0.0, 0.0), ROOM[1] + (4.2, 0.0, 0.0))
    host = host_of(box(*ROOM), box(*beyond))
    assert np.allclose(host.upper, beyond[1]) and host.area == pytest.approx(2 * ROOM_AREA, rel=1e-5)


def test_two_cameras_far_apart_keep_both_their_rooms() -> None:
    away = np.array([200.0, 0.0, 0.0])
    other = Camera((200.5, 1.5, 1.5), (199.5, 1.4, -2.0), fov=70.0)
    host = host_of(box(*ROOM), box(ROOM[0] + away, ROOM[1] + away), cameras=(INSIDE, other))
    assert np.allclose(host.lower, ROOM[0], atol=1e-5) and np.allclose(host.upper, ROOM[1] + away, atol=1e-5)


def test_far_camera_does_not_take_the_say_from_the_near_one() -> None:
    """An overview from high above sees the dome's rim; the view into the room is what needs detail."""
    above = Camera((0.0, 400.0, 10.0), (0.0, 0.0, 0.0), fov=80.0)
    host = host_of(windowed_room(), ground(1000.0), cameras=(INSIDE, above))
    assert (host.upper - host.lower).max() < 20.0


@pytest.mark.parametrize(
    "camera", [Camera((0.0, 1.0, 900.0), (0.0, 1.0, 2000.0)), Camera((0.0, 5000.0, 0.0), (1.0, 9000.0, 0.0))]
)
def test_camera_that_looks_at_nothing_leaves_it_to_the_triangles(camera: Camera) -> None:
    host = host_of(box(*ROOM), stray(300.0), cameras=(camera,))
    assert_is_room(host)


def test_same_every_time() -> None:
    first, second = (host_of(windowed_room(), dome(500.0), ground(1000.0)) for _ in range(2))
    assert np.array_equal(first.lower, second.lower) and np.array_equal(first.upper, second.upper)
    assert first.area == second.area


# --- animation -----------------------------------------------------------------------------------------------------


class Shift:
    """Moves along x by `speed` metres a second."""

    def __init__(self, speed: float) -> None:
        self.speed = speed

    def __call__(self, time: float) -> np.ndarray:
        matrix = np.eye(4)
        matrix[0, 3] = self.speed * time
        return matrix


@pytest.mark.parametrize(("speed", "reach"), [(1.0, 4.5), (1000.0, 2.0)])
def test_moving_object_counts_while_it_is_near(speed: float, reach: float) -> None:
    """Through the wall to 4 m: it belongs to the scene. A thing that flies off to 4 km does not."""
    data = scene(box(*ROOM), duration=4.0)
    block = box(np.array([-0.5, 0.5, -0.5]), np.array([0.5, 1.5, 0.5]))
    mover = scene(block).objects[0]
    mover.motion = Shift(speed)
    data.objects.append(mover)
    host = upload(data).host
    assert np.allclose(host.lower, ROOM[0], atol=1e-5)
    assert host.upper[0] == pytest.approx(reach, abs=1e-4)


# --- without cameras -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "outside",
    [stray(300.0), stray(1000.0, 1.0), dome(500.0), ground(1000.0), np.concatenate([dome(500.0), ground(1000.0)])],
    ids=["stray", "large-stray", "dome", "ground", "dome-and-ground"],
)
def test_triangles_alone_find_the_room(outside: np.ndarray) -> None:
    assert_is_room(host_of(box(*ROOM), outside, cameras=()))


@pytest.mark.parametrize("radius", [0.1, 0.01, 0.001])
def test_triangles_alone_keep_a_detailed_thing_in_a_plain_room(radius: float) -> None:
    """A thing of two millimetres to 0.2 m with many triangles on a table does not make its room surroundings."""
    thing = dome(radius) + (0.3, 0.8, 0.2)
    assert_is_room(host_of(box(*ROOM), thing, cameras=()))


# --- nothing to measure --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "corners",
    [
        np.zeros((3, 3, 3)),
        np.full((1, 3, 3), 5.0),
        np.linspace(0.0, 1.0, 9)[:, None].repeat(3, axis=1).reshape(3, 3, 3),
        ground(3.0),
        stray(0.0),
    ],
    ids=["point", "elsewhere", "line", "plane", "one-triangle"],
)
def test_flat_scenes_have_finite_bounds(corners: np.ndarray) -> None:
    found = triangle_bounds(Triangles(corners.astype(np.float32)))
    assert np.isfinite(found.lower).all() and np.isfinite(found.upper).all() and np.isfinite(found.area)
    assert (found.lower <= found.upper).all() and found.area >= 0.0


@pytest.mark.parametrize(
    "name", ["cornell-box", "furnace", "sphere", "two-rooms", "opening", "attic", "atrium", "glossy"]
)
def test_built_in_scenes_keep_their_whole_box_and_area(name: str) -> None:
    """They have no surroundings, so surfels and probes are as large as by the box of all triangles."""
    data = load(name)
    corners = world_corners(data)
    edges = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    host = upload(data).host
    assert np.allclose(host.lower, corners.min(axis=(0, 1)), atol=1e-5)
    assert np.allclose(host.upper, corners.max(axis=(0, 1)), atol=1e-5)
    assert host.area == pytest.approx(0.5 * np.linalg.norm(np.cross(*edges), axis=1).sum(), rel=0.02)
