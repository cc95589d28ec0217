"""Depth as planes: what a texel's rays hit, fitted by least squares, instead of the mean of their distances.

A distance averaged over a texel is blurred wherever a wall is seen at a slant, and light leaks through the blur. But
the inverse distance to a plane, 1 / t = a . w, is linear in the direction w, so the three numbers a of a texel describe
a wall exactly, and what the fit leaves over tells where there is more than one surface. Ours; the sources keep moments.
"""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi

from luxel.methods.ddgi.atlas import (
    Footprint,
    block_size,
    bound_by_chebyshev,
    interior_of,
    lobe,
    texel_direction,
    write_rows,
)
from luxel.methods.ddgi.state import PlaneSums, ProbeRayResults

RIDGE = 2e-4
"""Pull towards the plane that faces the probe, as a share of the weight: for texels that few rays have met."""
FADED = 0.02
"""Weight below which what was seen and is seen no more is forgotten."""
NEAREST_PLANE = 0.01
"""Share of the reach that stands for depth zero, whose inverse has no number: small enough that a texel of which a
share p of the rays was stopped at once bounds the sight through it by 1 - p."""
LEAST_DEVIATION = 0.01
"""Relative deviation that every plane is allowed: a hundredth of the distance."""


def new_sums(count: int) -> PlaneSums:
    """Return `count` texels that have seen nothing."""
    return PlaneSums(*(dr.zeros(mi.Float, count) for _ in range(11)))


def join_sums(
    old: PlaneSums, now: PlaneSums, keep: mi.Float, longest: float, active: mi.Bool, asked: mi.Bool | None = None
) -> PlaneSums:
    """Return `old` times `keep` plus `now`, the weight at most `longest`."""
    keep = dr.select(old.weight > 0.0, keep, 0.0)
    weight = old.weight * keep + now.weight
    shrink = dr.fmin(longest / dr.fmax(weight, 1e-6), 1.0)
    names = ("xx", "yy", "zz", "xy", "xz", "yz", "x", "y", "z", "square", "weight")
    joined = PlaneSums(*((getattr(old, name) * keep + getattr(now, name)) * shrink for name in names))
    # Where rays went but none ended within reach, the past fades, until the texel is open.
    learnt = now.weight > 1e-4
    if asked is not None:
        joined.weight = dr.select(learnt | (joined.weight > FADED), joined.weight, 0.0)
        learnt |= asked
    return dr.select(active & learnt, joined, old)


@dr.syntax
def sum_planes(
    results: ProbeRayResults,
    direction: mi.Vector3f,
    sharpness: int,
    limits: tuple[mi.Float, mi.Float],
    reject: bool,
    span: tuple[mi.UInt32, mi.UInt32],
    active: mi.Bool,
) -> PlaneSums:
    """Return the sums over a probe's rays, the `span` from a first one on.

    Rays that a back stopped count at the nearer of the two `limits`; beyond the farther one they are rejected, or taken
    at it.
    """
    sums = PlaneSums(*(mi.Float(0.0) for _ in range(11)))
    nearest, limit = limits
    ray, end = mi.UInt32(span[0]), span[0] + span[1]
    going = active & (ray < end)
    while going:
        row = dr.gather(mi.Vector4f, results.direction_depth, ray, going)
        w = lobe(direction.x * row.x + direction.y * row.y + direction.z * row.z, sharpness)
        t = dr.select(row.w < 0.0, nearest, row.w)
        w = dr.select(t > limit, 0.0, w) if reject else w
        s = 1.0 / dr.clip(t, 1e-6, limit)
        wx, wy, wz, ws = w * row.x, w * row.y, w * row.z, w * s
        sums.xx += wx * row.x
        sums.yy += wy * row.y
        sums.zz += wz * row.z
        sums.xy += wx * row.y
        sums.xz += wx * row.z
        sums.yz += wy * row.z
        sums.x += wx * s
        sums.y += wy * s
        sums.z += wz * s
        sums.square += ws * s
        sums.weight += w
        ray += 1
        going &= ray < end
    return sums


def pack_planes(
    sums: PlaneSums, reach_of: Callable[[mi.UInt32], mi.Float], resolution: int, count: int, half: bool
) -> mi.Float | mi.Float16:
    """Return the atlas of planes, 4 values a texel: a (1/m) and the relative deviation of 1 / t from it.

    Texels that saw nothing within reach are open: planes at `reach_of` their probe.
    """
    block = block_size(resolution)
    lane = dr.arange(mi.UInt32, count * block)
    probe = lane // block
    inner = interior_of(lane % block, resolution)
    texel = probe * (resolution * resolution) + inner

    def get(values: mi.Float) -> mi.Float:
        return dr.gather(mi.Float, values, texel)

    weight = get(sums.weight)
    seen = weight > 0.0
    inverse = dr.select(seen, 1.0 / dr.fmax(weight, 1e-20), 0.0)
    d = texel_direction(inner, resolution)
    b = mi.Vector3f(get(sums.x), get(sums.y), get(sums.z)) * inverse
    m = mi.Matrix3f(
        get(sums.xx), get(sums.xy), get(sums.xz),
        get(sums.xy), get(sums.yy), get(sums.yz),
        get(sums.xz), get(sums.yz), get(sums.zz),
    ) * inverse  # fmt: skip
    # Solve for what is left beside the plane that faces the probe: with few rays the matrix is all but singular, and
    # its rounded inverse must meet small numbers only.
    mean = dr.dot(b, d) / dr.fmax(dr.dot(d, m @ d), 1e-20)
    facing = mean * d
    a = facing + dr.rcp(m + mi.Matrix3f(RIDGE)) @ (b - m @ facing)
    left_over = dr.fmax(get(sums.square) * inverse - 2.0 * dr.dot(a, b) + dr.dot(a, m @ a), 0.0)
    deviation = dr.sqrt(left_over) / dr.fmax(mean, 1e-6)
    open_at = 1.0 / reach_of(probe)
    a = dr.select(seen, a, d * open_at)
    row = mi.Vector4f(a.x, a.y, a.z, dr.select(seen, deviation, 0.0))
    row = dr.select(dr.isfinite(row), row, 0.0)
    return write_rows(row, lane, half)


def visibility_past_planes(
    atlas: mi.Float | mi.Float16,
    half: bool,
    probe: mi.UInt32,
    away: mi.Vector3f,
    resolution: int,
    active: mi.Bool,
) -> mi.Float:
    """Return how far a probe sees the point that lies `away` from it, 0..1.

    Each of the four texels around the direction judges by its own plane; their verdicts are interpolated, not the
    planes, as shadow maps filter results and not depths.
    """
    footprint = Footprint(away, resolution)
    block = probe * block_size(resolution)
    total = mi.Float(0.0)
    kind = mi.Array4f16 if half else mi.Vector4f
    for slot, weight in zip(footprint.slots, footprint.weights, strict=True):
        row = mi.Vector4f(dr.gather(kind, atlas, block + slot, active))
        # a . away is 1 on the plane and more beyond it: all in units of the distance, so that no root is taken.
        beyond = dr.fmax(dr.fma(row.x, away.x, dr.fma(row.y, away.y, row.z * away.z)) - 1.0, 0.0)
        variance = dr.square((row.w + LEAST_DEVIATION) * (beyond + 1.0))
        total += weight * bound_by_chebyshev(variance, beyond)
    return total
