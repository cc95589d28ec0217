"""Which clusters light a texel: from the root down, one is split at a time, until the budget is reached.

The document splits the heaviest. But a cluster's radiosity is a mean over its whole area, while the texel sees some of
it more than the rest, and what is hidden tends to be dark: with 90 clusters the Cornell box came out 1.4 % too dark. So
here that cluster is split whose halves the texel sees most unlike their areas. With halves of area share a and b and
hits h and k, that is |h b - k a|: how much light the split moves for each unit that the halves' radiosities differ (the
row's coefficient in the Haar basis of the tree).
"""

from __future__ import annotations

import numpy as np

from luxel.methods.lightmap.passes import count_rays, plan_lists, sum_over_nodes
from luxel.methods.lightmap.state import HIT_BITS
from luxel.methods.lightmap.tree import Tree

HEAVY_SHARE = 0.05
"""What a hit counts beside the unevenness: even clusters are split too, the heaviest first."""


class Refiner:
    """Refines rows of one tree."""

    def __init__(self, tree: Tree, roots: np.ndarray, area: np.ndarray, budget: int, by_weight: bool) -> None:
        """`area` (L,) is that of the leaves, in their order; `by_weight` splits the heaviest, as the document does."""
        self.tree, self.roots, self.budget, self.by_weight = tree, roots, budget, by_weight
        self.leaves = len(tree.leaf)
        self.lists = plan_lists(tree, area)
        inner = sum_over_nodes(tree, area)[tree.children]
        total = np.maximum(inner.sum(axis=1), 1e-300)
        self.share = inner / total[:, None]
        self.cut = tree.low[tree.children[:, 1]] if len(tree.children) else np.zeros(0, np.int64)

    def refine(self, leaf: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return words (rows, budget) uint32, cluster << `HIT_BITS` | hits, for the leaf (rows, rays) each ray met.

        A word of 0 ends a row. The hits of a row add up to its rays, however far it is refined. Beside them, how many
        rays each item of `lists` was seen by.
        """
        rows = len(leaf)
        keys = np.sort((leaf.astype(np.int64) + np.arange(rows, dtype=np.int64)[:, None] * self.leaves).ravel())
        return self.refine_sorted(keys, None, rows)

    def refine_sorted(self, keys: np.ndarray, weight: np.ndarray | None, rows: int) -> tuple[np.ndarray, np.ndarray]:
        """Refine from sorted keys, row * leaves + leaf, with the weight (hits) of each; None: one each."""
        work = _Rows(self, keys, weight, rows)
        for root in self.roots:
            low, high = (np.searchsorted(keys, work.base + end[root]) for end in (self.tree.low, self.tree.high))
            row = np.flatnonzero(high > low)
            work.add(row, np.full(len(row), root), low[row], high[row])
        active = np.arange(rows)
        while len(active):
            active = work.split(active)
        words = np.where(work.held > 0, work.node << HIT_BITS | work.held, 0)
        # In the order of the rows of radiosity: neighbours in memory are read one after the other.
        return np.sort(words, axis=1)[:, ::-1].astype(np.uint32), self._count(work)

    def _count(self, work: _Rows) -> np.ndarray:
        """Return how many rays each item of `lists` was seen by: clusters of a row share its keys out in order."""
        used = np.flatnonzero((work.last > work.first).ravel())
        order = used[np.argsort(work.first.ravel()[used])]
        node = np.repeat(work.node.ravel()[order], (work.last - work.first).ravel()[order])
        return count_rays(self.lists, self.tree, node, work.keys % self.leaves)


class _Rows:
    """The clusters of a batch of rows while they are refined.

    A cluster is a range of leaves, so its hits are those between two places among the keys.
    """

    def __init__(self, refiner: Refiner, keys: np.ndarray, weight: np.ndarray | None, rows: int) -> None:
        self.by, self.keys = refiner, keys
        self.total = None if weight is None else np.concatenate([[0], np.cumsum(weight)])
        self.base = np.arange(rows) * refiner.leaves
        self.node, self.first, self.middle, self.last, self.held = (
            np.zeros((rows, refiner.budget), np.int64) for _ in range(5)
        )
        self.gain = np.zeros((rows, refiner.budget), np.float32)
        self.used = np.zeros(rows, np.int64)

    def hits(self, first: np.ndarray, last: np.ndarray) -> np.ndarray:
        """Return the hits of keys `first` .. `last`."""
        return last - first if self.total is None else self.total[last] - self.total[first]

    def add(self, row: np.ndarray, node: np.ndarray, first: np.ndarray, last: np.ndarray) -> None:
        """Give rows one more cluster each."""
        self.put(row, self.used[row], node, first, last)
        self.used[row] += 1

    def put(self, row: np.ndarray, column: np.ndarray, node: np.ndarray, first: np.ndarray, last: np.ndarray) -> None:
        """Set clusters, where their halves part, and what splitting them is worth."""
        by = self.by
        is_inner = node >= by.leaves
        inner = np.where(is_inner, node - by.leaves, 0)
        cut = by.cut[inner] if len(by.cut) else inner
        middle = np.searchsorted(self.keys, self.base[row] + cut)
        middle = np.where(is_inner, np.clip(middle, first, last), last)
        held, left = self.hits(first, last), self.hits(first, middle)
        if by.by_weight or not len(by.cut):
            gain = held.astype(np.float32)
        else:
            share = by.share[inner]
            gain = np.abs(left * share[:, 1] - (held - left) * share[:, 0]) + HEAVY_SHARE * held
        self.node[row, column], self.held[row, column] = node, held
        self.first[row, column], self.middle[row, column], self.last[row, column] = first, middle, last
        self.gain[row, column] = np.where(is_inner, gain, 0.0)

    def split(self, active: np.ndarray) -> np.ndarray:
        """Split the best cluster of each row of `active`; return the rows that may go on."""
        column = self.gain[active].argmax(axis=1)
        going = self.gain[active, column] > 0.0
        active, column = active[going], column[going]
        if not len(active):
            return active
        left, right = self.by.tree.children[self.node[active, column] - self.by.leaves].T
        first, middle, last = (held[active, column] for held in (self.first, self.middle, self.last))
        both = (middle > first) & (middle < last)
        # No room for a second half: this cluster stays as it is.
        full = both & (self.used[active] >= self.by.budget)
        self.gain[active[full], column[full]] = 0.0
        go = ~full
        only_right = middle == first
        kept, end = np.where(only_right, right, left)[go], np.where(both, middle, last)[go]
        self.put(active[go], column[go], kept, first[go], end)
        two = both & go
        self.add(active[two], right[two], middle[two], last[two])
        return active
