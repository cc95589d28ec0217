"""Taps into the last frame, against the same taps by NumPy: planes, edges, steps in depth, what moves, the sky."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.kernels.camera import camera_axes, make_pinhole
from luxel.kernels.film import Film
from luxel.kernels.gbuffer import GBuffer, trace_gbuffer
from luxel.kernels.reproject import DEPTH_TOLERANCE, Taps, find_taps, forget, remember
from luxel.scene.device import Scene, set_time, upload
from luxel.scene.library.shapes import box, quad, rotation, translation
from luxel.scene.model import Camera, Material, Object, SceneData, Sky

FILM = Film(61, 37)
LANES = FILM.lanes_of_image()
WALL = quad((-30, -30, 0), (30, -30, 0), (30, 30, 0), (-30, 30, 0), 0)
FLOOR = quad((-300, 0, 300), (300, 0, 300), (300, 0, -300), (-300, 0, -300), 0)


def stage(*objects: Object) -> Scene:
    return upload(SceneData("stage", list(objects), [Material()], sky=Sky((0.25, 0.5, 1.0)), duration=2.0))


def image(value: object) -> np.ndarray:
    array = np.array(value)
    array = array.T if array.ndim == 2 else array
    return np.broadcast_to(array, (FILM.lane_count, *array.shape[1:]))[LANES]


def lanes_of(plane: np.ndarray) -> mi.Float:
    """Return (H, W) values as a device array in tile order, 1e9 in the padding: nobody may read it."""
    values = np.full(FILM.lane_count, 1e9, np.float32)
    values[LANES] = plane
    return mi.Float(values)


def look(
    scene: Scene, camera: Camera, before: Camera, offset: tuple[float, float] = (0.0, 0.0), times: tuple = ()
) -> tuple[GBuffer, GBuffer, Taps]:
    """Return what `before` saw a frame ago, what `camera` sees now, and the taps; `times` are of both."""
    now, then = (make_pinhole(each, FILM.width, FILM.height) for each in (camera, before))
    for time in times[:1]:
        set_time(scene, time)
    moved = mi.Vector2f(*offset)
    old = trace_gbuffer(scene, FILM, then, then, moved)
    last = remember(old, moved)
    dr.eval(last, old)
    for time in times[1:]:
        set_time(scene, time)
    new = trace_gbuffer(scene, FILM, now, then)
    taps = find_taps(scene, FILM, new, then, last)
    dr.eval(new, taps)
    return old, new, taps


def rays(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Return the eye and the (H, W, 3) directions through the pixels' centres, by hand."""
    eye, right, up, forward = camera_axes(camera)
    half = np.tan(np.radians(camera.fov) / 2.0)
    rows, columns = np.mgrid[: FILM.height, : FILM.width]
    x, y = (columns + 0.5) / FILM.width * 2 - 1, 1 - (rows + 0.5) / FILM.height * 2
    across, upwards = half * right, half * FILM.height / FILM.width * up
    return eye, forward + x[..., None] * across + y[..., None] * upwards


def to_pixels(points: np.ndarray, camera: Camera) -> np.ndarray:
    """Return (..., 2) pixel positions (column, row) of world points, by hand."""
    eye, right, up, forward = camera_axes(camera)
    offset = points - eye
    depth = offset @ forward
    half = np.tan(np.radians(camera.fov) / 2.0)
    x, y = offset @ right / depth / half, offset @ up / depth / (half * FILM.height / FILM.width)
    return np.stack([(x + 1.0) * FILM.width / 2.0, (1.0 - y) * FILM.height / 2.0], axis=-1)


def bilinear(plane: np.ndarray, places: np.ndarray, allowed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return `plane` at `places` by the taps that `allowed` (H, W) has, and their weight before scaling."""
    corner = np.floor(places - 0.5).astype(int)
    share = places - 0.5 - corner
    total, weight = np.zeros(places.shape[:-1]), np.zeros(places.shape[:-1])
    for down in (0, 1):
        for right in (0, 1):
            column, row = corner[..., 0] + right, corner[..., 1] + down
            inside = (column >= 0) & (column < FILM.width) & (row >= 0) & (row < FILM.height)
            column, row = column.clip(0, FILM.width - 1), row.clip(0, FILM.height - 1)
            part = np.where(right, share[..., 0], 1 - share[..., 0]) * np.where(down, share[..., 1], 1 - share[..., 1])
            part = part * (inside & allowed[row, column])
            total, weight = total + part * plane[row, column], weight + part
    return total / np.maximum(weight, 1e-9), weight


BEFORE = Camera((0.3, 1.6, 6.0), (0.1, 0.9, 0.0), fov=60.0)
NOW = Camera((1.0, 1.3, 6.6), (0.9, 1.2, 0.0), fov=60.0)


@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.3, -0.4)])
def test_a_plane_under_a_moving_camera(offset: tuple[float, float]) -> None:
    """Each pixel of the wall takes what the last frame had at the place where its point was."""
    _, new, taps = look(stage(Object("wall", [WALL])), NOW, BEFORE, offset)
    eye, directions = rays(NOW)
    points = eye + directions * (-eye[2] / directions[..., 2])[..., None]
    was = to_pixels(points, BEFORE)
    assert np.abs(was - to_pixels(points, NOW)).max() > 2.0
    noise = np.random.default_rng(1).random((FILM.height, FILM.width))
    expected, weight = bilinear(noise, was - offset, np.ones_like(noise, bool))
    found = image(taps.found)
    assert 0.5 < (weight > 0.999).mean() < 0.99 and (weight == 0.0).sum() > 20  # inside, beside the image, at its rim
    np.testing.assert_array_equal(found[np.abs(weight - 0.01) > 1e-3], weight[np.abs(weight - 0.01) > 1e-3] > 0.01)
    gathered = image(taps.gather(lanes_of(noise)))
    sure = found & (weight > 0.05)
    np.testing.assert_allclose(gathered[sure], expected[sure], atol=5e-3)
    assert not gathered[~found].any()
    total = image(sum(taps.weights[1:], taps.weights[0]))
    np.testing.assert_allclose(total, found, atol=1e-5)
    assert image(new.tracked).all()


def test_a_floor_that_falls_away_keeps_its_taps() -> None:
    """Between two rows of it, depths differ by more than the tolerance; the plane says that it is the same floor."""
    before = Camera((0.0, 0.5, 6.0), (0.0, 0.3, 0.0), fov=60.0)
    now = Camera((0.0, 0.5, 5.9), (0.0, 0.3, 0.0), fov=60.0)
    old, new, taps = look(stage(Object("floor", [FLOOR])), now, before)
    depth, seen = image(old.depth), image(new.surface.active)
    near, far = depth[1:], depth[:-1]
    ratio = near[np.isfinite(far)] / far[np.isfinite(far)]
    assert (np.abs(ratio - 1.0) > 2 * DEPTH_TOLERANCE).mean() > 0.9
    was = to_pixels(image(new.surface.p), before)
    inside = np.all((was > 1) & (was < (60, 36)), axis=-1)
    assert image(taps.found)[seen & inside].mean() > 0.99
    kinds = image(taps.gather(lanes_of(image(old.surface.active).astype(float))))
    np.testing.assert_allclose(kinds[image(taps.found)], seen[image(taps.found)], atol=1e-5)


def test_a_disoccluded_strip_has_no_history() -> None:
    """A board before a wall, of one object, both facing the camera: depth alone tells them apart."""
    board = quad((-0.8, 0, 2.0), (0.8, 0, 2.0), (0.8, 2, 2.0), (-0.8, 2, 2.0), 0)
    before, now = (Camera((x, 1.0, 6.0), (x, 1.0, 0.0), fov=60.0) for x in (0.0, 0.9))
    old, new, taps = look(stage(Object("all", [WALL, board])), now, before)
    points = image(new.surface.p).astype(float)
    on_wall = points[..., 2] < 1.0
    # Where the way from the old eye to a wall point crosses the board's plane.
    eye = np.array(before.eye)
    crossing = eye + (points - eye) * ((2.0 - eye[2]) / (points[..., 2] - eye[2]))[..., None]

    def behind(margin: float) -> np.ndarray:
        return on_wall & (np.abs(crossing[..., 0]) < 0.8 + margin) & (np.abs(crossing[..., 1] - 1.0) < 1.0 + margin)

    found = image(taps.found)
    pixel = 2 * np.tan(np.radians(30)) / FILM.width * 4.0  # of the board's plane, metres
    hidden = behind(-1.5 * pixel)
    assert hidden.sum() > 40
    assert not found[hidden].any()
    was = to_pixels(points, before)
    inside = np.all((was > 1) & (was < (FILM.width - 1, FILM.height - 1)), axis=-1)
    assert found[on_wall & inside & ~behind(1.5 * pixel)].all()
    assert found[~on_wall & inside].all()
    # And what is taken at all is of the same kind.
    old_wall = image(old.surface.p)[..., 2] < 1.0
    kinds = image(taps.gather(lanes_of(old_wall.astype(float))))
    np.testing.assert_allclose(kinds[found], on_wall[found], atol=1e-5)


def test_normals_and_objects_part_what_touches() -> None:
    """Across a box's edge normals differ, across a seam in a plane objects do; depths go on in both."""
    left = quad((-9, -9, -1), (0, -9, -1), (0, 9, -1), (-9, 9, -1), 0)
    right = quad((0, -9, -1), (9, -9, -1), (9, 9, -1), (0, 9, -1), 0)
    block = box((-0.8, -0.3, -0.5), (0.8, 1.1, 0.7), 0)
    scene = stage(Object("left", [left]), Object("right", [right]), Object("block", [block], rotation("y", 40.0)))
    old, new, taps = look(scene, Camera((0.6, 1.9, 4.0), (0, 0.4, 0)), Camera((0.2, 2.1, 4.2), (0, 0.4, 0)))
    found = image(taps.found)

    def label(seen: GBuffer) -> np.ndarray:
        n = image(seen.surface.n_geometric)
        faces = np.array([[0.64, 0, 0.77], [-0.77, 0, 0.64], [0, 1, 0]])
        return image(seen.surface.object_id) * 10.0 + np.argmax(n @ faces.T, axis=-1)

    old_label, new_label = label(old), label(new)
    assert len(np.unique(new_label)) >= 5
    kinds = image(taps.gather(lanes_of(old_label)))
    np.testing.assert_allclose(kinds[found], new_label[found], atol=1e-4)
    assert found.mean() > 0.85


def test_what_moves_takes_its_history_along() -> None:
    """A block that turns by 32 degrees a frame: its normals are asked for as they were."""

    def turn(time: float) -> np.ndarray:
        return translation(0.3 * time, 0.2 * time, 0.2) @ rotation("y", 40.0 * time)

    block = box((-1.2, -0.6, -0.9), (1.1, 1.2, 0.9), 0)
    scene = stage(Object("wall", [WALL], translation(0, 0, -4)), Object("block", [block], turn(0.0), turn))
    old, new, taps = look(scene, BEFORE, BEFORE, times=(0.4, 1.2))
    on_block = image(new.surface.object_id) == 2
    old_block = image(old.surface.object_id) == 2
    assert on_block.sum() > 150
    local = image(new.surface.p_object)
    before = local @ turn(0.4)[:3, :3].T + turn(0.4)[:3, 3]
    n_local = image(new.surface.n_geometric) @ turn(1.2)[:3, :3]
    n_before = n_local @ turn(0.4)[:3, :3].T
    facing = ((np.array(BEFORE.eye) - before) * n_before).sum(axis=-1)
    was = to_pixels(before, BEFORE)
    inside = np.all((was > 1) & (was < (60, 36)), axis=-1)
    found = image(taps.found)
    assert (on_block & inside & (facing > 0.5)).sum() > 200
    assert found[on_block & inside & (facing > 0.5)].mean() > 0.98  # its side was seen before, too
    assert not found[on_block & (facing < -0.1)].any()
    # What comes along is the same place of the block, as the old picture has it: within a tap's reach.
    places = [np.where(old_block, image(old.surface.p_object)[..., axis], 1e6) for axis in range(3)]
    gathered = np.stack([image(taps.gather(lanes_of(place))) for place in places], axis=-1).astype(float)
    there = to_pixels(gathered @ turn(0.4)[:3, :3].T + turn(0.4)[:3, 3], BEFORE)
    off = np.linalg.norm(there - was, axis=-1)[on_block & found]
    assert off.max() < 1.5 and np.median(off) < 0.1


def test_what_deforms_takes_its_history_along() -> None:
    """A cloth that is stretched to one side: its points are where its triangles were."""
    cloth = quad((-1.5, -0.5, 1), (1.5, -0.5, 1), (1.5, 2, 0), (-1.5, 2, 0), 0)

    def deform(time: float) -> list[tuple[np.ndarray, np.ndarray | None]]:
        return [((cloth.positions * (1.0 + 0.4 * time, 1.0, 1.0) + (0.2 * time, 0, 0)).astype(np.float32), None)]

    scene = stage(Object("wall", [WALL], translation(0, 0, -4)), Object("cloth", [cloth], deform=deform))
    old, new, taps = look(scene, BEFORE, BEFORE, times=(0.4, 1.0))
    on_cloth = image(new.surface.object_id) == 2
    found = image(taps.found)
    assert on_cloth.sum() > 300 and found[on_cloth].mean() > 0.98
    # What was at x is now at x times the ratio of the stretches, and moved.
    rest = (image(old.surface.p)[..., 0] - 0.08) / 1.16
    gathered = image(taps.gather(lanes_of(np.where(image(old.surface.object_id) == 2, rest, 1e6))))
    off = np.abs(gathered - (image(new.surface.p)[..., 0] - 0.2) / 1.4)[on_cloth & found]
    assert off.max() < 0.15 and np.median(off) < 0.01


def test_the_sky_moves_as_the_camera_turns() -> None:
    scene = stage(Object("floor", [FLOOR]))
    before, now = Camera((0, 2, 0), (0, 4, -5), fov=60.0), Camera((3, 2.5, 1), (3.5, 4.6, -4), fov=60.0)
    _, new, taps = look(scene, now, before)
    miss = ~image(new.surface.active)
    directions = rays(now)[1]
    was = to_pixels(np.array(before.eye) + directions, before)
    rows, columns = np.mgrid[: FILM.height, : FILM.width]
    centres = np.stack([columns + 0.5, rows + 0.5], axis=-1)
    assert miss.sum() > 500 and np.abs(was - centres)[miss].max() > 3.0
    np.testing.assert_allclose(image(new.motion)[miss], (centres - was)[miss], atol=5e-3)
    old_directions = rays(before)[1]
    inside = np.all((was > 1) & (was < (60, 36)), axis=-1)
    found = image(taps.found) & miss
    assert found[miss & inside].mean() > 0.95
    for axis in range(3):
        gathered = image(taps.gather(lanes_of(old_directions[..., axis] / np.linalg.norm(old_directions, axis=-1))))
        unit = directions[..., axis] / np.linalg.norm(directions, axis=-1)
        assert np.abs(gathered - unit)[found & inside].max() < 0.02


def test_an_orthographic_sky_turns_as_one() -> None:
    before, now = (Camera((x, 5, 3), (x, 9, 0), orthographic_width=4.0) for x in (0.0, 2.0))
    _, new, taps = look(stage(Object("floor", [FLOOR])), now, before)
    assert not image(new.surface.active).any()
    np.testing.assert_allclose(image(new.motion), 0.0, atol=1e-4)
    assert image(taps.found).all()


def test_an_orthographic_view_of_a_floor() -> None:
    before, now = (Camera((x, 5, 3), (x, 0, 0), orthographic_width=6.1) for x in (0.0, 0.5))
    _, _, taps = look(stage(Object("floor", [FLOOR])), now, before)
    found = image(taps.found)  # 0.5 m are 5 pixels: the last columns are new
    assert found[:, :55].all() and not found[:, 57:].any()


def test_nothing_comes_from_behind_the_eye_or_from_the_first_frame() -> None:
    """An endless floor lies behind the old camera as well: the plane alone would not tell."""
    scene = stage(Object("floor", [FLOOR]))
    before, now = Camera((0, 1, 0), (0, 0.5, -5), fov=60.0), Camera((0, 1, 0), (0, 0.5, 5), fov=60.0)
    _, new, taps = look(scene, now, before)
    assert image(new.surface.active).any() and not image(taps.found).any()
    pinhole = make_pinhole(now, FILM.width, FILM.height)
    seen = trace_gbuffer(scene, FILM, pinhole, pinhole)
    assert not image(find_taps(scene, FILM, seen, pinhole, forget(FILM)).found).any()


def test_records_are_gathered_field_by_field() -> None:
    _, _, taps = look(stage(Object("wall", [WALL])), NOW, BEFORE)
    one, two = (lanes_of(np.random.default_rng(seed).random((FILM.height, FILM.width))) for seed in (1, 2))
    color = taps.gather(mi.Color3f(one, two, one))
    np.testing.assert_array_equal(np.array(color.y), np.array(taps.gather(two)))
