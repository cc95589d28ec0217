"""Probes that sleep, wake, scroll with the camera, and are placed where nobody sees."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.methods.ddgi.activity import ViewSamples, request_placements
from luxel.methods.ddgi.blend import blend
from luxel.methods.ddgi.state import ASLEEP, AWAKE
from luxel.render.renderer import Renderer
from luxel.scene.library.shapes import box, framed_hole, merge, quad
from luxel.scene.model import Camera, Light, Material, Object, SceneData


def field(length: float = 8.0, sky: bool = True) -> SceneData:
    """A long floor, lamps at both ends; nothing above."""
    floor = quad((-length, 0, 4), (length, 0, 4), (length, 0, -4), (-length, 0, -4), 0)
    lamps = [Light("point", (9.0, 9.0, 9.0), (side * (length - 2), 2.0, 0.0)) for side in (-1.0, 1.0)]
    camera = Camera((-length + 1, 2.0, 3.0), (-length + 2.5, 0.0, 0.0), fov=50.0)
    return SceneData("field", [Object("floor", [floor])], [Material()], lamps, [camera])


def status(renderer: Renderer) -> np.ndarray:
    return np.array(renderer.state.probes.status)


def places(renderer: Renderer) -> np.ndarray:
    return np.array(renderer.state.probes.p).T


# --------------------------------------------------------------------------------------------- sleep


TALL = "0,4,0 size 15,8,6 probes 6,5,3"


def test_far_from_everything_seen_probes_sleep_and_wake() -> None:
    params = {"boxes": TALL, "extra_probes": 0, "sleep_after": 6, "num_samples_per_probe": 16}
    renderer = Renderer(field(), "ddgi", params, size=(16, 16), seed=1)
    renderer.run(6)
    assert (status(renderer) == AWAKE).all()
    renderer.run(12)
    high = places(renderer)[:, 1] > 5.0
    assert (status(renderer)[high] == ASLEEP).all(), "nobody reads those under the sky"
    assert (status(renderer)[places(renderer)[:, 1] < 1.0] == AWAKE).any()
    assert renderer.cache()["asleep_probes"] == (status(renderer) == ASLEEP).sum()
    # A shelf up there that only this camera sees: a look at it wakes its probes.
    before = status(renderer).copy()
    shelf = Camera((0.0, 7.9, 0.0), (0.0, 0.0, 0.01), fov=60.0)
    for _ in range(2):
        renderer.step(camera=shelf)
    assert (status(renderer)[before == AWAKE] == AWAKE).sum() >= 0.8 * (before == AWAKE).sum()


def test_a_look_wakes_within_two_frames() -> None:
    params = {"boxes": TALL, "extra_probes": 0, "sleep_after": 6, "num_samples_per_probe": 16}
    data = field()
    post = box((6.0, 0.0, -0.5), (6.4, 7.0, 0.5), 0)
    data.objects.append(Object("post", [post]))
    renderer = Renderer(data, "ddgi", params, size=(16, 16), seed=1)
    renderer.run(4)
    state = renderer.state
    # Put all to sleep by hand, long unread.
    for name, value in (("status", ASLEEP), ("unread", 1000), ("age", 1000)):
        array = dr.full(mi.UInt32, value, state.settings.total)
        dr.make_opaque(array)
        setattr(state.probes, name, array)
    at_post = Camera((3.0, 6.0, 0.1), (6.0, 6.0, 0.0), fov=20.0)
    for _ in range(2):
        renderer.step(camera=at_post)
    near = (np.abs(places(renderer) - (6.0, 6.0, 0.0)) < (2.9, 1.9, 2.9)).all(axis=1)
    assert near.any() and (status(renderer)[near] == AWAKE).all()


def test_light_that_changed_while_it_slept_is_forgotten_soon_after() -> None:
    params = {
        "boxes": "0,1,0 size 15,3,6 probes 9,3,4",
        "extra_probes": 0,
        "sleep_after": 4,
        "num_samples_per_probe": 16,
    }
    renderer = Renderer(field(), "ddgi", params, size=(16, 16), seed=1)
    renderer.run(40)
    everyone = np.array([[-5.0, 0.5, 0.5]]), np.array([[0.0, -1.0, 0.0]])
    bright = renderer.irradiance_at(*everyone).mean()
    assert bright > 1e-3
    state = renderer.state
    state.probes.status = dr.full(mi.UInt32, ASLEEP, state.settings.total)
    dr.make_opaque(state.probes.status)
    renderer.set_light_scale(0.0)
    for _ in range(16):
        renderer.step()
    assert renderer.irradiance_at(*everyone).mean() < 0.1 * bright


# --------------------------------------------------------------------------------------------- scrolling


SCROLL = {
    "probe_box_size": (6.0, 4.0, 6.0), "num_probes_x": 7, "num_probes_y": 5, "num_probes_z": 7,
    "follow_camera": True, "num_samples_per_probe": 32,
}  # fmt: skip


def eye(x: float) -> Camera:
    return Camera((x, 2.0, 2.0), (x, 0.0, 0.0), fov=70.0)


def test_a_scrolled_box_answers_like_a_fresh_one() -> None:
    travelled = Renderer(field(), "ddgi", SCROLL, size=(16, 16), seed=1, camera=eye(-6.0))
    travelled.run(8)
    for x in np.linspace(-6.0, 6.0, 25):
        travelled.step(camera=eye(float(x)))
    travelled.run(60)
    fresh = Renderer(field(), "ddgi", SCROLL, size=(16, 16), seed=1, camera=eye(6.0))
    fresh.run(80)
    x = np.linspace(4.0, 7.5, 8)
    points = np.stack([x, 0 * x + 1.0, 0 * x], axis=1)
    down = np.tile([0.0, -1.0, 0.0], (8, 1))
    found, expected = travelled.irradiance_at(points, down), fresh.irradiance_at(points, down)
    assert expected.mean() > 0.05
    np.testing.assert_allclose(found, expected, rtol=0.1, atol=0.02 * expected.mean())
    # Every probe is within the window around the camera, none was left behind.
    low = np.array(travelled.state.volumes[0].low).ravel()
    assert low[0] >= 4 and np.abs(places(travelled)[:, 0] - 6.0).max() < 5.0


@pytest.mark.parametrize("count", [2, 4, 6, 7])
def test_the_camera_stays_in_the_middle_of_its_box(count: int) -> None:
    settings = {**SCROLL, "num_probes_x": count, "probe_box_size": (float(count - 1), 4.0, 6.0)}
    renderer = Renderer(field(), "ddgi", settings, size=(8, 8), seed=1, camera=eye(-6.0))
    off = []
    for x in np.arange(-5.0, 5.0, 0.37):
        renderer.step(camera=eye(float(x)))
        p = places(renderer)[:, 0]
        off.append(x - 0.5 * (p.min() + p.max()))
    assert np.abs(off).max() < 0.75, "cells of 1 m: never more than half a cell and the slack off the middle"


def test_entering_planes_are_cleared_and_the_rest_is_kept() -> None:
    renderer = Renderer(field(), "ddgi", SCROLL, size=(16, 16), seed=1, camera=eye(0.0))
    renderer.run(12)
    count = np.array(renderer.state.irradiance.count).reshape(-1, 64)
    before = places(renderer)
    assert count.min() >= 1
    renderer.step(camera=eye(1.3))
    entered = np.abs(places(renderer) - before).max(axis=1) > 0.5
    assert entered.sum() == 5 * 7
    rows = np.array(renderer.state.rows).reshape(-1, 4)
    assert (rows[entered, 3] == 0.0).all(), "who knows nothing is not asked"
    np.testing.assert_allclose(rows[:, :3], places(renderer), atol=1e-6)
    renderer.step(camera=eye(1.3))
    after = np.array(renderer.state.irradiance.count).reshape(-1, 64)
    assert (after[entered] == 1).all(), "its first rays count whole"
    assert (after[~entered] > 1).all()


def test_light_switched_off_while_out_of_the_box_is_not_remembered() -> None:
    renderer = Renderer(field(), "ddgi", SCROLL, size=(16, 16), seed=1, camera=eye(-6.0))
    renderer.run(30)
    where = np.array([[-6.0, 1.0, 0.0]]), np.array([[0.0, -1.0, 0.0]])
    bright = renderer.irradiance_at(*where).mean()
    assert bright > 0.05
    for x in np.linspace(-6.0, 6.0, 13):
        renderer.step(camera=eye(float(x)))
    renderer.set_light_scale(0.0)
    for x in np.linspace(6.0, -6.0, 13):
        renderer.step(camera=eye(float(x)))
    assert renderer.irradiance_at(*where).mean() < 0.02 * bright


def test_who_has_moved_forgets_its_old_place(bare, build, lit, rays, frame) -> None:
    state = build(bare, boxes="0,0,0 size 2,2,2 probes 3,3,3", extra_probes=0)
    state = lit(state, np.full((27, 3), 5.0))
    state = replace(state, depth=replace(state.depth, weight=state.depth.weight + 7.0))
    age = np.full(27, 9, np.uint32)
    age[4] = 0
    state = replace(state, probes=replace(state.probes, age=mi.UInt32(age)))
    found = blend(bare, state, rays(state, radiance=0.0, distance=1e30), frame)
    light = np.array(found.irradiance.mean)[0].reshape(27, 64)
    weights = np.array(found.depth.weight).reshape(27, 256)
    assert not light[4].any() and not weights[4].any()
    assert np.delete(light, 4, axis=0).all() and np.delete(weights, 4, axis=0).all()


# --------------------------------------------------------------------------------------------- held back


def closet() -> SceneData:
    """A lit room of 4 m, and behind its wall a closet of 0.6 m with a small door: no probe of the grid is in it."""
    room = box((-2, -2, -2), (2, 2, 2), 0, inward=True, sides=("-x", "+x", "-y", "+y", "+z"))
    outer = [(-2, -2, -2), (2, -2, -2), (2, 2, -2), (-2, 2, -2)]
    hole = [(0.35, 0.35, -2), (0.85, 0.35, -2), (0.85, 0.85, -2), (0.35, 0.85, -2)]
    wall = framed_hole(outer, hole, 0)
    lo, hi = (0.3, 0.3, -2.7), (0.9, 0.9, -2.02)
    inside = box(lo, hi, 0, inward=True, sides=("-x", "+x", "-y", "+y", "-z"))
    front = framed_hole(
        [(0.9, 0.3, -2.02), (0.3, 0.3, -2.02), (0.3, 0.9, -2.02), (0.9, 0.9, -2.02)],
        [(0.85, 0.35, -2.02), (0.35, 0.35, -2.02), (0.35, 0.85, -2.02), (0.85, 0.85, -2.02)],
        0,
    )
    lamp = Light("point", (6.0, 6.0, 6.0), (0.6, 0.6, 1.0))
    camera = Camera((0.6, 0.6, -0.5), (0.6, 0.6, -2.7), fov=35.0)
    grey = Material(base_color=(0.6, 0.6, 0.6))
    return SceneData("closet", [Object("all", [merge([room, wall, inside, front])])], [grey], [lamp], [camera])


CLOSET = {"boxes": "0,0,-0.4 size 5.2,5.2,5.6 probes 5,5,5", "num_samples_per_probe": 32}
SIDES = np.array([[0.31, 0.6, -2.4], [0.89, 0.62, -2.5], [0.6, 0.31, -2.45]])
INTO = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def look_in(renderer: Renderer, frames: int) -> None:
    """Look at the closet's sides from within it."""
    views = [Camera((0.6, 0.6, -2.1), (x, y, -2.5), fov=90.0) for x, y in ((0.3, 0.6), (0.9, 0.6), (0.6, 0.3))]
    for index in range(frames):
        renderer.step(camera=views[index % 3])


def test_places_that_nobody_sees_get_a_probe_and_the_right_light() -> None:
    truth = Renderer(closet(), "path", {"samples": 256}, size=(8, 8), seed=3)
    truth.step()
    expected = truth.irradiance_at(SIDES, INTO).mean()
    renderer = Renderer(closet(), "ddgi", CLOSET, size=(32, 32), seed=1)
    look_in(renderer, 60)
    assert renderer.cache()["extra_probes"] > 0
    extra = places(renderer)[125 : 125 + int(renderer.cache()["extra_probes"])]
    assert np.isfinite(extra).all() and (np.abs(extra - (0, 0, -0.4)) < (2.7, 2.7, 2.9)).all()
    found = renderer.irradiance_at(SIDES, INTO)
    assert (found > 0.0).all()
    assert expected > 1e-3 and 0.5 * expected < found.mean() < 2.0 * expected


def test_a_probe_held_back_that_is_looked_at_stays_awake_and_follows_the_light() -> None:
    renderer = Renderer(closet(), "ddgi", {**CLOSET, "sleep_after": 8}, size=(32, 32), seed=1)
    look_in(renderer, 40)
    count = int(renderer.cache()["extra_probes"])
    assert count > 0
    assert (status(renderer)[125 : 125 + count] == AWAKE).any(), "they are read in every frame"
    before = renderer.irradiance_at(SIDES, INTO).mean()
    renderer.set_light_scale(0.0)
    look_in(renderer, 120)
    assert renderer.irradiance_at(SIDES, INTO).mean() < 0.05 * before


def test_no_more_than_are_held_back_and_a_warning() -> None:
    renderer = Renderer(closet(), "ddgi", {**CLOSET, "extra_probes": 1}, size=(32, 32), seed=1)
    look_in(renderer, 20)
    assert renderer.cache()["extra_probes"] == 1
    assert any("extra_probes" in said for said in renderer.method.warnings(renderer.state))


def test_boxes_that_move_hold_none_back() -> None:
    renderer = Renderer(field(), "ddgi", SCROLL, size=(8, 8), seed=1)
    assert renderer.state.settings.extra_count == 0


def test_boxes_apart_do_not_take_each_others_probes() -> None:
    """Those held back serve the last box: what the view shows in the other one must not use them up."""
    data = closet()
    # The closet is in the first, finer box; the last one stands where nothing is unseen.
    boxes = "0,0,-0.4 size 5.2,5.2,5.6 probes 5,5,5; 20,0,0 size 8,8,8 probes 3,3,3"
    renderer = Renderer(data, "ddgi", {"boxes": boxes, "num_samples_per_probe": 32}, size=(32, 32), seed=1)
    renderer.run(24)
    assert renderer.cache()["extra_probes"] == 0
    alone = Renderer(data, "ddgi", CLOSET, size=(32, 32), seed=1)
    alone.run(24)
    assert alone.cache()["extra_probes"] > 0, "the same view does wish for some"


def test_two_views_of_one_frame_may_both_wish() -> None:
    renderer = Renderer(closet(), "ddgi", CLOSET, size=(32, 32), seed=1, freeze=False)
    renderer.run(1)
    wanted = np.array(renderer.state.wishes.wanted)
    p = np.array(renderer.state.wishes.p).T
    nothing = ViewSamples(*(dr.zeros(kind, 64) for kind in (mi.Point3f, mi.Normal3f, mi.Vector3f, mi.Bool, mi.Bool)))
    again = request_placements(renderer.state, nothing)
    assert wanted.any()
    np.testing.assert_array_equal(np.array(again.wanted), wanted)
    np.testing.assert_array_equal(np.array(again.p).T[wanted], p[wanted])
