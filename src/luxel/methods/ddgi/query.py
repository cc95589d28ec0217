"""Light from the probes around a point (Majercik et al. 2019; Roháček 2022, sections 3.2.7 and 3.3).

Eight probes make a cage. A probe's say is the product of four factors: how near it is (trilinear), on which side of
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
    block_size,
    bound_by_chebyshev,
    read_color,
    read_moments,
)
from luxel.methods.ddgi.planes import sight_past_planes
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

CRUSH = 0.2
"""Visibility below which a probe's say falls faster still (Majercik et al. 2019: probes that hardly see the point)."""
ENOUGH = 0.05
"""Sum of weights from which a cage answers alone; below, others are asked."""
RIDGE_ACROSS, RIDGE_ALONG = 0.02, 0.05
"""Squared cell sides that are added to the spread of the probes' places: across the surface, where they are all on one
side of it, and along it, where their places say less and the noise of their light the more."""
FARTHEST = 2.0
"""Cell sides along an axis beyond which places count alike: far outside the box a slope has no sense."""
LEAST_CHANGE, MOST_CHANGE = 0.7, 1.15
"""Factors between which the value (a fourth root) at the point stays to the mean of the probes."""
NEIGHBOURS = 64
"""Probes of the cage and of those around it."""
LEAST = 1e-6
"""Share of an unseen probe's say that stays, so that a cage's mean answers where nothing else does."""


@dataclass
class Answer:
    """What the probes say of a point."""

    irradiance: mi.Color3f
    seen: mi.Float
    """Sum of the weights of probes that see the point: 1 in the open, 0 where none does."""
    said: mi.Float
    """Share of the boxes that had anything to say: 0 where all probes around are dead."""
    parts: list[mi.Float]
    """By what the weights of each box's cage were multiplied."""


def query_probes(
    state: DdgiState, p: mi.Point3f, n: mi.Normal3f, n_light: mi.Normal3f, wo: mi.Vector3f, active: mi.Bool
) -> Answer:
    """Return irradiance at world points `p` with geometric normals `n`, lit about `n_light`, seen from `wo`."""
    footprint = Footprint(mi.Vector3f(n_light), state.settings.irradiance_resolution)
    total = mi.Color3f(0.0)
    left = mi.Float(1.0)
    seen = mi.Float(0.0)
    parts: list[mi.Float] = []
    spare = no_tally()
    spared = mi.UInt32(len(state.volumes))
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
        tally = _ask_cage(state, volume, p, n, wo, footprint, wanted, ~later)
        # A cage that does not see the point leaves it to the next box; if none does, the finest one guesses.
        share *= dr.select(later | (spare.weight > 0.0), dr.clip(tally.seen * (1.0 / ENOUGH), 0.0, 1.0), 1.0)
        guesses = wanted & later & (spare.weight <= 0.0) & (tally.weight > 0.0)
        spare = dr.select(guesses, tally, spare)
        spared = dr.select(guesses, mi.UInt32(index), spared)
        share = dr.select(wanted & (tally.weight > 0.0), left * share, 0.0)
        parts.append(share / dr.fmax(tally.weight, 1e-30))
        total += tally.total * (share / dr.fmax(tally.weight, 1e-30))
        seen += tally.seen * share
        left -= share
    if len(state.volumes) > 1:
        guess = dr.select(spare.weight > 0.0, left / dr.fmax(spare.weight, 1e-30), 0.0)
        parts = [dr.select(spared == index, part + guess, part) for index, part in enumerate(parts)]
        total += spare.total * guess
        left = dr.select(spare.weight > 0.0, 0.0, left)
    # Where the last box had nothing to say, what the others said counts whole.
    said = 1.0 - left
    total *= dr.select(said > 1e-6, 1.0 / dr.fmax(said, 1e-6), 0.0)
    total = light_of(state, total) * state.scale
    return Answer(dr.select(active, total, mi.Color3f(0.0)), seen, said, [part / dr.fmax(said, 1e-6) for part in parts])


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
class Tally:
    """Running sums of a look-up."""

    total: mi.Color3f
    """Value (`value_of`) times weight."""
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


def no_tally() -> Tally:
    """Return the sums of a look-up that has asked nobody yet."""
    zero, nowhere = mi.Float(0.0), mi.Vector3f(0.0)
    return Tally(mi.Color3f(0.0), zero, zero, nowhere, nowhere, nowhere, nowhere)


def bring_to_point(tally: Tally, n: mi.Normal3f) -> Tally:
    """Return the sums with the value that a linear fit through the probes' values has at the point, of normal `n`.

    The mean of the probes' places would be the point if all had their trilinear say. But those behind the surface, or
    out of sight of the point, have none; the others stand off the surface, away from walls and towards openings, and
    most places get less light than they do. All channels take the change that their sum takes, so the hue stays.
    """
    share = 1.0 / dr.fmax(tally.weight, 1e-30)
    place, mean = tally.place * share, dr.sum(tally.total) * share
    across = mi.Vector3f(n) * (RIDGE_ACROSS - RIDGE_ALONG)
    square = dr.fma(tally.square, share, -place * place) + across * n + RIDGE_ALONG
    mixed = tally.mixed * share - _mixed(place, place) + _mixed(across, n)
    slope = tally.slope * share - place * mean
    change = mean - dr.dot(_solve_symmetric(square, mixed, place), slope)
    factor = dr.clip(change / dr.fmax(mean, 1e-30), LEAST_CHANGE, MOST_CHANGE)
    return replace(tally, total=tally.total * dr.select(mean > 0.0, factor, 1.0))


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
class Say:
    """What one probe's word counts for at a point, factor by factor."""

    probe: mi.UInt32
    q: mi.Point3f
    """Where it is."""
    near: mi.Float
    facing: mi.Float
    sight: mi.Float
    weight: mi.Float
    seen: mi.Float
    """The part of `weight` that sight gives."""


class Question:
    """What the probes of one cage are asked. A plain object: loops read it and carry nothing of it along."""

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


def _ask_cage(
    state: DdgiState,
    volume: Volume,
    p: mi.Point3f,
    n: mi.Normal3f,
    wo: mi.Vector3f,
    footprint: Footprint,
    active: mi.Bool,
    final: mi.Bool,
) -> Tally:
    """Return what the cage around `p`, and who stands in for it, say."""
    asked = Question(state, volume, p, n, wo, footprint)
    tally = _ask_corners(asked, active)
    if state.settings.extra_count > 0:
        tally = _ask_extra(asked, active, tally)
    if state.settings.detect_dead:
        tally = _ask_neighbours(asked, active & final, tally)
    return bring_to_point(tally, n) if state.settings.roots else tally


@dr.syntax
def _ask_corners(asked: Question, active: mi.Bool) -> Tally:
    """Ask the eight probes of the cage, two at once: one alone waits for memory, all together crowd the registers."""
    tally = no_tally()
    pair = mi.UInt32(0)
    going = mi.Bool(active)
    while going:
        for x in range(2):
            bits = mi.Vector3i(x, mi.Int32(pair & 1), mi.Int32(pair >> 1))
            tally = _ask_corner(asked, bits, going, tally)
        pair += 1
        going &= pair < 4
    return tally


def _ask_corner(asked: Question, bits: mi.Vector3i, active: mi.Bool, so_far: Tally) -> Tally:
    """Add what one probe of the cage says."""
    say = weigh_corner(asked, bits, active)
    color = value_of(asked.state, say.probe, asked.footprint, active & (say.weight > 0.0))
    total, weight, seen = so_far.total + color * say.weight, so_far.weight + say.weight, so_far.seen + say.seen
    if not asked.state.settings.roots:
        return replace(so_far, total=total, weight=weight, seen=seen)
    d = dr.clip(mi.Vector3f(say.q - asked.p) / asked.volume.side, -FARTHEST, FARTHEST)
    share = d * say.weight
    return Tally(
        total=total,
        weight=weight,
        seen=seen,
        place=so_far.place + share,
        square=so_far.square + share * d,
        mixed=so_far.mixed + _mixed(share, d),
        slope=so_far.slope + share * dr.sum(color),
    )


def weigh_corner(asked: Question, bits: mi.Vector3i, active: mi.Bool) -> Say:
    """Return the say of the probe at corner `bits` (0 or 1 along each axis) of the cage."""
    state, volume, p, n, x = asked.state, asked.volume, asked.p, asked.n, asked.x
    node = asked.base + bits
    slot = dr.select(bits == 1, asked.high, asked.low)
    probe = slot.x + slot.y + slot.z
    row = dr.gather(mi.Vector4f, state.rows, probe, active)
    q = mi.Point3f(row.x, row.y, row.z)
    near = dr.fmax(nearness_of(state, volume, q, node, asked.inner - mi.Point3f(bits)), 1e-4)
    facing = facing_of(state, p, n, q)
    usable = dr.select(row.w > 0.5, near * facing, 0.0)
    sight = sight_of(state, probe, q, x, active & (usable > 0.0))
    return Say(probe, q, near, facing, sight, usable * dr.fmax(sight, LEAST), usable * sight)


@dr.syntax
def _ask_extra(asked: Question, active: mi.Bool, so_far: Tally) -> Tally:
    """Ask the probe held back for this eighth of the cell, as far as the cage does not see the point."""
    probe = find_extra(asked, active & (so_far.seen < ENOUGH))
    total, weight = mi.Color3f(0.0), mi.Float(0.0)
    # A branch, not a mask: few points want it, and the others are spared the arithmetic.
    if probe > 0:
        weight = weigh_extra(asked, probe, so_far.seen, mi.Bool(True)).weight
        total = value_of(asked.state, probe, asked.footprint, weight > 0.0) * weight
    return replace(so_far, total=so_far.total + total, weight=so_far.weight + weight, seen=so_far.seen + weight)


def find_extra(asked: Question, active: mi.Bool) -> mi.UInt32:
    """Return the id of the probe held back for this eighth of the cell; 0 where there is none."""
    part = part_of(asked.state, asked.volume, asked.base, asked.inner)
    return dr.gather(mi.UInt32, asked.state.extras.of_part, part, active)


def weigh_extra(asked: Question, probe: mi.UInt32, seen: mi.Float, active: mi.Bool) -> Say:
    """Return the say of `probe`, held back, where those of the cage that see the point weigh `seen` together."""
    row = dr.gather(mi.Vector4f, asked.state.rows, probe, active)
    q = mi.Point3f(row.x, row.y, row.z)
    facing = facing_of(asked.state, asked.p, asked.n, q)
    sight = sight_of(asked.state, probe, q, asked.x, active)
    weight = dr.select(row.w > 0.5, sight * facing * dr.fmax(ENOUGH - seen, 0.0), 0.0)
    return Say(probe, q, mi.Float(1.0), facing, sight, weight, weight)


@dr.syntax
def _ask_neighbours(asked: Question, active: mi.Bool, so_far: Tally) -> Tally:
    """Borrow from the neighbouring cages where all probes of this one are dead."""
    total, weight_all = mi.Color3f(so_far.total), mi.Float(so_far.weight)
    ring = mi.UInt32(0)
    going = active & (weight_all <= 0.0)
    while going:
        say = weigh_neighbour(asked, ring, going)
        total += value_of(asked.state, say.probe, asked.footprint, going & (say.weight > 0.0)) * say.weight
        weight_all += say.weight
        ring += 1
        going &= ring < NEIGHBOURS
    return replace(so_far, total=total, weight=weight_all)


def weigh_neighbour(asked: Question, ring: mi.UInt32, active: mi.Bool) -> Say:
    """Return the say of neighbour `ring` (0 .. NEIGHBOURS - 1) of the cage, by distance alone."""
    state, volume, p, n, x = asked.state, asked.volume, asked.p, asked.n, asked.x
    high = volume.low + mi.Vector3i(volume.nx - 1, volume.ny - 1, volume.nz - 1)
    step = mi.Vector3i(mi.Int32(ring & 3), mi.Int32((ring >> 2) & 3), mi.Int32(ring >> 4)) - 1
    probe = probe_of_node(volume, dr.minimum(dr.maximum(asked.base + step, volume.low), high))
    row = dr.gather(mi.Vector4f, state.rows, probe, active)
    q = mi.Point3f(row.x, row.y, row.z)
    distance = dr.squared_norm(q - x) / dr.square(volume.side)
    facing, squared = facing_of(state, p, n, q), dr.fmax(dr.square(distance), 1e-6)
    weight = dr.select(row.w > 0.5, facing / squared, 0.0)
    return Say(probe, q, 1.0 / squared, facing, mi.Float(0.0), weight, mi.Float(0.0))


def color_of(state: DdgiState, probe: mi.UInt32, footprint: Footprint, active: mi.Bool) -> mi.Color3f:
    """Return a probe's irradiance, in the atlas's unit."""
    settings = state.settings
    block = probe * block_size(settings.irradiance_resolution)
    return read_color(state.irradiance_atlas, settings.half_irradiance, block, footprint, active)


def value_of(state: DdgiState, probe: mi.UInt32, footprint: Footprint, active: mi.Bool) -> mi.Color3f:
    """Return what of a probe's irradiance is averaged: itself, or its fourth root.

    Away from a bright patch light falls off in a hollow curve, and the mean of what probes around get lies above what
    the point gets: by 10 to 16 % in Sponza. Roots are nearly straight there.
    """
    color = color_of(state, probe, footprint, active)
    return dr.sqrt(dr.sqrt(dr.maximum(color, 0.0))) if state.settings.roots else color


def light_of(state: DdgiState, mean: mi.Color3f) -> mi.Color3f:
    """Return the irradiance, in the atlas's unit, that a mean of `value_of` stands for."""
    return dr.square(dr.square(mean)) if state.settings.roots else mean


def biased_point(state: DdgiState, volume: Volume, p: mi.Point3f, n: mi.Normal3f, wo: mi.Vector3f) -> mi.Point3f:
    """Return the point that visibility is asked for: off the surface, so that it does not shadow itself."""
    dials = state.dials
    return mi.Point3f(p + (mi.Vector3f(n) * dials.normal_bias + wo * dials.view_bias) * volume.side)


def part_of(state: DdgiState, volume: Volume, base: mi.Vector3i, inner: mi.Point3f) -> mi.UInt32:
    """Return the index of the eighth of the cell that a point lies in."""
    cell = probe_of_node(volume, base)
    octant = dr.select(inner.x > 0.5, mi.UInt32(1), 0)
    octant += dr.select(inner.y > 0.5, mi.UInt32(2), 0)
    octant += dr.select(inner.z > 0.5, mi.UInt32(4), 0)
    return cell * 8 + octant


def nearness_of(state: DdgiState, volume: Volume, q: mi.Point3f, node: mi.Vector3i, t: mi.Point3f) -> mi.Float:
    """Return the trilinear factor of a probe at `q` whose node is `t` cells from the point.

    A moved probe's weight peaks where it is and still vanishes at the neighbouring nodes: along each axis a tent with
    its top at the offset. Symmetric in the two sides, so cages join without a seam (the thesis's listing 3.12 treats
    offsets to one side only).
    """
    if not state.settings.corrected_weights:
        w = dr.fmax(1.0 - dr.abs(t), 0.0)
        return w.x * w.y * w.z
    o = grid_coordinates(volume, q) - mi.Point3f(node)
    side = dr.select(t < o, mi.Point3f(1.0), -1.0)
    height, base = dr.fmax(dr.fma(side, t, 1.0), 0.0), dr.fma(side, o, 1.0)
    return (height.x * height.y * height.z) * dr.rcp(base.x * base.y * base.z)


def facing_of(state: DdgiState, p: mi.Point3f, n: mi.Normal3f, q: mi.Point3f) -> mi.Float:
    """Return the smooth back-face factor: ((cos + 1) / 2)^2, plus the 2019 paper's offset where it is wanted."""
    to_probe = q - p
    cosine = dr.dot(to_probe, mi.Vector3f(n)) * dr.rsqrt(dr.fmax(dr.squared_norm(to_probe), 1e-20))
    return dr.square(dr.fma(cosine, 0.5, 0.5)) + state.dials.backface_offset


def sight_of(state: DdgiState, probe: mi.UInt32, q: mi.Point3f, x: mi.Point3f, active: mi.Bool) -> mi.Float:
    """Return how far the probe at `q` sees `x`, 0..1: an upper bound of the share of its texel that reaches so far."""
    settings, away = state.settings, mi.Vector3f(x - q)
    resolution, half = settings.depth_resolution, settings.half_depth
    if settings.planes:
        sight = sight_past_planes(state.depth_atlas, half, probe, away, resolution, active)
    else:
        distance = dr.norm(away)
        footprint, block = Footprint(away, resolution), probe * block_size(resolution)
        mean, variance = read_moments(state.depth_atlas, half, block, footprint, active)
        sight = bound_by_chebyshev(variance, dr.fmax(distance - mean, 0.0))
    return dr.select(sight < CRUSH, sight * sight * sight * (1.0 / CRUSH**2), sight)
