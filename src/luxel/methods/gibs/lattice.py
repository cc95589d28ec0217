"""Where the surfels' grid begins: shifted so that the scene's walls and floors lie in the middle of its cells."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.kernels.grid import Lattice, find_shift, make_lattice
from luxel.kernels.transform import transform_point
from luxel.kernels.triangle import fetch_triangle, triangle_count
from luxel.methods.gibs.params import GibsParams
from luxel.methods.gibs.sizes import LEVELS
from luxel.scene.device import Scene

SAMPLE = 1 << 16
"""Triangles looked at, about; of larger scenes every so-manyth."""


def fit_lattice(scene: Scene, params: GibsParams, radius: float) -> Lattice:
    """Return the lattice for surfels of `radius` metres that lie on the scene's surfaces.

    The scene only has a say in where cells begin, which saves reading; cells reach everywhere.
    """
    corners = sample_triangles(scene)
    radii = radius * 0.5 ** np.arange(LEVELS if params.by_view else 1)
    shifts = [find_shift(corners, params.cell_size * size, size / params.plane_scale) for size in radii]
    return make_lattice(radius, params.cell_size, params.capacity_for(), np.stack(shifts))


def sample_triangles(scene: Scene) -> np.ndarray:
    """Return the corners (F, 3, 3), metres, of triangles from all over the scene as it is now, at most 2 `SAMPLE`."""
    count = triangle_count(scene)
    step = max(count // SAMPLE, 1)
    triangle = fetch_triangle(scene, dr.arange(mi.UInt32, count // step) * step, mi.Bool(True))
    corners = triangle.positions
    if scene.features.moving:
        corners = [transform_point(scene.geometry.to_world, triangle.object_id, corner) for corner in corners]
    return np.stack([np.array(corner).T for corner in corners], axis=1).astype(np.float64)
