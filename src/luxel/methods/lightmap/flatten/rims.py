"""Texels that lie inside geometry but for a rim: what shows of a plate on a column is the edge that juts out.

All points of such a texel may fall inside, and its rim would show as black. So points are moved out to the edges of
their triangles, no further than a texel, and stay there where that is the open.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from luxel.methods.lightmap.flatten.atlas import Atlas, Points, place_points
from luxel.methods.lightmap.flatten.faces import Faces
from luxel.methods.lightmap.flatten.origins import find_inside_geometry, make_origins
from luxel.methods.lightmap.flatten.tables import AtlasTables
from luxel.scene.device import Scene

RIM = 0.01
"""How far from a triangle's edge points are put, as a share of its height there."""


def move_to_rims(
    still: Scene, tables: AtlasTables, faces: Faces, atlas: Atlas, points: Points, valid: np.ndarray, seed: int
) -> tuple[Points, np.ndarray]:
    """Return `points`, and which of them (N,) lie in the open, after those of texels without a `valid` one moved."""
    chosen = np.flatnonzero(np.bincount(points.chart, weights=valid, minlength=atlas.chart_count)[points.chart] == 0)
    if not len(chosen):
        return points, valid
    face, weights = points.face[chosen], points.weights[chosen].copy()
    row, nearest = np.arange(len(chosen)), weights.argmin(axis=1)
    weights *= ((1.0 - RIM) / (1.0 - weights[row, nearest]))[:, None]
    weights[row, nearest] = RIM
    p, normal = place_points(faces, face, weights)
    near = np.linalg.norm(p - points.p[chosen], axis=1) <= atlas.texel_size
    open_now = near & ~find_inside_geometry(still, tables, make_origins(p, faces.normal[face], normal), seed)
    moved = chosen[open_now]
    found = replace(points, weights=points.weights.copy(), p=points.p.copy(), normal=points.normal.copy())
    found.weights[moved], found.p[moved], found.normal[moved] = weights[open_now], p[open_now], normal[open_now]
    valid = valid.copy()
    valid[moved] = True
    return found, valid
