"""Unit normals in one word: three signed 10-bit numbers, which unpack without a square root."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

STEPS = 511.0


def pack_normal(n: mi.Normal3f, flag: mi.Bool | None = None) -> mi.Float:
    """Return the unit normal `n` as the bits of a float; it comes back within 2e-3 per component.

    A `flag` goes along in the float's sign: `unpack_flag`.
    """
    x, y, z = (mi.UInt32(dr.round(dr.clip(c, -1.0, 1.0) * STEPS + STEPS)) for c in (n.x, n.y, n.z))
    # The upper bits stay below the exponent of NaN, so that the word survives every copy as a float.
    word = x | (y << 10) | (z << 20)
    return dr.reinterpret_array(mi.Float, word if flag is None else word | (dr.select(flag, mi.UInt32(1), 0) << 31))


def unpack_normal(word: mi.Float) -> mi.Vector3f:
    """Return the vector that `pack_normal` stored; its length is one within 2e-3."""
    bits = dr.reinterpret_array(mi.UInt32, word)
    scale = 1.0 / STEPS
    return mi.Vector3f(
        dr.fma(mi.Float(bits & 1023), scale, -1.0),
        dr.fma(mi.Float((bits >> 10) & 1023), scale, -1.0),
        dr.fma(mi.Float((bits >> 20) & 1023), scale, -1.0),
    )


def unpack_flag(word: mi.Float) -> mi.UInt32:
    """Return the flag that `pack_normal` stored, 0 or 1."""
    return dr.reinterpret_array(mi.UInt32, word) >> 31
