"""Rays that go where light was found: the same light as without, with less noise."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.kernels.sampling import hash_pair
from luxel.kernels.square_maps import CELLS, SquareMaps, learn_samples, new_square_maps, refresh_maps
from luxel.methods.gibs.budget import plan_rays
from luxel.methods.gibs.directions import choose_direction
from luxel.methods.gibs.guiding import find_guide, map_count, nearest_of_26, turned_axes
from luxel.methods.gibs.normal_light import square_of_widened, widened_hemisphere
from luxel.methods.gibs.params import EKBERG
from luxel.methods.gibs.surfels import GibsState
from luxel.methods.gibs.trace import trace_surfels
from luxel.render.renderer import Renderer
from luxel.scene import load
from luxel.scene.arrays import from_numpy, vectors_from_numpy
from luxel.scene.library.shapes import quad
from luxel.scene.model import Camera, Material, Object, SceneData, Sky

SMALL = {"surfel_target": 600}
FINE = {"surfel_target": 4000, "radius_pixels": 1.0, "hit_spawn_threshold": 0.0, "depth_texels": 0, "share_rays": False}
"""Surfels close enough to share a map, and nothing else that takes time."""


@pytest.mark.parametrize("share", [0.0, 0.1, 0.7])
def test_squares_fold_to_hemispheres_and_back(share: float) -> None:
    sample = np.random.default_rng(3).random((2, 2000), dtype=np.float32)
    local = widened_hemisphere(mi.Point2f(*(from_numpy(mi.Float, row) for row in sample)), mi.Float(share))
    found = np.array(square_of_widened(local, mi.Float(share)))
    # Next to the pole a hair of the cosine is far on the disc.
    away = np.array(local)[2] < 0.999
    np.testing.assert_allclose(found[:, away], sample[:, away], atol=2e-3)


def directions(count: int) -> np.ndarray:
    found = np.random.default_rng(8).normal(size=(count, 3))
    found[: count // 4] = np.round(found[: count // 4])
    found = found[np.linalg.norm(found, axis=1) > 0.0]
    return (found / np.linalg.norm(found, axis=1)[:, None]).astype(np.float32)


def test_frames_are_right_angled_and_alike_for_normals_alike() -> None:
    """Walls have normals with components of next to nothing, of either sign."""
    n = directions(4000)
    nudged = n + np.random.default_rng(2).normal(size=n.shape).astype(np.float32) * 1e-6
    frames, facing = [], []
    for normals in (n, nudged):
        unit = mi.Normal3f(vectors_from_numpy(mi.Vector3f, normals))
        q = nearest_of_26(unit)
        s, t = (np.array(axis).T for axis in turned_axes(q, unit))
        for one, other, cosine in ((s, s, 1), (t, t, 1), (s, t, 0), (s, normals, 0), (t, normals, 0)):
            np.testing.assert_allclose((one * other).sum(axis=1), cosine, atol=1e-5)
        frames.append(np.concatenate([s, t], axis=1))
        facing.append(np.array(q).T)
    same = (facing[0] == facing[1]).all(axis=1)
    assert same.mean() > 0.99
    np.testing.assert_allclose(frames[0][same], frames[1][same], atol=1e-4)
    assert len(np.unique(facing[0], axis=0)) == 26
    # The nearest of the 26, or next to that.
    cosine = (facing[0] * n).sum(axis=1) / np.linalg.norm(facing[0], axis=1)
    assert cosine.min() > np.cos(np.radians(36.0))


def spotted_sky() -> np.ndarray:
    """A dim sky with a bright spot in it, (32, 64, 3)."""
    image = np.full((32, 64, 3), 0.2, np.float32)
    image[6:8, 20:23] = 60.0
    return image


def plain() -> SceneData:
    floor = Object("floor", [quad((-2, 0, 2), (2, 0, 2), (2, 0, -2), (-2, 0, -2), 0)])
    camera = Camera((0.0, 2.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, -1.0), fov=60.0)
    return SceneData("plain", [floor], [Material()], cameras=[camera], sky=Sky((1.0, 1.0, 1.0), spotted_sky()))


def uneven_maps(count: int) -> SquareMaps:
    """Return maps that all have learned one uneven thing from many samples."""
    brought = np.exp(np.random.default_rng(5).normal(0.0, 1.3, CELLS)).astype(np.float32)
    rays = 64 * CELLS
    lane = np.arange(count * rays, dtype=np.uint32)
    square = from_numpy(mi.Float, brought[lane % CELLS] ** 2)
    maps = learn_samples(
        new_square_maps(count), from_numpy(mi.UInt32, lane // rays), from_numpy(mi.UInt32, lane % CELLS), square,
        dr.full(mi.Bool, True, len(lane)),
    )  # fmt: skip
    return refresh_maps(maps, mi.Float(0.8), 1.0, mi.Bool(False))


@pytest.mark.parametrize("normal_light", [False, True])
@pytest.mark.parametrize("sky_share", [0.0, 0.5])
def test_one_over_the_density_sums_to_solid_angles(normal_light: bool, sky_share: float) -> None:
    """Over each patch of the hemisphere, the mean of 1 / density is its solid angle, whichever chose the directions."""
    params = {**SMALL, "sky_share": sky_share, "even_share": 0.2}
    renderer = Renderer(plain(), "gibs", params, size=(16, 16))
    state: GibsState = renderer.state
    state = replace(state, guide=uneven_maps(64), settings=replace(state.settings, normal_light=normal_light))
    count, n = 400_000, mi.Normal3f(0.28, 0.96, 0.0)
    words = hash_pair(dr.arange(mi.UInt32, count), mi.UInt32(6))
    guide = find_guide(state, mi.Point3f(0.3, 0.0, 0.2), n, mi.UInt32(0))
    chosen = choose_direction(renderer.scene, state, n, *words, mi.Bool(True), guide)
    direction, weight = np.array(chosen.direction).T, np.array(chosen.weight)
    assert chosen.guided is not None and np.array(chosen.guided.gain).std() > 0.2
    cosine = direction @ np.array([0.28, 0.96, 0.0])
    inverse = np.where(weight > 0.0, np.pi * weight / np.maximum(cosine, 1e-9), 0.0)
    # Patches of one solid angle: equal steps of the cosine, from 0.1, and of the angle about the normal.
    rings, sectors = 6, 16
    across, up = np.cross([0.28, 0.96, 0.0], [0.0, 0.0, 1.0]), np.array([0.0, 0.0, 1.0])
    sector = (np.arctan2(direction @ up, direction @ across) / (2 * np.pi) % 1.0 * sectors).astype(int) % sectors
    ring = np.floor((cosine - 0.1) / 0.9 * rings).astype(int)
    for patch in range(rings * sectors):
        value = np.where((ring == patch // sectors) & (sector == patch % sectors), inverse, 0.0)
        error = value.std() / np.sqrt(count)
        assert value.mean() == pytest.approx(2 * np.pi * 0.9 / (rings * sectors), abs=4.5 * error)
    # Both weights are 1 on average.
    for one in (weight, np.array(chosen.control)):
        assert one.mean() == pytest.approx(1.0, abs=4.0 * one.std() / np.sqrt(count) + 1e-5)


@cache
def pictures(scene: str, share: float, frames: int, seeds: int) -> np.ndarray:
    """Return the indirect light at the pixels that show something, (seeds, N)."""
    found = []
    params = {**(FINE if scene == "opening" else SMALL), "guide_share": share}
    for seed in range(seeds):
        renderer = Renderer(scene, "gibs", params, size=(40, 40), seed=seed)
        renderer.run(frames)
        layers = renderer.layers()
        found.append(layers.indirect.mean(axis=2)[layers.hit])
    return np.stack(found)


def test_the_opening_has_the_same_light() -> None:
    plain, guided = (pictures("opening", share, 32, 4) for share in (0.0, 0.5))
    means = [images.mean(axis=1) for images in (plain, guided)]
    error = np.sqrt(sum(mean.var(ddof=1) / len(mean) for mean in means))
    assert abs(means[0].mean() - means[1].mean()) < 3.0 * error
    assert error < 0.06 * means[0].mean()


def rays_of(renderer: Renderer, state: GibsState) -> np.ndarray:
    """Return what random rays bring to each living surfel of one and the same cache, (192, surfels)."""
    found = []
    alive = np.array(state.surfels.object_id) != 0
    plan = plan_rays(state, mi.UInt32(0))
    for turn in range(48):
        surfels = replace(state.surfels, ray_index=state.surfels.ray_index + 1000 * turn)
        brought = trace_surfels(renderer.scene, replace(state, surfels=surfels), plan).irradiance
        found.append(np.array(brought).mean(axis=0).reshape(-1, state.settings.rays_per_surfel)[alive])
    return np.concatenate([part.T for part in found]).astype(np.float64)


def test_guided_rays_bring_the_same_with_less_noise() -> None:
    renderer = Renderer("opening", "gibs", FINE, size=(40, 40), seed=1)
    renderer.run(48)
    state: GibsState = renderer.state
    state = replace(state, settings=replace(state.settings, low_discrepancy=False))
    guided, plain = rays_of(renderer, state), rays_of(renderer, replace(state, guide=None))
    noise = [rays.var(axis=0, ddof=1).sum() for rays in (guided, plain)]
    error = np.sqrt(sum(noise) / len(plain)) / plain.shape[1]
    assert abs(guided.mean() - plain.mean()) < 3.0 * error < 0.06 * plain.mean()
    assert noise[0] < 0.85 * noise[1]


@pytest.mark.parametrize(("scene", "within"), [("furnace", 0.012), ("sphere", 0.02)])
def test_known_light_stays_with_nearly_all_rays_guided(scene: str, within: float) -> None:
    known = load(scene).facts["indirect_irradiance"]
    assert pictures(scene, 0.9, 96, 1).mean() == pytest.approx(known, rel=within)


def test_maps_learn_and_a_pool_has_enough_of_them() -> None:
    renderer = Renderer("opening", "gibs", SMALL, size=(32, 32))
    renderer.run(24)
    state: GibsState = renderer.state
    assert state.guide is not None
    count = map_count(state.settings.capacity)
    assert dr.width(state.guide.fresh) == count and count & (count - 1) == 0
    assert (np.array(state.guide.densities) != 1.0).any()


def test_a_share_of_none_has_no_maps() -> None:
    assert EKBERG["guide_share"] == 0.0
    renderer = Renderer("furnace", "gibs", {**SMALL, "guide_share": 0.0}, size=(16, 16))
    renderer.run(1)
    assert renderer.state.guide is None
