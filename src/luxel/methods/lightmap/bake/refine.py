"""Which clusters light a texel: from the root down, one is split at a time, until the budget is reached.

The document splits the heaviest. But a cluster's radiosity is a mean over its whole area, while the texel sees some of
it more than the rest, and what is hidden tends to be dark: with 90 clusters the Cornell box came out 1.4 % too dark. So
here that cluster is split whose halves the texel sees most unlike their areas. With halves of area share a and b and
hits h and k, that is |h b - k a|: how much light the split moves for each unit that the halves' radiosities differ (the
row's coefficient in the Haar basis of the tree).

A row's keys are the leaves that its rays met, ascending. A cluster is a range of leaves, so it is a range of keys, and
its hits are found by bisection. One lane refines one row.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.errors import LuxelError
from luxel.methods.lightmap.bake.passes import plan_lists, sum_over_nodes
from luxel.methods.lightmap.bake.tree import Tree
from luxel.methods.lightmap.bake.words import HIT_BITS
from luxel.scene.arrays import from_numpy

HEAVY_SHARE = 0.05
"""What a hit counts beside the unevenness: even clusters are split too, the heaviest first."""


@dataclass
class TreeTables:
    """The tree as the kernels read it: L leaves, then inner nodes."""

    leaves: mi.UInt32
    root_of: mi.UInt32
    """(L,) root above each leaf."""
    low: mi.UInt32
    """(nodes,) first leaf of each node."""
    high: mi.UInt32
    """(nodes,) one past its last leaf."""
    left: mi.UInt32
    """(inner,) first child."""
    right: mi.UInt32
    share: mi.Float
    """(inner,) the first child's area over the node's."""
    starts: mi.UInt32
    """(inner + 1,) list of what each inner node is summed over."""
    items: mi.UInt32


@dataclass
class RowLeaves:
    """The leaves that rows met."""

    leaf: mi.UInt32
    """Row by row, ascending in each."""
    starts: mi.UInt32
    """(rows + 1,)."""
    total: mi.UInt32 | None
    """Hits of all keys before each; None: one hit a key."""


@dataclass
class Cluster:
    """One cluster of a row: the keys first .. last lie in it, those from middle on in its second child."""

    node: mi.UInt32
    first: mi.UInt32
    middle: mi.UInt32
    last: mi.UInt32


@dataclass
class RowClusters:
    """What each lane's row is made of so far: `budget` places in local memory."""

    clusters: dr.Local[Cluster]
    gain: dr.Local[mi.Float]
    """What splitting each is worth."""


class Refiner:
    """Refines rows of one tree."""

    def __init__(self, tree: Tree, roots: np.ndarray, area: np.ndarray, budget: int, by_weight: bool) -> None:
        """`area` (L,) is that of the leaves, in their order; `by_weight` splits the heaviest, as the document does."""
        self.tree, self.budget, self.by_weight = tree, budget, by_weight
        self.lists = plan_lists(tree, area)
        node_area = sum_over_nodes(tree, area)
        left, right = tree.children.T if len(tree.children) else np.zeros((2, 1), np.int64)
        root_of = np.zeros(len(tree.leaf), np.int64)
        for root in roots:
            root_of[tree.low[root] : tree.high[root]] = root
        self.tables = TreeTables(
            leaves=dr.opaque(mi.UInt32, len(tree.leaf)),
            root_of=from_numpy(mi.UInt32, root_of),
            low=from_numpy(mi.UInt32, tree.low),
            high=from_numpy(mi.UInt32, tree.high),
            left=from_numpy(mi.UInt32, left),
            right=from_numpy(mi.UInt32, right),
            share=from_numpy(mi.Float, node_area[left] / np.maximum(node_area[left] + node_area[right], 1e-300)),
            starts=from_numpy(mi.UInt32, self.lists.starts),
            items=from_numpy(mi.UInt32, self.lists.items if len(self.lists.items) else np.zeros(1)),
        )

    def refine(self, leaf: np.ndarray, hits: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return words (rows, budget) uint32, cluster << `HIT_BITS` | hits, for the leaves (rows, rays) that rays met.

        A word of 0 ends a row. The hits of a row add up to its rays, however far it is refined; with `hits`
        (rows, rays), of ascending leaves, to their sum. Beside them, how many rays each item of `lists` was seen by.
        Raises LuxelError where a row's leaves lie in more trees than the budget has clusters.
        """
        rows, rays = leaf.shape
        total = None
        if hits is None:
            leaf = np.sort(leaf, axis=1)
        else:
            total = from_numpy(mi.UInt32, np.concatenate([[0], np.cumsum(hits)]))
        keys = RowLeaves(from_numpy(mi.UInt32, leaf.ravel()), from_numpy(mi.UInt32, np.arange(rows + 1) * rays), total)
        words, clusters, unplaced = refine_rows(self.tables, keys, rows, self.budget, self.by_weight)
        dr.eval(words, clusters, unplaced)
        if np.array(unplaced).any():
            raise LuxelError(
                f"'clusters_per_texel' is {self.budget}, but a texel sees more regions than that which do not see one "
                "another: set it higher"
            )
        seen = count_items(self.tables, keys, clusters, len(self.lists.items))
        # In the order of the rows of radiosity: neighbours in memory are read one after the other.
        return np.sort(np.array(words).reshape(rows, -1), axis=1)[:, ::-1], np.array(seen).astype(np.int64)


def refine_rows(
    tree: TreeTables, keys: RowLeaves, rows: int, budget: int, by_weight: bool
) -> tuple[mi.UInt32, Cluster, mi.UInt32]:
    """Return words and clusters, (rows, budget) each: every row's keys shared out to at most `budget` clusters.

    Beside them, how many keys of each row were left over because they lie in more trees than that.
    """
    held, used, unplaced = _find_trees(tree, keys, rows, budget, by_weight)
    held, used = _split_clusters(tree, keys, held, used, budget, by_weight)
    return *_write_rows(keys, held, used, rows, budget), unplaced


@dr.syntax
def _find_trees(
    tree: TreeTables, keys: RowLeaves, rows: int, budget: int, by_weight: bool
) -> tuple[RowClusters, mi.UInt32, mi.UInt32]:
    """Return the trees that each row's rays met, a range of its keys each, how many, and the keys past the budget."""
    row = dr.arange(mi.UInt32, rows)
    at, end = dr.gather(mi.UInt32, keys.starts, row), dr.gather(mi.UInt32, keys.starts, row + 1)
    nothing = mi.UInt32(0)
    clusters = dr.alloc_local(Cluster, budget, Cluster(nothing, nothing, nothing, nothing))
    gain = dr.alloc_local(mi.Float, budget, mi.Float(0.0))
    used = mi.UInt32(0)
    while (at < end) & (used < budget):
        root = dr.gather(mi.UInt32, tree.root_of, dr.gather(mi.UInt32, keys.leaf, at))
        until = lower_bound(keys.leaf, dr.gather(mi.UInt32, tree.high, root), at, end)
        cluster, worth = tighten(tree, keys, root, at, until, by_weight)
        clusters.write(cluster, used)
        gain.write(worth, used)
        used += 1
        at = mi.UInt32(until)
    return RowClusters(clusters, gain), used, end - at


@dr.syntax
def _split_clusters(
    tree: TreeTables, keys: RowLeaves, held: RowClusters, used: mi.UInt32, budget: int, by_weight: bool
) -> tuple[RowClusters, mi.UInt32]:
    """Split the best cluster of each row in two, while there is room and something to split."""
    clusters, gain = held.clusters, held.gain
    going = used < budget
    while going:
        best, most, index = mi.UInt32(0), mi.Float(0.0), mi.UInt32(0)
        while index < used:
            worth = gain.read(index)
            best, most = dr.select(worth > most, index, best), dr.maximum(worth, most)
            index += 1
        going = most > 0.0
        cluster = clusters.read(best, going)
        inner = cluster.node - tree.leaves
        left, right = dr.gather(mi.UInt32, tree.left, inner, going), dr.gather(mi.UInt32, tree.right, inner, going)
        first, worth = tighten(tree, keys, left, cluster.first, cluster.middle, by_weight, going)
        second, other = tighten(tree, keys, right, cluster.middle, cluster.last, by_weight, going)
        clusters.write(first, best, going)
        gain.write(worth, best, going)
        clusters.write(second, used, going)
        gain.write(other, used, going)
        used += dr.select(going, mi.UInt32(1), 0)
        going &= used < budget
    return RowClusters(clusters, gain), used


@dr.syntax
def _write_rows(
    keys: RowLeaves, held: RowClusters, used: mi.UInt32, rows: int, budget: int
) -> tuple[mi.UInt32, Cluster]:
    """Return words and clusters, (rows, budget) each, of what each row holds."""
    row, clusters = dr.arange(mi.UInt32, rows), held.clusters
    words, written = dr.zeros(mi.UInt32, rows * budget), dr.zeros(Cluster, rows * budget)
    index = mi.UInt32(0)
    while index < used:
        cluster = clusters.read(index)
        hits = dr.minimum(count_hits(keys, cluster.first, cluster.last), (1 << HIT_BITS) - 1)
        word = dr.select(hits > 0, (cluster.node << HIT_BITS) | hits, 0)
        dr.scatter(words, word, row * budget + index)
        dr.scatter(written, cluster, row * budget + index)
        index += 1
    return words, written


@dr.syntax
def tighten(
    tree: TreeTables, keys: RowLeaves, node: mi.UInt32, first: mi.UInt32, last: mi.UInt32, by_weight: bool,
    active: mi.Bool | bool = True,
) -> tuple[Cluster, mi.Float]:  # fmt: skip
    """Return the smallest node at or below `node` that holds the keys first .. last, and what splitting it is worth.

    A leaf, whose rays all went to one surfel, is worth nothing.
    """
    node, middle = mi.UInt32(node), mi.UInt32(last)
    going = (node >= tree.leaves) & active
    while going:
        inner = node - tree.leaves
        right = dr.gather(mi.UInt32, tree.right, inner, going)
        middle = lower_bound(keys.leaf, dr.gather(mi.UInt32, tree.low, right, going), first, last)
        left_only, right_only = middle == last, middle == first
        left = dr.gather(mi.UInt32, tree.left, inner, going & left_only)
        node = dr.select(right_only, right, dr.select(left_only, left, node))
        going = (right_only | left_only) & (node >= tree.leaves)
    is_inner = (node >= tree.leaves) & active
    hits = mi.Float(count_hits(keys, first, last))
    worth = mi.Float(hits)
    if dr.hint(not by_weight, mode="scalar"):
        share = dr.gather(mi.Float, tree.share, node - tree.leaves, is_inner)
        half = mi.Float(count_hits(keys, first, middle))
        worth = dr.abs(half * (1.0 - share) - (hits - half) * share) + HEAVY_SHARE * hits
    return Cluster(node, mi.UInt32(first), middle, mi.UInt32(last)), dr.select(is_inner, worth, 0.0)


@dr.syntax
def lower_bound(sorted_words: mi.UInt32, value: mi.UInt32, first: mi.UInt32, last: mi.UInt32) -> mi.UInt32:
    """Return the first place in first .. last whose word is not below `value`; `last` where there is none."""
    low, high = mi.UInt32(first), mi.UInt32(last)
    while low < high:
        middle = (low + high) >> 1
        below = dr.gather(mi.UInt32, sorted_words, middle) < value
        low, high = dr.select(below, middle + 1, low), dr.select(below, high, middle)
    return low


def count_hits(keys: RowLeaves, first: mi.UInt32, last: mi.UInt32) -> mi.UInt32:
    """Return the hits of the keys first .. last."""
    if keys.total is None:
        return last - first
    return dr.gather(mi.UInt32, keys.total, last) - dr.gather(mi.UInt32, keys.total, first)


@dr.syntax
def count_items(tree: TreeTables, keys: RowLeaves, clusters: Cluster, item_count: int) -> mi.UInt32:
    """Return how many keys went to each item (I,) of the lists of those clusters through which they are read."""
    seen = dr.zeros(mi.UInt32, item_count)
    is_inner = clusters.node >= tree.leaves
    inner = clusters.node - tree.leaves
    first = dr.gather(mi.UInt32, tree.starts, inner, is_inner)
    last = dr.gather(mi.UInt32, tree.starts, inner + 1, is_inner)
    key = mi.UInt32(clusters.first)
    while is_inner & (key < clusters.last):
        leaf = dr.gather(mi.UInt32, keys.leaf, key)
        low, high = mi.UInt32(first), mi.UInt32(last)
        while high - low > 1:
            middle = (low + high) >> 1
            past = dr.gather(mi.UInt32, tree.low, dr.gather(mi.UInt32, tree.items, middle)) > leaf
            low, high = dr.select(past, low, middle), dr.select(past, middle, high)
        dr.scatter_inc(seen, low)
        key += 1
    return seen
