"""How densely each chart is sampled: fully within the scene's robust bounds and near them, and less farther off.

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
NEAR = 0.25
"""How far around the bounds density is full, in their diagonals: a ground is brightest to a house just beside it, and may
lie a hair below its lowest floor."""
STEPS = 40
"""Octaves of distance at most: more than single precision tells apart from the bounds."""


def octave_boxes(bounds: Box, count: int) -> list[Box]:
    """Return the boxes that octaves 0 .. `count` - 1 of distance end at, each in the next."""
    size = max(float(np.linalg.norm(bounds.upper - bounds.lower)), 1e-9)
    margins = [size * (2.0**step - 1.0 + NEAR) for step in range(count)]
    return [Box(bounds.lower - margin, bounds.upper + margin) for margin in margins]


def measure_octaves(distance: np.ndarray, size: float) -> np.ndarray:
    """Return the octave (n,) of points `distance` (n,) away from bounds with diagonal `size`, along one axis at most."""
    octave = np.ceil(np.log2(distance / max(size, 1e-9) + 1.0 - NEAR))
    return np.clip(octave, 0, STEPS - 1).astype(np.int64)


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
