"""The grid of discs of many sizes against a k-d tree: each is listed on its level, and readers miss none."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy import spatial

from luxel.kernels import grid as kernel

LEVELS, LARGEST, FLATNESS = 6, 0.4, 0.25


def make_discs(count: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return positions (N, 3) in a box of 3 m, unit normals, levels, and radii of each level's upper half."""
    rng = np.random.default_rng(seed)
    n = rng.normal(size=(count, 3))
    level = rng.integers(0, LEVELS, count)
    radius = LARGEST * 0.5**level * rng.uniform(0.5, 1.0, count)
    place = rng.uniform(-1.5, 1.5, (count, 3))
    return place.astype(np.float32), (n / np.linalg.norm(n, axis=1)[:, None]).astype(np.float32), level, radius


def build(p: np.ndarray, n: np.ndarray, level: np.ndarray, radius: np.ndarray, room_for: int, cell: float = 1.0):
    """Return the lattice and the grid."""
    shifts = np.random.default_rng(8).random((LEVELS, 3))
    lattice = kernel.make_lattice(LARGEST, cell, room_for, shifts)
    size = mi.Float(radius.astype(np.float32))
    words = mi.UInt32(level.astype(np.uint32))
    grid = kernel.build_grid(
        lattice, mi.Point3f(p.T), mi.Normal3f(n.T), size, size * FLATNESS, mi.Bool(True), 1 << 19, level=words
    )
    return lattice, grid


def listed(lattice: kernel.Lattice, grid: kernel.Grid, points: np.ndarray) -> list[set[tuple[int, int]]]:
    """Return the (level, disc) pairs that a reader of the present levels comes upon, for each point."""
    where = mi.Point3f(points.T)
    masks = np.array(kernel.levels_at(lattice, grid, where, mi.Bool(True)))
    starts, items = np.array(grid.starts), np.array(grid.items)
    found: list[set[tuple[int, int]]] = [set() for _ in points]
    for level in range(LEVELS):
        slots = np.array(kernel.slot_of_point(lattice, where, mi.UInt32(level)))
        for index, slot in enumerate(slots):
            if masks[index] >> level & 1:
                found[index] |= {(level, int(disc)) for disc in items[starts[slot] : starts[slot + 1]]}
    return found


@pytest.mark.parametrize(("room_for", "cell"), [(4000, 1.0), (8, 1.0), (4000, 0.4), (4000, 2.5)])
def test_a_reader_of_the_present_levels_misses_no_disc(room_for: int, cell: float) -> None:
    p, n, level, radius = make_discs(4000, 1)
    lattice, grid = build(p, n, level, radius, room_for, cell)
    rng = np.random.default_rng(2)
    # Half of the points lie beside small discs, near their rims.
    beside = p[level >= 3][:400] + rng.normal(size=(400, 3)) * 0.5 * radius[level >= 3][:400, None]
    points = np.concatenate([rng.uniform(-1.5, 1.5, (400, 3)), beside]).astype(np.float32)
    found = listed(lattice, grid, points)
    near = spatial.KDTree(p).query_ball_point(points, LARGEST)
    expected = 0
    for point, held, candidates in zip(points, found, near, strict=True):
        ids = np.array(candidates, int)
        offset = point.astype(float) - p[ids]
        off_plane = (offset * n[ids]).sum(axis=1)
        inside = (offset**2).sum(axis=1) + (FLATNESS**-2 - 1.0) * off_plane**2 < radius[ids] ** 2 * (1.0 - 1e-5)
        wanted = {(int(level[disc]), int(disc)) for disc in ids[inside]}
        expected += len(wanted)
        assert wanted <= held
    assert expected > 500


def test_small_discs_have_short_lists() -> None:
    """A floor of discs of 1.25 cm where the largest have 40: a reader meets few. One level: a third of all."""
    rng = np.random.default_rng(3)
    count = 4000
    p = np.zeros((count, 3), np.float32)
    p[:, :2] = rng.uniform(0.0, 0.7, (count, 2))
    n = np.tile(np.array([0, 0, 1], np.float32), (count, 1))
    level = np.full(count, 5)
    lattice, grid = build(p, n, level, LARGEST * 0.5**level * 1.0, 8000)
    sizes = [len(held) for held in listed(lattice, grid, p[:50])]
    assert 4 < np.mean(sizes) < 60
    assert np.mean(sizes) < 0.02 * count


def test_absent_levels_are_not_read() -> None:
    p, n, level, radius = make_discs(500, 4)
    keep = (level == 1) | (level == 4)
    lattice, grid = build(p[keep], n[keep], level[keep], radius[keep], 4000)
    masks = np.array(kernel.levels_at(lattice, grid, mi.Point3f(p[keep].T), mi.Bool(True)))
    assert not (masks & ~np.uint32(0b10010)).any() and (masks >> 1 & 1).any() and (masks >> 4 & 1).any()
    away = mi.Point3f(np.array([[900.0, 800.0, 700.0]], np.float32).T)
    assert np.array(kernel.levels_at(lattice, grid, away, mi.Bool(True)))[0] == 0


@pytest.mark.parametrize("bits", [0b1, 0b1000, 0b1011, 0x80000000])
def test_the_finest_level_is_the_highest_bit(bits: int) -> None:
    assert np.array(kernel.finest_level(dr.opaque(mi.UInt32, bits)))[0] == bits.bit_length() - 1
