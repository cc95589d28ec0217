"""Octahedral texels with a gutter: packed from the running means, read by bilinear look-up.

A probe's block is (resolution + 2)^2 texels side by side in memory; the gutter repeats what the octahedral map
continues with beyond each border (Roháček 2022, section 3.2.2), so that no look-up asks for another probe's texels.
"""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi

from luxel.kernels.octahedral import direction_to_square, square_to_direction

HALF_LIMIT = 65000.0


def texel_direction(texel: mi.UInt32, resolution: int) -> mi.Vector3f:
    """Return the direction of interior texel `texel` (0 .. resolution^2 - 1), through its middle."""
    x = mi.Float(texel % resolution) + 0.5
    y = mi.Float(texel // resolution) + 0.5
    return square_to_direction(mi.Point2f(x, y) * (2.0 / resolution) - 1.0)


def interior_of(slot: mi.UInt32, resolution: int) -> mi.UInt32:
    """Return which interior texel the slot (0 .. (resolution + 2)^2 - 1) of a block shows."""
    side = resolution + 2
    x, y = mi.Int32(slot % side), mi.Int32(slot // side)
    on_side, on_end = (x == 0) | (x == side - 1), (y == 0) | (y == side - 1)
    # Beyond a border the map goes on mirrored about the border's middle; beyond a corner, at the opposite corner.
    u = dr.select(on_end, side - 1 - x, x)
    v = dr.select(on_side, side - 1 - y, y)
    u = dr.clip(u, 1, resolution) - 1
    v = dr.clip(v, 1, resolution) - 1
    return mi.UInt32(u + resolution * v)


def block_size(resolution: int) -> int:
    """Return texels a probe, gutter included."""
    return (resolution + 2) ** 2


def lobe(cosine: mi.Float, sharpness: int) -> mi.Float:
    """Return max(cosine, 0)^sharpness by repeated squaring; what is under a thousandth does not count."""
    base, result = dr.fmax(cosine, 0.0), mi.Float(1.0)
    while sharpness > 0:
        if sharpness & 1:
            result = result * base
        base = base * base
        sharpness >>= 1
    return dr.select(result > 1e-3, result, 0.0)


def bound_by_chebyshev(variance: mi.Float, beyond: mi.Float) -> mi.Float:
    """Return how much can lie `beyond` (>= 0) the mean by Chebyshev's inequality, cubed (2019 paper)."""
    bound = (variance + 1e-20) * dr.rcp(dr.fma(beyond, beyond, variance + 1e-20))
    return bound * bound * bound


class Footprint:
    """The four texels of a bilinear look-up within a block, and their weights."""

    def __init__(self, direction: mi.Vector3f, resolution: int) -> None:
        """Find them for `direction`s of any length."""
        square = direction_to_square(direction)
        t = dr.fma(square, 0.5 * resolution, 0.5 * resolution + 0.5)
        i = mi.Point2u(t)
        f = t - mi.Point2f(i)
        side = resolution + 2
        base = i.x + side * i.y
        self.slots = (base, base + 1, base + side, base + side + 1)
        self.weights = ((1.0 - f.x) * (1.0 - f.y), f.x * (1.0 - f.y), (1.0 - f.x) * f.y, f.x * f.y)


def read_color(
    atlas: mi.Float | mi.Float16, half: bool, block: mi.UInt32, footprint: Footprint, active: mi.Bool
) -> mi.Color3f:
    """Return the interpolated colour from the blocks that start at texel `block`."""
    kind = mi.Array4f16 if half else mi.Vector4f
    total = mi.Color3f(0.0)
    for slot, weight in zip(footprint.slots, footprint.weights, strict=True):
        row = mi.Vector4f(dr.gather(kind, atlas, block + slot, active))
        total += mi.Color3f(row.x, row.y, row.z) * weight
    return total


def read_moments(
    atlas: mi.Float | mi.Float16, half: bool, block: mi.UInt32, footprint: Footprint, active: mi.Bool
) -> tuple[mi.Float, mi.Float]:
    """Return the interpolated mean distance and its variance.

    The texels hold deviations, which half floats keep where squares would cancel; how far the four means are apart is
    part of the variance (law of total variance), in single precision.
    """
    kind = mi.Array2f16 if half else mi.Vector2f
    mean, square = mi.Float(0.0), mi.Float(0.0)
    rows = [mi.Vector2f(dr.gather(kind, atlas, block + slot, active)) for slot in footprint.slots]
    reference = rows[0].x
    for row, weight in zip(rows, footprint.weights, strict=True):
        away = row.x - reference
        mean += weight * away
        square += weight * dr.fma(away, away, row.y * row.y)
    return reference + mean, dr.fmax(square - mean * mean, 0.0)


def write_rows(row: mi.Vector4f | mi.Vector2f, lane: mi.UInt32, half: bool) -> mi.Float | mi.Float16:
    """Return a new array with each lane's values side by side, as half floats (kept within their range) or whole."""
    values = dr.empty(mi.Float16 if half else mi.Float, len(row) * dr.width(lane))
    if half:
        kind = mi.Array4f16 if len(row) == 4 else mi.Array2f16
        row = kind(dr.clip(row, -HALF_LIMIT, HALF_LIMIT))
    dr.scatter(values, row, lane)
    return values


def pack_irradiance(
    mean: mi.Color3f, scale: mi.Float, resolution: int, count: int, half: bool
) -> mi.Float | mi.Float16:
    """Return the atlas of `count` probes from their texels' means."""
    block = block_size(resolution)
    lane = dr.arange(mi.UInt32, count * block)
    texel = (lane // block) * (resolution * resolution) + interior_of(lane % block, resolution)
    value = dr.maximum(dr.gather(mi.Color3f, mean, texel), 0.0) / scale
    row = mi.Vector4f(value.x, value.y, value.z, 1.0)
    return write_rows(row, lane, half)


def pack_depth(
    mean: mi.Float,
    variance: mi.Float,
    weight: mi.Float,
    reach_of: Callable[[mi.UInt32], mi.Float],
    resolution: int,
    count: int,
    half: bool,
) -> mi.Float | mi.Float16:
    """Return the depth atlas; texels that saw nothing within reach are open up to `reach_of` their probe."""
    block = block_size(resolution)
    lane = dr.arange(mi.UInt32, count * block)
    probe = lane // block
    texel = probe * (resolution * resolution) + interior_of(lane % block, resolution)
    seen = dr.gather(mi.Float, weight, texel) > 0.0
    distance = dr.select(seen, dr.gather(mi.Float, mean, texel), reach_of(probe))
    deviation = dr.select(seen, dr.sqrt(dr.gather(mi.Float, variance, texel)), 0.0)
    row = mi.Vector2f(distance, deviation)
    return write_rows(row, lane, half)
