"""Seams: where two charts meet on a smooth surface, both borders should show the same light.

Measured at points along each shared edge, by the same bilinear look-up that a viewer makes; then closed by the smallest
change of texels, in the least-squares sense, that makes both sides agree.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csr_array, eye_array, vstack
from scipy.sparse.linalg import cg

from luxel.bake.layout import Layout

POINTS_PER_TEXEL = 2.0
"""Points that look at a seam, along a texel's length."""
SMOOTH = 0.999
"""Cosine between the normals that two faces are shaded by at their edge from which no crease hides their seam."""
BEND = 0.7
"""Cosine between the faces themselves from which they may share light: a hem between two sides of a cloth may not."""
PULL = 30.0
"""How much more a seam's agreement counts than a texel's own value, squared."""


@dataclass
class Seams:
    """S pairs of places in the atlas that are one place on the surface, in texels."""

    a: np.ndarray
    """(S, 2)."""
    b: np.ndarray
    """(S, 2)."""


def find_seams(layout: Layout, corners: np.ndarray, normals: np.ndarray) -> Seams:
    """Return points along every edge that two faces share smoothly in the open, but that lies in the atlas twice.

    `corners` and `normals` (F, 3, 3) are the faces' world positions and the unit normals that they are shaded by.
    """
    held = np.flatnonzero(layout.chart >= 0)
    p, uv = corners[held].astype(np.float64), layout.uv[held].astype(np.float64)
    scale = max(float(np.ptp(p.reshape(-1, 3), axis=0).max()), 1e-9)
    _, vertex = np.unique(np.round(p.reshape(-1, 3) / (scale * 1e-6)), axis=0, return_inverse=True)
    vertex = vertex.reshape(-1, 3)
    low, high = np.minimum(vertex, vertex[:, [1, 2, 0]]), np.maximum(vertex, vertex[:, [1, 2, 0]])
    edge = (low * (vertex.max() + 1) + high).ravel()
    # Each edge's two ends in the atlas, in the order of their vertices.
    swap = (vertex > vertex[:, [1, 2, 0]])[..., None]
    start, end = _both_ends(uv, swap)
    order = np.argsort(edge, kind="stable")
    first, second = order[:-1], order[1:]
    pair = edge[first] == edge[second]
    first, second = first[pair], second[pair]
    alike = [(normal[first] * normal[second]).sum(axis=1) for normal in _both_ends(normals[held], swap)]
    faces = layout.normal[held]
    smooth = (np.minimum(*alike) > SMOOTH) & ((faces[first // 3] * faces[second // 3]).sum(axis=1) > BEND)
    apart = np.abs(start[first] - start[second]).max(axis=1) + np.abs(end[first] - end[second]).max(axis=1) > 1e-3
    wide = _find_wide(layout, held)
    chosen = smooth & apart & wide[first // 3] & wide[second // 3]
    first, second = first[chosen], second[chosen]
    length = np.maximum(*(np.linalg.norm(end[i] - start[i], axis=1) for i in (first, second)))
    counts = np.maximum(np.ceil(length * POINTS_PER_TEXEL).astype(np.int64), 2)
    owner = np.repeat(np.arange(len(first)), counts)
    step = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    t = ((step + 0.5) / counts[owner])[:, None]
    a, b = (start[i][owner] * (1.0 - t) + end[i][owner] * t for i in (first, second))
    # Where one side runs inside another thing, the step is real and nobody sees it.
    lit = [look_up(layout, places) @ layout.open.astype(float) > 0.999 for places in (a, b)]
    seen = lit[0] & lit[1]
    return Seams(a[seen], b[seen])


def _find_wide(layout: Layout, held: np.ndarray) -> np.ndarray:
    """Return which of the faces `held` lie in a chart that is a texel wide and tall or more.

    In a narrower one light cannot change from one border to the other: agreement there would spread from chart to
    chart and leave one colour all over.
    """
    chart, uv = layout.chart[held], layout.uv[held]
    low, high = (np.full((int(chart.max(initial=0)) + 1, 2), bound) for bound in (np.inf, -np.inf))
    np.minimum.at(low, chart, uv.min(axis=1))
    np.maximum.at(high, chart, uv.max(axis=1))
    return np.asarray((high - low > 0.5).all(axis=1))[chart]


def _both_ends(values: np.ndarray, swap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return what the corners' `values` (F, 3, C) are at both ends of each edge, (3 F, C), turned round by `swap`."""
    after, width = values[:, [1, 2, 0]], values.shape[2]
    return np.where(swap, after, values).reshape(-1, width), np.where(swap, values, after).reshape(-1, width)


def look_up(layout: Layout, places: np.ndarray) -> csr_array:
    """Return the bilinear look-up at places (S, 2) as a matrix (S, M); rows sum to 1 over the texels that exist."""
    row_of = np.full(layout.width * layout.height, -1)
    row_of[layout.slot] = np.arange(len(layout.slot))
    base = np.clip(np.floor(places + 1e-4).astype(np.int64), 0, [layout.width - 1, layout.height - 1])
    part = np.clip(places - base, 0.0, 1.0)
    part[part < 1e-3] = 0.0
    rows, columns, values = [], [], []
    for i in (0, 1):
        for j in (0, 1):
            x, y = np.minimum(base[:, 0] + i, layout.width - 1), np.minimum(base[:, 1] + j, layout.height - 1)
            weight = (part[:, 0] if i else 1.0 - part[:, 0]) * (part[:, 1] if j else 1.0 - part[:, 1])
            texel = row_of[y * layout.width + x]
            used = (weight > 0.0) & (texel >= 0)
            rows.append(np.flatnonzero(used))
            columns.append(texel[used])
            values.append(weight[used])
    matrix = coo_array(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), (len(places), len(layout.slot))
    ).tocsr()
    total = np.maximum(np.asarray(matrix.sum(axis=1)).ravel(), 1e-9)
    return csr_array(matrix.multiply((1.0 / total)[:, None]))


def measure_seams(layout: Layout, seams: Seams, values: np.ndarray) -> float:
    """Return the mean difference across seams over the texels' mean, of `values` (M, 3); 0 where there is no seam."""
    mean = float(np.abs(values).mean())
    if not len(seams.a) or mean <= 0.0:
        return 0.0
    return float(np.abs(look_up(layout, seams.a) @ values - look_up(layout, seams.b) @ values).mean()) / mean


def close_seams(layout: Layout, seams: Seams, values: np.ndarray) -> np.ndarray:
    """Return `values` (M, 3) moved as little as makes both sides of each seam agree; never below zero."""
    if not len(seams.a):
        return values
    difference = look_up(layout, seams.a) - look_up(layout, seams.b)
    touched = np.unique(difference.indices)
    part = difference[:, touched] * PULL
    identity = eye_array(len(touched), format="csr")
    stacked = csr_array(vstack([part, identity]))
    normal = csr_array(stacked.T @ stacked)
    closed = values.copy()
    for channel in range(values.shape[1]):
        start = values[touched, channel]
        closed[touched, channel] = np.maximum(cg(normal, start, x0=start, rtol=1e-6, maxiter=500)[0], 0.0)
    return closed
