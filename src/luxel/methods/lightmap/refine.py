"""Which clusters light a texel: from the root down, the heaviest is split, until the budget is reached."""

from __future__ import annotations

import numpy as np

from luxel.methods.lightmap.state import HIT_BITS
from luxel.methods.lightmap.tree import Tree


def refine_rows(leaf: np.ndarray, tree: Tree, roots: np.ndarray, budget: int) -> np.ndarray:
    """Return words (rows, `budget`) uint32, cluster << `HIT_BITS` | hits, for the leaf (rows, rays) that each ray met.

    A word of 0 ends a row. The hits of a row add up to its rays, however far it is refined.
    """
    rows, rays = leaf.shape
    leaves = len(tree.leaf)
    keys = np.sort((leaf.astype(np.int64) + np.arange(rows, dtype=np.int64)[:, None] * leaves).ravel())
    return refine_sorted(keys, None, rows, tree, roots, budget)


def refine_sorted(
    keys: np.ndarray, weight: np.ndarray | None, rows: int, tree: Tree, roots: np.ndarray, budget: int
) -> np.ndarray:
    """Refine from sorted keys, row * leaves + leaf, with the weight (hits) of each; None: one each.

    A cluster is a range of leaves, so its weight in a row is the difference of two places among the keys.
    """
    leaves = len(tree.leaf)
    total = None if weight is None else np.concatenate([[0], np.cumsum(weight)])

    def hits(first: np.ndarray, last: np.ndarray) -> np.ndarray:
        return last - first if total is None else total[last] - total[first]

    node = np.zeros((rows, budget), np.int64)
    first = np.zeros((rows, budget), np.int64)
    last = np.zeros((rows, budget), np.int64)
    held = np.zeros((rows, budget), np.int64)
    used = np.zeros(rows, np.int64)
    base = np.arange(rows) * leaves
    for root in roots:
        low, high = (np.searchsorted(keys, base + end[root]) for end in (tree.low, tree.high))
        row = np.flatnonzero(high > low)
        column = used[row]
        node[row, column], first[row, column], last[row, column] = root, low[row], high[row]
        held[row, column] = hits(low[row], high[row])
        used[row] += 1
    # What can still be split: inner clusters, by their hits.
    open_hits = np.where(node >= leaves, held, 0)
    active = np.arange(rows)
    while len(active):
        column = open_hits[active].argmax(axis=1)
        going = open_hits[active, column] > 0
        active, column = active[going], column[going]
        parent = node[active, column]
        left, right = tree.children[parent - leaves].T
        low, high = first[active, column], last[active, column]
        middle = np.searchsorted(keys, base[active] + tree.low[right])
        only_left, only_right = middle == high, middle == low
        both = ~only_left & ~only_right
        # No room for a second half: this cluster stays as it is.
        full = both & (used[active] >= budget)
        open_hits[active[full], column[full]] = 0
        row, place = active[~full], column[~full]
        kept = np.where(only_right, right, left)[~full]
        cut = np.where(both, middle, high)[~full]
        node[row, place], last[row, place] = kept, cut
        held[row, place] = hits(low[~full], cut)
        open_hits[row, place] = np.where(kept >= leaves, held[row, place], 0)
        row, extra = active[both & ~full], used[active[both & ~full]]
        pick = both & ~full
        node[row, extra], first[row, extra], last[row, extra] = right[pick], middle[pick], high[pick]
        held[row, extra] = hits(middle[pick], high[pick])
        open_hits[row, extra] = np.where(right[pick] >= leaves, held[row, extra], 0)
        used[row] += 1
    # In the order of the rows of radiosity: neighbours in memory are read one after the other.
    words = np.where(held > 0, node << HIT_BITS | held, 0)
    return np.sort(words, axis=1)[:, ::-1].astype(np.uint32)
