"""Light from the probes around a point (Majercik et al. 2019; Roháček 2022, sections 3.2.7 and 3.3).

Eight probes make a cage. A probe's weight is the product of four factors: how near it is (trilinear), on which side of
the surface it is (smooth back-face weight), whether it sees the point (Chebyshev's inequality on its depth), and
whether it is of use at all. Where none of a cage sees the point, a probe held back for that place answers, or the
next box, and at last the cage's mean: never black.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from luxel.methods.ddgi.atlas import (
    Footprint,
)
from luxel.methods.ddgi.state import DdgiState
from luxel.methods.ddgi.volume import (
    Volume,
    cage_of,
    cage_slots,
    grid_coordinates,
    inside_share,
    is_inside,
    probe_of_node,
)
from luxel.methods.ddgi.weights import (
    backface_weight,
    biased_point,
    chebyshev_visibility,
    decode_irradiance,
    encoded_irradiance,
    octant_index,
    trilinear_weight,
)

MIN_CAGE_WEIGHT = 0.05
"""Sum of weights from which a cage answers alone; below, others are asked."""
RIDGE_ACROSS, RIDGE_ALONG = 0.02, 0.05
"""Squared cell sides that are added to the spread of the probes' places: across the surface, where they are all on one
side of it, and along it, where their places say less and the noise of their light the more."""
FIT_REACH = 2.0
"""Cell sides along an axis beyond which places count alike: far outside the box a slope has no sense."""
MIN_CHANGE, MAX_CHANGE = 0.7, 1.15
"""Factors between which the value (a fourth root) at the point stays to the mean of the probes."""
NEIGHBOURS = 64
"""Probes of the cage and of those around it."""
MIN_VISIBILITY = 1e-6
"""Share of an unseen probe's weight that stays, so that a cage's mean answers where nothing else does."""


@dataclass
class ProbeIrradiance:
    """What a look-up gives at a point."""

    irradiance: mi.Color3f
    seen: mi.Float
    """Sum of the weights of probes that see the point: 1 in the open, 0 where none does."""
    coverage: mi.Float
    """Share of the boxes that answer: 0 where all probes around are dead."""
    parts: list[mi.Float]
    """By what the weights of each box's cage were multiplied."""


def query_probes(
    state: DdgiState, p: mi.Point3f, n: mi.Normal3f, n_light: mi.Normal3f, wo: mi.Vector3f, active: mi.Bool
) -> ProbeIrradiance:
    """Return irradiance at world points `p` with geometric normals `n`, lit about `n_light`, seen from `wo`."""
    footprint = Footprint(mi.Vector3f(n_light), state.settings.irradiance_resolution)
    total = mi.Color3f(0.0)
    left = mi.Float(1.0)
    seen = mi.Float(0.0)
    parts: list[mi.Float] = []
    fallback = empty_cage_sum()
    fallback_volume = mi.UInt32(len(state.volumes))
    places = [grid_coordinates(volume, p) for volume in state.volumes]
    holds = [is_inside(volume, g) for volume, g in zip(state.volumes, places, strict=True)]
    nearest = _nearest_box(state, places)
    for index, volume in enumerate(state.volumes):
        # The rest goes to later boxes only where one of them holds the point; outside all, the nearest box answers.
        later, any_box = mi.Bool(False), mi.Bool(False)
        for number, held in enumerate(holds):
            any_box |= held
            later |= held & (number > index)
        alone = dr.select(holds[index] | (~any_box & (nearest == index)), mi.Float(1.0), 0.0)
        share = dr.select(later, inside_share(volume, places[index]), alone)
        wanted = active & (left * share > 0.0)
        cage_sum = _sum_cage(state, volume, p, n, wo, footprint, wanted, ~later)
        # A cage that does not see the point leaves it to the next box; if none does, the finest one guesses.
        share *= dr.select(
            later | (fallback.weight > 0.0), dr.clip(cage_sum.seen * (1.0 / MIN_CAGE_WEIGHT), 0.0, 1.0), 1.0
        )
        guesses = wanted & later & (fallback.weight <= 0.0) & (cage_sum.weight > 0.0)
        fallback = dr.select(guesses, cage_sum, fallback)
        fallback_volume = dr.select(guesses, mi.UInt32(index), fallback_volume)
        share = dr.select(wanted & (cage_sum.weight > 0.0), left * share, 0.0)
        parts.append(share / dr.fmax(cage_sum.weight, 1e-30))
        total += cage_sum.total * (share / dr.fmax(cage_sum.weight, 1e-30))
        seen += cage_sum.seen * share
        left -= share
    if len(state.volumes) > 1:
        guess = dr.select(fallback.weight > 0.0, left / dr.fmax(fallback.weight, 1e-30), 0.0)
        parts = [dr.select(fallback_volume == index, part + guess, part) for index, part in enumerate(parts)]
        total += fallback.total * guess
        left = dr.select(fallback.weight > 0.0, 0.0, left)
    # Where the last box had nothing to say, what the others said counts whole.
    coverage = 1.0 - left
    total *= dr.select(coverage > 1e-6, 1.0 / dr.fmax(coverage, 1e-6), 0.0)
    total = decode_irradiance(state, total) * state.scale
    return ProbeIrradiance(
        dr.select(active, total, mi.Color3f(0.0)), seen, coverage, [part / dr.fmax(coverage, 1e-6) for part in parts]
    )


def _nearest_box(state: DdgiState, places: list[mi.Point3f]) -> mi.UInt32:
    """Return the number of the box that is nearest to each point, given in each box's lattice coordinates."""
    nearest, least = mi.UInt32(0), mi.Float(dr.inf)
    for index, (volume, g) in enumerate(zip(state.volumes, places, strict=True)):
        away = g - mi.Point3f(volume.low)
        span = mi.Point3f(volume.nx - 1.0, volume.ny - 1.0, volume.nz - 1.0)
        beyond = dr.maximum(dr.maximum(-away, away - span), 0.0)
        steps = (volume.step_x, volume.step_y, volume.step_z)
        distance = sum(dr.square(b) * dr.squared_norm(step) for b, step in zip(beyond, steps, strict=True))
        nearest = dr.select(distance < least, mi.UInt32(index), nearest)
        least = dr.minimum(distance, least)
    return nearest


@dataclass
class CageSum:
    """Running sums over the probes of a cage."""

    total: mi.Color3f
    """Value (`encoded_irradiance`) times weight."""
    weight: mi.Float
    seen: mi.Float
    """The part of `weight` that comes from probes with sight of the point."""
    place: mi.Vector3f
    """Weight times where the probes are, from the point, in cell sides."""
    square: mi.Vector3f
    """Weight times the squares of that along each axis."""
    mixed: mi.Vector3f
    """Weight times the products of two of its axes: y z, x z, x y."""
    slope: mi.Vector3f
    """Weight times the value, summed over its channels, times the place."""


def empty_cage_sum() -> CageSum:
    """Return the sums of a look-up before its first probe."""
    zero, nowhere = mi.Float(0.0), mi.Vector3f(0.0)
    return CageSum(mi.Color3f(0.0), zero, zero, nowhere, nowhere, nowhere, nowhere)


def extrapolate_to_point(cage_sum: CageSum, n: mi.Normal3f) -> CageSum:
    """Return the sums with the value that a linear fit through the probes' values has at the point, of normal `n`.

    The mean of the probes' places would be the point if all had their trilinear weight. But those behind the
    surface, or out of sight of the point, have none; the others stand off the surface, away from walls and towards
    openings, and most places get less light than they do. All channels take the change that their sum takes,
    so the hue stays.
    """
    share = 1.0 / dr.fmax(cage_sum.weight, 1e-30)
    place, mean = cage_sum.place * share, dr.sum(cage_sum.total) * share
    across = mi.Vector3f(n) * (RIDGE_ACROSS - RIDGE_ALONG)
    square = dr.fma(cage_sum.square, share, -place * place) + across * n + RIDGE_ALONG
    mixed = cage_sum.mixed * share - _mixed(place, place) + _mixed(across, n)
    slope = cage_sum.slope * share - place * mean
    change = mean - dr.dot(_solve_symmetric(square, mixed, place), slope)
    factor = dr.clip(change / dr.fmax(mean, 1e-30), MIN_CHANGE, MAX_CHANGE)
    return replace(cage_sum, total=cage_sum.total * dr.select(mean > 0.0, factor, 1.0))


def _mixed(a: mi.Vector3f, b: mi.Vector3f) -> mi.Vector3f:
    """Return the y z, x z and x y entries of the outer product of `a` and `b`, which are parallel."""
    return mi.Vector3f(a.y * b.z, a.x * b.z, a.x * b.y)


def _solve_symmetric(diagonal: mi.Vector3f, mixed: mi.Vector3f, b: mi.Vector3f) -> mi.Vector3f:
    """Return x of M x = b for positive matrices M of a `diagonal` and its (y z, x z, x y) entries, by cofactors."""
    (a, d, f), (yz, xz, xy) = diagonal, mixed
    xx, yy, zz = d * f - yz * yz, a * f - xz * xz, a * d - xy * xy
    x_y, x_z, y_z = xz * yz - xy * f, xy * yz - xz * d, xy * xz - a * yz
    inverse = dr.rcp(a * xx + xy * x_y + xz * x_z)
    return mi.Vector3f(
        xx * b.x + x_y * b.y + x_z * b.z,
        x_y * b.x + yy * b.y + y_z * b.z,
        x_z * b.x + y_z * b.y + zz * b.z,
    ) * inverse  # fmt: skip


@dataclass
class ProbeWeight:
    """One probe's weight at a point, factor by factor."""

    probe: mi.UInt32
    q: mi.Point3f
    """Where it is."""
    trilinear: mi.Float
    backface: mi.Float
    visibility: mi.Float
    weight: mi.Float
    seen: mi.Float
    """The part of `weight` that sight gives."""


class CageQuery:
    """A look-up in one cage. A plain object: loops read it and carry nothing of it along."""

    def __init__(
        self,
        state: DdgiState,
        volume: Volume,
        p: mi.Point3f,
        n: mi.Normal3f,
        wo: mi.Vector3f,
        footprint: Footprint,
    ) -> None:
        """Find the cage around `p`; `footprint` is of the direction that light is wanted for."""
        self.state, self.volume, self.p, self.n, self.footprint = state, volume, p, n, footprint
        self.x = biased_point(state, volume, p, n, wo)
        self.base, self.inner = cage_of(volume, grid_coordinates(volume, self.x))
        self.low, self.high = cage_slots(volume, self.base)


def _sum_cage(
    state: DdgiState,
    volume: Volume,
    p: mi.Point3f,
    n: mi.Normal3f,
    wo: mi.Vector3f,
    footprint: Footprint,
    active: mi.Bool,
    final: mi.Bool,
) -> CageSum:
    """Return the sum over the cage around `p` and what stands in for it."""
    cage = CageQuery(state, volume, p, n, wo, footprint)
    cage_sum = _sum_corners(cage, active)
    if state.settings.extra_count > 0:
        cage_sum = _add_extra_probe(cage, active, cage_sum)
    if state.settings.detect_dead:
        cage_sum = _add_neighbour_cages(cage, active & final, cage_sum)
    return extrapolate_to_point(cage_sum, n) if state.settings.roots else cage_sum


@dr.syntax
def _sum_corners(cage: CageQuery, active: mi.Bool) -> CageSum:
    """Ask the eight probes of the cage, two at once: one alone waits for memory, all together crowd the registers."""
    cage_sum = empty_cage_sum()
    pair = mi.UInt32(0)
    going = mi.Bool(active)
    while going:
        for x in range(2):
            bits = mi.Vector3i(x, mi.Int32(pair & 1), mi.Int32(pair >> 1))
            cage_sum = _add_corner_probe(cage, bits, going, cage_sum)
        pair += 1
        going &= pair < 4
    return cage_sum


def _add_corner_probe(cage: CageQuery, bits: mi.Vector3i, active: mi.Bool, so_far: CageSum) -> CageSum:
    """Add one probe of the cage."""
    term = weigh_corner_probe(cage, bits, active)
    color = encoded_irradiance(cage.state, term.probe, cage.footprint, active & (term.weight > 0.0))
    total, weight, seen = so_far.total + color * term.weight, so_far.weight + term.weight, so_far.seen + term.seen
    if not cage.state.settings.roots:
        return replace(so_far, total=total, weight=weight, seen=seen)
    d = dr.clip(mi.Vector3f(term.q - cage.p) / cage.volume.side, -FIT_REACH, FIT_REACH)
    share = d * term.weight
    return CageSum(
        total=total,
        weight=weight,
        seen=seen,
        place=so_far.place + share,
        square=so_far.square + share * d,
        mixed=so_far.mixed + _mixed(share, d),
        slope=so_far.slope + share * dr.sum(color),
    )


def weigh_corner_probe(cage: CageQuery, bits: mi.Vector3i, active: mi.Bool) -> ProbeWeight:
    """Return the weight of the probe at corner `bits` (0 or 1 along each axis) of the cage."""
    state, volume, p, n, x = cage.state, cage.volume, cage.p, cage.n, cage.x
    node = cage.base + bits
    slot = dr.select(bits == 1, cage.high, cage.low)
    probe = slot.x + slot.y + slot.z
    row = dr.gather(mi.Vector4f, state.rows, probe, active)
    q = mi.Point3f(row.x, row.y, row.z)
    trilinear = dr.fmax(trilinear_weight(state, volume, q, node, cage.inner - mi.Point3f(bits)), 1e-4)
    backface = backface_weight(state, p, n, q)
    usable = dr.select(row.w > 0.5, trilinear * backface, 0.0)
    visibility = chebyshev_visibility(state, probe, q, x, active & (usable > 0.0))
    return ProbeWeight(
        probe, q, trilinear, backface, visibility, usable * dr.fmax(visibility, MIN_VISIBILITY), usable * visibility
    )


@dr.syntax
def _add_extra_probe(cage: CageQuery, active: mi.Bool, so_far: CageSum) -> CageSum:
    """Ask the probe held back for this eighth of the cell, as far as the cage does not see the point."""
    probe = find_extra_probe(cage, active & (so_far.seen < MIN_CAGE_WEIGHT))
    total, weight = mi.Color3f(0.0), mi.Float(0.0)
    # A branch, not a mask: few points want it, and the others are spared the arithmetic.
    if probe > 0:
        weight = weigh_extra_probe(cage, probe, so_far.seen, mi.Bool(True)).weight
        total = encoded_irradiance(cage.state, probe, cage.footprint, weight > 0.0) * weight
    return replace(so_far, total=so_far.total + total, weight=so_far.weight + weight, seen=so_far.seen + weight)


def find_extra_probe(cage: CageQuery, active: mi.Bool) -> mi.UInt32:
    """Return the id of the probe held back for this eighth of the cell; 0 where there is none."""
    part = octant_index(cage.state, cage.volume, cage.base, cage.inner)
    return dr.gather(mi.UInt32, cage.state.extras.of_part, part, active)


def weigh_extra_probe(cage: CageQuery, probe: mi.UInt32, seen: mi.Float, active: mi.Bool) -> ProbeWeight:
    """Return the weight of `probe`, held back, where those of the cage that see the point weigh `seen` together."""
    row = dr.gather(mi.Vector4f, cage.state.rows, probe, active)
    q = mi.Point3f(row.x, row.y, row.z)
    backface = backface_weight(cage.state, cage.p, cage.n, q)
    visibility = chebyshev_visibility(cage.state, probe, q, cage.x, active)
    weight = dr.select(row.w > 0.5, visibility * backface * dr.fmax(MIN_CAGE_WEIGHT - seen, 0.0), 0.0)
    return ProbeWeight(probe, q, mi.Float(1.0), backface, visibility, weight, weight)


@dr.syntax
def _add_neighbour_cages(cage: CageQuery, active: mi.Bool, so_far: CageSum) -> CageSum:
    """Borrow from the neighbouring cages where all probes of this one are dead."""
    total, weight_all = mi.Color3f(so_far.total), mi.Float(so_far.weight)
    ring = mi.UInt32(0)
    going = active & (weight_all <= 0.0)
    while going:
        term = weigh_neighbour_probe(cage, ring, going)
        total += encoded_irradiance(cage.state, term.probe, cage.footprint, going & (term.weight > 0.0)) * term.weight
        weight_all += term.weight
        ring += 1
        going &= ring < NEIGHBOURS
    return replace(so_far, total=total, weight=weight_all)


def weigh_neighbour_probe(cage: CageQuery, ring: mi.UInt32, active: mi.Bool) -> ProbeWeight:
    """Return the weight of neighbour `ring` (0 .. NEIGHBOURS - 1) of the cage, by distance alone."""
    state, volume, p, n, x = cage.state, cage.volume, cage.p, cage.n, cage.x
    high = volume.low + mi.Vector3i(volume.nx - 1, volume.ny - 1, volume.nz - 1)
    step = mi.Vector3i(mi.Int32(ring & 3), mi.Int32((ring >> 2) & 3), mi.Int32(ring >> 4)) - 1
    probe = probe_of_node(volume, dr.minimum(dr.maximum(cage.base + step, volume.low), high))
    row = dr.gather(mi.Vector4f, state.rows, probe, active)
    q = mi.Point3f(row.x, row.y, row.z)
    distance = dr.squared_norm(q - x) / dr.square(volume.side)
    backface, squared = backface_weight(state, p, n, q), dr.fmax(dr.square(distance), 1e-6)
    weight = dr.select(row.w > 0.5, backface / squared, 0.0)
    return ProbeWeight(probe, q, 1.0 / squared, backface, mi.Float(0.0), weight, mi.Float(0.0))
