"""Which surfels light one point, with which weights, and why the others of its cell do not."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from luxel.kernels.grid import cell_of_point
from luxel.kernels.records import Surface
from luxel.methods.base import Contribution
from luxel.methods.gibs.surfels import GibsState


def explain_point(state: GibsState, surface: Surface) -> list[Contribution]:
    """Return one entry a surfel in the cell of the first point of `surface`, heaviest first."""
    cell = int(np.array(cell_of_point(state.lattice, surface.p))[0])
    starts = np.array(state.grid.starts)
    ids = np.array(state.grid.items)[starts[cell] : starts[cell + 1]]
    p, n = _first(surface.p), _first(surface.n_geometric)
    positions, normals = np.array(state.surfels.p).T[ids], np.array(state.surfels.n).T[ids]
    means, counts = np.array(state.surfels.estimate.mean).T[ids], np.array(state.surfels.estimate.count)[ids]
    radius = float(np.array(state.dials.radius)[0])
    stretch = float(np.array(state.dials.plane_stretch)[0])
    found = []
    for index, q, m, mean, count in zip(ids, positions, normals, means, counts, strict=True):
        offset = p - q
        off_plane = float(offset @ m)
        d = float(np.sqrt(offset @ offset + stretch * off_plane**2)) / radius
        agreement = max(float(m @ n), 0.0) ** state.settings.normal_power
        weight = (2 * d**3 - 3 * d**2 + 1) * agreement if d < 1.0 else 0.0
        found.append(
            Contribution(
                int(index),
                weight,
                (float(mean[0]), float(mean[1]), float(mean[2])),
                _reason(d, off_plane, radius, agreement, count),
            )
        )
    return sorted(found, key=lambda item: -item.weight)


def _reason(d: float, off_plane: float, radius: float, agreement: float, count: float) -> str:
    """Say in words why a surfel gives nothing; empty where it gives something."""
    if agreement <= 0.0:
        return "faces away"
    if d >= 1.0:
        return "off its plane" if abs(off_plane) > 0.5 * radius else "too far"
    return "has no sample yet" if count < 0.5 else ""


def _first(value: mi.Point3f | mi.Normal3f) -> np.ndarray:
    return np.array(value).T[0].astype(np.float64)
