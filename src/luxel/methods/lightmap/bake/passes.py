"""How clusters are summed: each over a list of smaller ones, in as few passes as the tree allows.

Level by level a binary tree takes as many passes as it is deep. Here a pass sums all clusters of up to 64 times the
leaves of the pass before, each over the largest clusters that are done: two passes for 4,096 surfels, three for
262,144.
Always in the same order, so that the sums do not depend on threads.

A cluster's radiosity is its flux over its area: a mean in which each item counts by its area. Texels see a cluster's
parts unevenly, though, and hidden parts tend to be dark. So the items of a cluster that texels read may count by the
rays that these texels sent to them (`weigh_items`). Over all texels the light that a cluster of surfels brings is then
exact, whatever the lights; that of a cluster of clusters nearly so, as those count by what their own texels saw.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from luxel.methods.lightmap.bake.tree import Tree

WIDTH = 64
"""Leaves below a cluster of the first pass, at most; each pass multiplies it."""


@dataclass
class SummationLists:
    """What each inner node is summed over. N nodes, ascending; I items."""

    nodes: np.ndarray
    """(N,)."""
    level: np.ndarray
    """(N,) pass that sums it, from 1."""
    starts: np.ndarray
    """(N + 1,)."""
    items: np.ndarray
    """(I,) nodes, in the order of their leaves."""
    share: np.ndarray
    """(I,) the item's area over the node's."""


def plan_lists(tree: Tree, area: np.ndarray) -> SummationLists:
    """Return what each inner node is summed over; `area` (L,) is that of the leaves, in their order."""
    leaves = len(tree.leaf)
    size = tree.high - tree.low
    level = np.zeros(len(size), np.int64)
    limit, rank = 1, 0
    while limit < size.max():
        level[size > limit] = rank + 1
        limit, rank = limit * WIDTH, rank + 1
    nodes = np.arange(leaves, len(size))
    counts = size[nodes].copy()
    wide = {node: _smaller(tree, level, node, leaves) for node in nodes[level[nodes] > 1].tolist()}
    for node, found in wide.items():
        counts[node - leaves] = len(found)
    starts = np.concatenate([[0], np.cumsum(counts)])
    items = np.arange(starts[-1]) - np.repeat(starts[:-1], counts) + np.repeat(tree.low[nodes], counts)
    for node, found in wide.items():
        items[starts[node - leaves] : starts[node - leaves + 1]] = found
    node_area = sum_over_nodes(tree, area)
    share = node_area[items] / np.repeat(np.maximum(node_area[nodes], 1e-300), counts)
    return SummationLists(nodes, level[nodes], starts, items, share)


def _smaller(tree: Tree, level: np.ndarray, node: int, leaves: int) -> list[int]:
    """Return the largest nodes below `node` that an earlier pass has summed, in the order of their leaves."""
    found, stack = [], [node]
    while stack:
        for child in tree.children[stack.pop() - leaves].tolist():
            (found if level[child] < level[node] else stack).append(child)
    return sorted(found, key=lambda child: int(tree.low[child]))


def weigh_items(lists: SummationLists, rays: np.ndarray) -> np.ndarray:
    """Return each item's share (I,) of its node by the `rays` (I,) it was seen by; by area where there are none."""
    counts = np.diff(lists.starts)
    total = np.add.reduceat(rays, lists.starts[:-1]) if len(lists.nodes) else np.zeros(0)
    total = np.repeat(total, counts)
    # Parts that no reader sees count nothing: a cluster that reaches through a wall brings no light through it.
    return np.where(total > 0, rays / np.maximum(total, 1), lists.share)


def sum_over_nodes(tree: Tree, values: np.ndarray) -> np.ndarray:
    """Return the sum of leaf `values` (L,) or (L, C) below each node."""
    total = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0, dtype=np.float64)])
    sums = total[tree.high] - total[tree.low]
    sums[: len(tree.leaf)] = values
    return sums
