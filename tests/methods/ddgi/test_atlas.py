"""Blocks of octahedral texels: their gutter, their look-ups, and what half floats keep."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.methods.ddgi.atlas import (
    Footprint,
    block_size,
    interior_of,
    lobe,
    pack_depth,
    pack_irradiance,
    read_color,
    read_moments,
    texel_direction,
)


def sphere(count: int, seed: int = 1) -> np.ndarray:
    d = np.random.default_rng(seed).normal(size=(count, 3))
    return (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)


def packed(values: np.ndarray, resolution: int, half: bool, scale: float = 1.0):
    """Return the atlas of one probe whose interior texels hold `values` in all three channels."""
    mean = mi.Color3f(mi.Float(values.astype(np.float32)))
    return pack_irradiance(mean, mi.Float(scale), resolution, 1, half)


def look_up(atlas, half: bool, directions: np.ndarray, resolution: int) -> np.ndarray:
    footprint = Footprint(mi.Vector3f(directions.T), resolution)
    block = dr.zeros(mi.UInt32, len(directions))
    return np.array(read_color(atlas, half, block, footprint, mi.Bool(True)))[0]


@pytest.mark.parametrize("resolution", [2, 3, 8, 16])
def test_the_gutter_repeats_the_octahedral_neighbours(resolution: int) -> None:
    """Majercik et al. 2019: mirrored along each border, opposite at the corners."""
    side, last = resolution + 2, resolution - 1
    shown = np.array(interior_of(dr.arange(mi.UInt32, side * side), resolution)).reshape(side, side)
    inner = np.arange(resolution**2).reshape(resolution, resolution)
    np.testing.assert_array_equal(shown[1:-1, 1:-1], inner)
    np.testing.assert_array_equal(shown[0, 1:-1], inner[0, ::-1])
    np.testing.assert_array_equal(shown[-1, 1:-1], inner[-1, ::-1])
    np.testing.assert_array_equal(shown[1:-1, 0], inner[::-1, 0])
    np.testing.assert_array_equal(shown[1:-1, -1], inner[::-1, -1])
    corners = [shown[0, 0], shown[0, -1], shown[-1, 0], shown[-1, -1]]
    assert corners == [inner[last, last], inner[last, 0], inner[0, last], inner[0, 0]]


@pytest.mark.parametrize("half", [True, False])
@pytest.mark.parametrize("resolution", [2, 8, 16])
def test_texel_directions_hit_their_own_texel(resolution: int, half: bool) -> None:
    values = np.random.default_rng(2).integers(1, 1000, resolution**2)
    directions = np.array(texel_direction(dr.arange(mi.UInt32, resolution**2), resolution)).T
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, atol=1e-6)
    found = look_up(packed(values, resolution, half), half, directions, resolution)
    np.testing.assert_allclose(found, values, atol=2e-2, rtol=1e-4)


@pytest.mark.parametrize("resolution", [2, 8])
def test_look_ups_are_continuous_over_the_whole_sphere(resolution: int) -> None:
    values = np.random.default_rng(3).uniform(0.0, 1.0, resolution**2)
    atlas = packed(values, resolution, half=False)
    d = sphere(60000)
    # A third of them within a hair of the fold: the great circles where a component is zero.
    thin = np.arange(len(d)) % 3 == 0
    d[thin, np.arange(thin.sum()) % 3] *= 1e-4
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    eps = 1e-3
    near = d + eps * sphere(60000, 4)
    near /= np.linalg.norm(near, axis=1, keepdims=True)
    jump = np.abs(look_up(atlas, False, d, resolution) - look_up(atlas, False, near.astype(np.float32), resolution))
    # The map's steepest stretch is about 2.2 squares a radian, half a square is `resolution / 2` texels.
    assert jump.max() < 4.0 * eps * resolution
    assert look_up(atlas, False, d, resolution).max() <= values.max() + 1e-6


def test_the_weights_are_an_average() -> None:
    footprint = Footprint(mi.Vector3f(sphere(5000).T), 8)
    weights = np.stack([np.array(w) for w in footprint.weights])
    assert weights.min() >= -1e-6
    np.testing.assert_allclose(weights.sum(axis=0), 1.0, atol=1e-6)
    assert max(int(np.array(slot).max()) for slot in footprint.slots) < block_size(8)


def test_half_floats_keep_three_digits_at_any_level_of_light() -> None:
    values = np.random.default_rng(5).uniform(0.5, 2.0, 64)
    d = sphere(2000)
    for level in (1e-6, 1e-3, 1.0, 1e4, 1e9):
        exact = look_up(packed(values * level, 8, False, level), False, d, 8)
        half = look_up(packed(values * level, 8, True, level), True, d, 8)
        np.testing.assert_allclose(half, exact, rtol=1e-3)
    assert np.isfinite(look_up(packed(values * 1e9, 8, True, 1.0), True, d, 8)).all(), "clipped, not infinite"


@pytest.mark.parametrize("half", [True, False])
def test_moments_by_the_law_of_total_variance(half: bool) -> None:
    rng = np.random.default_rng(6)
    mean, deviation = rng.uniform(1.0, 5.0, 64), rng.uniform(0.0, 0.5, 64)
    arrays = [mi.Float(v.astype(np.float32)) for v in (mean, deviation**2, np.ones(64))]
    atlas = pack_depth(arrays[0], arrays[1], arrays[2], lambda _: mi.Float(9.0), 8, 1, half)
    footprint = Footprint(mi.Vector3f(sphere(3000).T), 8)
    found_mean, found_variance = read_moments(atlas, half, dr.zeros(mi.UInt32, 3000), footprint, mi.Bool(True))
    texel = np.stack([np.array(interior_of(slot, 8)) for slot in footprint.slots])
    w = np.stack([np.array(weight) for weight in footprint.weights]).astype(float)
    expected = (w * mean[texel]).sum(axis=0)
    spread = (w * (deviation[texel] ** 2 + mean[texel] ** 2)).sum(axis=0) - expected**2
    np.testing.assert_allclose(np.array(found_mean), expected, rtol=1e-3)
    np.testing.assert_allclose(np.array(found_variance), spread, rtol=2e-2, atol=2e-4)


def test_small_variances_survive_far_away() -> None:
    """A wall at 60 m with a deviation of 5 cm: squares would cancel in half floats."""
    arrays = [mi.Float(np.full(64, v, np.float32)) for v in (60.0, 0.05**2, 1.0)]
    atlas = pack_depth(arrays[0], arrays[1], arrays[2], lambda _: mi.Float(9.0), 8, 1, half=True)
    footprint = Footprint(mi.Vector3f(sphere(100).T), 8)
    _, variance = read_moments(atlas, True, dr.zeros(mi.UInt32, 100), footprint, mi.Bool(True))
    np.testing.assert_allclose(np.sqrt(np.array(variance)), 0.05, rtol=0.01)


def test_what_saw_nothing_is_open() -> None:
    zeros = dr.zeros(mi.Float, 2 * 64)
    reach = mi.Float(np.array([3.0, 7.0], np.float32))
    atlas = pack_depth(zeros, zeros, zeros, lambda probe: dr.gather(mi.Float, reach, probe), 8, 2, half=False)
    rows = np.array(atlas).reshape(2, 100, 2)
    assert (rows[0] == (3.0, 0.0)).all() and (rows[1] == (7.0, 0.0)).all()


@pytest.mark.parametrize("sharpness", [1, 2, 7, 50, 1000])
def test_the_lobe_is_a_power_cut_at_a_thousandth(sharpness: int) -> None:
    cosine = np.linspace(-1.0, 1.0, 501)
    expected = np.maximum(cosine, 0.0) ** sharpness
    found = np.array(lobe(mi.Float(cosine.astype(np.float32)), sharpness))
    clear = np.abs(expected - 1e-3) > 1e-5
    np.testing.assert_allclose(found[clear], np.where(expected > 1e-3, expected, 0.0)[clear], rtol=2e-4)
