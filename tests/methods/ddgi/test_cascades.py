"""Cascades that luxel chooses by itself: when, where, how fine, and who guides them."""

from __future__ import annotations

import math
from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.methods.base import Frame
from luxel.methods.ddgi.activity import ViewSamples
from luxel.methods.ddgi.cascades import ANGLE, LEVELS, guide, plan_probes, view_distance
from luxel.methods.ddgi.params import MAJERCIK, ROHACEK, DdgiParams
from luxel.render.renderer import Renderer
from luxel.scene import load
from luxel.scene.device import upload
from luxel.scene.library.shapes import box
from luxel.scene.model import Camera, Light, Material, Object, SceneData

SMALL = {"probe_target": 60, "num_samples_per_probe": 16}


def hall(length: float = 60.0) -> SceneData:
    """A long bare hall, 4 m wide and high; the camera looks at its end wall from 2 m."""
    shell = box((0.0, 0.0, 0.0), (length, 4.0, 4.0), 0, inward=True)
    lamps = [Light("point", (20.0, 20.0, 20.0), (x, 3.5, 2.0)) for x in np.arange(2.0, length, 8.0)]
    return SceneData("hall", [Object("shell", [shell])], [Material()], lamps, [at(2.0, 0.0)])


def at(x: float, towards: float) -> Camera:
    return Camera((x, 2.0, 2.0), (towards, 2.0, 2.0), fov=40.0)


def guided(scene: SceneData | str, **settings: object) -> int:
    loaded = upload(load(scene) if isinstance(scene, str) else scene)
    return plan_probes(loaded, DdgiParams(**settings)).guided  # type: ignore[arg-type]


def middles(renderer: Renderer) -> list[np.ndarray]:
    """Return the middle of each box that goes with the view."""
    state = renderer.state
    found = []
    for volume in state.volumes[: state.settings.guided]:
        low = np.array(volume.low).ravel() + 0.5 * (np.array([volume.nx, volume.ny, volume.nz]) - 1)
        found.append(np.array(volume.origin).ravel() + low * float(np.array(volume.side)[0]))
    return found


def side(renderer: Renderer) -> float:
    return float(np.array(renderer.state.volumes[0].side)[0])


def test_they_are_chosen_where_the_fitted_box_is_too_coarse() -> None:
    assert guided(hall(), probe_target=60) == LEVELS
    assert guided(hall(), probe_target=20000) == 0, "cells of 0.4 m, as fine as the view needs"
    for name in ("cornell-box", "two-rooms", "atrium", "attic", "moving", "opening"):
        assert guided(name) == 0, f"{name}: a view of a whole room needs no more than one box"


@pytest.mark.parametrize(
    "said",
    [
        MAJERCIK, ROHACEK, {"cascades": 1}, {"cascades": 2}, {"follow_camera": True}, {"num_probes_x": 8},
        {"probe_box_size": (8.0, 4.0, 4.0)}, {"boxes": "2,2,2 size 4,4,4 probes 4,4,4"},
    ],
)  # fmt: skip
def test_whoever_says_where_probes_stand_gets_no_others(said: dict) -> None:
    assert guided(hall(), **{"probe_target": 60, **said}) == 0


def test_the_distance_of_a_view_is_that_of_what_it_shows() -> None:
    scene = upload(hall())
    # A wall at 2 m, over the picture's square: the mean of the logarithm of 2 sqrt(1 + x^2 + y^2).
    half = math.tan(math.radians(20.0))
    x, y = np.meshgrid(*(np.linspace(-half, half, 401),) * 2)
    expected = math.exp(np.log(2.0 * np.sqrt(1.0 + x**2 + y**2)).mean())
    assert view_distance(scene) == pytest.approx(expected, rel=0.05)


def test_the_first_view_says_how_fine_they_are_and_where() -> None:
    near = Renderer(hall(), "ddgi", SMALL, size=(16, 16), seed=1)
    near.run(3)
    assert side(near) == pytest.approx(ANGLE * 2.05, rel=0.15)
    eye = 30.0
    far = Renderer(hall(), "ddgi", SMALL, size=(16, 16), seed=1, camera=at(eye, 60.0))
    far.run(3)
    assert side(far) > 1.5 * side(near)
    for middle in middles(far):
        assert middle[0] > eye, "ahead of the eye"
        assert abs(middle[2] - 2.0) < 2.0


def test_they_go_with_the_camera_and_nothing_is_recorded_anew() -> None:
    renderer = Renderer(hall(), "ddgi", SMALL, size=(16, 16), seed=1, camera=at(10.0, 60.0))
    renderer.run(8)
    for x in (9.9, 10.0):
        renderer.step(camera=at(x, 60.0))
    recordings, start = renderer.compilations, middles(renderer)
    for x in np.arange(10.0, 30.0, 0.5):
        renderer.step(camera=at(float(x), 60.0))
    assert renderer.compilations == recordings
    for before, after in zip(start, middles(renderer), strict=True):
        assert after[0] - before[0] == pytest.approx(19.5, abs=2.0)
    renderer.run(24)
    light = renderer.irradiance_at(np.array([[34.0, 0.0, 2.0]]), np.array([[0.0, 1.0, 0.0]]))
    assert np.isfinite(light).all() and light.min() > 0.0


def test_a_view_at_rest_moves_nothing() -> None:
    renderer = Renderer(hall(), "ddgi", SMALL, size=(64, 64), seed=1, camera=at(10.0, 60.0))
    renderer.run(4)
    start = np.array(renderer.state.probes.age).copy()
    where = middles(renderer)
    renderer.run(24)
    np.testing.assert_array_equal(np.stack(where), np.stack(middles(renderer)))
    assert (np.array(renderer.state.probes.age) > start).any()


def test_of_several_views_of_a_frame_the_first_one_guides() -> None:
    renderer = Renderer(hall(), "ddgi", SMALL, size=(16, 16), seed=1, camera=at(10.0, 60.0))
    renderer.run(4)
    state = renderer.state

    def look(eye: float, index: int, state):
        frame = Frame(mi.UInt32(index), mi.UInt32(0), mi.Bool(True))
        p = mi.Point3f(mi.Float([eye + 4.0, eye + 6.0]), 2.0, 2.0)
        nothing = mi.Bool([False, False])
        view = ViewSamples(p, mi.Normal3f(-1.0, 0.0, 0.0), mi.Vector3f(-1.0, 0.0, 0.0), nothing, ~nothing)
        volumes, after, entering, probes = guide(renderer.scene, state, frame, mi.Point3f(eye, 2.0, 2.0), view)
        return replace(state, volumes=volumes, guide=after, probes=probes), bool(dr.any(entering))

    state, moved = look(20.0, 50, state)
    assert moved
    state, moved = look(40.0, 50, state)
    assert not moved, "another view of the same frame"
    state, moved = look(40.0, 51, state)
    assert moved


def test_new_dials_keep_what_the_cascades_have_learned() -> None:
    renderer = Renderer(hall(), "ddgi", SMALL, size=(16, 16), seed=1, camera=at(10.0, 60.0))
    renderer.run(12)
    assert renderer.set_params(normal_bias=0.2)
    renderer.run(2)
    assert np.array(renderer.state.probes.age).max() > 10


def test_a_state_comes_back_from_its_file(tmp_path) -> None:
    renderer = Renderer(hall(), "ddgi", SMALL, size=(16, 16), seed=1, camera=at(10.0, 60.0))
    renderer.run(12)
    renderer.method.save(renderer.state, tmp_path / "probes.npz")
    points, up = np.array([[14.0, 0.0, 2.0], [40.0, 0.0, 1.0]]), np.tile([0.0, 1.0, 0.0], (2, 1))
    expected = renderer.irradiance_at(points, up)
    other = Renderer(hall(), "ddgi", SMALL, size=(16, 16), seed=1, camera=at(10.0, 60.0))
    other.state = other.method.load(other.scene, other.params, tmp_path / "probes.npz")
    np.testing.assert_allclose(other.irradiance_at(points, up), expected, rtol=1e-5)


@pytest.mark.parametrize("swap", [False, True])
def test_a_state_is_read_for_a_camera_that_would_choose_other_boxes(tmp_path, swap: bool) -> None:
    """One close to the floor wants cascades, one that looks along the hall does not: both find what is saved."""
    fine, coarse = hall(8.0), hall(8.0)
    fine.cameras = [Camera((4.0, 0.3, 2.0), (4.2, 0.0, 2.0), fov=40.0)]
    coarse.cameras = [at(0.5, 8.0)]
    dials = {**SMALL, "probe_target": 600}
    first, second = (coarse, fine) if swap else (fine, coarse)
    writer = Renderer(first, "ddgi", dials, size=(16, 16), seed=1)
    writer.run(4)
    writer.method.save(writer.state, tmp_path / "probes.npz")
    reader = Renderer(second, "ddgi", dials, size=(16, 16), seed=1)
    assert (writer.state.settings.guided, reader.state.settings.guided) == ((0, LEVELS) if swap else (LEVELS, 0))
    points, up = np.array([[6.0, 0.5, 2.0], [4.2, 0.0, 2.0]]), np.tile([0.0, 1.0, 0.0], (2, 1))
    reader.state = reader.method.load(reader.scene, reader.params, tmp_path / "probes.npz")
    np.testing.assert_allclose(reader.irradiance_at(points, up), writer.irradiance_at(points, up), rtol=1e-5)
    reader.run(2)


def test_light_that_goes_out_is_forgotten_while_they_travel() -> None:
    renderer = Renderer(hall(), "ddgi", SMALL, size=(16, 16), seed=1, camera=at(10.0, 60.0))
    renderer.run(24)
    # Who is not asked sleeps and keeps what it knew: these places the camera sees all the way.
    points, up = np.array([[18.0, 1.0, 0.0], [24.0, 1.0, 0.0]]), np.tile([0.0, 0.0, 1.0], (2, 1))
    bright = renderer.irradiance_at(points, up)
    renderer.set_light_scale(0.0)
    for x in np.linspace(10.0, 14.0, 60):
        renderer.step(camera=at(float(x), 60.0))
    assert (renderer.irradiance_at(points, up) < 0.04 * bright).all()


def test_twice_the_light_is_twice_the_answer() -> None:
    found = []
    for scale in (1.0, 2.0):
        renderer = Renderer(hall(), "ddgi", SMALL, size=(16, 16), seed=1, camera=at(10.0, 60.0))
        renderer.set_light_scale(scale)
        renderer.run(12)
        found.append(renderer.irradiance_at(np.array([[14.0, 0.0, 2.0]]), np.array([[0.0, 1.0, 0.0]])))
    np.testing.assert_allclose(found[1], 2.0 * found[0], rtol=0.02)
