"""Charts cut by octaves of distance from the scene's bounds: a chart has one density, and a ground needs several.

A ground of two triangles reaches from under a house to the horizon. At its mean density it would be as coarse beside
the house as it is far off. So charts that reach over several octaves become one chart each, and triangles that do are
cut along the octaves' borders. Only the atlas knows: the triangles that rays meet stay as they are.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from luxel.methods.lightmap.cuts import cut_triangle
from luxel.methods.lightmap.density import measure_octaves, octave_boxes
from luxel.methods.lightmap.faces import Faces
from luxel.methods.lightmap.unwrap import Charts, to_metres
from luxel.scene.device import Scene
from luxel.scene.triangles import Box

REACH = 2
"""Octaves more than its nearest one from which a chart outside the bounds is cut. One that begins within them is cut at
the first."""
MOST_CUT = 1000
"""Triangles that are cut, at most: each takes some milliseconds."""


def cut_by_octaves(scene: Scene, faces: Faces, charts: Charts) -> tuple[Faces, Charts]:
    """Return faces and charts, those cut that reach over several octaves of distance."""
    bounds = Box(scene.host.lower, scene.host.upper)
    size = float(np.linalg.norm(bounds.upper - bounds.lower))
    low, high = faces.corners.min(axis=1), faces.corners.max(axis=1)
    away = np.maximum(np.maximum(bounds.lower - high, low - bounds.upper).max(axis=1), 0.0)
    near = measure_octaves(away, size)
    furthest = np.maximum(bounds.lower - low, high - bounds.upper).max(axis=1)
    # Small triangles are not cut: they are where they begin.
    edge = np.linalg.norm(faces.corners - faces.corners[:, [1, 2, 0]], axis=2).max(axis=1)
    far = np.where(edge > size + away, measure_octaves(np.maximum(furthest, 0.0), size), near)
    held = charts.chart >= 0
    least, most = np.full(charts.count, 1 << 30), np.zeros(charts.count, np.int64)
    np.minimum.at(least, charts.chart[held], near[held])
    np.maximum.at(most, charts.chart[held], far[held])
    reaches = (most >= least + REACH) | ((least == 0) & (most > 0))
    if not reaches.any():
        return faces, charts
    cut = held & reaches[charts.chart]
    large = np.flatnonzero(cut & (far > near))
    if len(large) > MOST_CUT:
        large = np.sort(large[np.argsort(-faces.area[large], kind="stable")[:MOST_CUT]])
        charts.notes.append(
            f"Of the triangles that reach far beyond the scene's bounds, the {MOST_CUT:,} largest were cut; the lightmap "
            "is coarser on the others."
        )
    faces, parent, octave = _cut_faces(faces, large, near, far, bounds)
    chart = np.where(held[parent] & cut[parent], charts.chart[parent] * (1 << 16) + octave, charts.chart[parent] << 16)
    chart[~held[parent]] = -1
    number = np.unique(chart[chart >= 0], return_inverse=True)[1]
    chart[chart >= 0] = number
    uv = charts.uv[parent]
    uv = uv if not len(faces.inside) else faces.inside @ uv
    count = int(number.max()) + 1
    return faces, Charts(chart, to_metres(faces, chart, uv, count), count, charts.notes, np.ones(count))


def _cut_faces(
    faces: Faces, large: np.ndarray, near: np.ndarray, far: np.ndarray, bounds: Box
) -> tuple[Faces, np.ndarray, np.ndarray]:
    """Return faces with those of `large` in parts, the face (F,) that each is or was of, and its octave (F,)."""
    if not len(large):
        return faces, np.arange(len(faces.prim)), near
    boxes = octave_boxes(bounds, int(far[large].max()) + 1)
    inside, octave, amount = [], [], []
    for face in large:
        parts, number = cut_triangle(faces.corners[face], boxes[near[face] : far[face]], int(near[face]))
        inside.append(parts)
        octave.append(number)
        amount.append(len(parts))
    whole = np.setdiff1d(np.arange(len(faces.prim)), large)
    parent = np.concatenate([whole, np.repeat(large, amount)])
    within = np.concatenate([np.broadcast_to(np.eye(3), (len(whole), 3, 3)), *inside])
    corners, normals = within @ faces.corners[parent], within @ faces.normals[parent]
    normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-12)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    cut = replace(
        faces, prim=faces.prim[parent], back=faces.back[parent], unit=faces.unit[parent], corners=corners,
        normals=normals, normal=faces.normal[parent], area=0.5 * np.linalg.norm(cross, axis=1), part=faces.part[parent],
        uv2=None if faces.uv2 is None else within @ faces.uv2[parent], whole=faces.corners[parent], inside=within,
        octave=np.concatenate([np.full(len(whole), -1), *octave]),
    )  # fmt: skip
    return cut, parent, np.concatenate([near[whole], *octave])
