"""Maps over the unit square: a density that integrates to one, points that follow it, and what they learn."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy import stats

from luxel.kernels.sampling import sequence_2d
from luxel.kernels.square_maps import (
    BRIGHTEST,
    CELLS,
    LEAST_KEPT,
    MOST_SAMPLES,
    SIDE,
    SquareMaps,
    cell_of_point,
    learn_samples,
    map_density,
    new_square_maps,
    refresh_maps,
    warp_by_map,
)
from luxel.scene.arrays import from_numpy

SHARE, DOUBT, COUNT = 0.6, 512.0, 3
CALM = mi.Bool(False)


def taught(brought: np.ndarray, rays: int, share: float = SHARE) -> SquareMaps:
    """Return maps; map 1 has learned from `rays` samples, spread evenly, that brought `brought` (CELLS)."""
    maps = new_square_maps(COUNT)
    cell = from_numpy(mi.UInt32, np.arange(rays, dtype=np.uint32) % CELLS)
    square = from_numpy(mi.Float, (brought**2).astype(np.float32)[np.arange(rays) % CELLS])
    maps = learn_samples(maps, dr.full(mi.UInt32, 1, rays), cell, square, dr.full(mi.Bool, True, rays))
    return refresh_maps(maps, mi.Float(share), DOUBT, CALM)


def light(seed: int = 4) -> np.ndarray:
    """Return what samples bring in each cell: much in a few, nothing in some."""
    generator = np.random.default_rng(seed)
    return np.where(generator.random(CELLS) < 0.3, 0.0, np.exp(generator.normal(0.0, 1.0, CELLS)))


def densities(maps: SquareMaps, index: int) -> np.ndarray:
    """Return a map's densities, read through a grid of 4 x 4 points a cell: (4 SIDE, 4 SIDE)."""
    at = (np.arange(4 * SIDE, dtype=np.float32) + 0.5) / (4 * SIDE)
    y, x = (from_numpy(mi.Float, grid.ravel()) for grid in np.meshgrid(at, at, indexing="ij"))
    found = map_density(maps, mi.UInt32(index), cell_of_point(mi.Point2f(x, y)), mi.Bool(True))
    return np.array(found).reshape(4 * SIDE, 4 * SIDE)


def test_the_density_integrates_to_one_and_follows_the_root_mean_square() -> None:
    rays = 64 * CELLS
    brought = light()
    found = densities(taught(brought, rays), 1)
    assert found.mean() == pytest.approx(1.0, abs=1e-5)
    share = SHARE * rays / (rays + DOUBT)
    expected = 1.0 - share + share * brought / brought.mean()
    np.testing.assert_allclose(found[::4, ::4].ravel(), expected, rtol=0.05)
    # Its neighbours have learned nothing.
    for other in (0, 2):
        np.testing.assert_array_equal(densities(taught(brought, rays), other), 1.0)


def test_points_follow_the_density() -> None:
    maps, count = taught(light(), 4096), 200_000
    generator = np.random.default_rng(9)
    sample = mi.Point2f(*(from_numpy(mi.Float, row) for row in generator.random((2, count), dtype=np.float32)))
    point, density = warp_by_map(maps, mi.UInt32(1), sample, mi.Bool(True))
    # Finer than the map's cells: within one, points are spread evenly.
    x, y = np.array(point)
    assert x.min() >= 0.0 and y.min() >= 0.0 and max(x.max(), y.max()) < 1.0
    bins = np.histogram2d(y, x, bins=4 * SIDE, range=((0, 1), (0, 1)))[0]
    expected = densities(maps, 1)
    expected *= count / expected.sum()
    assert stats.chisquare(bins.ravel(), expected.ravel()).pvalue > 1e-3
    read = map_density(maps, mi.UInt32(1), cell_of_point(point), mi.Bool(True))
    assert (np.abs(np.array(read) - np.array(density)) > 1e-6).mean() < 1e-4


def test_a_map_that_knows_nothing_moves_no_point() -> None:
    sample = sequence_2d(dr.arange(mi.UInt32, 4096), (mi.UInt32(5), mi.UInt32(7)))
    point, density = warp_by_map(new_square_maps(COUNT), mi.UInt32(2), sample, mi.Bool(True))
    np.testing.assert_allclose(np.array(point), np.array(sample), atol=1e-6)
    np.testing.assert_array_equal(np.array(density), 1.0)


def test_a_sequence_keeps_its_spread() -> None:
    """The mean weight, known to be one, is nearer to it than with random points by far."""
    maps, count = taught(light(), 8192), 512
    index = dr.arange(mi.UInt32, count)
    errors = []
    for start in range(16):
        shift = (mi.UInt32(start * 0x9E3779B1 & 0xFFFFFFFF), mi.UInt32(start * 0x85EBCA6B & 0xFFFFFFFF))
        _, density = warp_by_map(maps, mi.UInt32(1), sequence_2d(index, shift), mi.Bool(True))
        errors.append(np.mean(1.0 / np.array(density)) - 1.0)
    one = densities(maps, 1)
    random = np.sqrt((np.mean(1.0 / one) - 1.0) / count)
    assert np.sqrt(np.mean(np.square(errors))) < 0.6 * random


def test_few_samples_change_no_map() -> None:
    np.testing.assert_array_equal(densities(taught(light(), 100), 1), 1.0)


def test_no_light_at_all_leaves_a_map_even() -> None:
    np.testing.assert_array_equal(densities(taught(np.zeros(CELLS), 4096), 1), 1.0)


def test_densities_stay_until_much_is_new() -> None:
    maps = taught(np.ones(CELLS), 1024)
    before = densities(maps, 1)
    one = np.zeros(CELLS)
    one[5] = 30.0
    for rays, changed in ((1024, False), (4096, True)):
        square = from_numpy(mi.Float, (one**2).astype(np.float32)[np.arange(rays) % CELLS])
        cell = from_numpy(mi.UInt32, np.arange(rays, dtype=np.uint32) % CELLS)
        more = learn_samples(maps, dr.full(mi.UInt32, 1, rays), cell, square, dr.full(mi.Bool, True, rays))
        more = refresh_maps(more, mi.Float(SHARE), DOUBT, CALM)
        assert (not np.array_equal(densities(more, 1), before)) == changed


def test_an_alarm_halves_what_is_known_down_to_a_rest() -> None:
    maps = taught(light(), 4096)
    known = []
    for _ in range(6):
        maps = refresh_maps(maps, mi.Float(SHARE), DOUBT, mi.Bool(True))
        known.append(int(np.array(maps.learned + maps.fresh)[1]))
    assert known == [2048, 1024, LEAST_KEPT, LEAST_KEPT, LEAST_KEPT, LEAST_KEPT]
    # The sums go down with them.
    assert np.array(maps.sums)[CELLS : 2 * CELLS].sum() == pytest.approx(
        np.array(taught(light(), 4096).sums).sum() / 8, rel=0.01
    )


def test_sums_never_overflow() -> None:
    """What is brightest, in one cell, as often as maps count at all."""
    rays = 15_000
    maps = new_square_maps(COUNT)
    one, here = dr.full(mi.UInt32, 1, rays), dr.full(mi.Bool, True, rays)
    maps = learn_samples(maps, one, one, dr.full(mi.Float, 1e12, rays), here)
    assert np.array(maps.sums).max() == rays * int(BRIGHTEST * 64)
    long = taught(light(), 4 * MOST_SAMPLES)
    assert np.array(long.learned)[1] == MOST_SAMPLES
