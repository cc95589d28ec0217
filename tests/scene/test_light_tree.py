"""The light tree's order and bounds against arithmetic; scenes of 100,000 lights."""

from __future__ import annotations

import numpy as np
import pytest

from luxel.scene.light_tree import LightBounds, empty_bounds, fit_nodes, order_leaves, tree_depth


def random_bounds(count: int, seed: int = 0, spread: float = 0.0) -> LightBounds:
    """Return sources with places, random axes and cones of half angle `spread`."""
    rng = np.random.default_rng(seed)
    bounds = empty_bounds(count)
    bounds.lower = rng.uniform(-9.0, 9.0, (count, 3))
    bounds.upper = bounds.lower + rng.uniform(0.0, 0.5, (count, 3))
    bounds.intensity = rng.uniform(0.1, 5.0, count)
    axis = rng.normal(size=(count, 3))
    bounds.axis = axis / np.linalg.norm(axis, axis=1, keepdims=True)
    bounds.spread[:] = spread
    bounds.range = rng.uniform(1.0, 20.0, count)
    return bounds


def leaves_below(node: int, depth: int) -> np.ndarray:
    """Return the leaves below `node`, counted from the left."""
    level = node.bit_length() - 1
    width = 1 << (depth - level)
    return (node - (1 << level)) * width + np.arange(width)


@pytest.mark.parametrize("count", [1, 2, 3, 8, 9, 100, 1025])
def test_each_source_has_one_leaf(count: int) -> None:
    depth = tree_depth(count)
    assert 1 << depth >= count
    assert depth == 1 or 1 << (depth - 1) < 1.25 * count
    for wider in (depth, depth + 2):
        leaves = order_leaves(random_bounds(count), wider)
        assert len(leaves) == 1 << wider
        assert sorted(leaves[leaves >= 0]) == list(range(count))
        assert leaves[0] >= 0


@pytest.mark.parametrize("spread", [0.0, 0.3, 3.0])
def test_a_node_holds_all_that_is_below_it(spread: float) -> None:
    """Box, cone, intensity and range of every node, by those of the sources below it."""
    bounds, depth = random_bounds(37, 3, spread), 6
    bounds.two_sided[::5] = True
    leaves = order_leaves(bounds, depth)
    nodes = fit_nodes(bounds, leaves).astype(np.float64)
    unit = bounds.intensity.sum() / nodes[1, 7]
    for node in range(1, 1 << (depth + 1)):
        below = leaves[leaves_below(node, depth)]
        below = below[below >= 0]
        row = nodes[node]
        assert row[7] * unit == pytest.approx(bounds.intensity[below].sum(), rel=1e-5)
        if not len(below):
            continue
        assert (row[:3] - row[4:7] <= bounds.lower[below]).all()
        assert (row[:3] + row[4:7] >= bounds.upper[below]).all()
        assert row[3] >= bounds.range[below].max() * (1.0 - 1e-6)
        assert row[15] >= bounds.two_sided[below].max()
        cosine = bounds.axis[below] @ row[8:11]
        cosine = np.abs(cosine) if row[15] else cosine
        angle = np.arccos(np.clip(cosine, -1.0, 1.0)) + bounds.spread[below]
        assert (np.minimum(angle, np.pi) <= np.arccos(np.clip(row[11], -1.0, 1.0)) + 1e-3).all()


def test_neighbours_share_a_node() -> None:
    """Two clusters a long way apart are the two halves of the tree."""
    bounds = random_bounds(32, 5)
    bounds.lower[::2, 2] += 500.0
    bounds.upper[::2, 2] += 500.0
    leaves = order_leaves(bounds, 5)
    assert len(set(leaves[:16] % 2)) == 1
    assert len(set(leaves[16:] % 2)) == 1


@pytest.mark.parametrize("place", ["one point", "one line", "one plane"])
def test_sources_without_extent_make_a_tree(place: str) -> None:
    bounds = random_bounds(20, 7)
    flat = {"one point": (0, 1, 2), "one line": (0, 2), "one plane": (1,)}[place]
    bounds.lower[:, flat] = 1.5
    bounds.upper = bounds.lower.copy()
    nodes = fit_nodes(bounds, order_leaves(bounds, 5))
    assert np.isfinite(nodes).all()
    assert (nodes[1, 4:7][list(flat)] < 1e-4).all()


def test_what_is_far_away_stays_together() -> None:
    """Sources without a place share their nodes, so that few nodes hold both kinds."""
    bounds = random_bounds(64, 9)
    far = np.arange(64) % 4 == 0
    bounds.intensity[far], bounds.far[far] = 0.0, 2.0
    leaves = order_leaves(bounds, 6)
    changes = np.count_nonzero(np.diff(far[leaves].astype(int)))
    assert changes == 1
    nodes = fit_nodes(bounds, leaves)
    mixed = (nodes[:, 7] > 0.0) & (nodes[:, 14] > 0.0)
    assert mixed.sum() <= 6


def test_tiny_and_huge_intensities_stay_finite() -> None:
    bounds = random_bounds(8, 11)
    bounds.intensity = 10.0 ** np.linspace(-30, 60, 8)
    nodes = fit_nodes(bounds, order_leaves(bounds, 3))
    assert np.isfinite(nodes).all()
    assert nodes[1, 7] == pytest.approx(1.0)
