"""Surfels: even pieces of the charts by k-means over the dense points, each chart by its share of the area."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from luxel.methods.base import Progress, stay_silent
from luxel.methods.lightmap.flatten.atlas import SUBTEXELS, Atlas, Points, Texels
from luxel.methods.lightmap.flatten.faces import NONE
from luxel.methods.lightmap.flatten.flat_scene import FlatScene
from luxel.methods.lightmap.flatten.nearest import find_nearest
from luxel.methods.lightmap.params import LightmapParams

ROUNDS = 10
"""Rounds of Lloyd's algorithm."""
SETS = 4
"""Sets of sample points that frames with the same lights take in turn."""
ALBEDO_MOST = 0.99
"""Surfels reflect at most so much: light between perfect mirrors of it would never settle."""


@dataclass
class BakedSurfels:
    """S surfels."""

    p: np.ndarray
    """(S, 3) mean position."""
    normal: np.ndarray
    """(S, 3) mean normal, unit."""
    area: np.ndarray
    """(S,) m^2."""
    albedo: np.ndarray
    """(S, 3) mean over its points: the texture, filtered to its size."""
    chart: np.ndarray
    """(S,)."""
    samples: np.ndarray
    """(S, K SETS) dense points that stand for it when it is lit; sets are strided, so that each goes all around it."""


def make_surfels(
    flat: FlatScene, albedo: np.ndarray, params: LightmapParams, seed: int, report: Progress = stay_silent
) -> tuple[BakedSurfels, np.ndarray]:
    """Return the surfels and the surfel (N,) of each dense point, -1 where it does not take part.

    `albedo` (N, 3) is that of the points. About `surfel_target` surfels, none across two pieces of a chart; every
    piece with a point that takes part has at least one.
    """
    points, random = flat.points, np.random.default_rng(seed)
    chosen = np.flatnonzero(flat.valid)
    place = points.xy[chosen] * np.sqrt(points.area[chosen])[:, None] * SUBTEXELS
    # On an even grid, ties would make stripes.
    place += random.uniform(-0.02, 0.02, place.shape) * flat.atlas.texel_size
    label = _find_clusters(place, flat.piece[chosen], flat.weight[chosen], params.surfel_target, random, report)
    used, first, label = np.unique(label, return_index=True, return_inverse=True)
    of_point = np.full(len(points.p), -1, np.int64)
    of_point[chosen] = label
    area = points.area[chosen]
    total = np.bincount(label, weights=area, minlength=len(used))

    def average(values: np.ndarray) -> np.ndarray:
        sums = np.stack([np.bincount(label, weights=area * column, minlength=len(used)) for column in values.T], 1)
        return sums / total[:, None]

    normal = average(points.normal[chosen])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    surfels = BakedSurfels(
        p=average(points.p[chosen]),
        normal=np.where(length > 1e-3, normal / np.maximum(length, 1e-3), points.normal[chosen][first]),
        area=total,
        albedo=np.clip(average(albedo[chosen]), 0.0, ALBEDO_MOST),
        chart=points.chart[chosen][first],
        samples=chosen[_pick_samples(place, label, params.points_per_surfel * SETS, random)],
    )
    return surfels, of_point


def _find_clusters(
    flat: np.ndarray, piece: np.ndarray, area: np.ndarray, target: int, random: np.random.Generator, report: Progress
) -> np.ndarray:
    """Return the cluster (n,) of each point (n, 2) by k-means, none across two pieces."""
    _, inverse, amount = np.unique(piece, return_inverse=True, return_counts=True)
    piece_area = np.bincount(inverse, weights=area)
    count = np.minimum(np.maximum(np.round(piece_area / piece_area.sum() * target), 1), amount).astype(np.int64)
    # Each piece stands in a plane of its own: one search serves all.
    far = 16.0 * float(np.ptp(flat, axis=0).sum()) + 1.0
    placed = np.column_stack([flat, inverse * far])
    order = np.lexsort((random.random(len(flat)), inverse))
    rank = np.empty(len(flat), np.int64)
    rank[order] = np.arange(len(flat)) - np.repeat(np.cumsum(amount) - amount, amount)
    centres = placed[rank < count[inverse]]
    label = np.zeros(len(flat), np.int64)
    for number in range(ROUNDS):
        report("making surfels", number / ROUNDS)
        label = np.asarray(scipy.spatial.KDTree(centres).query(placed, workers=-1)[1])
        held = np.bincount(label, minlength=len(centres))
        mean = np.stack([np.bincount(label, weights=axis, minlength=len(centres)) for axis in placed.T], axis=1)
        centres = np.where(held[:, None] > 0, mean / np.maximum(held, 1)[:, None], centres)
    return label


def _pick_samples(flat: np.ndarray, label: np.ndarray, count: int, random: np.random.Generator) -> np.ndarray:
    """Return (S, `count`) points of each surfel, spread around its middle."""
    amount = np.bincount(label)
    mean = np.stack([np.bincount(label, weights=axis) for axis in flat.T], axis=1) / amount[:, None]
    offset = flat - mean[label]
    order = np.lexsort((np.arctan2(offset[:, 1], offset[:, 0]), label))
    first = np.cumsum(amount) - amount
    step = (np.arange(count)[None] + random.random((len(amount), count))) / count
    return order[first[:, None] + np.minimum((step * amount[:, None]).astype(np.int64), amount[:, None] - 1)]


def label_cells(atlas: Atlas, points: Points, of_point: np.ndarray, texels: Texels) -> np.ndarray:
    """Return the surfel of every fine cell (height * SUBTEXELS * width * SUBTEXELS,), `NONE` away from the charts.

    Cells around a chart, and those of points inside geometry, take the nearest surfel of their own chart.
    """
    size = (atlas.width * SUBTEXELS, atlas.height * SUBTEXELS)
    labels = np.full(size[0] * size[1], NONE, np.uint32)
    valid = of_point >= 0
    step = np.arange(SUBTEXELS)
    x = (texels.slot % atlas.width)[:, None, None] * SUBTEXELS + step[None, :, None]
    y = (texels.slot // atlas.width)[:, None, None] * SUBTEXELS + step[None, None, :]
    cells = (y * size[0] + x).reshape(len(texels.slot), -1)
    chart = np.repeat(texels.chart, SUBTEXELS * SUBTEXELS)
    cells = cells.ravel()
    middle = np.column_stack([cells % size[0], cells // size[0]]) + 0.5 - 0.5 * SUBTEXELS
    index = find_nearest(points.xy[valid] * SUBTEXELS, points.chart[valid], middle, chart)[:, 0]
    labels[cells[index >= 0]] = of_point[valid][index[index >= 0]]
    return labels
