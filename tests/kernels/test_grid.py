"""The grid of discs against brute force and a k-d tree."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy import spatial

from luxel.kernels import grid as kernel

LOWER, UPPER = np.array([-1.0, -0.5, 0.0]), np.array([1.5, 1.0, 2.0])
RADIUS, STRETCH = 0.17, 4.0
ROOMY = 1 << 20


def make_discs(count: int, seed: int, reach: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Return (N, 3) float32 positions in the box widened by `reach`, and unit normals, a third of them along axes."""
    rng = np.random.default_rng(seed)
    p = rng.uniform(LOWER - reach, UPPER + reach, (count, 3))
    n = rng.normal(size=(count, 3))
    n[: count // 3] = np.eye(3)[rng.integers(0, 3, count // 3)] * rng.choice([-1.0, 1.0], (count // 3, 1))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    return p.astype(np.float32), n.astype(np.float32)


def build(p: np.ndarray, n: np.ndarray, cell: float, alive: np.ndarray | None = None, capacity: int = ROOMY):
    """Return lattice, starts and items of the discs' grid."""
    lattice = kernel.make_lattice(LOWER, UPPER, cell)
    living = mi.Bool(np.ones(len(p), bool) if alive is None else alive)
    radius, thickness = dr.opaque(mi.Float, RADIUS), dr.opaque(mi.Float, RADIUS / STRETCH)
    grid = kernel.build_grid(lattice, mi.Point3f(p.T), mi.Normal3f(n.T), radius, thickness, living, capacity)
    return lattice, np.array(grid.starts).astype(np.int64), np.array(grid.items)


def cells_of(lattice: kernel.Lattice, points: np.ndarray) -> np.ndarray:
    return np.array(kernel.cell_of_point(lattice, mi.Point3f(points.T.astype(np.float32))))


def answering(points: np.ndarray, p: np.ndarray, n: np.ndarray) -> list[set[int]]:
    """Return for each point the discs whose stretched distance is below the radius: k-d tree, then the exact test."""
    near = spatial.KDTree(p).query_ball_point(points, RADIUS)
    found = []
    for point, candidates in zip(points, near, strict=True):
        offset = point - p[candidates].astype(np.float64)
        off_plane = (offset * n[candidates]).sum(axis=1)
        squared = (offset**2).sum(axis=1) + (STRETCH**2 - 1.0) * off_plane**2
        found.append({int(c) for c, d2 in zip(candidates, squared, strict=True) if d2 < RADIUS**2 * (1.0 - 1e-5)})
    return found


@pytest.mark.parametrize("cell_in_radii", [0.4, 1.0, 2.5])
@pytest.mark.parametrize("reach", [0.0, 0.6])
def test_every_disc_is_listed_where_it_answers(cell_in_radii: float, reach: float) -> None:
    """With a reach, discs and points also lie outside the lattice, where border cells stand for everything beyond."""
    p, n = make_discs(1500, 1, reach)
    lattice, starts, items = build(p, n, cell_in_radii * RADIUS)
    rng = np.random.default_rng(2)
    # Half of the points are near discs' rims and planes, where a missing cell would show.
    random = rng.uniform(LOWER - reach, UPPER + reach, (1500, 3))
    beside = p + rng.normal(size=p.shape) * 0.4 * RADIUS
    points = np.concatenate([random, beside]).astype(np.float32)
    wanted = answering(points, p, n)
    assert sum(map(len, wanted)) > 1000
    for cell, needed in zip(cells_of(lattice, points), wanted, strict=True):
        assert needed <= set(items[starts[cell] : starts[cell + 1]].tolist())


def test_lists_hold_no_disc_twice_and_none_that_is_dead() -> None:
    p, n = make_discs(800, 3)
    alive = np.random.default_rng(4).random(800) < 0.6
    lattice, starts, items = build(p, n, RADIUS, alive)
    assert starts[0] == 0 and (np.diff(starts) >= 0).all() and len(starts) == lattice.cell_count + 1
    for first, last in zip(starts[:-1], starts[1:], strict=True):
        assert len(set(items[first:last])) == last - first
    assert alive[np.unique(items[: starts[-1]])].all()
    assert set(np.unique(items[: starts[-1]])) == set(np.flatnonzero(alive))


def test_no_disc_is_listed_in_an_inner_cell_that_it_cannot_touch() -> None:
    """The ellipsoid's box and the slab around its plane bound it; a tilted flat disc fills little of its box."""
    p, n = make_discs(150, 5)
    lattice, starts, items = build(p, n, 0.12 * RADIUS)
    dims = np.array([lattice.nx, lattice.ny, lattice.nz])
    size = 1.0 / float(np.array(lattice.inverse_size)[0])
    origin = np.array([float(np.array(c)[0]) for c in lattice.lower])
    cell = np.repeat(np.arange(lattice.cell_count), np.diff(starts))
    place = np.stack([cell % dims[0], cell // dims[0] % dims[1], cell // (dims[0] * dims[1])], axis=1)
    inner = ((place > 0) & (place < dims - 1)).all(axis=1)
    disc = items[: starts[-1]][inner]
    offset = origin + (place[inner] + 0.5) * size - p[disc].astype(float)
    normal = n[disc].astype(float)
    extent = np.sqrt(RADIUS**2 * (1.0 - normal**2) + (RADIUS / STRETCH) ** 2 * normal**2)
    assert (np.abs(offset) <= extent + 0.501 * size).all()
    slab = RADIUS / STRETCH + 0.5 * size * np.abs(normal).sum(axis=1)
    assert (np.abs((offset * normal).sum(axis=1)) <= slab + 1e-4 * size).all()
    all_extent = np.sqrt(RADIUS**2 * (1.0 - n.astype(float) ** 2) + (RADIUS / STRETCH) ** 2 * n.astype(float) ** 2)
    assert len(disc) < 0.75 * np.prod(2.0 * all_extent / size, axis=1).sum()


def test_overflow_leaves_items_out_and_corrupts_nothing() -> None:
    p, n = make_discs(1000, 6)
    _, full_starts, full_items = build(p, n, RADIUS)
    capacity = int(full_starts[-1]) // 3
    _, starts, items = build(p, n, RADIUS, capacity=capacity)
    assert len(items) == capacity and starts.max() == capacity
    np.testing.assert_array_equal(starts, np.minimum(full_starts, capacity))
    for cell in range(len(starts) - 1):
        kept = set(items[starts[cell] : starts[cell + 1]].tolist())
        assert kept <= set(full_items[full_starts[cell] : full_starts[cell + 1]].tolist())
        assert len(kept) == starts[cell + 1] - starts[cell]


def test_an_empty_grid_lists_nothing() -> None:
    p, n = make_discs(64, 7)
    _, starts, _ = build(p, n, RADIUS, np.zeros(64, bool))
    assert not starts.any()


def test_points_outside_belong_to_the_nearest_cell() -> None:
    lattice = kernel.make_lattice(LOWER, UPPER, 0.5)
    points = np.random.default_rng(8).uniform(LOWER - 3.0, UPPER + 3.0, (500, 3))
    inside = np.clip(points, LOWER + 1e-4, UPPER - 1e-4)
    np.testing.assert_array_equal(cells_of(lattice, points), cells_of(lattice, inside))


def test_cells_grow_where_there_would_be_too_many() -> None:
    lattice = kernel.make_lattice(np.zeros(3), np.array([1000.0, 700.0, 3.0]), 0.01)
    assert lattice.cell_count <= kernel.CELL_LIMIT
    corners = np.array([[0.0, 0.0, 0.0], [1000.0, 700.0, 3.0]])
    first, last = cells_of(lattice, corners)
    assert first == 0 and last == lattice.cell_count - 1
