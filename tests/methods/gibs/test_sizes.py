"""Surfels of many sizes: weights, the answer of several levels, spawning and what views ask for, against NumPy."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.kernels.camera import make_pinhole
from luxel.kernels.gbuffer import trace_gbuffer
from luxel.methods import METHODS
from luxel.methods.gibs import eyes, view
from luxel.methods.gibs.gather import gather_irradiance, surfel_weight
from luxel.methods.gibs.sizes import SMALLEST, radius_of_size, size_for_radius
from luxel.methods.gibs.spawn import SpawnCandidates, spawn
from luxel.methods.gibs.surfels import GibsState, Sight, count_surfels
from luxel.render.frame import make_film
from luxel.render.renderer import Renderer
from luxel.scene import load
from luxel.scene.model import Camera

PARAMS = METHODS["gibs"].Params()


@pytest.fixture(scope="module")
def cornell() -> Renderer:
    params = {"surfel_target": 1500, "radius_pixels": 1.5, "capacity": 8000, "normal_light": False, "depth_texels": 0}
    renderer = Renderer(load("cornell-box"), "gibs", params, size=(96, 96), seed=1)
    renderer.run(24)
    return renderer


def held(state: GibsState) -> dict[str, np.ndarray]:
    """Return what the lists hold of the surfels: place, normal, radius, level, light and confidence, by id."""
    size = np.array(state.surfels.size).astype(int)
    listed = np.zeros(len(size), bool)
    listed[np.array(state.grid.items)[: np.array(state.grid.starts)[-1]]] = True
    light = np.array(state.light).reshape(-1, 4).astype(float)
    return {
        "p": np.array(state.surfels.p).T.astype(float), "n": np.array(state.surfels.n).T.astype(float),
        "radius": float(np.array(state.dials.radius)[0]) * 2.0 ** (-size / 2.0), "level": size // 2, "size": size,
        "listed": listed, "light": light[:, :3], "confidence": light[:, 3],
    }  # fmt: skip


def weights_of(known: dict[str, np.ndarray], points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return the weight (P, N) of all listed surfels at points, by the formula in docs/methods/gibs.md."""
    offset = points[:, None] - known["p"]
    off_plane = (offset * known["n"]).sum(axis=2)
    d2 = ((offset**2).sum(axis=2) + (PARAMS.plane_scale**2 - 1.0) * off_plane**2) / known["radius"] ** 2
    d = np.sqrt(np.minimum(d2, 1.0))
    return known["listed"] * (2 * d**3 - 3 * d**2 + 1) * np.maximum(normals @ known["n"].T, 0.0) ** PARAMS.normal_power


def points_near(known: dict[str, np.ndarray], count: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(6)
    chosen = rng.choice(np.flatnonzero(known["listed"]), count)
    points = known["p"][chosen] + rng.normal(size=(count, 3)) * 0.15 * known["radius"][chosen][:, None]
    return points.astype(np.float32).astype(float), known["n"][chosen].astype(np.float32).astype(float)


def test_the_scene_has_surfels_of_many_sizes(cornell: Renderer) -> None:
    known = held(cornell.state)
    counts = np.bincount(known["level"][known["listed"]])
    assert (counts > 50).sum() >= 2, counts


def test_weights_are_those_of_each_surfels_own_radius(cornell: Renderer) -> None:
    known = held(cornell.state)
    points, normals = points_near(known, 40)
    # All of the scene's normals lie along the axes: where points do not lean, no power of the cosine shows.
    normals = normals + np.random.default_rng(8).normal(size=normals.shape) * 0.4
    normals = (normals / np.linalg.norm(normals, axis=1)[:, None]).astype(np.float32).astype(float)
    wanted = weights_of(known, points, normals)
    ids = np.flatnonzero(known["listed"])
    for index in range(0, 40, 4):
        p, n = (mi.Vector3f(*map(float, v[index])) for v in (points, normals))
        found = surfel_weight(cornell.state, mi.UInt32(ids), mi.Point3f(p), mi.Normal3f(n), mi.Bool(True))
        np.testing.assert_allclose(np.array(found), wanted[index][ids], atol=1.2e-2)
    assert (wanted > 0.1).sum() > 30


def test_finer_levels_have_the_first_say(cornell: Renderer) -> None:
    """Coarser ones fill what is missing to a confidence of 1, and nothing is read twice."""
    known = held(cornell.state)
    points, normals = points_near(known, 600)
    weights = weights_of(known, points, normals) * known["confidence"]
    light, covered = np.zeros((600, 3)), np.zeros(600)
    for level in np.unique(known["level"])[::-1]:
        part = weights[:, known["level"] == level]
        total = part.sum(axis=1)
        left = (1.0 - np.minimum(covered, 1.0)) * np.minimum(1.0 / np.maximum(total, 1e-20), 1.0)
        share = np.where(covered > 0.0, left, 1.0)
        light += share[:, None] * (part @ known["light"][known["level"] == level])
        covered += share * total
    found = gather_irradiance(
        cornell.state, mi.Point3f(points.T.astype(np.float32)), mi.Normal3f(normals.T.astype(np.float32)), mi.Bool(True)
    )
    sure = covered > 0.05
    assert sure.sum() > 200
    np.testing.assert_allclose(np.array(found.confidence)[sure], covered[sure], rtol=2e-2, atol=6e-3)
    wanted = light[sure] / covered[sure][:, None]
    np.testing.assert_allclose(np.array(found.irradiance).T[sure], wanted, rtol=3e-2, atol=2e-2 * wanted.mean())


def test_sizes_are_powers_of_the_root_of_two(cornell: Renderer) -> None:
    state, sizes = cornell.state, np.arange(SMALLEST + 1)
    largest = float(np.array(state.dials.radius)[0])
    radii = np.array(radius_of_size(state, mi.UInt32(sizes)))
    np.testing.assert_allclose(radii, largest * 2.0 ** (-sizes / 2.0), rtol=1e-6)
    np.testing.assert_array_equal(size_for_radius(state, mi.Float(radii * 1.18)), sizes)
    np.testing.assert_array_equal(size_for_radius(state, mi.Float([1e9, 1e-12])), [0, SMALLEST])


def test_spawning_takes_the_lowest_lane_of_a_cell_and_ids_by_rank(cornell: Renderer) -> None:
    """Against NumPy: cells are told by the shift and the width of each level; ids come from the top of the stack."""
    state, rng = cornell.state, np.random.default_rng(7)
    count = 500
    prim = rng.integers(0, 12, count)
    barycentric = rng.uniform(0.0, 0.5, (count, 2)).astype(np.float32)
    size, wanted = rng.integers(0, 6, count), rng.random(count) < 0.7
    candidates = SpawnCandidates(
        mi.UInt32(prim),
        mi.Point2f(barycentric.T),
        mi.Bool(np.zeros(count, bool)),
        mi.Bool(wanted),
        mi.UInt32(size),
        mi.Color3f(0.0),
    )
    surfels, free = spawn(cornell.scene, state, candidates, mi.UInt32(99))
    taken = int(np.array(state.free.count)[0]) - int(np.array(free.count)[0])
    ids = np.array(state.free.ids)[: int(np.array(state.free.count)[0])][::-1][:taken]
    p = np.array(surfels.p).T[ids]
    placed = np.array(surfels.size)[ids]
    assert (np.array(surfels.sight.seen)[ids] == 99).all() and (np.array(surfels.ray_index)[ids] == 0).all()

    shift, width = np.array(state.lattice.shift).T, 1.0 / float(np.array(state.lattice.inverse_size)[0])
    cells = np.floor(p / (width * 0.5 ** (placed // 2))[:, None] + shift[placed // 2]).astype(int)
    keys = {(int(level), *map(int, cell)) for level, cell in zip(placed // 2, cells, strict=True)}
    # Cells may share a slot, then one waits; two surfels never share a cell.
    assert len(keys) == taken and 100 < taken < wanted.sum()
    first = np.flatnonzero(wanted)[0]
    assert placed[0] == size[first], "ranks follow the lanes"


@pytest.mark.parametrize("samples", [0.0, 8.0])
def test_a_newborn_surfel_starts_from_the_light_that_is_known(samples: float) -> None:
    params = {"surfel_target": 1500, "birth_samples": samples}
    renderer = Renderer(load("cornell-box"), "gibs", params, size=(32, 32), seed=1)
    state, count = renderer.state, 9
    light = np.zeros((count, 3), np.float32)
    light[4:] = (0.5, 0.25, 0.125)
    barycentric = np.random.default_rng(4).uniform(0.1, 0.4, (count, 2)).astype(np.float32)
    candidates = SpawnCandidates(
        mi.UInt32(np.arange(count)), mi.Point2f(barycentric.T), mi.Bool(np.zeros(count, bool)),
        mi.Bool(np.ones(count, bool)), mi.UInt32(np.zeros(count, np.uint32)), mi.Color3f(light.T),
    )  # fmt: skip
    surfels, free = spawn(renderer.scene, state, candidates, mi.UInt32(0))
    taken = state.settings.capacity - int(np.array(free.count)[0])
    mean, known = np.array(surfels.estimate.mean).T[:taken], np.array(surfels.estimate.count)[:taken]
    lit = mean[:, 0] > 0.0
    np.testing.assert_array_equal(known, np.where(lit, samples, 0.0))
    assert lit.any() == (samples > 0.0) and not lit[:4].any()
    np.testing.assert_array_equal(mean[lit], np.broadcast_to(light[4], mean[lit].shape))


def resized(state: GibsState, sizes: np.ndarray, wanted: np.ndarray, patience: int) -> tuple[np.ndarray, np.ndarray]:
    """Return sizes and who lives after an update in which views wanted `wanted`, after so many frames of patience."""
    capacity = state.settings.capacity
    sight = Sight(
        mi.UInt32(np.full(capacity, 50, np.uint32)),
        mi.UInt32(wanted + 1),
        dr.full(mi.UInt32, patience * 0x10001, capacity),
    )
    surfels = replace(
        state.surfels, object_id=dr.full(mi.UInt32, 1, capacity), size=mi.UInt32(sizes), sight=sight,
        seed=mi.UInt32(np.random.default_rng(2).integers(0, 1 << 32, capacity, np.uint32)),
    )  # fmt: skip
    free = replace(state.free, count=mi.UInt32(0))
    before = count_surfels(replace(state, free=free))
    after, stack = view.resize(replace(state, surfels=surfels, free=free), mi.UInt32(51))
    alive = np.array(after.object_id) != 0
    freed = int(np.array(stack.count)[0])
    assert before - freed == alive.sum()
    assert set(np.array(stack.ids)[:freed].tolist()) == set(np.flatnonzero(~alive).tolist())
    return np.array(after.size), alive


def test_shrinking_waits_little_and_growing_long_and_thins_out(cornell: Renderer) -> None:
    state = cornell.state
    capacity = state.settings.capacity
    # No limit on numbers, so that only sizes have a say.
    state = replace(state, dials=replace(state.dials, surfel_limit=mi.Float(1e9)))
    four = np.full(capacity, 4, np.uint32)
    for wanted, patience, expected in ((5, 500, 4), (7, 3, 4), (7, view.SHRINK_AFTER, 7), (3, 500, 4), (1, 60, 4)):
        size, alive = resized(state, four, np.full(capacity, wanted, np.uint32), patience)
        assert (size == expected).all() and alive.all(), (wanted, patience)
    size, alive = resized(state, four, np.full(capacity, 1, np.uint32), view.GROW_AFTER + view.GROW_SPREAD)
    assert (size[alive] == 1).all()
    assert alive.mean() == pytest.approx(2.0**-3, rel=0.1), "three steps up cover eight times as much"


def test_too_many_surfels_give_back_the_longest_unseen(cornell: Renderer) -> None:
    state = cornell.state
    capacity = state.settings.capacity
    unseen = np.repeat([0, 10, 200, 800], capacity // 4 + 1)[:capacity].astype(np.uint32)
    size = np.where(np.arange(capacity) % 5 == 0, 0, 3).astype(np.uint32)
    limit = 0.9 * capacity
    sight = Sight(mi.UInt32(1000 - unseen), dr.zeros(mi.UInt32, capacity), dr.zeros(mi.UInt32, capacity))
    surfels = replace(
        state.surfels, object_id=dr.full(mi.UInt32, 1, capacity), size=mi.UInt32(size), sight=sight,
        seed=mi.UInt32(np.random.default_rng(3).integers(0, 1 << 32, capacity, np.uint32)),
    )  # fmt: skip
    state = replace(
        state, surfels=surfels, free=replace(state.free, count=mi.UInt32(0)),
        dials=replace(state.dials, surfel_limit=mi.Float(limit)),
    )  # fmt: skip
    after, _ = view.resize(state, mi.UInt32(1000))
    freed = np.array(after.object_id) == 0
    assert not freed[unseen <= 10].any()
    # Those that rays place go last, but they go, or a flight would fill the pool with them.
    assert 0.0 < freed[(unseen == 800) & (size == 0)].mean() < 0.1 * freed[(unseen == 800) & (size > 0)].mean()
    assert freed.sum() == pytest.approx(capacity - limit, rel=0.15)
    shares = [freed[(unseen == age) & (size > 0)].mean() for age in (200, 800)]
    assert shares[1] / shares[0] == pytest.approx(((800 - view.REST) / (200 - view.REST)) ** 2, rel=0.5)


@pytest.mark.parametrize(("target", "expected"), [(3000, None), (200_000, eyes.LEAST_PIXELS), (60, eyes.MOST_PIXELS)])
def test_a_view_is_filled_with_its_share(target: int, expected: float | None) -> None:
    """By docs/methods/gibs.md: r^2 = 1.6 x (sum over the pixels of 1 / cosine) / (0.6 surfel_target), from 2 to 16."""
    renderer = Renderer(load("cornell-box"), "gibs", {"surfel_target": target}, size=(64, 64), seed=1)
    renderer.run(2)
    pinhole = make_pinhole(renderer.camera, 64, 64)
    surface = trace_gbuffer(renderer.scene, make_film((64, 64)), pinhole, pinhole).surface
    hit = np.array(surface.active)
    ray = -np.array(surface.wo).T[hit]
    cosine = np.maximum(np.abs((ray * np.array(surface.n_geometric).T[hit]).sum(axis=1)), eyes.LEAST_COSINE)
    wanted = np.sqrt(1.6 * (1.0 / cosine).sum() / (0.6 * target)) if expected is None else expected
    assert renderer.cache()["radius_pixels"] == pytest.approx(wanted, rel=1e-3)
    # What the view leaves goes to surfels that only rays see: each size down needs twice as many.
    left = (target - 1.6 * (1.0 / cosine).sum() / wanted**2) / (0.4 * target)
    assert np.array(renderer.state.eyes.ray_size)[0] == np.floor(np.log2(max(left, 1.0)))


def test_a_view_of_the_sky_wants_no_small_surfels() -> None:
    """It has no pixels to fill. Its radius fell to the least one, and whoever turned back had the pool filled."""
    renderer = Renderer(load("cornell-box"), "gibs", {"surfel_target": 1000}, size=(128, 128), seed=1)
    here = renderer.camera
    renderer.run(40)
    before = renderer.cache()
    for _ in range(40):
        renderer.step(camera=replace(here, target=(0.0, 0.0, 20.0)))
    assert renderer.cache()["radius_pixels"] == before["radius_pixels"]
    for _ in range(8):
        renderer.step(camera=here)
    assert renderer.cache()["surfel_count"] < 1.1 * before["surfel_count"]


def test_a_view_that_wants_much_larger_surfels_gets_them_at_once() -> None:
    """From a corner of the image that is seen to all of it: the same number of surfels must do for more pixels."""
    renderer = Renderer(load("cornell-box"), "gibs", {"surfel_target": 3000}, size=(96, 96), seed=1)
    here = renderer.camera
    renderer.run(1)
    whole = renderer.cache()["radius_pixels"]
    for _ in range(30):
        renderer.step(camera=replace(here, lens_shift=(1.4, 0.0)))
    assert renderer.cache()["radius_pixels"] < 0.75 * whole
    renderer.step(camera=here)
    assert renderer.cache()["radius_pixels"] == whole


WIDE = Camera((0.0, 0.0, 0.9), (0.1, 0.0, 0.0), fov=150.0)
SHIFTED = Camera((0.0, 0.0, 3.9), (0.0, 0.0, 0.0), fov=40.0, lens_shift=(0.5, 0.2))
FLAT = Camera((0.0, 0.0, 3.9), (0.0, 0.0, 0.0), orthographic_width=2.4, orthographic_height=0.6)


@pytest.mark.parametrize("camera", [WIDE, SHIFTED, FLAT])
def test_pixels_want_surfels_of_as_many_pixels_wherever_they_are(camera: Camera) -> None:
    """A surfel of r pixels that faces the eye covers pi r^2 times the solid angle of its pixel, by NumPy's rays."""
    params = {"radius_pixels": 1.0, "surfel_target": 1000}
    renderer = Renderer(load("cornell-box"), "gibs", params, size=(64, 32), camera=camera)
    renderer.run(2)
    film, pinhole = make_film((64, 32)), make_pinhole(camera, 64, 32)
    gbuffer = trace_gbuffer(renderer.scene, film, pinhole, pinhole)
    found = film.to_image(view.pixel_sizes(renderer.state, gbuffer, mi.Float(1.0))).astype(int)
    hit, depth = film.to_image(gbuffer.surface.active).astype(bool), film.to_image(gbuffer.depth)
    if camera.orthographic_width > 0.0:
        area = np.full((32, 64), camera.orthographic_width * camera.orthographic_height / (64 * 32))
    else:
        half = np.tan(np.radians(camera.fov / 2.0))
        x = half * (np.linspace(-1.0, 1.0, 65) + camera.lens_shift[0])
        y = half / 2.0 * (np.linspace(1.0, -1.0, 33) + camera.lens_shift[1])
        ray = np.stack([*np.meshgrid(x, y), np.ones((33, 65))], axis=2)
        ray /= np.linalg.norm(ray, axis=2)[..., None]
        corner = ray[:-1, :-1]
        area = depth**2 * np.linalg.norm(np.cross(ray[:-1, 1:] - corner, ray[1:, :-1] - corner), axis=2)
    steps = 2.0 * np.log2(renderer.cache()["surfel_radius"] / np.sqrt(area[hit]))
    assert hit.mean() > 0.3 and steps.min() > 0.0
    np.testing.assert_allclose(found[hit], steps, atol=0.6)


def test_a_given_radius_in_pixels_holds() -> None:
    renderer = Renderer(load("cornell-box"), "gibs", {"surfel_target": 3000, "radius_pixels": 5.5}, size=(64, 64))
    renderer.run(3)
    assert renderer.cache()["radius_pixels"] == pytest.approx(5.5)


@pytest.mark.parametrize("params", [{"view_radius": False}, {"radius": 0.1}])
def test_off_is_one_radius_for_all(params: dict[str, float]) -> None:
    renderer = Renderer(load("cornell-box"), "gibs", {"surfel_target": 3000, **params}, size=(64, 64))
    renderer.run(6)
    assert renderer.compilations == 1, "what a frame leaves is what it began with"
    assert renderer.state.lattice.levels == 1 and not np.array(renderer.state.surfels.size).any()
    assert renderer.cache()["surfel_radius"] == pytest.approx(params.get("radius", 0.1178), rel=0.05)


def test_a_full_cell_takes_no_more_surfels() -> None:
    """One more would be in no list and cover nothing, so each frame would spawn again until the pool is full."""
    counts = {}
    for cell_surfels in (0, 4):
        params = {"cell_surfels": cell_surfels, "surfel_target": 2000, "depth_texels": 0}
        renderer = Renderer(load("cornell-box"), "gibs", params, size=(64, 64))
        renderer.run(48)
        counts[cell_surfels] = renderer.cache()["surfel_count"]
    assert 0 < counts[4] <= counts[0]
