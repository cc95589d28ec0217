"""Probes over the image: where they stand, hidden by what is before them, in the colours of their state."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from luxel.errors import LuxelError
from luxel.kernels.camera import camera_axes
from luxel.kernels.surface import free_surface
from luxel.methods.base import View
from luxel.methods.ddgi.query import query_probes
from luxel.render.probe_pictures import RAMP, draw_probes, draw_weights, heat
from luxel.render.renderer import Renderer
from luxel.render.tonemap import auto_exposure, to_display

SIZE = 96


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    params = {"probe_target": 300, "extra_probes": 8, "num_samples_per_probe": 32}
    made = Renderer("cornell-box", "ddgi", params, size=(SIZE, SIZE), seed=1)
    made.run(30)
    return made


def plain(renderer: Renderer) -> np.ndarray:
    image = renderer.image()
    return to_display(image, auto_exposure(image))


def show(renderer: Renderer, monkeypatch: pytest.MonkeyPatch, **data: object) -> None:
    """Let the method have one view of spheres, called `made`."""
    monkeypatch.setattr(type(renderer.method), "views", lambda *_: {"made": View("spheres", dict(data))})


def at_pixel(renderer: Renderer, column: int, row: int, distance: float) -> np.ndarray:
    """Return the world point (3,) at `distance` metres behind a pixel's middle."""
    eye, right, up, forward = camera_axes(renderer.camera)
    half = np.tan(np.deg2rad(renderer.camera.fov) / 2.0)
    x, y = (column + 0.5) * 2.0 / SIZE - 1.0, 1.0 - (row + 0.5) * 2.0 / SIZE
    way = forward + half * (x * right + y * up)
    return eye + distance * way / np.linalg.norm(way)


def test_a_sphere_stands_where_it_should_and_is_shaded(renderer: Renderer, monkeypatch: pytest.MonkeyPatch) -> None:
    point = at_pixel(renderer, 30, 40, 2.0)
    color = np.array([[0.2, 0.9, 0.4]], np.float32)
    show(renderer, monkeypatch, p=point[None], radius=0.05, color=color, atlas=color[:, None, None])
    drawn, before = draw_probes(renderer, "made"), plain(renderer)
    assert drawn.shape == (SIZE, SIZE, 3) and drawn.dtype == np.float32
    changed = np.abs(drawn - before).max(axis=2) > 1e-4
    rows, columns = np.nonzero(changed)
    assert rows.mean() == pytest.approx(40, abs=0.6) and columns.mean() == pytest.approx(30, abs=0.6)
    half = np.tan(np.deg2rad(renderer.camera.fov) / 2.0)
    across = 0.05 / 2.0 / half * SIZE
    assert changed.sum() == pytest.approx(np.pi * (across / 2.0) ** 2, rel=0.35)
    np.testing.assert_allclose(drawn[40, 30], color[0], atol=0.03)
    assert drawn[changed].sum(axis=1).min() < 0.85 * color.sum()
    # Twice the radius: about four times the pixels.
    twice = np.abs(draw_probes(renderer, "made", radius=0.1) - before).max(axis=2) > 1e-4
    assert twice.sum() == pytest.approx(4 * changed.sum(), rel=0.25)


def test_the_scene_and_nearer_spheres_hide_it(renderer: Renderer, monkeypatch: pytest.MonkeyPatch) -> None:
    colors = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], np.float32)
    behind = at_pixel(renderer, 48, 48, 100.0)
    for order in ((0, 1), (1, 0)):
        p = np.array([at_pixel(renderer, 48, 48, 2.0), at_pixel(renderer, 48, 48, 2.5)])[list(order)]
        some = colors[list(order)]
        show(renderer, monkeypatch, p=p, radius=0.05, color=some, atlas=some[:, None, None])
        np.testing.assert_allclose(draw_probes(renderer, "made")[48, 48], colors[0], atol=0.03)
    show(renderer, monkeypatch, p=behind[None], radius=5.0, color=colors[:1], atlas=colors[:1, None, None])
    np.testing.assert_array_equal(draw_probes(renderer, "made")[48, 48], plain(renderer)[48, 48])
    empty = np.zeros((0, 3), np.float32)
    show(renderer, monkeypatch, p=empty, radius=0.1, color=empty, atlas=empty[:, None, None])
    np.testing.assert_array_equal(draw_probes(renderer, "made"), plain(renderer))


def test_the_atlas_is_turned_to_the_world(renderer: Renderer, monkeypatch: pytest.MonkeyPatch) -> None:
    """A sphere that is red where it faces +Y is red above and not below."""
    resolution = 32
    line = (np.arange(resolution) + 0.5) * 2.0 / resolution - 1.0
    u, v = np.meshgrid(line, line)
    z = 1.0 - np.abs(u) - np.abs(v)
    up = v - np.maximum(-z, 0.0) * np.sign(v)  # the sign of a direction's y
    atlas = np.where(up[..., None] > 0.0, (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)).astype(np.float32)
    p = at_pixel(renderer, 48, 48, 2.0)[None]
    show(renderer, monkeypatch, p=p, radius=0.2, color=np.zeros((1, 3), np.float32), atlas=atlas[None])
    drawn = draw_probes(renderer, "made")
    assert drawn[44, 48, 0] > 0.5 > drawn[44, 48, 2] and drawn[52, 48, 2] > 0.5 > drawn[52, 48, 0]


@pytest.mark.parametrize("by", ["irradiance", "depth", "state", "offsets"])
def test_probes_are_drawn_by_each_view(renderer: Renderer, by: str) -> None:
    drawn, before = draw_probes(renderer, by, radius=0.08), plain(renderer)
    changed = np.abs(drawn - before).max(axis=2) > 1e-3
    assert 0.005 < changed.mean() < 0.9
    assert np.isfinite(drawn).all() and drawn.min() >= 0.0 and drawn.max() <= 1.0


def test_weights_are_those_of_the_look_up(renderer: Renderer) -> None:
    shown = draw_weights(renderer)
    layers = renderer.layers()
    assert shown.shape == (SIZE, SIZE, 3)
    assert not shown[~layers.hit].any() and (shown[layers.hit].max(axis=1) > 0.1).all()
    # A pixel of the back wall: the sum of weights of the point itself.
    middle = at_pixel(renderer, 34, 30, 1.0) - np.array(renderer.camera.eye)
    point = np.array(renderer.camera.eye) + middle * (-1.0 - renderer.camera.eye[2]) / middle[2]
    surface = free_surface(point[None], np.array([[0.0, 0.0, 1.0]]))
    surface.wo = mi.Vector3f(*(float(v) for v in -middle / np.linalg.norm(middle)))
    answer = query_probes(renderer.state, surface.p, surface.n_geometric, surface.n_shading, surface.wo, surface.active)
    np.testing.assert_allclose(shown[30, 34], heat(np.array(answer.seen))[0], atol=0.02)


def test_the_ramp_runs_from_dark_to_bright() -> None:
    values = heat(np.linspace(-0.5, 1.5, 41))
    np.testing.assert_allclose(values[[0, -1]], RAMP[[0, -1]])
    assert (np.diff(values @ (0.2126, 0.7152, 0.0722)) >= -1e-6).all()


def test_what_cannot_be_drawn_is_refused(renderer: Renderer) -> None:
    with pytest.raises(LuxelError, match="irradiance, depth, state"):
        draw_probes(renderer, "warmth")
    with pytest.raises(LuxelError, match="radius"):
        draw_probes(renderer, "state", radius=0.0)
    other = Renderer("cornell-box", "none", size=(16, 16))
    other.run(1)
    with pytest.raises(LuxelError, match="'none'"):
        draw_probes(other)
    with pytest.raises(LuxelError, match="'none'"):
        draw_weights(other)
