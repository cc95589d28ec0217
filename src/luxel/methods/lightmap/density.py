"""How densely each chart is sampled: fully within the scene's robust bounds, and less the farther off it lies.

One texel size for all would share texels and surfels out by area: a dome of 500 m around a room takes all of them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from luxel.methods.lightmap.faces import Faces
from luxel.methods.lightmap.unwrap import Charts
from luxel.scene.device import Scene
from luxel.scene.triangles import Box, Triangles, areas_within

FALL = 1.5
"""Exponent of the distance by which density falls. A ground without end then takes about as much as a surface as large
as the bounds; at 1 it would take ever more, with every octave of distance the same."""
STEPS = 40
"""Octaves of distance at most: more than single precision tells apart from the bounds."""


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
    lower, upper = scene.host.lower, scene.host.upper
    size = max(float(np.linalg.norm(upper - lower)), 1e-9)
    counted, inside, rest = np.zeros(len(faces.area)), np.zeros(len(faces.area)), np.arange(len(faces.area))
    for step in range(STEPS):
        margin = size * (2.0**step - 1.0)
        found = areas_within(Triangles(faces.corners[rest], faces.area[rest]), Box(lower - margin, upper + margin))
        counted[rest] += (found - inside[rest]) * 4.0 ** (-FALL * step)
        inside[rest] = found
        rest = rest[found < (1.0 - 1e-6) * faces.area[rest]]
        if not len(rest):
            break
    return counted
