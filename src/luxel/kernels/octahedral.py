"""The octahedral map: unit directions to the square, and to one 32-bit word (Cigolle et al. 2014)."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


def direction_to_square(d: mi.Vector3f) -> mi.Point2f:
    """Return the point of [-1, 1]^2 that stands for the unit direction `d`."""
    d = d / (dr.abs(d.x) + dr.abs(d.y) + dr.abs(d.z))
    folded = mi.Point2f(
        (1.0 - dr.abs(d.y)) * dr.mulsign(mi.Float(1.0), d.x), (1.0 - dr.abs(d.x)) * dr.mulsign(mi.Float(1.0), d.y)
    )
    return dr.select(d.z >= 0.0, mi.Point2f(d.x, d.y), folded)


def square_to_direction(p: mi.Point2f) -> mi.Vector3f:
    """Return the unit direction that the point `p` of [-1, 1]^2 stands for."""
    z = 1.0 - dr.abs(p.x) - dr.abs(p.y)
    fold = dr.fmax(-z, 0.0)
    return dr.normalize(mi.Vector3f(p.x - dr.mulsign(fold, p.x), p.y - dr.mulsign(fold, p.y), z))


def pack_normal(n: mi.Normal3f) -> mi.Float:
    """Return the unit normal `n` in one word (two 16-bit numbers), as a float's bits; within 1e-4 rad."""
    p = direction_to_square(mi.Vector3f(n))
    x = mi.UInt32(dr.round(dr.clip(p.x * 0.5 + 0.5, 0.0, 1.0) * 65535.0))
    y = mi.UInt32(dr.round(dr.clip(p.y * 0.5 + 0.5, 0.0, 1.0) * 65535.0))
    return dr.reinterpret_array(mi.Float, x | (y << 16))


def unpack_normal(word: mi.Float) -> mi.Normal3f:
    """Return the normal that `pack_normal` stored."""
    bits = dr.reinterpret_array(mi.UInt32, word)
    x, y = mi.Float(bits & 0xFFFF), mi.Float(bits >> 16)
    return mi.Normal3f(square_to_direction(mi.Point2f(x, y) * (2.0 / 65535.0) - 1.0))
