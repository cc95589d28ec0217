"""The tree: surfels merged pair by pair, nearest first, until one cluster holds all (agglomerative clustering).

Merges are restricted to near neighbours: each surfel starts with the few nearest ones as candidates, and a cluster
inherits those of its two halves. So the work is n log n and memory grows with n; the dearest pair of all is never
looked at. Nodes 0 .. L - 1 are the leaves in the order in which the tree is walked: every cluster is a range of leaves.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

NEIGHBOURS = 10
"""Nearest surfels that each one may merge with at first."""
TELL_EVERY = 2000
"""Merges between two reports."""


@dataclass
class MergeWeights:
    """Weights of a merge's cost, in surfel spacings."""

    normal: float
    chart: float
    view: float
    balance: float


@dataclass
class Items:
    """What is clustered: n items."""

    p: np.ndarray
    """(n, 3)."""
    normal: np.ndarray
    """(n, 3)."""
    area: np.ndarray
    chart: np.ndarray
    view: np.ndarray
    """(n, 4) what they see, as `MutualVisibility` has it."""


@dataclass
class Tree:
    """L leaves and L - 1 inner nodes, numbered from L; the last is the root."""

    leaf: np.ndarray
    """(L,) which item each leaf is."""
    children: np.ndarray
    """(L - 1, 2) nodes."""
    low: np.ndarray
    """(2 L - 1,) first leaf of each node."""
    high: np.ndarray
    """(2 L - 1,) one past its last leaf."""

    @property
    def leaf_of(self) -> np.ndarray:
        """The leaf (L,) of each item; the items are numbered from 0 to L - 1."""
        return np.argsort(self.leaf)


class _Clusters:
    """Items and what they have been merged into, as lists: the loop over merges is plain Python."""

    def __init__(self, held: Items) -> None:
        spacing = float(np.sqrt(held.area.mean())) or 1.0
        self.places: list[tuple[float, ...]] = [tuple(row) for row in (held.p / spacing).tolist()]
        """In surfel spacings."""
        self.normals: list[tuple[float, ...]] = [tuple(row) for row in held.normal.tolist()]
        self.views: list[tuple[float, ...]] = [tuple(row) for row in held.view.tolist()]
        self.areas: list[float] = (held.area / held.area.mean()).tolist()
        self.charts: list[int] = held.chart.tolist()
        """-1: of several."""
        self.near: list[set[int] | None] = [set() for _ in held.area]
        """What each may merge with; None: it has been merged itself."""

    def merge(self, a: int, b: int) -> set[int]:
        """Append the cluster of `a` and `b`, by area; return what it may merge with."""
        weight = self.areas[a] + self.areas[b]
        share = self.areas[a] / weight if weight > 0.0 else 0.5
        rest = 1.0 - share
        for rows in (self.places, self.normals, self.views):
            rows.append(tuple([share * x + rest * y for x, y in zip(rows[a], rows[b], strict=True)]))
        self.areas.append(weight)
        self.charts.append(self.charts[a] if self.charts[a] == self.charts[b] else -1)
        near, node = self.near, len(self.near)
        around = ((near[a] or set()) | (near[b] or set())) - {a, b}
        near[a] = near[b] = None
        near.append(around)
        for other in around:
            beside = near[other]
            assert beside is not None
            beside.discard(a)
            beside.discard(b)
            beside.add(node)
        return around

    def connect(self, view: float) -> list[tuple[int, int]]:
        """Return new pairs among what is left: each with its nearest ones, in space and in what it sees."""
        items = [item for item, around in enumerate(self.near) if around is not None]
        alive = np.column_stack(
            [[self.places[item] for item in items], view * np.array([self.views[item] for item in items])]
        )
        neighbours = np.asarray(scipy.spatial.KDTree(alive).query(alive, k=min(NEIGHBOURS + 1, len(items)))[1])
        pairs = []
        for item, row in zip(items, neighbours.tolist(), strict=True):
            around = self.near[item]
            assert around is not None
            for other in (items[index] for index in row):
                if other != item and other not in around:
                    around.add(other)
                    self.near[other].add(item)  # type: ignore[union-attr]
                    pairs.append((item, other))
        return pairs


def _make_cost(clusters: _Clusters, weights: MergeWeights) -> Callable[[int, int], float]:
    """Return the function that prices a merge of two clusters."""
    places, normals, views, areas, charts = (
        clusters.places, clusters.normals, clusters.views, clusters.areas, clusters.charts
    )  # fmt: skip

    def cost(a: int, b: int) -> float:
        (ax, ay, az), (bx, by, bz), (al, am, an), (bl, bm, bn) = places[a], places[b], normals[a], normals[b]
        distance = ((ax - bx) ** 2 + (ay - by) ** 2 + (az - bz) ** 2) ** 0.5
        apart = weights.normal * (1.0 - (al * bl + am * bm + an * bn))
        (a1, a2, a3, a4), (b1, b2, b3, b4) = views[a], views[b]
        apart += weights.view * ((a1 - b1) ** 2 + (a2 - b2) ** 2 + (a3 - b3) ** 2 + (a4 - b4) ** 2) ** 0.5
        across = weights.chart if charts[a] != charts[b] or charts[a] < 0 else 0.0
        return (distance + apart + across) * (areas[a] + areas[b]) ** weights.balance

    return cost


def merge_pairs(held: Items, weights: MergeWeights, tell: Callable[[int], None] | None = None) -> np.ndarray:
    """Return merges (n - 1, 2) of n items: merge k makes node n + k. `tell` hears now and then how many are done."""
    count = len(held.p)
    if count < 2:
        return np.zeros((0, 2), np.int64)
    clusters = _Clusters(held)
    cost, near = _make_cost(clusters, weights), clusters.near
    merges: list[tuple[int, int]] = []
    heap: list[tuple[float, int, int]] = []
    while len(merges) < count - 1:
        if not heap:
            # At first, and for islands without a common neighbour.
            heap = [(cost(a, b), a, b) if a < b else (cost(b, a), b, a) for a, b in clusters.connect(weights.view)]
            heapq.heapify(heap)
        _, a, b = heapq.heappop(heap)
        if near[a] is None or near[b] is None:
            continue
        node = len(near)
        merges.append((a, b))
        for other in clusters.merge(a, b):
            heapq.heappush(heap, (cost(node, other), other, node))
        if tell is not None and len(merges) % TELL_EVERY == 0:
            tell(len(merges))
    return np.array(merges, np.int64)


def order_tree(merges: np.ndarray, count: int) -> Tree:
    """Return the tree of `merges` over `count` items, leaves numbered in the order of the walk."""
    total = count + len(merges)
    size = np.ones(total, np.int64)
    for index, (a, b) in enumerate(merges.tolist()):
        size[count + index] = size[a] + size[b]
    low = np.zeros(total, np.int64)
    for index in range(len(merges) - 1, -1, -1):
        a, b = merges[index]
        low[a] = low[count + index]
        low[b] = low[a] + size[a]
    position = low[:count]
    leaf = np.empty(count, np.int64)
    leaf[position] = np.arange(count)
    renumber = np.concatenate([position, np.arange(count, total)])
    children = renumber[merges] if len(merges) else np.zeros((0, 2), np.int64)
    node_low = np.empty(total, np.int64)
    node_high = np.empty(total, np.int64)
    node_low[renumber], node_high[renumber] = low, low + size
    return Tree(leaf, children, node_low, node_high)


def put_side_by_side(trees: list[Tree]) -> tuple[Tree, np.ndarray]:
    """Return several trees as one set of nodes, leaves first, and the root of each; empty trees have none.

    Their `leaf` must name items of one common list.
    """
    leaves = [len(tree.leaf) for tree in trees]
    inner = [len(tree.children) for tree in trees]
    leaf_start = np.concatenate([[0], np.cumsum(leaves)])
    inner_start = leaf_start[-1] + np.concatenate([[0], np.cumsum(inner)])
    children, low, high, roots = [], [], [], []
    for index, tree in enumerate(trees):
        if not leaves[index]:
            continue
        shift, base = leaf_start[index], inner_start[index]
        children.append(
            np.where(tree.children < leaves[index], tree.children + shift, tree.children - leaves[index] + base)
        )
        low.append(tree.low + shift)
        high.append(tree.high + shift)
        roots.append(base + inner[index] - 1 if inner[index] else shift)
    held = [index for index, count in enumerate(leaves) if count]
    split = [
        (low[i][: leaves[k]], low[i][leaves[k] :], high[i][: leaves[k]], high[i][leaves[k] :])
        for i, k in enumerate(held)
    ]
    whole = Tree(
        leaf=np.concatenate([trees[k].leaf for k in held]),
        children=np.concatenate(children),
        low=np.concatenate([part[0] for part in split] + [part[1] for part in split]),
        high=np.concatenate([part[2] for part in split] + [part[3] for part in split]),
    )
    return whole, np.array(roots, np.int64)
