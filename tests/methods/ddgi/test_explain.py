"""Why a point is lit as it is: the weights are those of the look-up, and the reasons are words."""

from __future__ import annotations

import numpy as np
import pytest

from luxel.kernels.surface import free_surface
from luxel.methods import METHODS, inspector_of
from luxel.methods.inspect import Contribution
from luxel.render.renderer import Renderer
from luxel.scene import load
from luxel.scene.library.shapes import box, quad
from luxel.scene.model import Camera, Light, Material, Object, SceneData


def explain(renderer: Renderer, point: tuple[float, ...], normal: tuple[float, ...]) -> list[Contribution]:
    surface = free_surface(np.array([point]), np.array([normal]))
    return inspector_of(METHODS["ddgi"]).explain(renderer.scene, renderer.state, surface)


def cornell(**settings: object) -> Renderer:
    params = {"probe_target": 300, "num_samples_per_probe": 16, **settings}
    renderer = Renderer(load("cornell-box"), "ddgi", params, size=(32, 32), seed=1)
    renderer.run(12)
    return renderer


def check(renderer: Renderer, points: list[tuple[float, float, float]], normal=(0.0, 1.0, 0.0)) -> None:
    for point in points:
        found = explain(renderer, point, normal)
        weight = sum(item.weight for item in found)
        mean = sum(item.weight * np.array(item.irradiance) for item in found) / weight
        answer = renderer.irradiance_at(np.array([point]), np.array([normal]))[0]
        np.testing.assert_allclose(mean, answer, rtol=0.02, err_msg=f"at {point}")
        assert all(a.weight >= b.weight for a, b in zip(found[:-1], found[1:], strict=True)), "heaviest first"


POINTS = [(0.11, -0.99, 0.13), (-0.72, -0.99, 0.55), (0.3, -0.2, -0.1), (0.9, 0.4, 0.8)]


def test_the_weighted_mean_is_the_answer() -> None:
    check(cornell(extra_probes=0), POINTS)


def test_so_it_is_with_probes_held_back() -> None:
    renderer = cornell()
    rng = np.random.default_rng(1)
    check(renderer, [tuple(p) for p in rng.uniform(-0.95, 0.95, (24, 3))])


def test_so_it_is_with_several_boxes() -> None:
    """The finer box answers alone inside: the coarser one must not be given the same say."""
    check(cornell(cascades=2, extra_probes=0, probe_target=100), POINTS)
    boxes = "0,0,0 size 1,1,1 probes 4,4,4; 0,0,0 size 2.4,2.4,2.4 probes 5,5,5"
    check(cornell(boxes=boxes, extra_probes=0), [(0.0, 0.1, 0.1), (0.4, 0.1, 0.1), (0.8, 0.1, 0.1)])


@pytest.fixture(scope="module")
def split() -> Renderer:
    """A room with a wall between two planes of probes and a box around one probe."""
    shell = box((-3, -3, -3), (3, 3, 3), 0, inward=True)
    wall = [quad((0.5, -3, 3), (0.5, -3, -3), (0.5, 3, -3), (0.5, 3, 3), 0)]
    wall.append(quad((0.49, -3, -3), (0.49, -3, 3), (0.49, 3, 3), (0.49, 3, -3), 0))
    crate = box((-1.6, -0.6, -0.6), (-0.4, 0.6, 0.6), 0)
    objects = [Object("shell", [shell]), Object("wall", wall), Object("crate", [crate])]
    lamp = Light("point", (5.0, 5.0, 5.0), (0.0, 2.5, 0.0))
    data = SceneData("split", objects, [Material()], [lamp], [Camera((-2.5, 2, 2.5), (0, 0, 0))])
    params = {"boxes": "0,0,0 size 4,4,4 probes 5,5,5", "extra_probes": 0, "offset_dead_probes": False}
    renderer = Renderer(data, "ddgi", params, size=(16, 16), seed=1)
    renderer.run(30)
    return renderer


def test_a_dead_probe_is_called_dead(split: Renderer) -> None:
    found = explain(split, (-0.7, 0.61, 0.3), (0.0, 1.0, 0.0))
    dead = [item for item in found if "dead" in item.reason]
    assert len(dead) == 1 and dead[0].weight == 0.0 and "inside" in dead[0].reason


def test_a_probe_behind_the_wall_does_not_see(split: Renderer) -> None:
    found = explain(split, (0.3, 1.3, 1.3), (-1.0, 0.0, 0.0))
    blind = [item for item in found if "not see" in item.reason]
    assert len(blind) == 4 and max(item.weight for item in blind) < 1e-3
    assert sum(item.weight > 1e-3 for item in found) == 4


def test_blind_probes_that_share_a_guess_are_called_blind(split: Renderer) -> None:
    """Within the crate, where the living probes around do not look: their shares add up to one, and none answers."""
    found = explain(split, (-0.7, 0.3, 0.3), (1.0, 0.0, 0.0))
    assert sum(item.weight for item in found) == pytest.approx(1.0, abs=1e-3)
    assert max(item.weight for item in found) > 0.1
    assert {item.why for item in found} <= {"depth", "dead", "normal"} and not any(item.answers for item in found)


def test_a_probe_behind_the_surface_is_called_so(split: Renderer) -> None:
    found = explain(split, (-0.99, 1.01, 1.15), (0.0, 0.0, 1.0))
    assert any("behind" in item.reason for item in found)


def test_outside_it_says_so(split: Renderer) -> None:
    found = explain(split, (-2.9, 1.5, 1.5), (1.0, 0.0, 0.0))
    assert found and any("outside the box" in item.reason for item in found)


def test_every_silent_probe_has_a_reason(split: Renderer) -> None:
    for x in (-2.5, -1.3, -0.1, 0.2, 1.5):
        for item in explain(split, (x, 1.3, 1.3), (0.0, 1.0, 0.0)):
            assert item.answers or item.reason
            assert np.isfinite(item.weight) and np.isfinite(item.irradiance).all()
