"""Which probes light one point, with which weights, and why the others of its cage do not."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.kernels.records import Surface
from luxel.methods.base import Contribution
from luxel.methods.ddgi.atlas import Footprint
from luxel.methods.ddgi.query import (
    ENOUGH,
    LEAST,
    biased_point,
    color_of,
    facing_of,
    nearness_of,
    part_of,
    query_probes,
    sight_of,
)
from luxel.methods.ddgi.state import DEAD, UNUSED, DdgiState
from luxel.methods.ddgi.volume import Volume, cage_of, grid_coordinates, is_inside, probe_of_node


def explain_point(state: DdgiState, surface: Surface) -> list[Contribution]:
    """Return one entry a probe of each cage around the first point of `surface`, and of its extra, heaviest first."""
    p, n, wo = (type(v)(*(dr.gather(mi.Float, c, 0) for c in v)) for v in (surface.p, surface.n_geometric, surface.wo))
    light = mi.Vector3f(*(dr.gather(mi.Float, c, 0) for c in surface.n_shading))
    footprint = Footprint(light, state.settings.irradiance_resolution)
    found: list[Contribution] = []
    parts = query_probes(state, p, n, mi.Normal3f(light), wo, mi.Bool(True)).parts
    for volume, part in zip(state.volumes, parts, strict=True):
        found += _explain_cage(state, volume, p, n, wo, footprint, float(np.array(part).ravel()[0]))
    return sorted(found, key=lambda item: -item.weight)


def _explain_cage(
    state: DdgiState, volume: Volume, p: mi.Point3f, n: mi.Normal3f, wo: mi.Vector3f, footprint: Footprint, part: float
) -> list[Contribution]:
    x = biased_point(state, volume, p, n, wo)
    base, inner = cage_of(volume, grid_coordinates(volume, x))
    corner = dr.arange(mi.UInt32, 9)
    bits = mi.Vector3i(mi.Int32(corner & 1), mi.Int32((corner >> 1) & 1), mi.Int32((corner >> 2) & 1))
    probe = probe_of_node(volume, base + bits)
    is_extra = corner == 8
    if state.settings.extra_count:
        extra = dr.gather(mi.UInt32, state.extras.of_part, part_of(state, volume, base, inner))
        probe = dr.select(is_extra, extra, probe)
    row = dr.gather(mi.Vector4f, state.rows, probe)
    q = mi.Point3f(row.x, row.y, row.z)
    near = dr.select(is_extra, 1.0, nearness_of(state, volume, q, base + bits, inner - mi.Point3f(bits)))
    values = [near, facing_of(state, p, n, q), sight_of(state, probe, q, x, mi.Bool(True)), row.w]
    color = color_of(state, probe, footprint, mi.Bool(True)) * state.scale
    table = np.stack([np.broadcast_to(np.array(v), 9) for v in (*values, *color)], axis=1).astype(float)
    ids, status = np.array(probe), np.array(state.probes.status)
    outside = not bool(np.array(is_inside(volume, grid_coordinates(volume, p)))[0])
    found, seen = [], 0.0
    for index, (identity, line) in enumerate(zip(ids, table, strict=True)):
        if index == 8 and (not state.settings.extra_count or identity == 0):
            continue
        nearness, facing, sight, usable = line[:4]
        weight = max(nearness, 1e-4) * facing * max(sight, LEAST) * usable
        if index < 8:
            seen += max(nearness, 1e-4) * facing * sight * usable
        else:
            weight = facing * sight * usable * max(ENOUGH - seen, 0.0)
        reason = _reason(int(status[identity]), nearness, facing, sight, weight)
        if outside and not reason:
            reason = "answers from outside the box: this is its nearest cage"
        found.append(
            Contribution(int(identity), float(weight * part), (float(line[4]), float(line[5]), float(line[6])), reason)
        )
    return found


def _reason(status: int, nearness: float, facing: float, sight: float, weight: float) -> str:
    """Say in words why a probe gives next to nothing; empty where it gives something."""
    if status == DEAD:
        return "dead: inside geometry"
    if status == UNUSED:
        return "held back"
    if weight > 1e-3:
        return ""
    if sight < 0.05:
        return "does not see the point"
    if facing < 0.05:
        return "behind the surface"
    return "too far" if nearness < 0.05 else "little say"
