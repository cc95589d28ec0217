"""Look-ups in the hashed grid in whole scenes: moving ones against NumPy over all surfels, wide ones by arithmetic."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.kernels.surface import free_surface
from luxel.methods import METHODS, inspector_of
from luxel.methods.gibs.gather import gather_irradiance
from luxel.render.renderer import Renderer
from luxel.scene import load
from luxel.scene.library.shapes import quad, translation
from luxel.scene.model import Camera, Material, Object, SceneData, Sky

RADIUS = 0.05


def coverage_of(points: np.ndarray, normals: np.ndarray, renderer: Renderer) -> np.ndarray:
    """Return the summed weights (N,) of all surfels that were sorted, by the formula in docs/methods/gibs.md."""
    surfels, params = renderer.state.surfels, METHODS["gibs"].Params()
    # The last update sorted those that have cast rays; what was placed later is in no list yet.
    old = (np.array(surfels.object_id) != 0) & (np.array(surfels.ray_index) > 0)
    p, n = (np.array(v).T[old].astype(float) for v in (surfels.p, surfels.n))
    radius = renderer.cache()["surfel_radius"]
    offset = points[:, None] - p
    off_plane = (offset * n).sum(axis=2)
    d2 = ((offset**2).sum(axis=2) + (params.plane_scale**2 - 1.0) * off_plane**2) / radius**2
    d = np.sqrt(np.minimum(d2, 1.0))
    return ((2 * d**3 - 3 * d**2 + 1) * np.maximum(normals @ n.T, 0.0) ** params.normal_power).sum(axis=1)


@pytest.mark.parametrize("capacity", [4000, 64])
def test_surfels_on_moving_objects_are_found_where_they_are_now(capacity: int) -> None:
    """With a small pool the table is small too, and its slots are shared."""
    params = {"surfel_target": 2000, "capacity": capacity, "radius": 0.15, "depth_texels": 0}
    renderer = Renderer(load("moving"), "gibs", params, size=(64, 64), seed=3)
    renderer.run(24, time_of=lambda frame: 0.11 * frame)
    surfels = renderer.state.surfels
    alive = np.flatnonzero(np.array(surfels.object_id) != 0)
    assert len(np.unique(np.array(surfels.object_id)[alive])) >= 3, "surfels lie on what moves"
    rng = np.random.default_rng(4)
    chosen = rng.choice(alive, 2000)
    points = np.array(surfels.p).T[chosen] + rng.normal(size=(2000, 3)) * 0.05
    normals = np.array(surfels.n).T[chosen].astype(np.float32)
    found = gather_irradiance(
        renderer.state, mi.Point3f(points.T.astype(np.float32)), mi.Normal3f(normals.T), dr.ones(mi.Bool, 2000)
    )
    wanted = coverage_of(points.astype(np.float32).astype(float), normals.astype(float), renderer)
    assert wanted.max() > 0.5
    # Normals are packed in 32 bits.
    np.testing.assert_allclose(np.array(found.coverage), wanted, atol=5e-3, rtol=5e-3)


@pytest.fixture(scope="module")
def wide() -> Renderer:
    """Return 5 cm surfels on a ground of 2 km before a black wall, 0.5 m high and 400 m long, under an even sky."""
    ground = quad((-1e3, 0, 1e3), (1e3, 0, 1e3), (1e3, 0, -1e3), (-1e3, 0, -1e3), 0)
    wall = quad((-200, 0, 0), (200, 0, 0), (200, 0.5, 0), (-200, 0.5, 0), 1)
    materials = [Material("grey", (0.5, 0.5, 0.5)), Material("black", (0.0, 0.0, 0.0))]
    above = Camera((0.0, 3.0, 0.6), (0.0, 0.0, 0.6), up=(0.0, 0.0, -1.0), orthographic_width=1.1)
    data = SceneData("wide", [Object("all", [ground, wall])], materials, sky=Sky((1.0, 1.0, 1.0)), cameras=[above])
    renderer = Renderer(data, "gibs", {"radius": RADIUS, "capacity": 4096}, size=(64, 64), seed=1)
    renderer.run(64)
    return renderer


def test_small_surfels_light_a_wide_ground(wide: Renderer) -> None:
    """A wall of height h at distance d takes (1 - d / sqrt(h^2 + d^2)) / 2 of the light of an even sky."""
    for distance in (0.2, 0.5, 1.0):
        points = np.stack([np.linspace(-0.4, 0.4, 33), np.zeros(33), np.full(33, distance)], axis=1)
        light = wide.irradiance_at(points, np.tile([0.0, 1.0, 0.0], (33, 1)))
        wanted = np.pi * (1.0 + distance / np.hypot(distance, 0.5)) / 2.0
        assert light.mean() == pytest.approx(wanted, rel=0.03)


def test_a_look_up_on_a_wide_ground_reads_what_it_reads_in_a_room(wide: Renderer) -> None:
    """1.6 surfels a radius^2 and cells a radius wide: about ten surfels touch a cell, spawning apart."""
    grid = np.stack(np.meshgrid(np.linspace(-0.4, 0.4, 20), [0.0], np.linspace(0.1, 1.1, 20)), axis=-1).reshape(-1, 3)
    surface = free_surface(grid, np.tile([0.0, 1.0, 0.0], (len(grid), 1)))
    read = inspector_of(METHODS["gibs"]).read(wide.scene, wide.state, surface, "cell-occupancy")
    assert 4.0 < np.array(read.value).mean() < 40.0
    assert np.array(read.value).max() < 80.0


def test_full_lists_are_said() -> None:
    renderer = Renderer(load("cornell-box"), "gibs", {"surfel_target": 1500, "items_per_surfel": 1}, size=(64, 64))
    renderer.run(16)
    assert any("items_per_surfel" in text for text in renderer.method.warnings(renderer.state))


def test_a_dial_keeps_the_cache_although_floors_have_moved() -> None:
    """Cells would begin elsewhere now; the light that surfels have gathered does not depend on that."""
    floor = quad((-1, 0, 1), (1, 0, 1), (1, 0, -1), (-1, 0, -1), 0)

    def lift(time: float) -> np.ndarray:
        return translation(0.0, 0.043 * time, 0.0)

    data = SceneData(
        "lift", [Object("lift", [floor], lift(0.0), lift)], [Material("grey", (0.5, 0.5, 0.5))],
        sky=Sky((1.0, 1.0, 1.0)), cameras=[Camera((0.0, 2.0, 1.0), (0.0, 0.0, 0.0))], duration=2.0,
    )  # fmt: skip
    renderer = Renderer(data, "gibs", {"radius": 0.1, "capacity": 1024}, size=(32, 32))
    renderer.run(4, time_of=lambda frame: 0.3 * frame)
    method, params = renderer.method, METHODS["gibs"].Params(radius=0.1, capacity=1024, spawn_threshold=2.0)
    assert method.build(renderer.scene, params, 0).lattice.shift.y[0] != renderer.state.lattice.shift.y[0]
    assert method.retune(renderer.scene, renderer.state, params) is not None
