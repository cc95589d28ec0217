"""NumPy arrays as Dr.Jit arrays of its own memory."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np


def to_floats(array: np.ndarray) -> mi.Float:
    """Return `array`, flattened, as floats that Dr.Jit owns.

    `mi.Float(array)` maps NumPy's memory on the CPU, and a frozen function records anew whenever the alignment of
    such memory changes; arrays that are replaced from frame to frame are therefore copied.
    """
    mapped = mi.Float(np.ascontiguousarray(array, np.float32).ravel())
    return copy_floats(mapped)


def copy_floats(array: mi.Float) -> mi.Float:
    """Return a copy of `array` in memory of its own."""
    return copy_array(array)


def copy_array(array: Any) -> Any:
    """Return a copy of a Dr.Jit array of any kind in memory of its own."""
    copy = dr.empty(type(array), dr.width(array))
    dr.scatter(copy, array, dr.arange(mi.UInt32, dr.width(array)))
    dr.eval(copy)
    return copy


def to_words(values: np.ndarray) -> mi.UInt32:
    """Return whole numbers from 0 to 2^32 - 1 as one array of words."""
    return mi.UInt32(np.ascontiguousarray(values).astype(np.uint32))
