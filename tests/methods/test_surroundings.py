"""Surroundings change nothing inside: the furnace's radiance is 2 whatever lies beyond its walls.

Every surface of the closed box has albedo 0.5 and emits 1, so the radiance is 1 / (1 - 0.5) = 2 everywhere.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from luxel.metrics.error import bias
from luxel.render.renderer import Renderer
from luxel.render.truth import render_truth
from luxel.scene import load
from luxel.scene.library.shapes import make_mesh, quad, sphere
from luxel.scene.model import Camera, Light, Material, Object, SceneData, Sky

SETTINGS: dict[str, dict[str, Any]] = {
    "gibs": {"surfel_target": 3000},
    "ddgi": {"probe_target": 200},
    "lightmap": {"texel_target": 2000, "surfel_target": 500},
}


def surrounded(name: str) -> SceneData:
    """Return the furnace with something black far outside."""
    data = load("furnace")
    black = len(data.materials)
    far, half = 300.0, 1000.0
    outside = {
        "stray": make_mesh([(far, far, far), (far + 0.1, far, far), (far, far + 0.1, far)], [(0, 1, 2)], black),
        "dome": sphere((0.0, 0.0, 0.0), 500.0, black, inward=True),
        "ground": quad((-half, -1.5, half), (half, -1.5, half), (half, -1.5, -half), (-half, -1.5, -half), black),
    }
    data.materials = [*data.materials, Material(base_color=(0.0, 0.0, 0.0))]
    data.objects = [*data.objects, Object(name, [outside[name]])]
    return data


@pytest.mark.parametrize("method", SETTINGS)
@pytest.mark.parametrize("name", ["stray", "dome", "ground"])
def test_furnace_within_surroundings(method: str, name: str) -> None:
    renderer = Renderer(surrounded(name), method, SETTINGS[method], size=(24, 24))
    renderer.run(8 if method == "lightmap" else 96)
    image = renderer.image()
    assert abs(float(image.mean()) / 2.0 - 1.0) < 0.03
    assert float(image.min()) > 1.0 and np.isfinite(image).all()


def test_surfels_and_probes_are_as_fine_as_without() -> None:
    """Sizes come from the room: four tenths of the surfels cover it, sqrt(1.6 x 24 m^2 / 1200) = 0.179 m."""
    for name in ("stray", "dome", "ground"):
        renderer = Renderer(surrounded(name), "gibs", SETTINGS["gibs"], size=(16, 16))
        renderer.run(1)
        assert renderer.cache()["surfel_radius"] == pytest.approx((1.6 * 24.0 / 1200) ** 0.5, rel=0.02)


def light_on_plate(rays: int, frames: int, seed: int = 0) -> float:
    """Return what a small upright plate gets over what it should: half sky of radiance 1, half ground of 0.8.

    The ground is 2 km wide: surfels that fit the plate cannot cover it, so its light must come without them.
    """
    half, albedo, own = 1000.0, 0.8, 0.5
    ground = quad((-half, 0.0, half), (half, 0.0, half), (half, 0.0, -half), (-half, 0.0, -half), 0)
    plate = quad((-0.1, 0.9, 0.0), (0.1, 0.9, 0.0), (0.1, 1.1, 0.0), (-0.1, 1.1, 0.0), 1)
    data = SceneData(
        "plate",
        [Object("ground", [ground]), Object("plate", [plate])],
        [Material(base_color=(albedo, albedo, albedo)), Material(base_color=(own, own, own))],
        cameras=[Camera((0.0, 1.0, 0.5), (0.0, 1.0, 0.0), fov=20.0)],
        sky=Sky((1.0, 1.0, 1.0)),
    )
    params = {"surfel_target": 2000, "rays_per_surfel": rays}
    renderer = Renderer(data, "gibs", params, size=(24, 24), seed=seed)
    renderer.run(frames)
    return float(renderer.image()[8:16, 8:16].mean()) / (own * 0.9)


def test_plate_over_a_wide_ground() -> None:
    assert abs(light_on_plate(4, 128) - 1.0) < 0.03


def test_many_rays_to_far_surroundings_are_little_noise() -> None:
    """1,024 rays a surfel, a quarter goes on: seeds differ by 0.02. One path a frame for all 64 rays made 0.07."""
    assert np.std([light_on_plate(64, 16, seed) for seed in range(6)]) < 0.035


def warnings_of(**settings: Any) -> list[str]:
    """What `ddgi` says of a box on a wide ground under a sky, which the probes in the margin outside see."""
    data = surrounded("ground")
    data.sky = Sky((1.0, 1.0, 1.0))
    renderer = Renderer(data, "ddgi", {"probe_target": 60, **settings}, size=(16, 16))
    renderer.run(24)
    return [text for text in renderer.method.warnings(renderer.state) if "outside the probe box" in text]


def test_light_taken_from_the_border_is_said_with_advice_that_helps() -> None:
    """The box is fitted as it is: to be told to leave its size at 0 helps nobody."""
    said = warnings_of(outside="border")
    assert said and all("probe_box_size" in text and "at 0" not in text for text in said)
    assert not warnings_of()


@pytest.mark.parametrize("method", ["gibs", "ddgi"])
def test_a_dome_far_off_does_not_reflect_the_rooms_light(method: str) -> None:
    """A lamp of 1 W/(sr m^2) in a room that is open on one side: at 500 m next to nothing of it lights the dome.

    What comes back through the open side is at most albedo / pi times the lamp's flux over 500^2 m^2: a millionth.
    """
    pi, half = float(np.pi), 1.0
    walls = quad((-half, 0.0, -half), (half, 0.0, -half), (half, 2.0, -half), (-half, 2.0, -half), 0)
    floor = quad((-half, 0.0, half), (half, 0.0, half), (half, 0.0, -half), (-half, 0.0, -half), 0)
    dome = sphere((0.0, 0.0, 0.0), 500.0, 0, inward=True)
    data = SceneData(
        "corner",
        [Object("wall", [walls]), Object("floor", [floor]), Object("dome", [dome])],
        [Material(base_color=(0.5, 0.5, 0.5))],
        lights=[Light("point", (pi, pi, pi), position=(0.0, 1.0, 0.5))],
        cameras=[Camera((0.0, 1.2, 3.0), (0.0, 0.9, 0.0), fov=40.0)],
    )
    truth = render_truth(data, size=(24, 24), spp=512).layers
    settings = {"gibs": {"surfel_target": 3000}, "ddgi": {"probe_target": 400}}
    renderer = Renderer(data, method, settings[method], size=(24, 24))
    renderer.run(64)
    assert abs(bias(renderer.layers(), truth)) < 0.06
