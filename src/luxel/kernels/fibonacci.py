"""Directions spread evenly over the sphere, and random turns of them."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from luxel.kernels.sampling import hash_pair, to_unit

GOLDEN_STEP = 0.6180339887498949
"""Golden ratio minus one: the share of a full turn between two points."""


def fibonacci_direction(index: mi.UInt32, count: mi.UInt32) -> mi.Vector3f:
    """Return point `index` of `count` on the unit sphere (spherical Fibonacci lattice, Keinert et al. 2015)."""
    turns = mi.Float(index) * GOLDEN_STEP
    phi = dr.two_pi * (turns - dr.floor(turns))
    z = 1.0 - (2.0 * mi.Float(index) + 1.0) / mi.Float(count)
    r = dr.safe_sqrt(1.0 - z * z)
    s, c = dr.sincos(phi)
    return mi.Vector3f(r * c, r * s, z)


def random_rotation(a: mi.UInt32, b: mi.UInt32) -> mi.Vector4f:
    """Return a uniformly random unit quaternion (x, y, z, w) for a pair of counters (Shoemake 1992)."""
    word_a, word_b = hash_pair(a, b)
    word_c, _ = hash_pair(word_b + 0x68BC21EB, word_a)
    u, v, w = to_unit(word_a), to_unit(word_b), to_unit(word_c)
    s_v, c_v = dr.sincos(dr.two_pi * v)
    s_w, c_w = dr.sincos(dr.two_pi * w)
    low, high = dr.sqrt(1.0 - u), dr.sqrt(u)
    return mi.Vector4f(low * s_v, low * c_v, high * s_w, high * c_w)


def rotate(q: mi.Vector4f, v: mi.Vector3f) -> mi.Vector3f:
    """Turn `v` by the unit quaternion `q` (x, y, z, w)."""
    axis = mi.Vector3f(q.x, q.y, q.z)
    t = 2.0 * dr.cross(axis, v)
    return v + q.w * t + dr.cross(axis, t)
