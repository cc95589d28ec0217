"""Balls over the image: where they stand, hidden by what is before them, in their colours."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from luxel.errors import LuxelError
from luxel.inspect.looks import Shot, take_shot
from luxel.inspect.looks.spheres import _list_by_tile, paint_spheres
from luxel.kernels.camera import camera_axes, make_pinhole
from luxel.kernels.film import Film
from luxel.render.renderer import Renderer
from luxel.scene.model import Camera

SIZE = 96


@pytest.fixture(scope="module")
def shot() -> Shot:
    made = Renderer("cornell-box", "none", size=(SIZE, SIZE), seed=1)
    made.run(1)
    return take_shot(made)


@pytest.fixture(scope="module")
def ground() -> np.ndarray:
    return np.full((SIZE, SIZE, 3), 0.5, np.float32)


def balls(p: np.ndarray, radius: float, colors: np.ndarray) -> dict[str, Any]:
    return {"p": np.asarray(p, np.float32), "radius": radius, "atlas": np.asarray(colors, np.float32)[:, None, None]}


def at_pixel(shot: Shot, column: int, row: int, distance: float) -> np.ndarray:
    """Return the world point (3,) at `distance` metres behind a pixel's middle."""
    camera = shot.scene.host.data.cameras[0]
    eye, right, up, forward = camera_axes(camera)
    half = np.tan(np.deg2rad(camera.fov) / 2.0)
    x, y = (column + 0.5) * 2.0 / SIZE - 1.0, 1.0 - (row + 0.5) * 2.0 / SIZE
    way = forward + half * (x * right + y * up)
    return eye + distance * way / np.linalg.norm(way)


def test_a_ball_stands_where_it_should_and_is_shaded(shot: Shot, ground: np.ndarray) -> None:
    color = np.array([[0.2, 0.9, 0.4]])
    ball = balls(at_pixel(shot, 30, 40, 2.0)[None], 0.05, color)
    drawn = paint_spheres(shot, ball, ground)
    assert drawn.shape == (SIZE, SIZE, 3) and drawn.dtype == np.float32
    changed = np.abs(drawn - ground).max(axis=2) > 1e-4
    rows, columns = np.nonzero(changed)
    assert rows.mean() == pytest.approx(40, abs=0.6) and columns.mean() == pytest.approx(30, abs=0.6)
    across = 0.05 / 2.0 / np.tan(np.deg2rad(shot.scene.host.data.cameras[0].fov) / 2.0) * SIZE
    assert changed.sum() == pytest.approx(np.pi * (across / 2.0) ** 2, rel=0.35)
    np.testing.assert_allclose(drawn[40, 30], color[0], atol=0.03)
    assert drawn[changed].sum(axis=1).min() < 0.85 * color.sum()
    # Twice the radius: about four times the pixels.
    twice = np.abs(paint_spheres(shot, ball, ground, radius=0.1) - ground).max(axis=2) > 1e-4
    assert twice.sum() == pytest.approx(4 * changed.sum(), rel=0.25)


def test_paint_shows_colours_as_they_are(shot: Shot, ground: np.ndarray) -> None:
    """All but the outline has the painted colour itself: a scale can be read off it."""
    ball = balls(at_pixel(shot, 48, 48, 2.0)[None], 0.3, np.array([[0.25, 0.0, 0.0]]))
    drawn = paint_spheres(shot, ball, ground, paint=lambda values: np.repeat(2.0 * values[..., :1], 3, axis=-1) * 0.9)
    changed = np.abs(drawn - ground).max(axis=2) > 1e-4
    exact = np.abs(drawn - 0.45).max(axis=2) < 1e-4
    assert exact.sum() > 0.8 * changed.sum() and drawn[changed].min() < 0.1


def test_the_scene_and_nearer_balls_hide_it(shot: Shot, ground: np.ndarray) -> None:
    colors = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], np.float32)
    near, far = at_pixel(shot, 48, 48, 2.0), at_pixel(shot, 48, 48, 2.5)
    for p, colored in ((np.array([near, far]), colors), (np.array([far, near]), colors[::-1])):
        np.testing.assert_allclose(paint_spheres(shot, balls(p, 0.05, colored), ground)[48, 48], colors[0], atol=0.03)
    behind = balls(at_pixel(shot, 48, 48, 100.0)[None], 5.0, colors[:1])
    np.testing.assert_array_equal(paint_spheres(shot, behind, ground)[48, 48], ground[48, 48])
    nothing = balls(np.zeros((0, 3)), 0.1, np.zeros((0, 3)))
    np.testing.assert_array_equal(paint_spheres(shot, nothing, ground), ground)


def test_the_atlas_is_turned_to_the_world(shot: Shot, ground: np.ndarray) -> None:
    """A ball that is red where it faces +Y is red above and not below."""
    resolution = 32
    line = (np.arange(resolution) + 0.5) * 2.0 / resolution - 1.0
    u, v = np.meshgrid(line, line)
    z = 1.0 - np.abs(u) - np.abs(v)
    up = v - np.maximum(-z, 0.0) * np.sign(v)  # the sign of a direction's y
    atlas = np.where(up[..., None] > 0.0, (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)).astype(np.float32)
    data = {"p": at_pixel(shot, 48, 48, 2.0)[None].astype(np.float32), "radius": 0.2, "atlas": atlas[None]}
    drawn = paint_spheres(shot, data, ground)
    assert drawn[44, 48, 0] > 0.5 > drawn[44, 48, 2] and drawn[52, 48, 2] > 0.5 > drawn[52, 48, 0]


@pytest.mark.parametrize("width", [0.0, 2.5])
@pytest.mark.parametrize("radius", [0.02, 0.3, 1.5])
def test_every_tile_lists_the_balls_that_its_rays_meet(radius: float, width: float) -> None:
    """Against rays through every fourth pixel and every ball, balls around and behind the eye included."""
    film = Film(90, 50)
    camera = Camera((0.3, 0.2, 1.0), (0.1, -0.1, -1.0), fov=80.0, orthographic_width=width)
    pinhole = make_pinhole(camera, film.width, film.height)
    centers = np.random.default_rng(3).uniform(-2.0, 2.0, (300, 3))
    lists = _list_by_tile(centers, radius, film, pinhole)
    starts, items = np.array(lists.starts), np.array(lists.items)
    eye, right, up, forward, across, upwards = (np.array(v).reshape(3) for v in vars(pinhole).values())
    met = 0
    for row in range(0, film.height, 4):
        for column in range(0, film.width, 4):
            x, y = (column + 0.5) * 2.0 / film.width - 1.0, 1.0 - (row + 0.5) * 2.0 / film.height
            way = forward + x * right + y * up
            way = way / np.linalg.norm(way)
            away = centers - eye - x * across - y * upwards
            along = away @ way
            apart = np.linalg.norm(away - along[:, None] * way, axis=1)
            hit = np.nonzero((apart < 0.999 * radius) & (along > 0.0))[0]
            tile = (row // 16) * film.tiles_x + column // 16
            assert set(hit) <= set(items[starts[tile] : starts[tile + 1]])
            met += len(hit)
    assert met > 5
    assert len(items) < 0.9 * len(centers) * len(starts) or radius > 1.0


def test_what_cannot_be_drawn_is_refused(shot: Shot, ground: np.ndarray) -> None:
    for radius in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(LuxelError, match="radius"):
            paint_spheres(shot, balls(np.zeros((1, 3)), 0.1, np.zeros((1, 3))), ground, radius=radius)


def test_the_eye_in_a_ball_sees_others(shot: Shot, ground: np.ndarray) -> None:
    """A ball around the eye hides nothing: its front is behind the camera."""
    eye = np.array(shot.camera.eye).reshape(3)
    p = np.stack([eye, at_pixel(shot, 48, 48, 2.0)])
    drawn = paint_spheres(shot, balls(p, 0.3, np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])), ground)
    np.testing.assert_allclose(drawn[48, 48], (0.0, 0.0, 1.0), atol=0.03)
    assert np.isfinite(drawn).all()
