"""The trees that stand side by side: one for each region of surfels that see one another, the sky's, and the void."""

from __future__ import annotations

from dataclasses import dataclass, replace

import mitsuba as mi
import numpy as np

from luxel.errors import LuxelError
from luxel.methods.base import Progress, stay_silent
from luxel.methods.lightmap.bake.mutual_visibility import MutualVisibility
from luxel.methods.lightmap.bake.sky import make_sky_tree
from luxel.methods.lightmap.bake.surfels import BakedSurfels
from luxel.methods.lightmap.bake.tree import Items, MergeWeights, Tree, merge_pairs, order_tree, put_side_by_side
from luxel.methods.lightmap.bake.visibility import Leaves
from luxel.methods.lightmap.bake.words import NODE_LIMIT
from luxel.methods.lightmap.flatten.faces import NONE
from luxel.methods.lightmap.params import LightmapParams
from luxel.scene.arrays import from_numpy


@dataclass
class Forest:
    """Trees over S surfels, R R cells of the sky, and the void, a tree of one leaf."""

    tree: Tree
    """All of them side by side. Items: the surfels, the cells, the void."""
    roots: np.ndarray
    """One node a tree."""
    surfel_count: int
    sky_resolution: int
    """R; 0: the scene has no sky."""
    sky_direction: np.ndarray
    """(R R, 3) middle of each cell."""
    sky_angle: np.ndarray
    """(R R,) steradians."""


def check_node_count(surfel_count: int, resolution: int, name: str) -> None:
    """Raise LuxelError where the trees of so many surfels and the sky would have more nodes than words can name."""
    # Binary trees: fewer than two nodes a leaf, the void's among them.
    if 2 * (surfel_count + resolution * resolution + 1) > NODE_LIMIT:
        raise LuxelError(
            f"{name}: {surfel_count:,} surfels make more clusters than {NODE_LIMIT:,}, the most there can be; every "
            "piece of a surface takes one surfel: lower 'surfel_target', join meshes, or leave small parts out"
        )


def grow_forest(
    surfels: BakedSurfels,
    visibility: MutualVisibility,
    resolution: int,
    params: LightmapParams,
    report: Progress = stay_silent,
) -> Forest:
    """Return the trees of the surfels, by region, and of a sky of `resolution` R."""
    weights = MergeWeights(params.tree_normal, params.tree_chart, params.tree_outlook, params.tree_balance)
    trees, done, count = [], 0, len(surfels.p)
    report("growing the tree", 0.0)
    for number in np.unique(visibility.region):
        held = np.flatnonzero(visibility.region == number)
        items = Items(
            surfels.p[held], surfels.normal[held], surfels.area[held], surfels.chart[held], visibility.view[held]
        )
        merges = merge_pairs(
            items, weights, lambda now, before=done: report("growing the tree", (before + now) / count)
        )
        tree = order_tree(merges, len(held))
        done += len(held)
        trees.append(replace(tree, leaf=held[tree.leaf]))
    direction, angle = np.zeros((0, 3)), np.zeros(0)
    if resolution:
        sky, direction, angle = make_sky_tree(resolution)
        trees.append(replace(sky, leaf=sky.leaf + count))
    last = count + resolution * resolution
    void = Tree(np.array([last]), np.zeros((0, 2), np.int64), np.zeros(1, np.int64), np.ones(1, np.int64))
    tree, roots = put_side_by_side([*trees, void])
    return Forest(tree, roots, count, resolution, direction, angle)


def make_leaves(forest: Forest, labels: np.ndarray) -> Leaves:
    """Return which leaf a ray meets in each fine cell, whose surfels `labels` names, and each cell of the sky."""
    leaf_of, resolution = forest.tree.leaf_of, forest.sky_resolution
    held = labels != NONE
    of_cell = np.full(len(labels), NONE, np.uint32)
    of_cell[held] = leaf_of[labels[held]]
    sky = leaf_of[forest.surfel_count : forest.surfel_count + resolution * resolution]
    of_sky = from_numpy(mi.UInt32, sky if resolution else np.zeros(1))
    return Leaves(from_numpy(mi.UInt32, of_cell), of_sky, resolution, int(leaf_of[-1]))
