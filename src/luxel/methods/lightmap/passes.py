"""The order in which clusters are summed: each from a list of smaller ones, in as few passes as the tree allows.

Level by level a binary tree takes as many passes as it is deep. Here a pass sums all clusters of up to 64 times the
leaves of the pass before, each over the largest clusters that are done: two passes for 4,096 surfels, three for 262,144.
Always in the same order, so that the sums do not depend on threads.
"""

from __future__ import annotations

import numpy as np

from luxel.methods.lightmap.tree import Tree

WIDTH = 64
"""Leaves below a cluster of the first pass, at most; each pass multiplies it."""


def plan_passes(tree: Tree, area: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Return (nodes, starts, items, shares) of each pass; `area` (L,) is that of the leaves, in their order.

    Node i of a pass is the sum of share times value over its items, items[starts[i]:starts[i + 1]]; shares add up to 1.
    """
    leaves = len(tree.leaf)
    node_area = sum_over_nodes(tree, area)
    size = tree.high - tree.low
    level = np.zeros(len(size), np.int64)
    limit, rank = 1, 0
    while limit < size.max():
        level[size > limit] = rank + 1
        limit, rank = limit * WIDTH, rank + 1
    plan = []
    for rank in range(1, int(level.max()) + 1):
        nodes = np.flatnonzero(level == rank)
        # Long sums first: lanes that run side by side are alike.
        nodes = nodes[np.argsort(-size[nodes], kind="stable")]
        if rank == 1:
            counts = size[nodes]
            starts = np.concatenate([[0], np.cumsum(counts)])
            items = np.arange(starts[-1]) - np.repeat(starts[:-1], counts) + np.repeat(tree.low[nodes], counts)
        else:
            lists = [_smaller(tree, level, node, leaves) for node in nodes.tolist()]
            starts = np.concatenate([[0], np.cumsum([len(found) for found in lists])])
            items = np.concatenate([np.array(found, np.int64) for found in lists])
        share = node_area[items] / np.repeat(np.maximum(node_area[nodes], 1e-300), np.diff(starts))
        plan.append((nodes, starts, items, share))
    return plan


def sum_over_nodes(tree: Tree, values: np.ndarray) -> np.ndarray:
    """Return the sum of leaf `values` (L,) or (L, C) below each node."""
    total = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0, dtype=np.float64)])
    sums = total[tree.high] - total[tree.low]
    sums[: len(tree.leaf)] = values
    return sums


def _smaller(tree: Tree, level: np.ndarray, node: int, leaves: int) -> list[int]:
    """Return the largest nodes below `node` that an earlier pass has summed."""
    found, stack = [], [node]
    while stack:
        for child in tree.children[stack.pop() - leaves].tolist():
            (found if level[child] < level[node] else stack).append(child)
    return sorted(found)
