"""What no surfel covers is never black where light falls, and stays black where none can come."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import luxel
from luxel.metrics.leak import box_points
from luxel.render.renderer import Renderer
from luxel.scene import load
from luxel.scene.library.shapes import box
from luxel.scene.model import Camera, Light, Material, Object, SceneData

SIZES = [(8, 8), (33, 17), (64, 64), (128, 128)]
FRAMES = (1, 2, 8, 32)
PAINT: dict[str, Any] = {"pbrMetallicRoughness": {"baseColorFactor": [0.7, 0.4, 0.2, 1.0], "metallicFactor": 0.0}}


def room_with_a_lamp() -> SceneData:
    """A room with a block in it and one bulb: every wall is lit, half of the block and its shadow by bounces alone."""
    walls = box((-2.0, 0.0, -3.0), (2.0, 2.5, 3.0), 0, inward=True)
    block = box((-0.5, 0.0, -0.5), (0.5, 1.2, 0.5), 1)
    return SceneData(
        "room",
        [Object("walls", [walls]), Object("block", [block])],
        [Material("white", (0.7, 0.7, 0.7)), Material("red", (0.6, 0.2, 0.2))],
        lights=[Light("point", (10.0, 10.0, 10.0), position=(1.2, 2.0, -2.0), name="bulb")],
        cameras=[Camera((0.0, 1.4, 2.9), (0.0, 1.0, 0.0), fov=75.0)],
    )


def count_black(renderer: Renderer) -> int:
    layers = renderer.layers()
    assert layers.hit.any() and np.isfinite(layers.indirect).all()
    return int((layers.hit & (layers.indirect.max(axis=2) <= 0.0)).sum())


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_no_pixel_of_a_lit_room_is_black(size: tuple[int, int]) -> None:
    renderer, done = Renderer(room_with_a_lamp(), size=size), 0
    for frames in FRAMES:
        renderer.run(frames - done)
        done = frames
        assert count_black(renderer) == 0, frames


def test_no_pixel_of_a_file_under_the_default_sky_is_black(write_gltf: Callable[..., Path]) -> None:
    mesh = box((-1.0, 0.0, -1.0), (1.0, 1.5, 1.0), 0)
    data = luxel.load(write_gltf("block.gltf", [("block", mesh.positions[mesh.faces], PAINT)]))
    for size in SIZES[:3]:
        renderer = Renderer(data, size=size)
        for _ in range(3):
            renderer.step()
            assert count_black(renderer) == 0


def test_the_first_picture_shows_the_light_that_is_there() -> None:
    """One bounce of it at least; the mean over the view is what a path tracer finds, less the later bounces."""
    data = room_with_a_lamp()
    truth = luxel.render_truth(data, size=(64, 64), spp=64, cache=False).layers
    renderer = Renderer(data, size=(64, 64))
    renderer.step()
    first = renderer.layers().indirect[truth.hit].mean() / truth.indirect[truth.hit].mean()
    assert 0.25 < first < 1.05


def test_a_sealed_room_stays_black_to_its_own_camera() -> None:
    data = load("two-rooms")
    dark = data.cameras[1]
    renderer = Renderer(data, camera=dark, size=(64, 48))
    for _ in range(4):
        renderer.step()
        assert renderer.layers().hit.all() and not renderer.layers().indirect.any()
    # And the cache's rays lend no light through the wall, after a look at the lit side.
    for _ in range(16):
        renderer.step(camera=data.cameras[0])
    assert renderer.layers().indirect.mean() > 0.01
    for _ in range(16):
        renderer.step(camera=dark)
    facts = data.facts
    low, high = (np.array([facts[f"sealed_{end}_{axis}"] for axis in "xyz"]) for end in ("lo", "hi"))
    assert renderer.irradiance_at(*box_points(low, high)).max() <= 0.01


def test_no_light_is_taken_from_behind_a_wall_thinner_than_a_pixel() -> None:
    """Parallel rays look down into a lit room and a sealed one whose floors touch: pixels of one tile lie in both."""
    shell = box((-2.0, 0.0, -2.0), (2.0, 3.0, 2.0), 0, inward=True)
    wall = box((0.0, 0.0, -2.0), (0.004, 3.0, 2.0), 0)
    data = SceneData(
        "two",
        [Object("all", [shell, wall])],
        [Material(base_color=(0.5, 0.5, 0.5))],
        lights=[Light("point", (5.0, 5.0, 5.0), position=(-1.0, 1.2, 0.0))],
        cameras=[Camera((0.05, 2.9, 0.0), (0.05, 0.0, 0.0), up=(0.0, 0.0, -1.0), orthographic_width=1.2)],
    )
    renderer, shares = Renderer(data, "gibs", {"surfel_target": 5000}, size=(64, 64), seed=1), []
    for _ in range(20):
        renderer.step()
        columns = renderer.layers().indirect.mean(axis=(0, 2))
        # Pixels of 19 mm; the wall's tile has columns 24 to 31, and the wall stands between 29 and 30.
        shares.append(columns[30:32].mean() / columns[24:29].mean())
    assert max(shares) < 0.1, shares


def test_rays_borrow_the_light_of_the_surfel_that_cast_them() -> None:
    """In a furnace every place has the same light, so what is borrowed is right: no surfel lies where the rays hit."""
    data = load("furnace")
    data.cameras = [Camera(data.cameras[0].eye, data.cameras[0].target, data.cameras[0].up, fov=20.0)]
    renderer = Renderer(data, "gibs", {"hit_spawn_threshold": 0.0, "surfel_target": 2000}, size=(32, 32))
    renderer.run(128)
    # A few surfels fill the view: five seeds lie within 1.5 %. Without what is borrowed half of the light is missing.
    assert renderer.layers().indirect.mean() == pytest.approx(data.facts["indirect_irradiance"], rel=0.04)


def test_only_what_is_bare_is_filled() -> None:
    """Where surfels answer in full, the picture is theirs alone: the query's answer, to the last bit."""
    renderer = Renderer(room_with_a_lamp(), "gibs", {"surfel_target": 4000}, size=(64, 64))
    renderer.run(64)
    layers = renderer.layers()
    assert (layers.weight[layers.hit] >= 1.0).mean() > 0.95
    from luxel.kernels.gbuffer import trace_gbuffer
    from luxel.methods.gibs.gather import gather_irradiance

    view = renderer.view_camera
    surface = trace_gbuffer(renderer.scene, renderer.film, view, view).surface
    # The frame gathers before it spawns; spawned surfels have no sample yet and change nothing but the coverage.
    found = gather_irradiance(renderer.state, surface.p, surface.n_geometric, surface.active)
    answered = renderer.film.to_image(found.confidence) >= 1.0
    assert answered.mean() > 0.9
    np.testing.assert_allclose(layers.indirect[answered], renderer.film.to_image(found.irradiance)[answered], rtol=1e-5)
