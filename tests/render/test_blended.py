"""Blended surfaces, hidden emitters and parallel cameras in whole frames, against arithmetic and Mitsuba's renderer."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from luxel.inspect.explain import explain_pixel
from luxel.render.oracle import make_full_scene
from luxel.render.renderer import Renderer
from luxel.render.truth import render_truth
from luxel.scene.library.shapes import box, quad
from luxel.scene.model import Camera, Light, Material, Object, SceneData, Sky

SIZE = (32, 32)
WIDE = (192, 144)
"""Large enough that luxel's rays through pixel centres see as much of an edge as Mitsuba's jittered ones."""


def panes(alpha: float) -> SceneData:
    """A glowing pane before a wall that glows twice as bright, both black."""
    pane = Material("pane", (0, 0, 0), emission=(1, 1, 1), alpha=alpha, alpha_mode="blend", emit_back=True)
    wall = Material("wall", (0, 0, 0), emission=(2, 2, 2), emit_back=True)
    objects = [
        Object("pane", [quad((-5, -5, 0), (5, -5, 0), (5, 5, 0), (-5, 5, 0), 0)]),
        Object("wall", [quad((-9, -9, -1), (9, -9, -1), (9, 9, -1), (-9, 9, -1), 1)]),
    ]
    return SceneData("panes", objects, [pane, wall], cameras=[Camera((0, 0, 4), (0, 0, 0), fov=50)])


def curtain() -> SceneData:
    """A white half-open curtain over a grey floor under a lamp and a sky: shadows, bounces, what is behind."""
    cloth = Material("cloth", (0.9, 0.3, 0.2), alpha=0.4, alpha_mode="blend")
    objects = [
        Object("floor", [quad((-4, 0, 4), (4, 0, 4), (4, 0, -4), (-4, 0, -4), 0)]),
        Object("cloth", [quad((-1.5, 0.2, 0.5), (1.5, 0.2, 0.5), (1.5, 2.2, 0.5), (-1.5, 2.2, 0.5), 1)]),
        Object("block", [box((-0.5, 0, -1.5), (0.5, 1.5, -0.8), 0)]),
    ]
    lights = [Light("point", (30, 30, 30), position=(1, 3, 2.5)), Light("directional", (2, 2, 2), direction=(1, -2, 0))]
    camera = Camera((0, 1.5, 5), (0, 0.8, 0), fov=55)
    return SceneData("curtain", objects, [Material("grey"), cloth], lights, [camera], Sky((0.3, 0.4, 0.5)))


@pytest.mark.parametrize("alpha", [0.25, 0.8])
def test_layers_average_to_their_share(alpha: float) -> None:
    expected = alpha * 1.0 + (1.0 - alpha) * 2.0
    renderer = Renderer(panes(alpha), "none", size=SIZE)
    renderer.run(64)
    image = renderer.image()
    # 64 layers a pixel: a pixel's deviation is at most 0.5 / 8, the mean of 1,024 pixels' 0.002.
    assert image.mean() == pytest.approx(expected, abs=0.01)
    assert image.std() < 0.1
    truth = render_truth(panes(alpha), size=SIZE, spp=64, cache=False).layers.image()
    assert truth.mean() == pytest.approx(expected, abs=0.01)
    assert renderer.compilations <= 3


def test_one_frame_shows_one_layer() -> None:
    renderer = Renderer(panes(0.25), "none", size=SIZE)
    renderer.step()
    image = renderer.image()
    assert set(np.unique(np.round(image, 4))) == {1.0, 2.0}


def block_means(image: np.ndarray) -> np.ndarray:
    return image.reshape(12, image.shape[0] // 12, 16, image.shape[1] // 16, 3).mean(axis=(1, 3))


def mitsuba_image(data: SceneData, spp: int, hide: bool = False) -> np.ndarray:
    """Return Mitsuba's image of `data` through its first camera, described to Mitsuba by hand."""
    camera = data.cameras[0]
    to_world = mi.ScalarTransform4f().look_at(list(camera.eye), list(camera.target), [0, 1, 0])
    film = {"type": "hdrfilm", "width": WIDE[0], "height": WIDE[1], "rfilter": {"type": "box"}}
    sensor = {"type": "perspective", "fov": camera.fov, "fov_axis": "x", "to_world": to_world, "film": film}
    if camera.orthographic_width > 0.0:
        half = camera.orthographic_width / 2
        scaled = to_world @ mi.ScalarTransform4f().scale([half, half, 1])
        sensor = {"type": "orthographic", "to_world": scaled, "film": film, "near_clip": 0.001}
    # Mitsuba's `path` takes a mask for opaque on the way to a point light; `volpath` lets the light through.
    integrator = mi.load_dict({"type": "path" if hide else "volpath", "max_depth": -1, "hide_emitters": hide})
    scene = make_full_scene(data)
    return np.array(mi.render(scene, sensor=mi.load_dict(sensor), integrator=integrator, spp=spp))[..., :3]


def compare(data: SceneData, image: np.ndarray, other: np.ndarray) -> None:
    assert image.mean() == pytest.approx(other.mean(), rel=0.01)
    error = np.sqrt(((block_means(image) - block_means(other)) ** 2).mean()) / other.mean()
    assert error < 0.02


def test_a_curtain_is_mitsubas() -> None:
    data = curtain()
    truth = render_truth(data, size=WIDE, spp=64, cache=False).layers.image()
    compare(data, truth, mitsuba_image(data, 64))
    renderer = Renderer(data, "path", size=WIDE)
    renderer.run(64)
    compare(data, renderer.image(), truth)


def test_hidden_emitters_still_light() -> None:
    data = curtain()
    data.materials[1] = Material("lamp", (0, 0, 0), emission=(4, 4, 4), emit_back=False)
    data.hide_emitters = True
    truth = render_truth(data, size=WIDE, spp=64, cache=False).layers.image()
    compare(data, truth, mitsuba_image(data, 64, hide=True))
    # The lamp stands in the middle of the view and the sky above: neither is seen.
    assert truth[:4].max() == 0.0 and truth.max() < 4.0
    data.hide_emitters = False
    assert render_truth(data, size=WIDE, spp=4, cache=False).layers.image().max() >= 4.0


def test_a_parallel_camera_is_mitsubas() -> None:
    data = curtain()
    data.cameras[0] = Camera((1, 1.5, 5), (0, 0.8, 0), orthographic_width=5.0)
    truth = render_truth(data, size=WIDE, spp=64, cache=False).layers.image()
    compare(data, truth, mitsuba_image(data, 64))


def room_behind_glass() -> SceneData:
    """A closed room with a bulb, and a pane across the view."""
    walls = box((-2, 0, -3), (2, 2.5, 3), 0, inward=True)
    pane = quad((-1.9, 0.1, 1.5), (1.9, 0.1, 1.5), (1.9, 2.4, 1.5), (-1.9, 2.4, 1.5), 1)
    glass = Material("glass", (0.2, 0.3, 0.9), alpha=0.3, alpha_mode="blend")
    lights = [Light("point", (10, 10, 10), position=(1.2, 2.0, -2.0))]
    camera = Camera((0, 1.4, 2.8), (0, 1, 0), fov=60)
    objects = [Object("walls", [walls]), Object("pane", [pane])]
    return SceneData("room", objects, [Material("wall", (0.7, 0.6, 0.5)), glass], lights, [camera])


def test_a_filling_cache_does_not_stay_in_the_mean() -> None:
    """The first frames know little light; a plain mean would keep 7 % of the light away after 64 frames."""
    data = room_behind_glass()
    truth = render_truth(data, size=(64, 48), spp=256, cache=False).layers
    renderer = Renderer(data, "gibs", size=(64, 48))
    renderer.run(64)
    layers = renderer.layers()
    assert (layers.albedo * layers.indirect).mean() == pytest.approx((truth.albedo * truth.indirect).mean(), rel=0.02)


def test_what_is_explained_is_one_layer() -> None:
    """Albedo and light are those of the surface that is named, not the mean over what lies behind the pixel."""
    data = room_behind_glass()
    renderer = Renderer(data, "gibs", size=(64, 48))
    renderer.run(64)
    found = explain_pixel(renderer, 32, 24)
    own = next(item.base_color for item in data.materials if item.name == found.material_name)
    assert found.albedo == pytest.approx(own, abs=0.01)
    assert found.paths is not None
    assert np.mean(found.indirect) == pytest.approx(np.mean(found.paths.indirect), rel=0.15)
