"""One cache, several cameras: the same pictures as `Renderer`, and no recording for a second visitor."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import luxel
from luxel.methods import METHODS, Frame, Light, Method, make_params
from luxel.render.renderer import Renderer
from luxel.render.shared import Cache, CameraView
from luxel.scene.device import upload
from luxel.scene.model import Camera

SIZE = (48, 32)
AWAY = Camera((0.5, 0.3, 3.0), (0.0, -0.2, 0.0), fov=45.0)


def make_cache(method: str = "gibs", **settings: Any) -> Cache:
    return Cache(upload(luxel.load("cornell-box")), method, make_params(method, None, settings))


def test_it_shows_what_a_renderer_shows() -> None:
    settings = {"surfel_target": 2000}
    renderer = Renderer("cornell-box", "gibs", settings, size=SIZE)
    renderer.run(40)
    cache = make_cache("gibs", **settings)
    eye = CameraView(cache, SIZE)
    for _ in range(40):
        cache.advance()
        eye.look(renderer.camera)
    ours, theirs = eye.layers(), renderer.layers()
    # Seed, number and stillness of every frame are the same, so the pictures are, up to the order of sums.
    for name in ("albedo", "direct", "indirect"):
        difference = np.abs(getattr(ours, name) - getattr(theirs, name)).mean()
        assert difference < 1e-3 * getattr(theirs, name).mean()
    assert eye.still_frames == 39


def test_a_second_camera_of_the_same_size_records_nothing() -> None:
    cache = make_cache(surfel_target=2000)
    one, two = CameraView(cache, SIZE), CameraView(cache, SIZE)
    for _ in range(4):
        cache.advance()
        one.look(AWAY)
    recordings = cache.recordings
    for step in range(6):
        cache.advance()
        one.look(Camera((0.1 * step, 0.3, 3.0), (0.0, 0.0, 0.0), fov=45.0))
        two.look(AWAY)
    assert cache.recordings == recordings


def test_shifted_films_together_are_the_full_picture() -> None:
    """The albedo of a 2 x 2 mosaic is that of one film, pixel by pixel."""
    cache = make_cache("none")
    whole = CameraView(cache, SIZE)
    whole.look(AWAY)
    wanted, found = whole.layers().albedo, np.zeros((SIZE[1], SIZE[0], 3), np.float32)
    for row in range(2):
        for column in range(2):
            eye = CameraView(cache, (SIZE[0] // 2, SIZE[1] // 2))
            eye.look(AWAY, (2.0 * (column - 0.5) / SIZE[0], -2.0 * (row - 0.5) / SIZE[1]))
            found[row::2, column::2] = eye.layers().albedo
    assert (np.abs(found - wanted).max(axis=-1) > 1e-3).mean() < 0.005  # rounding may choose the other side of an edge


def test_looking_without_learning_leaves_the_cache_alone() -> None:
    cache = make_cache(surfel_target=2000)
    eye = CameraView(cache, SIZE)
    eye.look(AWAY, learn=False)
    assert cache.method.cache(cache.state)["surfel_count"] == 0
    eye.look(AWAY)
    assert cache.method.cache(cache.state)["surfel_count"] > 0


def test_means_start_anew_where_something_changed() -> None:
    cache = make_cache("path")
    eye = CameraView(cache, SIZE)
    for _ in range(5):
        cache.advance()
        eye.look(AWAY)
    assert eye.still_frames == 4
    eye.mark_changed()
    eye.look(AWAY)
    assert eye.still_frames == 0
    eye.look(Camera(AWAY.eye, AWAY.target, fov=50.0))
    assert eye.still_frames == 0


# ----------------------------------------------------------------------------------- a frame's number and seed


@dataclass
class Marks:
    updated: mi.UInt32
    observed: mi.UInt32


class Watch(Method):
    """Tells in its irradiance: frames since the update, the look's seed over its range, frames since observed."""

    @dataclass
    class Params:
        pass

    name = "watch"

    def build(self, scene, params, seed, *, workdir=None, progress=None):  # noqa: ANN001, ANN201
        return Marks(dr.opaque(mi.UInt32, 0), dr.opaque(mi.UInt32, 0))

    def update(self, scene: Any, state: Marks, frame: Frame) -> Marks:
        return Marks(mi.UInt32(frame.index), state.observed)

    def query(self, scene: Any, state: Marks, surface: Any) -> Light:
        return Light(mi.Color3f(0.0), mi.Color3f(0.0), mi.Float(1.0))

    def shade(self, scene: Any, state: Marks, screen: Any, frame: Frame, gbuffer: Any) -> tuple[Light, Any]:
        told = mi.Color3f(
            mi.Float(frame.index - state.updated), mi.Float(frame.seed >> 8), mi.Float(frame.index - state.observed)
        )
        return Light(told + dr.zeros(mi.Float, dr.width(gbuffer.lane)), mi.Color3f(0.0), mi.Float(1.0)), screen

    def observe(self, scene: Any, state: Marks, frame: Frame, gbuffer: Any, light: Light) -> Marks:
        return Marks(state.updated, mi.UInt32(frame.index))


@pytest.fixture
def watch() -> Iterator[None]:
    METHODS["watch"] = Watch()
    yield
    del METHODS["watch"]


def told(eye: CameraView) -> np.ndarray:
    return eye.layers().indirect[0, 0]


def test_a_frame_has_one_number_and_each_look_a_seed(watch: None) -> None:
    cache = make_cache("watch")
    one, two = CameraView(cache, SIZE), CameraView(cache, SIZE)
    for frame in range(5):
        cache.advance()
        if frame != 2:  # the world may go on without a look
            one.look(AWAY)
            two.look(AWAY)
            two.look(AWAY)
    assert told(one)[0] == told(two)[0] == 0.0
    assert told(two)[2] == 0.0  # the looks before it had the same number
    assert told(one)[1] != told(two)[1]
    alone = CameraView(make_cache("watch"), SIZE)
    for _ in range(5):
        alone.step(AWAY)
    assert tuple(told(alone)) == (0.0, told(one)[1], 1.0)


# ----------------------------------------------------------------------------------- recordings and constants


def test_a_flag_that_another_one_has_already_is_noticed() -> None:
    """The box has one-sided materials, so one flag is on: Dr.Jit itself overlooks a second one that comes on."""
    cache = make_cache("none")
    eye = CameraView(cache, SIZE)
    past = Camera((0.0, 0.0, 3.9), (10.0, 0.0, 3.9), fov=40.0)
    for _ in range(3):
        eye.step(past)
    assert not eye.layers().emission.any()
    data = luxel.load("cornell-box")
    data.sky = luxel.Sky((1.0, 2.0, 3.0))
    cache.scene.lights = upload(data).lights
    eye.step(past)
    np.testing.assert_allclose(eye.layers().emission[0, 0], (1.0, 2.0, 3.0), rtol=1e-6)
