"""Surfels that ride on an object and come to another light."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from luxel.bench.reproduce.fast_object import two_places
from luxel.methods.gibs.sizes import radius_of_size
from luxel.methods.gibs.surfels import forget_by_travel
from luxel.render.renderer import Renderer
from luxel.scene.library.shapes import quad, translation
from luxel.scene.model import Camera, Material, Object, SceneData, Sky


@pytest.fixture(scope="module")
def settled() -> Renderer:
    renderer = Renderer(two_places(), "gibs", {"surfel_target": 4000}, size=(64, 36), seed=1)
    renderer.run(24, time_of=lambda _: 0.0)
    return renderer


def counts(renderer: Renderer, shift: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return the samples that placed surfels count for before and after a way of `shift` radii."""
    state = renderer.state
    alive = (np.array(state.surfels.object_id) != 0) & (np.array(state.surfels.ray_index) > 0)
    radius = radius_of_size(state, state.surfels.size)
    p = state.surfels.p + mi.Vector3f(*shift) * radius
    after = forget_by_travel(state, mi.Point3f(p), state.surfels.n, radius)
    return np.array(state.surfels.estimate.count)[alive], np.array(after.count)[alive]


def test_who_stays_forgets_nothing(settled: Renderer) -> None:
    before, after = counts(settled, (0.0, 0.0, 0.0))
    np.testing.assert_array_equal(before, after)


def test_what_is_known_shrinks_with_the_way(settled: Renderer) -> None:
    before, after = counts(settled, (2.0, 0.0, 0.0))
    np.testing.assert_allclose(after, np.minimum(before, 4.0), rtol=1e-3)
    assert before.max() > 4.0
    _, far = counts(settled, (0.0, 100.0, 0.0))
    assert (far < 0.5).all(), "below half a sample the next one counts whole"


def test_the_light_of_the_old_place_is_gone_with_the_first_rays() -> None:
    """The crate jumps from the strong light into the weak; what it carries along is the error of the first frames."""

    def light(memory: float, before: float) -> np.ndarray:
        params = {"surfel_target": 4000, "memory_radii": memory}
        renderer = Renderer(two_places(), "gibs", params, size=(64, 36), seed=1)
        renderer.run(48, time_of=lambda _: before)
        renderer.run(2, time_of=lambda _: 1.0)
        return renderer.layers().indirect

    there_all_along = light(8.0, 1.0)
    error = {memory: np.square(light(memory, 0.0) - there_all_along).mean() ** 0.5 for memory in (0.0, 8.0)}
    assert error[8.0] < 0.7 * error[0.0]


@pytest.mark.parametrize("params", [{}, {"radius_pixels": 1.5}, {"view_radius": False}])
def test_how_soon_it_forgets_is_no_matter_of_the_view(params: dict[str, float]) -> None:
    """By arithmetic: 8 radii of what covers the scene evenly, over the way a frame, and one sample more."""
    step, target = 0.08, 3000
    sheet = quad((-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0), 0)
    slides = Object("sheet", [sheet], motion=lambda time: translation(step * 30.0 * time, 0.0, 0.0))
    still = Object("wall", [quad((-3, -3, -1), (3, -3, -1), (3, 3, -1), (-3, 3, -1), 0)])
    scene = SceneData("sliding", [slides, still], [Material(base_color=(0.5, 0.5, 0.5))], sky=Sky((1.0, 1.0, 1.0)))
    camera = Camera((1.3, 0.0, 4.0), (1.3, 0.0, 0.0), fov=60.0)
    params = {"surfel_target": target, "share_rays": False, "rays_per_surfel": 4, **params}
    renderer = Renderer(scene, "gibs", params, size=(48, 48), seed=1, camera=camera)
    renderer.run(32, time_of=lambda frame: frame / 30.0)
    surfels = renderer.state.surfels
    rides = (np.array(surfels.object_id) == 1) & (np.array(surfels.ray_index) > 4 * 24)
    held = np.array(surfels.estimate.count)[rides]
    radius = (1.6 * renderer.scene.host.area / target) ** 0.5
    assert rides.sum() > 20 and 1.0 + 8.0 * radius / step < 24.0
    np.testing.assert_allclose(np.median(held), 1.0 + 8.0 * radius / step, rtol=0.02)
