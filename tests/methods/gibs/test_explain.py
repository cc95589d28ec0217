"""Why a point is lit as it is by surfels, and which surfel a look shows where."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.kernels.surface import free_surface
from luxel.methods import METHODS, inspector_of
from luxel.methods.inspect import WHYS, Contribution
from luxel.render.renderer import Renderer
from luxel.scene import load

POINTS = [(0.11, -1.0, 0.83), (-0.72, -1.0, 0.55), (0.5, 1.0, -0.1), (0.3, -1.0, -0.9)]


@pytest.fixture(scope="module")
def cornell() -> Renderer:
    renderer = Renderer(load("cornell-box"), "gibs", {"surfel_target": 1500}, size=(64, 64), seed=1)
    renderer.run(20)
    return renderer


def explain(
    renderer: Renderer, point: tuple[float, float, float], normal: tuple[float, float, float]
) -> list[Contribution]:
    surface = free_surface(np.array([point]), np.array([normal]))
    return inspector_of(METHODS["gibs"]).explain(renderer.scene, renderer.state, surface)


def normal_at(point: tuple[float, float, float]) -> tuple[float, float, float]:
    return (0.0, 1.0, 0.0) if point[1] < 0 else (0.0, -1.0, 0.0)


@pytest.mark.parametrize("point", POINTS)
def test_the_weighted_mean_is_the_answer(cornell: Renderer, point: tuple[float, float, float]) -> None:
    found = explain(cornell, point, normal_at(point))
    assert sum(item.weight for item in found) == pytest.approx(1.0, abs=1e-4)
    mean = sum(item.weight * np.array(item.irradiance) for item in found)
    answer = cornell.irradiance_at(np.array([point]), np.array([normal_at(point)]))[0]
    np.testing.assert_allclose(mean, answer, rtol=1e-3)
    weights = [item.weight for item in found]
    assert weights == sorted(weights, reverse=True)


def test_every_silent_surfel_has_a_reason(cornell: Renderer) -> None:
    """In an edge of the room the cell holds surfels of two walls, some of them too far."""
    whys = set()
    positions = np.array(cornell.state.surfels.p).T
    for point in (*POINTS, (0.0, -1.0, -0.98), (-0.98, -1.0, 0.2)):
        for item in explain(cornell, point, normal_at(point)):
            assert (item.weight > 0.0) == (item.reason == "") and (item.why in WHYS or not item.why)
            np.testing.assert_allclose(item.p or (), positions[item.item], atol=1e-6)
            whys.add(item.why)
    assert {"distance", "normal"} <= whys


def test_young_surfels_are_called_so() -> None:
    """Surfels in their cells that have not cast a ray, as they are in the frame after their birth."""
    renderer = Renderer(load("cornell-box"), "gibs", {"surfel_target": 1500}, size=(64, 64), seed=1)
    renderer.run(20)
    state = renderer.state
    renderer.state = replace(state, light=dr.zeros(mi.Float, 4 * state.settings.capacity))
    found = [item for point in POINTS for item in explain(renderer, point, normal_at(point))]
    assert any(item.why == "young" for item in found) and all(item.weight == 0.0 for item in found)


def test_where_no_surfel_is_nothing_is_listed(cornell: Renderer) -> None:
    assert explain(cornell, (0.0, 0.0, 0.6), (0.0, 1.0, 0.0)) == []


def test_the_surfel_shown_is_the_nearest(cornell: Renderer) -> None:
    """Against all surfels in NumPy: the least distance, stretched along the surfel's normal, of those that face us.

    Distances are in radii of each surfel; of several levels the finest that has a surfel there is asked.
    """
    from luxel.methods.gibs.looks import nearest_surfel

    rng = np.random.default_rng(5)
    points = np.stack([rng.uniform(-0.95, 0.95, 64), np.full(64, -1.0), rng.uniform(0.75, 0.95, 64)], axis=1)
    surface = free_surface(points, np.tile((0.0, 1.0, 0.0), (64, 1)))
    state = cornell.state
    surfel, place, found = (np.array(v) for v in nearest_surfel(state, surface.p, surface.n_geometric, surface.active))
    alive = np.array(state.surfels.object_id) != 0
    p, n = np.array(state.surfels.p).T, np.array(state.surfels.n).T
    largest, stretch = (float(np.array(v)[0]) for v in (state.dials.radius, state.dials.plane_stretch))
    size = np.array(state.surfels.size)
    radius, level = largest * 0.5 ** (size / 2.0), size // 2
    # Surfels of the last frame are in no cell yet.
    listed = np.zeros(len(alive), bool)
    starts = np.array(state.grid.starts)
    listed[np.array(state.grid.items)[: starts[-1]]] = True
    for index, point in enumerate(points.astype(np.float32)):
        offset = point - p
        distance = np.sqrt((offset**2).sum(axis=1) + stretch * (offset * n).sum(axis=1) ** 2) / radius
        distance[~(alive & listed) | (n[:, 1] <= 1e-3)] = np.inf
        distance[level < level[distance < 1.0 - 1e-4].max(initial=0)] = np.inf
        assert found[index] == (distance.min() < 1.0)
        if found[index]:
            assert place[index] == pytest.approx(distance.min(), abs=5e-3)
            assert distance[surfel[index]] == pytest.approx(distance.min(), abs=5e-3)
    assert found.mean() > 0.9
