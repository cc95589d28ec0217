"""The grid of discs against brute force and a k-d tree: near the origin, far from it, and in a crowded table."""

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
NEAR_RIM = RADIUS**2 * (1.0 - 1e-5)


def make_discs(count: int, seed: int, reach: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Return (N, 3) float32 positions in the box widened by `reach`, and unit normals, a third of them along axes."""
    rng = np.random.default_rng(seed)
    p = rng.uniform(LOWER - reach, UPPER + reach, (count, 3))
    n = rng.normal(size=(count, 3))
    n[: count // 3] = np.eye(3)[rng.integers(0, 3, count // 3)] * rng.choice([-1.0, 1.0], (count // 3, 1))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    return p.astype(np.float32), n.astype(np.float32)


def build(
    p: np.ndarray, n: np.ndarray, cell_in_radii: float = 1.0, alive: np.ndarray | None = None, capacity: int = ROOMY,
    room_for: int = 2000, keys: np.ndarray | None = None, longest: int = 0,
):  # fmt: skip
    """Return lattice, starts and items of the discs' grid, in a table for `room_for` of them."""
    lattice = kernel.make_lattice(RADIUS, cell_in_radii, room_for, np.array([0.3, 0.7, 0.1]))
    living = mi.Bool(np.ones(len(p), bool) if alive is None else alive)
    radius, thickness = dr.opaque(mi.Float, RADIUS), dr.opaque(mi.Float, RADIUS / STRETCH)
    order = None if keys is None else mi.UInt32(keys)
    grid = kernel.build_grid(
        lattice, mi.Point3f(p.T), mi.Normal3f(n.T), radius, thickness, living, capacity, order, longest
    )
    return lattice, np.array(grid.starts).astype(np.int64), np.array(grid.items)


def slots_of(lattice: kernel.Lattice, points: np.ndarray) -> np.ndarray:
    return np.array(kernel.slot_of_point(lattice, mi.Point3f(points.T.astype(np.float32))))


def stretched(point: np.ndarray, p: np.ndarray, n: np.ndarray) -> np.ndarray:
    """Return the squared distances of a point to discs, those off their planes stretched, in float64."""
    offset = point.astype(np.float64) - p.astype(np.float64)
    off_plane = (offset * n).sum(axis=1)
    return (offset**2).sum(axis=1) + (STRETCH**2 - 1.0) * off_plane**2


def answering(points: np.ndarray, p: np.ndarray, n: np.ndarray) -> list[list[int]]:
    """Return for each point the discs whose stretched distance is below the radius: k-d tree, then the exact test."""
    near = spatial.KDTree(p.astype(np.float64)).query_ball_point(points.astype(np.float64), RADIUS)
    return [
        sorted(np.array(c)[stretched(point, p[c], n[c]) < NEAR_RIM].tolist()) if c else []
        for point, c in zip(points, near, strict=True)
    ]


def listed(lattice: kernel.Lattice, starts: np.ndarray, items: np.ndarray, points, p, n) -> list[list[int]]:
    """Return the same by the grid: what a look-up reads, less what its distance test throws out."""
    found = []
    for point, slot in zip(points, slots_of(lattice, points), strict=True):
        ids = items[starts[slot] : starts[slot + 1]]
        found.append(sorted(ids[stretched(point, p[ids], n[ids]) < NEAR_RIM].tolist()))
    return found


@pytest.mark.parametrize("room_for", [2000, 8])
@pytest.mark.parametrize("cell_in_radii", [0.25, 0.4, 1.0, 2.5, 16.0])
@pytest.mark.parametrize("away", [0.0, -300.0, 2e4, -3e6])
def test_a_look_up_finds_what_a_tree_finds_and_each_disc_once(away: float, cell_in_radii: float, room_for: int) -> None:
    """In a table for eight discs nearly all slots are shared. At 3,000 km float32 knows quarters of a metre."""
    p, n = make_discs(1500, 1)
    rng = np.random.default_rng(2)
    # Half of the points are near discs' rims and planes, where a missing cell would show.
    random = rng.uniform(LOWER, UPPER, (700, 3))
    beside = p[:700] + rng.normal(size=(700, 3)) * 0.4 * RADIUS
    shift = away * np.array([1.0, -0.3, 0.7])
    p = (p + shift).astype(np.float32)
    points = (np.concatenate([random, beside]) + shift).astype(np.float32)
    wanted = answering(points, p, n)
    assert sum(map(len, wanted)) > 1000
    assert listed(*build(p, n, cell_in_radii, room_for=room_for), points, p, n) == wanted


def test_discs_beyond_all_cells_are_found_too() -> None:
    """Past 2^30 cells all share the last one; what is not a number is listed nowhere and harms nobody."""
    _, n = make_discs(6, 9)
    p = np.array([[4e9, 0, 0], [4e9, 1, 0], [-4e9, 0, 0], [1e30, -1e30, 0], [np.inf, 0, 0], [np.nan, 0, 0]], np.float32)
    lattice, starts, items = build(p, n)
    found = [set(items[starts[s] : starts[s + 1]].tolist()) for s in slots_of(lattice, p[:4])]
    assert all(disc in ids for disc, ids in enumerate(found))


@pytest.mark.parametrize("room_for", [800, 8])
def test_lists_hold_no_disc_twice_and_none_that_is_dead(room_for: int) -> None:
    p, n = make_discs(800, 3)
    alive = np.random.default_rng(4).random(800) < 0.6
    lattice, starts, items = build(p, n, alive=alive, room_for=room_for)
    assert starts[0] == 0 and (np.diff(starts) >= 0).all() and len(starts) == lattice.slot_count + 1
    for first, last in zip(starts[:-1], starts[1:], strict=True):
        assert len(set(items[first:last])) == last - first
    assert set(np.unique(items[: starts[-1]])) == set(np.flatnonzero(alive))


@pytest.mark.parametrize("cell_in_radii", [0.25, 1.0])
def test_few_discs_are_listed_in_cells_that_they_do_not_touch(cell_in_radii: float) -> None:
    """Points strewn through each disc's ellipsoid hit the cells that it must be in; their box would be far more."""
    p, n = make_discs(60, 5)
    _, starts, _ = build(p, n, cell_in_radii)
    rng = np.random.default_rng(6)
    ball = rng.normal(size=(40_000, 3))
    ball *= (rng.random(40_000) ** (1 / 3) * RADIUS / np.linalg.norm(ball, axis=1))[:, None]
    touched = 0
    for place, normal in zip(p.astype(float), n.astype(float), strict=True):
        inside = place + ball - (1.0 - 1.0 / STRETCH) * (ball @ normal)[:, None] * normal
        cells = np.floor(inside / (cell_in_radii * RADIUS) + [0.3, 0.7, 0.1])
        touched += len(np.unique(cells, axis=0))
    assert touched <= starts[-1] < 1.35 * touched


@pytest.mark.parametrize("extent", [10.0, 2000.0])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_cells_spread_over_the_table_however_wide_the_ground(extent: float, axis: int) -> None:
    """Blocks of a plane are strewn like dice: as many slots in use as chance gives, less a tenth, and no long lists."""
    rng = np.random.default_rng(7)
    cell = 0.05
    corners = rng.uniform(-extent / 2, extent / 2, (300, 3))
    offsets = np.stack(np.meshgrid(np.arange(8), np.arange(8), [0]), axis=-1).reshape(-1, 3) * cell
    points = np.roll((corners[:, None] * [1, 1, 0] + offsets).reshape(-1, 3), axis, axis=1)
    lattice = kernel.make_lattice(0.05, 1.0, 16_384)
    cells = len(np.unique(np.floor(points.astype(np.float32) / np.float32(cell)), axis=0))
    _, counts = np.unique(slots_of(lattice, points), return_counts=True)
    assert lattice.slot_count == 65_536
    assert len(counts) > 0.9 * lattice.slot_count * (1.0 - np.exp(-cells / lattice.slot_count))


def test_overflow_leaves_whole_lists_out_and_corrupts_nothing() -> None:
    p, n = make_discs(1000, 6)
    _, full_starts, full_items = build(p, n)
    capacity = int(full_starts[-1]) // 3
    _, starts, items = build(p, n, capacity=capacity)
    listed = full_starts[full_starts <= capacity].max()
    np.testing.assert_array_equal(starts, np.minimum(full_starts, listed))
    np.testing.assert_array_equal(items[:listed], full_items[:listed])


@pytest.mark.parametrize("longest", [0, 1, 5])
@pytest.mark.parametrize("room_for", [8, 40_000])
def test_lists_hold_the_first_discs_by_key_in_the_order_of_keys(longest: int, room_for: int) -> None:
    """As NumPy sorts them, by key and among alike keys by id, whatever the threads did; so twice the same."""
    p, n = make_discs(30_000, 11, reach=1.0)
    keys = np.random.default_rng(12).integers(0, 5000, len(p)).astype(np.uint32)
    _, all_starts, all_items = build(p, n, room_for=room_for)
    _, starts, items = build(p, n, room_for=room_for, keys=keys, longest=longest)
    slot = np.repeat(np.arange(len(all_starts) - 1), np.diff(all_starts))
    found = all_items[: all_starts[-1]]
    order = np.lexsort((found, keys[found], slot))
    rank = np.arange(len(order)) - all_starts[slot]
    kept = rank < (longest or len(order))
    np.testing.assert_array_equal(np.diff(starts), np.minimum(np.diff(all_starts), longest or len(order)))
    np.testing.assert_array_equal(items[: starts[-1]], found[order][kept])
    assert longest != 5 or (~kept).sum() > 100


def test_an_empty_grid_lists_nothing() -> None:
    p, n = make_discs(64, 7)
    _, starts, _ = build(p, n, alive=np.zeros(64, bool))
    assert not starts.any()


def rectangle(axis: int, place: float, side: float = 2.0) -> np.ndarray:
    """Return the corners (2, 3, 3) of a square across `axis`."""
    square = np.array([[0, 0], [side, 0], [side, side], [0, side]])
    corners = np.insert(square, axis, place, axis=1)
    return corners[[[0, 1, 2], [0, 2, 3]]]


@pytest.mark.parametrize("cell", [0.0288, 0.07, 0.31])
def test_walls_and_floors_lie_clear_of_the_borders_of_cells(cell: float) -> None:
    """Two planes an axis can always be a quarter of a cell clear of borders, or nearly; small clutter has no say."""
    room = [rectangle(axis, place) for axis, pair in enumerate(((-1, 1), (0, 2.3), (0.2, 5))) for place in pair]
    clutter = [rectangle(axis, place, 0.02) for axis in range(3) for place in np.linspace(0, 1, 50)]
    tilted = np.array([[[0, 0, 0], [1, 1, 0], [0, 1, 1]], [[0, 0, 0], [0, 0, 0], [0, 0, 0]]], float)
    shift = kernel.find_shift(np.concatenate([*room, *clutter, tilted]), cell, 0.25 * cell)
    for wall in room:
        axis = int(np.argmin(np.ptp(wall.reshape(-1, 3), axis=0)))
        inside = (wall[0, 0, axis] / cell + shift[axis]) % 1.0
        assert min(inside, 1.0 - inside) > 0.25 - 2.5 / kernel.SHIFTS
    np.testing.assert_array_equal(kernel.find_shift(tilted, cell, 0.25 * cell), 0.5)
