"""One cache, several cameras: the same pictures as `Renderer`, and no recording for a second visitor."""

from __future__ import annotations

from typing import Any

import numpy as np

import luxel
from luxel.methods import make_params
from luxel.render.renderer import Renderer
from luxel.render.shared import Cache, Eye
from luxel.scene.device import upload
from luxel.scene.model import Camera

SIZE = (48, 32)
AWAY = Camera((0.5, 0.3, 3.0), (0.0, -0.2, 0.0), fov=45.0)


def make_cache(method: str = "gibs", **settings: Any) -> Cache:
    return Cache(upload(luxel.load("cornell-box")), method, make_params(method, None, settings))


def test_it_shows_what_a_renderer_shows() -> None:
    settings = {"surfel_target": 2000}
    renderer = Renderer("cornell-box", "gibs", settings, size=SIZE, device="cpu")
    renderer.run(40)
    cache = make_cache("gibs", **settings)
    eye = Eye(cache, SIZE)
    for _ in range(40):
        cache.advance()
        eye.look(renderer.camera)
    ours, theirs = eye.layers(), renderer.layers()
    np.testing.assert_allclose(ours.albedo, theirs.albedo, atol=1e-5)
    np.testing.assert_allclose(ours.indirect.mean(), theirs.indirect.mean(), rtol=0.03)
    np.testing.assert_allclose(ours.direct.mean(), theirs.direct.mean(), rtol=0.03)
    assert eye.still_frames == 39


def test_a_second_camera_of_the_same_size_records_nothing() -> None:
    cache = make_cache(surfel_target=2000)
    one, two = Eye(cache, SIZE), Eye(cache, SIZE)
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
    whole = Eye(cache, SIZE)
    whole.look(AWAY)
    wanted, found = whole.layers().albedo, np.zeros((SIZE[1], SIZE[0], 3), np.float32)
    for row in range(2):
        for column in range(2):
            eye = Eye(cache, (SIZE[0] // 2, SIZE[1] // 2))
            eye.look(AWAY, (2.0 * (column - 0.5) / SIZE[0], -2.0 * (row - 0.5) / SIZE[1]))
            found[row::2, column::2] = eye.layers().albedo
    assert (np.abs(found - wanted).max(axis=-1) > 1e-3).mean() < 0.005  # rounding may choose the other side of an edge


def test_looking_without_learning_leaves_the_cache_alone() -> None:
    cache = make_cache(surfel_target=2000)
    eye = Eye(cache, SIZE)
    eye.look(AWAY, learn=False)
    assert cache.method.cache(cache.state)["surfel_count"] == 0
    eye.look(AWAY)
    assert cache.method.cache(cache.state)["surfel_count"] > 0


def test_means_start_anew_where_something_changed() -> None:
    cache = make_cache("path")
    eye = Eye(cache, SIZE)
    for _ in range(5):
        cache.advance()
        eye.look(AWAY)
    assert eye.still_frames == 4
    eye.mark_changed()
    eye.look(AWAY)
    assert eye.still_frames == 0
    eye.look(Camera(AWAY.eye, AWAY.target, fov=50.0))
    assert eye.still_frames == 0
