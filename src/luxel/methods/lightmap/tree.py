"""The tree: surfels merged pair by pair, nearest first, until one cluster holds all (agglomerative clustering).

Merges are restricted to near neighbours: each surfel starts with the few nearest ones as candidates, and a cluster
inherits those of its two halves. So the work is n log n and memory grows with n; the dearest pair of all is never
looked at. Nodes 0 .. L - 1 are the leaves in the order in which the tree is walked: every cluster is a range of leaves.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
import scipy

NEIGHBOURS = 10
"""Nearest surfels that each one may merge with at first."""


@dataclass
class TreeDials:
    """Weights of a merge's cost, in surfel spacings."""

    normal: float
    chart: float
    outlook: float
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
    """(n, 4) what they see, as `Outlook` has it."""


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


def merge_pairs(held: Items, dials: TreeDials) -> np.ndarray:
    """Return merges (n - 1, 2) of n items: merge k makes node n + k."""
    p, area = held.p, held.area
    count = len(p)
    if count < 2:
        return np.zeros((0, 2), np.int64)
    spacing = float(np.sqrt(area.mean())) or 1.0
    places = [tuple(row) for row in (p / spacing).tolist()] + [()] * (count - 1)
    normals = [tuple(row) for row in held.normal.tolist()] + [()] * (count - 1)
    views = [tuple(row) for row in held.view.tolist()] + [()] * (count - 1)
    areas: list[float] = (area / area.mean()).tolist() + [0.0] * (count - 1)
    charts: list[int] = held.chart.tolist() + [-1] * (count - 1)
    near: list[set[int] | None] = [set() for _ in range(count)] + [None] * (count - 1)
    heap: list[tuple[float, int, int]] = []

    def push(a: int, b: int) -> None:
        (ax, ay, az), (bx, by, bz), (al, am, an), (bl, bm, bn) = places[a], places[b], normals[a], normals[b]
        distance = ((ax - bx) ** 2 + (ay - by) ** 2 + (az - bz) ** 2) ** 0.5
        apart = dials.normal * (1.0 - (al * bl + am * bm + an * bn))
        (a1, a2, a3, a4), (b1, b2, b3, b4) = views[a], views[b]
        apart += dials.outlook * ((a1 - b1) ** 2 + (a2 - b2) ** 2 + (a3 - b3) ** 2 + (a4 - b4) ** 2) ** 0.5
        across = dials.chart if charts[a] != charts[b] or charts[a] < 0 else 0.0
        cost = (distance + apart + across) * (areas[a] + areas[b]) ** dials.balance
        heapq.heappush(heap, (cost, a, b) if a < b else (cost, b, a))

    def connect(items: list[int]) -> None:
        # Near is what is cheap to merge: in space and in outlook.
        alive = np.column_stack(
            [[places[item] for item in items], dials.outlook * np.array([views[item] for item in items])]
        )
        neighbours = np.asarray(scipy.spatial.KDTree(alive).query(alive, k=min(NEIGHBOURS + 1, len(items)))[1])
        for item, row in zip(items, neighbours.tolist(), strict=True):
            for other in (items[index] for index in row):
                around = near[item]
                assert around is not None
                if other != item and other not in around:
                    around.add(other)
                    near[other].add(item)  # type: ignore[union-attr]
                    push(item, other)

    connect(list(range(count)))
    merges: list[tuple[int, int]] = []
    while len(merges) < count - 1:
        if not heap:
            # Islands without a common neighbour: look for neighbours among what is left.
            connect([item for item in range(count + len(merges)) if near[item] is not None])
        _, a, b = heapq.heappop(heap)
        around_a, around_b = near[a], near[b]
        if around_a is None or around_b is None:
            continue
        node = count + len(merges)
        merges.append((a, b))
        weight = areas[a] + areas[b]
        share = float(areas[a] / weight) if weight > 0.0 else 0.5
        places[node] = tuple(share * x + (1.0 - share) * y for x, y in zip(places[a], places[b], strict=True))
        normals[node] = tuple(share * x + (1.0 - share) * y for x, y in zip(normals[a], normals[b], strict=True))
        views[node] = tuple(share * x + (1.0 - share) * y for x, y in zip(views[a], views[b], strict=True))
        areas[node] = weight
        charts[node] = charts[a] if charts[a] == charts[b] else -1
        near[a] = near[b] = None
        around = (around_a | around_b) - {a, b}
        near[node] = around
        for other in around:
            beside = near[other]
            assert beside is not None
            beside.discard(a)
            beside.discard(b)
            beside.add(node)
            push(node, other)
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
