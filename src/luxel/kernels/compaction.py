"""Stream compaction: lanes that have work, side by side.

A GPU runs 32 lanes in step, a CPU 8 or 16: where a few lanes all over an array have work, nearly all wait for them.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


def pack_lanes(active: mi.Bool) -> tuple[mi.UInt32, mi.UInt32]:
    """Return the numbers of the `active` (N,) lanes in order, and how many there are.

    The array keeps its width N, so that no kernel is compiled anew; what lies beyond the count is 0.
    """
    width = dr.width(active)
    one = dr.select(active, mi.UInt32(1), 0)
    packed = dr.zeros(mi.UInt32, width)
    dr.scatter(packed, dr.arange(mi.UInt32, width), dr.prefix_reduce(dr.ReduceOp.Add, one), active)
    return packed, dr.sum(one)
