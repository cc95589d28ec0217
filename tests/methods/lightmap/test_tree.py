"""The tree and its sums: every cluster a range of leaves, merges of near ones, sums as if each was added up alone."""

from __future__ import annotations

import numpy as np
import pytest

from luxel.errors import LuxelError
from luxel.methods.lightmap.bake.passes import WIDTH, plan_lists, sum_over_nodes, weigh_items
from luxel.methods.lightmap.bake.refine import Refiner
from luxel.methods.lightmap.bake.tree import Items, MergeWeights, Tree, merge_pairs, order_tree, put_side_by_side
from luxel.methods.lightmap.bake.words import HIT_BITS

WEIGHTS = MergeWeights(normal=2.0, chart=1.0, view=0.0, balance=0.5)


def random_items(count: int, seed: int = 0) -> Items:
    random = np.random.default_rng(seed)
    p = random.random((count, 3)) * [10.0, 10.0, 0.0]
    normal = np.tile([0.0, 0.0, 1.0], (count, 1))
    return Items(p, normal, np.full(count, 0.1), np.zeros(count, np.int64), np.zeros((count, 4)))


def grow(count: int, seed: int = 0) -> Tree:
    return order_tree(merge_pairs(random_items(count, seed), WEIGHTS), count)


def refine_all(tree: Tree, roots: np.ndarray, leaf: np.ndarray, budget: int, by_weight: bool = False) -> np.ndarray:
    area = np.ones(len(tree.leaf))
    return Refiner(tree, roots, area, budget, by_weight).refine(leaf)[0]


@pytest.mark.parametrize("count", [1, 2, 3, 50, 3000])
def test_every_cluster_is_a_range_of_leaves(count: int) -> None:
    tree = grow(count)
    assert sorted(tree.leaf) == list(range(count))
    np.testing.assert_array_equal(tree.high[:count] - tree.low[:count], 1)
    left, right = tree.children.T
    np.testing.assert_array_equal(tree.low[count:], tree.low[left])
    np.testing.assert_array_equal(tree.high[left], tree.low[right])
    np.testing.assert_array_equal(tree.high[count:], tree.high[right])
    assert tree.low[-1] == 0 and tree.high[-1] == count


def test_clusters_are_compact() -> None:
    """Cut into 16, items of a square lie far nearer to their cluster's middle than to the square's."""
    items = random_items(1000)
    tree = order_tree(merge_pairs(items, WEIGHTS), 1000)
    chosen = [len(tree.low) - 1]
    while len(chosen) < 16:
        largest = max(chosen, key=lambda node: tree.high[node] - tree.low[node])
        chosen.remove(largest)
        chosen += tree.children[largest - 1000].tolist()
    spread = [np.var(items.p[tree.leaf[tree.low[n] : tree.high[n]]], axis=0).sum() for n in chosen]
    sizes = [tree.high[n] - tree.low[n] for n in chosen]
    assert np.average(spread, weights=sizes) < 0.12 * np.var(items.p, axis=0).sum()


def test_islands_that_share_no_neighbour_are_joined() -> None:
    near, far = random_items(30), random_items(30, 1)
    both = Items(*(np.concatenate([a, b]) for a, b in zip(vars(near).values(), vars(far).values(), strict=True)))
    both.p[30:] += 1e4
    tree = order_tree(merge_pairs(both, WEIGHTS), 60)
    assert {frozenset(tree.leaf[tree.low[n] : tree.high[n]] < 30) for n in tree.children[-1]} == {
        frozenset({True}),
        frozenset({False}),
    }


def test_unlike_outlooks_merge_last() -> None:
    items = random_items(400)
    items.view[::2, 3] = 1.0
    weights = MergeWeights(2.0, 1.0, 50.0, 0.5)
    tree = order_tree(merge_pairs(items, weights), 400)
    halves = [set(tree.leaf[tree.low[n] : tree.high[n]] % 2) for n in tree.children[-1]]
    assert sorted(map(tuple, halves)) == [(0,), (1,)]


def test_trees_stand_side_by_side() -> None:
    first, second = grow(40), grow(7, 1)
    second.leaf[:] += 40
    whole, roots = put_side_by_side([first, second])
    assert sorted(whole.leaf) == list(range(47)) and len(roots) == 2
    assert set(whole.leaf[whole.low[roots[1]] : whole.high[roots[1]]]) == set(range(40, 47))
    left, right = whole.children.T
    np.testing.assert_array_equal(whole.high[left], whole.low[right])


@pytest.mark.parametrize("by_weight", [False, True])
@pytest.mark.parametrize("budget", [2, 5, 90, 400])
def test_refinement_keeps_the_sum(budget: int, by_weight: bool) -> None:
    tree = grow(300)
    leaf = np.random.default_rng(3).integers(0, 300, (40, 256)).astype(np.uint32)
    words = refine_all(tree, np.array([len(tree.low) - 1]), leaf, budget, by_weight)
    node, hits = words >> HIT_BITS, words & ((1 << HIT_BITS) - 1)
    np.testing.assert_array_equal(hits.sum(axis=1), 256)
    for row in range(40):
        used = node[row][words[row] != 0]
        assert len(used) <= budget
        covered = np.concatenate([np.arange(int(tree.low[n]), int(tree.high[n])) for n in used.tolist()])
        assert len(covered) == len(set(covered)), "no leaf is read twice"
        for n, h in zip(used, hits[row][words[row] != 0], strict=True):
            assert h == ((leaf[row] >= tree.low[n]) & (leaf[row] < tree.high[n])).sum()


def test_with_budget_enough_every_leaf_stands_alone() -> None:
    tree = grow(60)
    leaf = np.random.default_rng(3).integers(0, 60, (5, 64)).astype(np.uint32)
    words = refine_all(tree, np.array([len(tree.low) - 1]), leaf, 64)
    for row in range(5):
        used = words[row][words[row] != 0]
        assert set(used >> HIT_BITS) == set(leaf[row])


@pytest.mark.parametrize("count", [1, 2, WIDTH, WIDTH + 1, 5000])
def test_passes_add_up_what_leaves_hold(count: int) -> None:
    tree = grow(count)
    random = np.random.default_rng(1)
    area, value = random.random(count) + 0.1, random.random(count)
    lists = plan_lists(tree, area)
    rows = np.zeros(len(tree.low))
    rows[:count] = value
    for level in range(1, int(lists.level.max(initial=0)) + 1):
        for index in np.flatnonzero(lists.level == level):
            part = slice(lists.starts[index], lists.starts[index + 1])
            rows[lists.nodes[index]] = (lists.share[part] * rows[lists.items[part]]).sum()
    wanted = sum_over_nodes(tree, area * value) / sum_over_nodes(tree, area)
    np.testing.assert_allclose(rows, wanted)
    assert lists.level.max(initial=0) <= 3


def test_clusters_can_count_by_who_sees_them() -> None:
    """The sum over all rows is then exact: clusters bring what their leaves would have brought."""
    tree = grow(500)
    random = np.random.default_rng(2)
    # Rows see but a part of the tree, as texels do.
    leaf = (random.integers(0, 120, (64, 200)) + 300).astype(np.uint32)
    area, value = random.random(500) + 0.1, random.random(500)
    refiner = Refiner(tree, np.array([len(tree.low) - 1]), area, 12, False)
    words, seen = refiner.refine(leaf)
    lists = refiner.lists
    share = weigh_items(lists, seen)
    np.testing.assert_allclose(np.add.reduceat(share, lists.starts[:-1]), 1.0)
    rows = np.zeros(len(tree.low))
    rows[:500] = value
    for index in np.lexsort((lists.nodes, lists.level)):
        part = slice(lists.starts[index], lists.starts[index + 1])
        rows[lists.nodes[index]] = (share[part] * rows[lists.items[part]]).sum()
    brought = ((words & ((1 << HIT_BITS) - 1)) * rows[words >> HIT_BITS]).sum()
    exact = value[leaf].sum()
    by_area = sum_over_nodes(tree, area * value) / sum_over_nodes(tree, area)
    plain = ((words & ((1 << HIT_BITS) - 1)) * by_area[words >> HIT_BITS]).sum()
    assert abs(brought - exact) < 0.02 * exact
    assert abs(brought - exact) < 0.5 * abs(plain - exact)


def test_rays_are_counted_where_they_went() -> None:
    tree = grow(200)
    # One row that sees each leaf once, through the root and, as its budget is 1, nothing below it.
    refiner = Refiner(tree, np.array([len(tree.low) - 1]), np.ones(200), 1, False)
    words, counts = refiner.refine(np.arange(200, dtype=np.uint32)[None, ::-1])
    assert words.tolist() == [[(len(tree.low) - 1) << HIT_BITS | 200]]
    lists = refiner.lists
    part = slice(lists.starts[-2], lists.starts[-1])
    np.testing.assert_array_equal(counts[part], (tree.high - tree.low)[lists.items[part]])
    assert counts.sum() == 200


def test_more_trees_than_clusters_are_refused() -> None:
    trees = [grow(9, seed) for seed in range(5)]
    for index, tree in enumerate(trees):
        tree.leaf[:] += 9 * index
    whole, roots = put_side_by_side(trees)
    leaf = np.random.default_rng(4).integers(0, 45, (7, 64)).astype(np.uint32)
    words = refine_all(whole, roots, leaf, 5)
    np.testing.assert_array_equal((words & ((1 << HIT_BITS) - 1)).sum(axis=1), 64)
    assert sorted((words[0] >> HIT_BITS).tolist()) == sorted(roots.tolist())
    with pytest.raises(LuxelError, match="'clusters_per_texel' is 3, but a texel sees more regions"):
        refine_all(whole, roots, leaf, 3)


def test_the_most_uneven_cluster_is_split_first() -> None:
    """Of two clusters, one seen evenly and one on one side only but for a ray, the second is the one to split."""
    children = np.array([[0, 1], [2, 3], [4, 5]])
    tree = Tree(np.arange(4), children, np.array([0, 1, 2, 3, 0, 2, 0]), np.array([1, 2, 3, 4, 2, 4, 4]))
    leaf = np.array([[0] * 8 + [1] * 8 + [2] * 15 + [3]], np.uint32)
    words = refine_all(tree, np.array([6]), leaf, 3)
    assert sorted((words[0] >> HIT_BITS).tolist()) == [2, 3, 4]
    assert sorted((words[0] & ((1 << HIT_BITS) - 1)).tolist()) == [1, 15, 16]
