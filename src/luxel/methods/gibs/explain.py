"""Which surfels light one point, with which weights, and why the others of its cell do not."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.kernels.grid import levels_at, slot_of_point
from luxel.kernels.records import Surface
from luxel.methods.gibs.depth import visibility
from luxel.methods.gibs.gather import surfel_weight
from luxel.methods.gibs.sizes import radius_of_size
from luxel.methods.gibs.surfels import GibsState
from luxel.methods.inspect import Contribution
from luxel.scene.arrays import from_numpy

OFF_PLANE = 0.5
"""Share of a radius off its plane from which a surfel's plane, not its distance, is named as the reason."""


def explain_point(state: GibsState, surface: Surface) -> list[Contribution]:
    """Return one entry a surfel that reaches the cell of the first point of `surface`, heaviest first.

    The weights are those of the look-up, as shares of the answer: fall-off, normals, and how young a surfel is.
    """
    p, n = (type(v)(*(dr.gather(mi.Float, c, 0) for c in v)) for v in (surface.p, surface.n_geometric))
    ids = _surfels_near(state, p)
    if not len(ids):
        return []
    surfel = from_numpy(mi.UInt32, ids)
    light = np.array(dr.gather(mi.Vector4f, state.light, surfel)).T.astype(float)
    weight = surfel_weight(state, surfel, p, n, mi.Bool(True))
    within = np.array(weight) > 0.0
    if state.depth is not None:
        asked = (weight > 0.0) & from_numpy(mi.Bool, light[:, 3] < 0.0)
        weight *= visibility(state, surfel, p, n, asked)[0]
        light[:, 3] = np.abs(light[:, 3])
    weights = np.array(weight).astype(float) * light[:, 3]
    if state.lattice.levels > 1:
        weights = _shares_of_levels(weights, np.array(state.surfels.size)[ids] // 2)
    shares = weights / max(float(weights.sum()), 1e-20)
    positions = np.array(dr.gather(mi.Point3f, state.surfels.p, surfel)).T.astype(float)
    reasons = _reasons(state, surfel, positions, p, n, weights, light[:, 3], within)
    rows = zip(ids, shares, light, positions, reasons, strict=True)
    found = [
        Contribution(int(item), float(share), _three(color), reason, _three(place), why)
        for item, share, color, place, (why, reason) in rows
    ]
    return sorted(found, key=lambda item: -item.weight)


def _surfels_near(state: GibsState, p: mi.Point3f) -> np.ndarray:
    """Return the ids of the surfels listed for the cells of `p`, without those of other cells that share a slot."""
    starts, items = np.array(state.grid.starts), np.array(state.grid.items)
    mask = int(np.array(levels_at(state.lattice, state.grid, p, mi.Bool(True)))[0])
    found = []
    for level in reversed(range(state.lattice.levels)):
        if not mask >> level & 1:
            continue
        slot = int(np.array(slot_of_point(state.lattice, p, mi.UInt32(level) if level else None))[0])
        ids = items[starts[slot] : starts[slot + 1]]
        if state.lattice.levels > 1:
            ids = ids[np.array(state.surfels.size)[ids] // 2 == level]
        positions = np.array(state.surfels.p).T[ids].astype(float)
        cell = 0.5**level / float(np.array(state.lattice.inverse_size)[0])
        # No surfel of the cell itself is farther from any point of it than this.
        reach = 0.5**level * float(np.array(state.dials.radius)[0]) + 3.0**0.5 * cell
        found.append(ids[np.linalg.norm(positions - np.array(p).reshape(3), axis=1) <= reach])
    return np.concatenate(found)


def _shares_of_levels(weights: np.ndarray, levels: np.ndarray) -> np.ndarray:
    """Return weights of which coarser levels have what finer ones leave, as in `gather_irradiance`."""
    weights, covered = weights.copy(), 0.0
    for level in np.unique(levels)[::-1]:
        of_level = levels == level
        total = weights[of_level].sum()
        share = (1.0 - min(covered, 1.0)) * min(1.0 / max(total, 1e-20), 1.0) if covered > 0.0 else 1.0
        weights[of_level] *= share
        covered += total * share
    return weights


def _reasons(
    state: GibsState, surfel: mi.UInt32, positions: np.ndarray, p: mi.Point3f, n: mi.Normal3f,
    weights: np.ndarray, confidence: np.ndarray, within: np.ndarray,
) -> list[tuple[str, str]]:  # fmt: skip
    """Return why each surfel gives nothing, in a word and in words; empty where it gives something."""
    normals = np.array(dr.gather(mi.Normal3f, state.surfels.n, surfel)).T.astype(float)
    radius = np.array(radius_of_size(state, dr.gather(mi.UInt32, state.surfels.size, surfel))).astype(float)
    point, normal = np.array(p).reshape(3), np.array(n).reshape(3)
    facing = normals @ normal > 0.0
    off_plane = np.abs(((point - positions) * normals).sum(axis=1)) > OFF_PLANE * radius
    found = []
    for index, weight in enumerate(weights):
        if weight > 0.0:
            found.append(("", ""))
        elif not facing[index]:
            found.append(("normal", "faces away"))
        elif confidence[index] <= 0.0:
            found.append(("young", "has no sample yet"))
        elif within[index]:
            found.append(("depth", "something is in between"))
        else:
            found.append(("plane", "off its plane") if off_plane[index] else ("distance", "too far"))
    return found


def _three(values: np.ndarray) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
