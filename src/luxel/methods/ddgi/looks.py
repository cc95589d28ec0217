"""What can be drawn of the probes: who lights each pixel, and how much; the probes themselves; their sheets."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from luxel.kernels.records import Surface
from luxel.kernels.sampling import hash_pair, to_unit
from luxel.methods.ddgi.atlas import Footprint
from luxel.methods.ddgi.query import (
    MIN_CAGE_WEIGHT,
    CageQuery,
    ProbeWeight,
    find_extra_probe,
    query_probes,
    weigh_corner_probe,
    weigh_extra_probe,
)
from luxel.methods.ddgi.state import DdgiState
from luxel.methods.inspect import Look, Reading

DDGI_LOOKS = (
    Look("probes", "probes, each lit as a white ball by what it knows", "spheres", "W/m²", view="irradiance"),
    Look("probe-depth", "distance seen by each probe, over its reach", "spheres", "", (0.0, 1.0), view="depth"),
    Look("probe-state", "probes by their state", "spheres", view="state"),
    Look("probe-offsets", "which way and how far probes have moved from the grid", "spheres", view="offsets"),
    Look("probe-shares", "who lights each pixel: a colour a probe, mixed by weights", "mix"),
    Look("top-share", "share of the heaviest probe; 1: it answers alone", "number", "", (0.0, 1.0)),
    Look("weights", "summed weights of the probes that see the point", "number", "", (0.0, 1.0)),
    Look("irradiance-atlas", "irradiance of all probes, layer by layer", "sheet", "W/m²", view="irradiance_atlas"),
    Look("depth-atlas", "distances seen by all probes, over their reach", "sheet", "", (0.0, 1.0), view="depth_atlas"),
    Look("certainty-atlas", "certainty by which each probe moves", "sheet", "", (0.0, 1.0), view="certainty"),
)  # fmt: skip


def read_probes_at(state: DdgiState, surface: Surface, look: str) -> Reading:
    """Return what `look`, one of `DDGI_LOOKS` that is no view, shows at a surface."""
    p, n, wo, active = surface.p, surface.n_geometric, surface.wo, surface.active
    answer = query_probes(state, p, n, surface.n_shading, wo, active)
    if look == "weights":
        return Reading(answer.seen, active)
    footprint = Footprint(mi.Vector3f(surface.n_shading), state.settings.irradiance_resolution)
    mix, top, total = mi.Color3f(0.0), mi.Float(0.0), mi.Float(0.0)
    for volume, part in zip(state.volumes, answer.parts, strict=True):
        cage = CageQuery(state, volume, p, n, wo, footprint)
        mix, top, total, seen = _add_corners(cage, active & (part > 0.0), part, mix, top, total)
        if state.settings.extra_count:
            probe = find_extra_probe(cage, active & (part > 0.0) & (seen < MIN_CAGE_WEIGHT))
            term = weigh_extra_probe(cage, probe, seen, probe > 0)
            mix, top, total = _add(term, part, mix, top, total)
    answered = active & (total > 0.0)
    share = 1.0 / dr.fmax(total, 1e-20)
    return Reading(mix * share if look == "probe-shares" else top * share, answered)


@dr.syntax
def _add_corners(
    cage: CageQuery, active: mi.Bool, part: mi.Float, mix: mi.Color3f, top: mi.Float, total: mi.Float
) -> tuple[mi.Color3f, mi.Float, mi.Float, mi.Float]:
    """Add the eight probes of a cage, their weights times `part`; also return the weight of those with sight."""
    mix, top, total, seen = mi.Color3f(mix), mi.Float(top), mi.Float(total), mi.Float(0.0)
    corner = mi.UInt32(0)
    going = mi.Bool(active)
    while going:
        bits = mi.Vector3i(mi.Int32(corner & 1), mi.Int32((corner >> 1) & 1), mi.Int32(corner >> 2))
        term = weigh_corner_probe(cage, bits, going)
        mix, top, total = _add(term, part, mix, top, total)
        seen += term.seen
        corner += 1
        going &= corner < 8
    return mix, top, total, seen


def _add(
    term: ProbeWeight, part: mi.Float, mix: mi.Color3f, top: mi.Float, total: mi.Float
) -> tuple[mi.Color3f, mi.Float, mi.Float]:
    """Add one probe to the mix of colours, the largest weight and the sum of weights."""
    weight = term.weight * part
    return mix + color_of_probe(term.probe) * weight, dr.fmax(top, weight), total + weight


def color_of_probe(probe: mi.UInt32) -> mi.Color3f:
    """Return a displayed colour for each id: any hue, none dark and none pale."""
    word, _ = hash_pair(probe, mi.UInt32(0x9E3779B9))
    turn = to_unit(word) * dr.two_pi
    red, green, blue = (dr.fma(dr.cos(turn - third * dr.two_pi / 3.0), 0.36, 0.56) for third in range(3))
    return mi.Color3f(red, green, blue)
