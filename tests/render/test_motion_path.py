"""The flight of `compare --motion`: its speed, its places, its frames, and what cannot be flown."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from luxel.errors import LuxelError
from luxel.render.loading import load
from luxel.render.motion_path import (
    FRAME_RATE,
    MotionPath,
    check_motion,
    curve_views,
    find_motion,
    frame_time,
    judged_frames,
    line_views,
)
from luxel.scene.axes import camera_axes
from luxel.scene.device import upload
from luxel.scene.model import Camera

BY_SPEED = [Camera((0, 1, 0), (0, 1, -1)), Camera((30, 1, 0), (30, 1, -1)), Camera((31, 1, -20), (31, 1, -21))]
BY_TURN = [Camera((0, 1, 0), (0, 1, -1)), Camera((0.1, 1, 0), (1.1, 1, 0)), Camera((0.1, 1, 0.1), (0.1, 1, 2))]
ON_ITS_HEEL = [Camera((0, 1, 0), (0, 1, -1)), Camera((0, 1, 0), (0, 1, 1)), Camera((0, 1, 0), (0.5, 1.5, -1))]
MIXED = [*BY_SPEED, Camera((31, 1, -20), (20, 1, -20)), Camera((25, 3, -21), (20, 1, -20), fov=40.0)]


def speeds(views: list[Camera]) -> tuple[np.ndarray, np.ndarray]:
    """Return metres and degrees a second from each view to the next; degrees of the whole turn, roll included."""
    axes = np.array([camera_axes(view) for view in views])
    metres = np.linalg.norm(np.diff(axes[:, 0], axis=0), axis=1)
    # The trace of a rotation by an angle is 1 + 2 cos(angle); of one matrix after another it is their inner product.
    inner = np.einsum("nij,nij->n", axes[1:, 1:], axes[:-1, 1:])
    return metres * FRAME_RATE, np.rad2deg(np.arccos(np.clip((inner - 1.0) / 2.0, -1.0, 1.0))) * FRAME_RATE


@pytest.mark.parametrize("keys", [BY_SPEED, BY_TURN, ON_ITS_HEEL, MIXED])
def test_a_flight_keeps_to_both_limits_and_reaches_one(keys: list[Camera]) -> None:
    metres, degrees = speeds(curve_views(keys, 60))
    assert metres.max() <= 2.0 and degrees.max() <= 60.0
    # Somewhere it is as fast as it may be, and never much slower than the limit that it is nearer to.
    assert np.maximum(metres / 2.0, degrees / 60.0).min() > 0.97


def test_a_long_curve_is_flown_from_its_start_and_a_short_one_to_its_end() -> None:
    part = curve_views(BY_SPEED, 96)
    assert part[0].eye == (0.0, 1.0, 0.0)
    # 95 steps at 2 m/s and 30 a second are 6.33 m of the way of 50.
    assert np.sum(speeds(part)[0]) / FRAME_RATE == pytest.approx(2.0 * 95 / 30, rel=2e-3)
    short = [Camera((0, 1, 0), (0, 1, -1)), Camera((0.3, 1, 0), (0.3, 1, -1))]
    whole = curve_views(short, 96)
    np.testing.assert_allclose(whole[-1].eye, (0.3, 1.0, 0.0), atol=1e-9)
    np.testing.assert_allclose(speeds(whole)[0], 0.3 / 95 * 30, rtol=1e-6)


@pytest.mark.parametrize("keys", [BY_SPEED, BY_TURN, ON_ITS_HEEL, MIXED])
def test_the_curve_meets_every_key_view_and_is_smooth(keys: list[Camera]) -> None:
    views = curve_views(keys, 2000)
    axes = np.array([camera_axes(view) for view in views])
    for key in keys:
        eye, _, _, forward = camera_axes(key)
        off = np.linalg.norm(axes[:, 0] - eye, axis=1) + np.linalg.norm(axes[:, 3] - forward, axis=1)
        assert off.min() < 0.1
    # No corner: from one step to the next, the way turns by little unless the eye all but stands, as where it turns.
    steps = np.diff(axes[:, 0], axis=0)
    length = np.linalg.norm(steps, axis=1)
    moves = (length[1:] > 0.01) & (length[:-1] > 0.01)
    cosine = (steps[1:] * steps[:-1]).sum(axis=1)[moves] / (length[1:] * length[:-1])[moves]
    assert cosine.size == 0 or cosine.min() > 0.8


@pytest.mark.parametrize("name", ["moving", "two-rooms", "cornell-box", "glossy", "opening", "attic", "atrium"])
def test_no_flight_swings_beyond_its_key_views(name: str) -> None:
    """Key views stand before walls; a curve that overshoots goes through them, and is black inside."""
    keys = load(name).flight
    views = curve_views(keys, 4000)
    eyes, ends = np.array([view.eye for view in views]), np.array([key.eye for key in keys])
    inside = [
        ((eyes > np.minimum(a, b) - 1e-6) & (eyes < np.maximum(a, b) + 1e-6)).all(axis=1)
        for a, b in zip(ends, ends[1:], strict=False)
    ]
    assert np.any(inside, axis=0).all()


def test_all_frames_have_the_first_key_views_field_of_view() -> None:
    views = curve_views([replace(MIXED[-1], fov=33.0), *MIXED], 20)
    assert {view.fov for view in views} == {33.0}


def test_all_frames_and_the_jump_have_the_first_key_views_projection() -> None:
    first = Camera((0, 1, 3), (0, 1, 0), orthographic_width=2.5, orthographic_height=1.5, lens_shift=(0.1, 0.2))
    first = replace(first, mirrored=True, motion=lambda time: np.eye(4))
    data = replace(load("two-rooms"), flight=[first, Camera((1, 1, 2), (0, 1, 0), fov=33.0)])
    path = find_motion(upload(data), 6)
    for view in (*path.views, path.cut):
        assert (view.orthographic_width, view.orthographic_height) == (2.5, 1.5)
        assert view.mirrored and view.lens_shift == (0.1, 0.2) and view.motion is None
    assert path.cut.eye == (1, 1, 2)


def test_a_straight_line_is_flown_in_exactly_those_frames() -> None:
    scene = upload(load("two-rooms"))
    path = find_motion(scene, 31, "-2,1,0;28,1,0;0,1,0;60,1,0;65")
    eyes = np.array([view.eye for view in path.views])
    targets = np.array([view.target for view in path.views])
    # 30 m and 60 m in 30 steps, far beyond 2 m/s.
    np.testing.assert_allclose(eyes[:, 0], np.arange(31) - 2.0, atol=1e-9)
    np.testing.assert_allclose(targets[:, 0], 2.0 * np.arange(31), atol=1e-9)
    assert {view.fov for view in path.views} == {65.0}
    assert find_motion(scene, 6, "-2,1,0;28,1,0;0,1,0;60,1,0").views[0].fov == 60.0


def test_a_scene_is_flown_along_its_own_views_and_jumps_to_the_last() -> None:
    scene = upload(load("two-rooms"))
    path = find_motion(scene)
    flight = scene.host.data.flight
    assert isinstance(path, MotionPath) and len(path.views) == 96
    assert path.judged == tuple(range(6, 97, 6)) and len(path.judged) == 16
    np.testing.assert_allclose(path.views[0].eye, flight[0].eye)
    assert path.cut.eye == flight[-1].eye and path.cut.fov == flight[0].fov


def test_who_has_arrived_at_the_last_view_jumps_to_the_first() -> None:
    data = replace(load("two-rooms"), flight=load("two-rooms").flight[:2])
    scene = upload(data)
    path = find_motion(scene, 3000)
    np.testing.assert_allclose(path.views[-1].eye, data.flight[1].eye, atol=1e-6)
    assert path.cut.eye == data.flight[0].eye


def test_every_sixth_frame_is_judged() -> None:
    assert judged_frames(96) == tuple(6 * number for number in range(1, 17))
    assert judged_frames(12) == (6, 12) and judged_frames(17) == (6, 12)


def test_the_scenes_clock_runs_from_the_warm_up_on() -> None:
    assert frame_time(-47) == 0.0 and frame_time(1) == pytest.approx(48 / 30)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("1,2,3;4,5,6", "not a flight path"),
        ("1,2,3;4,5,6;7,8,9", "not a flight path"),
        ("1,2,3;4,5,6;7,8,9;a,b,c", "not a flight path"),
        ("1,2,3;4,5,6;7,8,9;1,1,1;65;7", "not a flight path"),
        ("1,2,3;4,5,6;7,8,nan;1,1,1", "not a flight path"),
        ("1,2,3;4,5,6;7,8,9;1,1,1;200", "field of view"),
        ("1,2,3;4,5,6;1,2,3;1,1,1", "looks nowhere"),
        ("0,0,0;2,0,0;2,0,0;0,0,0", "meets its target"),
    ],
)
def test_a_line_that_cannot_be_flown_is_refused_in_a_sentence(line: str, words: str) -> None:
    with pytest.raises(LuxelError, match=words) as caught:
        check_motion(7, line)
    assert "\n" not in str(caught.value)


def test_too_few_frames_and_a_single_view_are_refused() -> None:
    with pytest.raises(LuxelError, match="none to judge"):
        check_motion(5, None)
    data = load("two-rooms")
    with pytest.raises(LuxelError, match="--flight-path"):
        find_motion(upload(replace(data, flight=data.flight[:1])))


def test_found_views_are_not_joined_through_a_wall() -> None:
    """`two-rooms` as a file would be: no flight of its own; its sealed room cannot be flown into."""
    data = load("two-rooms")
    scene = upload(replace(data, flight=[]))
    wall = data.facts["sealed_lo_x"]
    assert all(view.eye[0] < wall for view in find_motion(scene, 48).views)


def test_the_last_bits_of_a_curve_do_not_matter() -> None:
    """Keys that differ by rounding give the very same views: committed truths are found by them on every machine."""
    moved = [replace(key, eye=tuple(value * (1.0 + 2e-16) + 1e-17 for value in key.eye)) for key in MIXED]
    assert curve_views(moved, 40) == curve_views(MIXED, 40)


@pytest.mark.parametrize("keys", [BY_SPEED, BY_TURN, ON_ITS_HEEL, MIXED])
def test_far_away_a_flight_is_as_smooth_as_near(keys: list[Camera]) -> None:
    """Where maps put things, 5,000 km off: the same flight within 0.02 mm, and directions within a hundredth pixel."""
    away = np.array((5e6, 3e2, -4e6))

    def carried(point: tuple[float, float, float]) -> tuple[float, float, float]:
        x, y, z = (np.array(point) + away).tolist()
        return x, y, z

    far = [replace(key, eye=carried(key.eye), target=carried(key.target)) for key in keys]
    axes, axes_far = (np.array([camera_axes(view) for view in curve_views(each, 24)]) for each in (keys, far))
    np.testing.assert_allclose(axes_far[:, 0] - away, axes[:, 0], atol=2e-5)
    np.testing.assert_allclose(axes_far[:, 1:], axes[:, 1:], atol=2e-5)
    line, line_far = (np.array([view.eye for view in line_views(each[0], each[1], 24)]) for each in (keys, far))
    np.testing.assert_allclose(line_far - away, line, atol=2e-5)
