"""How densely each chart is sampled: fully within the scene's robust bounds and near them, and less farther off.

One texel size for all would share texels and surfels out by area: a dome of 500 m around a room takes all of them. And
one density for a ground from under a house to the horizon would leave it as coarse beside the house as far off: charts
that reach over several octaves of distance become one chart each, and large triangles are cut where octaves end. Only
the atlas knows: the triangles that rays meet stay as they are.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from luxel.methods.lightmap.flatten.faces import Faces
from luxel.methods.lightmap.flatten.octaves import (
    FALL,
    MOST_CUT,
    STEPS,
    Parts,
    cut_triangles,
    measure_octaves,
    octave_boxes,
    part_corners,
)
from luxel.methods.lightmap.flatten.unwrap import Charts, to_metres
from luxel.scene.device import Scene
from luxel.scene.triangles import Box, Triangles, areas_within

REACH = 2
"""Octaves from its nearest one over which a chart must reach to be cut; one that begins in the first, one is enough."""


def cut_charts(scene: Scene, faces: Faces, charts: Charts) -> tuple[Faces, Charts]:
    """Return faces and charts, those cut that reach over several octaves of distance."""
    bounds = Box(scene.host.lower, scene.host.upper)
    first, last = measure_octaves(faces.corners, bounds)
    held = charts.chart >= 0
    nearest, furthest = np.full(charts.count, STEPS), np.zeros(charts.count, np.int64)
    np.minimum.at(nearest, charts.chart[held], first[held])
    np.maximum.at(furthest, charts.chart[held], last[held])
    reaches = (furthest >= nearest + REACH) | ((nearest == 0) & (furthest > 0))
    if not reaches.any():
        return faces, charts
    cut = held & reaches[charts.chart]
    large = int((cut & (last > first)).sum())
    if large > MOST_CUT:
        charts.notes.append(
            f"{large:,} triangles reach from near the scene to far beyond it, and the {MOST_CUT:,} longest were cut; "
            "the lightmap is coarser on the others: cut them in the file."
        )
    parts = cut_triangles(faces.corners, bounds, cut)
    of = parts.triangle
    number = np.where(held[of], charts.chart[of] * STEPS + np.where(cut[of], parts.octave, 0), -1)
    used, number = np.unique(number, return_inverse=True)
    chart = number - int(used[0] < 0)
    faces, count = _take_parts(faces, parts), int(chart.max()) + 1
    uv = to_metres(faces, chart, part_corners(parts, charts.uv), count)
    return faces, Charts(chart, uv, count, charts.notes, np.ones(count))


def _take_parts(faces: Faces, parts: Parts) -> Faces:
    """Return the parts of faces as faces."""
    if not parts.is_cut.any():
        return faces
    of, corners = parts.triangle, part_corners(parts, faces.corners)
    normals = part_corners(parts, faces.normals)
    normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-12)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return replace(
        faces, prim=faces.prim[of], back=faces.back[of], unit=faces.unit[of], corners=corners, normals=normals,
        normal=faces.normal[of], area=0.5 * np.linalg.norm(cross, axis=1), part=faces.part[of],
        uv2=None if faces.uv2 is None else part_corners(parts, faces.uv2), whole=faces.corners[of],
        inside=parts.inside, octave=np.where(parts.is_cut, parts.octave, -1),
    )  # fmt: skip


def thin_out(scene: Scene, faces: Faces, charts: Charts) -> Charts:
    """Return the charts, those that reach far beyond the robust bounds shrunk by their mean density."""
    held = charts.chart >= 0
    area, counted = np.zeros(charts.count), np.zeros(charts.count)
    np.add.at(area, charts.chart[held], faces.area[held])
    np.add.at(counted, charts.chart[held], _count_area(scene, faces)[held])
    density = np.sqrt(counted / np.maximum(area, 1e-300))
    # What differs by round-off only is left as it is.
    density = np.where((density > 0.999) | (area <= 0.0), 1.0, density)
    scale = np.where(held, density[charts.chart], 1.0)
    return replace(charts, uv=charts.uv * scale[:, None, None], density=density)


def _count_area(scene: Scene, faces: Faces) -> np.ndarray:
    """Return the area (F,) of each face, each part of it by its density squared."""
    counted, inside, rest = np.zeros(len(faces.area)), np.zeros(len(faces.area)), np.arange(len(faces.area))
    for step, box in enumerate(octave_boxes(Box(scene.host.lower, scene.host.upper), STEPS)):
        found = areas_within(Triangles(faces.corners[rest], faces.area[rest]), box)
        counted[rest] += (found - inside[rest]) * 4.0 ** (-FALL * step)
        inside[rest] = found
        rest = rest[found < (1.0 - 1e-6) * faces.area[rest]]
        if not len(rest):
            break
    return counted
