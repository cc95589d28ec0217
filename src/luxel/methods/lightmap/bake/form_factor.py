"""The analytic form factor, which the source gave up: what it does where texel and surfel are close, to see why."""

from __future__ import annotations

import numpy as np

from luxel.methods.lightmap.bake.surfels import BakedSurfels
from luxel.methods.lightmap.bake.tree import Tree
from luxel.methods.lightmap.bake.words import HIT_BITS
from luxel.methods.lightmap.flatten.origins import Origins


def weigh_by_form_factor(
    leaf: np.ndarray, tree: Tree, surfels: BakedSurfels, origins: Origins, point: np.ndarray, rays: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the leaves (rows, rays) that rays met, ascending in each row, and their weight in `rays` parts.

    A leaf's weight stands with the first of its rays. A surfel that any ray of a row met has the weight of a small disc
    in full view: cos cos' area / (pi d^2). Nothing makes the weights of a row add up to 1, and close ones exceed it.
    Sky and void keep their hits.
    """
    leaf = np.sort(leaf, axis=1)
    is_first = np.ones(leaf.shape, bool)
    is_first[:, 1:] = leaf[:, 1:] != leaf[:, :-1]
    row, item = np.nonzero(is_first)[0], tree.leaf[leaf[is_first]]
    hits = np.diff(np.append(np.flatnonzero(is_first), leaf.size))
    solid = item < len(surfels.p)
    p = np.array(origins.p).T[point[row[solid]]]
    n = np.array(origins.n_shading).T[point[row[solid]]]
    surfel = item[solid]
    way = surfels.p[surfel] - p
    squared = np.maximum((way**2).sum(axis=1), 1e-12)
    cosines = np.maximum((way * n).sum(axis=1), 0.0) * np.maximum(-(way * surfels.normal[surfel]).sum(axis=1), 0.0)
    factor = cosines / squared * surfels.area[surfel] / (np.pi * squared)
    hits[solid] = np.clip(np.round(factor * rays), 0, (1 << HIT_BITS) - 1)
    weights = np.zeros(leaf.shape, np.int64)
    weights[is_first] = hits
    return leaf, weights
