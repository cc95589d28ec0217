"""Which probes light one point, with which weights, and why the others of its cage do not.

The weights are those of the look-up itself: the same functions of `query.py`, asked with one lane a probe.
"""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.kernels.records import Surface
from luxel.methods.ddgi.atlas import Footprint
from luxel.methods.ddgi.query import (
    NEIGHBOURS,
    CageQuery,
    ProbeWeight,
    find_extra_probe,
    query_probes,
    weigh_corner_probe,
    weigh_extra_probe,
    weigh_neighbour_probe,
)
from luxel.methods.ddgi.state import ASLEEP, DEAD, UNUSED, DdgiState
from luxel.methods.ddgi.volume import grid_coordinates, is_inside
from luxel.methods.ddgi.weights import read_irradiance
from luxel.methods.inspect import Contribution

NEGLIGIBLE_WEIGHT = 1e-3
"""Weight under which a probe gives next to nothing."""
NEGLIGIBLE_FACTOR = 0.05
"""Factor under which one is named as the reason for that."""


def explain_point(state: DdgiState, surface: Surface) -> list[Contribution]:
    """Return one entry a probe of each cage around the first point of `surface`, and of its extra, heaviest first.

    Where all of a cage are dead, the probes of the neighbouring cages that stand in for it follow.
    """
    p, n, wo = (type(v)(*(dr.gather(mi.Float, c, 0) for c in v)) for v in (surface.p, surface.n_geometric, surface.wo))
    light = mi.Vector3f(*(dr.gather(mi.Float, c, 0) for c in surface.n_shading))
    footprint = Footprint(light, state.settings.irradiance_resolution)
    found: list[Contribution] = []
    answer = query_probes(state, p, n, mi.Normal3f(light), wo, mi.Bool(True))
    for volume, part in zip(state.volumes, answer.parts, strict=True):
        cage = CageQuery(state, volume, p, n, wo, footprint)
        outside = not bool(np.array(is_inside(volume, grid_coordinates(volume, p)))[0])
        found += _explain_cage(cage, float(np.array(part).ravel()[0]), outside)
    found = sorted(found, key=lambda item: -item.weight)
    return _share_out(found, np.array(answer.irradiance).reshape(3)) if state.settings.roots else found


def _share_out(found: list[Contribution], whole: np.ndarray) -> list[Contribution]:
    """Return the entries with what each gives to an answer of `whole` (3,): the weighted mean is the answer.

    The answer is made of fourth roots: a probe brighter than it gives less than it has, a darker one more.
    """
    roots = np.array([item.irradiance for item in found]) ** 0.25
    mean = np.array([item.weight for item in found]) @ roots
    given = roots * (whole / np.maximum(mean, 1e-30))
    return [replace(item, irradiance=(r, g, b)) for item, (r, g, b) in zip(found, given.tolist(), strict=True)]


def _explain_cage(cage: CageQuery, part: float, outside: bool) -> list[Contribution]:
    """Return the entries of one cage, whose weights count `part` times."""
    state = cage.state
    corner = dr.arange(mi.UInt32, 8)
    bits = mi.Vector3i(mi.Int32(corner & 1), mi.Int32((corner >> 1) & 1), mi.Int32(corner >> 2))
    corners = weigh_corner_probe(cage, bits, mi.Bool(True))
    rows = _read(cage, corners, 8)
    weight = float(rows["weight"].sum())
    if state.settings.extra_count:
        seen = mi.Float(float(rows["seen"].sum()))
        held_back = find_extra_probe(cage, mi.Bool(True))
        if int(np.array(held_back)[0]):
            extra = _read(cage, weigh_extra_probe(cage, held_back, seen, mi.Bool(True)), 1)
            weight += float(extra["weight"].sum())
            rows = {name: np.concatenate([rows[name], extra[name]]) for name in rows}
    found = [_entry(state, rows, index, part, outside) for index in range(len(rows["probe"]))]
    # An answer without any weight of its own was borrowed.
    if part > 0.0 and weight <= 0.0:
        around = _read(cage, weigh_neighbour_probe(cage, dr.arange(mi.UInt32, NEIGHBOURS), mi.Bool(True)), NEIGHBOURS)
        found += _borrowed(around, part)
    return found


def _read(cage: CageQuery, term: ProbeWeight, width: int) -> dict[str, np.ndarray]:
    """Return weights of probes as arrays of `width` rows: id, place, factors, weights, irradiance in W/m^2."""
    color = read_irradiance(cage.state, term.probe, cage.footprint, mi.Bool(True)) * cage.state.scale
    numbers = {name: getattr(term, name) for name in ("probe", "trilinear", "backface", "visibility", "weight", "seen")}
    rows = {name: np.broadcast_to(np.array(value), width) for name, value in numbers.items()}
    for name, value in (("p", term.q), ("color", color)):
        columns = [np.broadcast_to(np.array(c), width) for c in value]
        rows[name] = np.stack(columns, axis=1).astype(float)
    return rows


def _entry(state: DdgiState, rows: dict[str, np.ndarray], index: int, part: float, outside: bool) -> Contribution:
    status = int(np.array(state.probes.status)[int(rows["probe"][index])])
    weight = float(rows["weight"][index]) * part
    factors = (float(rows[name][index]) for name in ("trilinear", "backface", "visibility"))
    why, reason = _reason(status, *factors, weight=weight)
    if outside and weight > NEGLIGIBLE_WEIGHT and why in ("", "depth"):
        why, reason = "outside", "answers from outside the box: this is its nearest cage"
    return _contribution(rows, index, weight, why, reason)


def _contribution(rows: dict[str, np.ndarray], index: int, weight: float, why: str, reason: str) -> Contribution:
    (r, g, b), (x, y, z) = rows["color"][index].tolist(), rows["p"][index].tolist()
    return Contribution(int(rows["probe"][index]), weight, (r, g, b), reason, (x, y, z), why)


def _borrowed(rows: dict[str, np.ndarray], part: float) -> list[Contribution]:
    """Return the neighbours that answer; at the border of the box one probe may stand for several."""
    found: dict[int, Contribution] = {}
    for index in np.nonzero(rows["weight"] > 0.0)[0]:
        probe = int(rows["probe"][index])
        weight = float(rows["weight"][index]) * part + (found[probe].weight if probe in found else 0.0)
        found[probe] = _contribution(
            rows, int(index), weight, "borrowed", "stands in: all probes of the point's own cage are dead"
        )
    return list(found.values())


def _reason(status: int, trilinear: float, backface: float, visibility: float, weight: float) -> tuple[str, str]:
    """Return in a word and in words why a probe has no weight; empty where it has some."""
    if status == DEAD:
        return "dead", "dead: inside geometry"
    if status == UNUSED:
        return "unplaced", "held back"
    # Where none sees the point, blind ones share a guess: their shares are large, and they see it no better.
    if visibility < NEGLIGIBLE_FACTOR:
        return "depth", "does not see the point"
    if weight > NEGLIGIBLE_WEIGHT:
        return "", ""
    if backface < NEGLIGIBLE_FACTOR:
        return "normal", "behind the surface"
    if status == ASLEEP:
        return "asleep", "asleep: no look-up reads it"
    return ("distance", "too far") if trilinear < NEGLIGIBLE_FACTOR else ("distance", "little say")
