"""The atlas: charts snapped to texel centres and packed, points spread evenly over them, and the texels they need.

A chart spans whole texels, so its straight borders run through texel centres and a bilinear look-up inside it never
reads beyond them. Rows of charts are one texel apart. A texel is needed where a look-up from inside a chart can read
it; one whose own cell no part of the chart covers (the gutter) takes the nearest points of its chart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from luxel.errors import LuxelError
from luxel.kernels.ray_origin import clear_points
from luxel.methods.lightmap.flatten.faces import Faces
from luxel.methods.lightmap.flatten.nearest import find_nearest
from luxel.methods.lightmap.flatten.raster import cover
from luxel.methods.lightmap.flatten.unwrap import Charts
from luxel.methods.lightmap.params import TEXEL_LIMIT

SUBTEXELS = 4
"""Points along a texel's side."""
SIDE_LIMIT = 8192
"""Texels along a side of the atlas at most."""
GUTTER_POINTS = 4
"""Points that a gutter texel takes from its chart."""


@dataclass
class Atlas:
    """Charts, placed: coordinates are in texels, texel (i, j) has its middle at (i, j)."""

    width: int
    height: int
    texel_size: float
    """Metres, where `Charts.density` is 1."""
    uv: np.ndarray
    """(F, 3, 2) of each face's corners."""
    spread: np.ndarray
    """(F, 3, 2) the same, but charts narrower than a texel are as wide as one: points are spread over these."""
    narrow: np.ndarray
    """(C, 2) bool: the chart has no width along this axis, it lies on a line of texel centres."""
    chart: np.ndarray
    """(F,); -1: not in the atlas."""
    chart_count: int


@dataclass
class Points:
    """Dense points, at most one in each cell of `SUBTEXELS` x `SUBTEXELS` to a texel. N of them."""

    cell: np.ndarray
    """(N,) cell of the fine grid, row by row, ascending."""
    face: np.ndarray
    """(N,)."""
    weights: np.ndarray
    """(N, 3) of the face's corners."""
    p: np.ndarray
    """(N, 3) world."""
    normal: np.ndarray
    """(N, 3) unit, interpolated, on the face's side."""
    area: np.ndarray
    """(N,) m^2: the charts' areas shared out."""
    chart: np.ndarray
    """(N,)."""
    xy: np.ndarray
    """(N, 2) place in the atlas, texels; in `Atlas.spread`."""


@dataclass
class Texels:
    """Texels that look-ups read. M of them."""

    slot: np.ndarray
    """(M,) y * width + x."""
    starts: np.ndarray
    """(M + 1,): texel m samples the points points[starts[m]:starts[m + 1]]."""
    points: np.ndarray
    chart: np.ndarray
    """(M,)."""


def make_atlas(faces: Faces, charts: Charts, texel_target: int, texels_per_metre: float, name: str) -> Atlas:
    """Snap and pack the charts.

    Raises LuxelError where they need a larger atlas than `SIDE_LIMIT` squared, or more texels than `TEXEL_LIMIT`.
    """
    held = charts.chart >= 0
    size = np.zeros((charts.count, 2))
    np.maximum.at(size, charts.chart[held], charts.uv[held].max(axis=1))
    area = np.bincount(charts.chart[held], weights=faces.area[held], minlength=charts.count) * charts.density**2
    fill = area / np.maximum(size.prod(axis=1), 1e-30)
    texel_size = 1.0 / texels_per_metre if texels_per_metre > 0.0 else _fit_texel(size, fill, texel_target)
    spans = np.round(size / texel_size).astype(np.int64)
    if float((spans + 2.0).prod(axis=1).sum()) > SIDE_LIMIT**2 or spans.max() + 1 > SIDE_LIMIT:
        raise LuxelError(
            f"{name}: an atlas of {SIDE_LIMIT} x {SIDE_LIMIT} is too small for its charts at {1.0 / texel_size:.3g} "
            "texels a metre; lower 'texel_target' or 'texels_per_metre'"
        )
    need = _count_texels(spans, fill)
    if need > TEXEL_LIMIT:
        raise LuxelError(
            f"{name}: {1.0 / texel_size:,.4g} texels a metre make {need:,.0f} texels, and {TEXEL_LIMIT:,} are the "
            "most; lower 'texels_per_metre'"
        )
    place, width, height = pack(spans + 1)
    if max(width, height) > SIDE_LIMIT:
        raise LuxelError(f"{name}: its {charts.count} charts do not fit an atlas of {SIDE_LIMIT} x {SIDE_LIMIT}")
    # A chart is stretched by up to half a texel, so that its border runs through texel centres.
    scale = np.where(size > 0.0, spans / np.maximum(size, 1e-30), 0.0)
    uv, spread, narrow = np.zeros_like(charts.uv), np.zeros_like(charts.uv), spans == 0
    chart = charts.chart[held]
    uv[held] = charts.uv[held] * scale[chart][:, None] + place[chart][:, None]
    share = charts.uv[held] / np.maximum(size, 1e-30)[chart][:, None]
    spread[held] = np.where(narrow[chart][:, None], uv[held] + share - 0.5, uv[held])
    return Atlas(width, height, texel_size, uv, spread, narrow, charts.chart, charts.count)


def _fit_texel(size: np.ndarray, fill: np.ndarray, target: int) -> float:
    """Return the texel size at which charts (C, 2) of the given fill need about `target` texels."""
    low, high = 1e-9 * float(size.max()), 4.0 * float(size.max())
    for _ in range(60):
        middle = (low * high) ** 0.5
        low, high = (middle, high) if _count_texels(np.round(size / middle), fill) > target else (low, middle)
    return high


def _count_texels(spans: np.ndarray, fill: np.ndarray) -> float:
    """Return about how many texels charts that span (C, 2) texels need, for their area and their border."""
    return float((spans.prod(axis=1) * np.minimum(fill, 1.0) + spans.sum(axis=1) + 1.0).sum())


def pack(sizes: np.ndarray) -> tuple[np.ndarray, int, int]:
    """Return lower corners (C, 2) of rectangles `sizes` (C, 2) in rows, a texel apart, and width and height of all."""
    padded = sizes + 1
    width = int(max(padded[:, 0].max(), np.ceil((padded.prod(axis=1).sum() * 1.05) ** 0.5)))
    place = np.zeros_like(sizes)
    order = np.lexsort((-sizes[:, 0], -sizes[:, 1]))
    x = y = tall = 0
    for index in order:
        wide, high = padded[index]
        if x and x + wide > width:
            x, y, tall = 0, y + tall, 0
        place[index] = x, y
        x, tall = x + wide, max(tall, high)
    return place, width, int(y + tall)


def spread_points(faces: Faces, atlas: Atlas) -> Points:
    """Return one point in the middle of each fine cell that a face covers, and at least one on each chart."""
    held = np.flatnonzero(atlas.chart >= 0)
    size = (atlas.width * SUBTEXELS, atlas.height * SUBTEXELS)
    # Half a cell's shift: texel i spans i - 1/2 .. i + 1/2, so that its cells are its own.
    fine = (atlas.spread[held] + 0.5) * SUBTEXELS
    cell, triangle, weights = cover(fine, size)
    first = np.unique(cell, return_index=True)[1]
    cell, triangle, weights = cell[first], triangle[first], weights[first]
    bare = np.setdiff1d(np.arange(len(held)), triangle)
    middle = np.floor(fine[bare].mean(axis=1)).astype(np.int64)
    extra = middle[:, 1] * size[0] + middle[:, 0]
    extra, kept = np.unique(extra, return_index=True)
    new = ~np.isin(extra, cell)
    extra, kept = extra[new], kept[new]
    cell = np.concatenate([cell, extra])
    triangle = np.concatenate([triangle, bare[kept]])
    weights = np.concatenate([weights, np.full((len(extra), 3), 1.0 / 3.0)])
    order = np.argsort(cell)
    cell, face, weights = cell[order], held[triangle[order]], weights[order]
    p, normal = place_points(faces, face, weights)
    chart = atlas.chart[face]
    amount = np.bincount(chart, minlength=atlas.chart_count)
    area = np.bincount(atlas.chart[held], weights=faces.area[held], minlength=atlas.chart_count)
    xy = (np.stack([cell % size[0], cell // size[0]], axis=1) + 0.5) / SUBTEXELS - 0.5
    return Points(cell, face, weights, p, normal, (area / np.maximum(amount, 1))[chart], chart, xy)


def place_points(faces: Faces, face: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and unit normals (n, 3) of points on `face` (n,), by the `weights` (n, 3) of its corners.

    Positions are where rays may start.
    """
    corners = faces.corners[face]
    p = clear_points((corners * weights[..., None]).sum(axis=1), faces.normal[face], faces.whole[face])
    normal = (faces.normals[face] * weights[..., None]).sum(axis=1)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return p, np.where(length > 1e-6, normal / np.maximum(length, 1e-6), faces.normal[face])


def find_texels(
    atlas: Atlas, points: Points, valid: np.ndarray, piece: np.ndarray, seen: np.ndarray
) -> tuple[Texels, np.ndarray]:
    """Return the texels that look-ups read, and which of them (M,) have a valid point of their own or nearby.

    `valid` (N,) says which points lie in the open. A texel samples its valid points, those of one `piece` (N,):
    the largest in it, of those that a camera has `seen` (N,) if there are such. One without any takes the nearest
    valid ones of its chart within 1.5 texels, and is not fine if there are none.
    """
    slot, chart = _find_read(atlas, points)
    own = np.floor(points.xy + 0.5).astype(np.int64)
    texel = np.searchsorted(slot, own[:, 1] * atlas.width + own[:, 0])
    # Unseen pieces give way where a look-up from a seen one may read: within a texel of it.
    given = valid & (seen | ~_near(points, valid & seen))
    chosen = np.flatnonzero(given)
    chosen = chosen[_of_largest_piece(texel[chosen], piece[chosen], seen[chosen])]
    order = chosen[np.argsort(texel[chosen], kind="stable")]
    counts = np.bincount(texel[chosen], minlength=len(slot))
    bare = np.flatnonzero(counts == 0)
    near = _nearest(atlas, points, np.flatnonzero(given), slot[bare], chart[bare])
    fine = np.ones(len(slot), bool)
    fine[bare] = near[:, 0] >= 0
    counts[bare] = np.where(fine[bare], GUTTER_POINTS, 0)
    starts = np.concatenate([[0], np.cumsum(counts)])
    held = np.zeros(starts[-1], np.int64)
    # Own points stand in the order of their texels; gutters fill the gaps.
    held[counts_before(counts, bare)] = order
    gutter = bare[fine[bare]]
    held[starts[gutter][:, None] + np.arange(GUTTER_POINTS)] = near[fine[bare]]
    return Texels(slot, starts, held, chart), fine


def _find_read(atlas: Atlas, points: Points) -> tuple[np.ndarray, np.ndarray]:
    """Return the texels (M,) that look-ups at the points read, ascending, and the chart of each."""
    # Beside a line of texel centres, look-ups of what lies on it read nothing.
    wide = ~atlas.narrow[points.chart]
    base = np.floor(points.xy + np.where(wide, 0.0, 0.5)).astype(np.int64)
    steps = [np.array(step) for step in ([0, 0], [1, 0], [0, 1], [1, 1])]
    reads = np.concatenate([base + step for step in steps])
    inside = ((reads >= 0) & (reads < [atlas.width, atlas.height])).all(axis=1)
    inside &= np.concatenate([(wide | (step == 0)).all(axis=1) for step in steps])
    slot, first = np.unique(reads[inside, 1] * atlas.width + reads[inside, 0], return_index=True)
    return slot, np.tile(points.chart, 4)[inside][first]


def _of_largest_piece(texel: np.ndarray, piece: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Return which points (n,) belong to the piece that has the most points in their texel, seen pieces first."""
    both, inverse, amount = np.unique(np.stack([texel, seen, piece]), axis=1, return_inverse=True, return_counts=True)
    order = np.lexsort((amount, both[1], both[0]))
    last = np.append(both[0][order][1:] != both[0][order][:-1], True)
    largest = np.zeros(len(amount), bool)
    largest[order[last]] = True
    return largest[inverse.ravel()]


def counts_before(counts: np.ndarray, skipped: np.ndarray) -> np.ndarray:
    """Return the places of all items of lists of `counts` items that stand side by side, `skipped` lists left out."""
    owner = np.repeat(np.arange(len(counts)), counts)
    wanted = np.ones(len(counts), bool)
    wanted[skipped] = False
    return np.flatnonzero(wanted[owner])


def _near(points: Points, chosen: np.ndarray) -> np.ndarray:
    """Return which points (N,) lie within two texels of a `chosen` (N,) one of their chart."""
    if not chosen.any() or chosen.all():
        return chosen.copy()
    near, other = chosen.copy(), ~chosen
    places = points.xy[chosen], points.chart[chosen]
    near[other] = find_nearest(*places, points.xy[other], points.chart[other], reach=2.0)[:, 0] >= 0
    return near


def _nearest(atlas: Atlas, points: Points, chosen: np.ndarray, slot: np.ndarray, chart: np.ndarray) -> np.ndarray:
    """Return the nearest valid points (n, `GUTTER_POINTS`) of the same chart within 1.5 texels; -1: none."""
    if not len(chosen):
        return np.full((len(slot), GUTTER_POINTS), -1)
    at = np.column_stack([slot % atlas.width, slot // atlas.width])
    index = find_nearest(points.xy[chosen], points.chart[chosen], at, chart, reach=1.5, count=GUTTER_POINTS)
    found = np.where(index >= 0, chosen[index], -1)
    return np.where(found >= 0, found, found[:, :1])
