"""NumPy arrays as Dr.Jit arrays.

Dr.Jit maps NumPy's memory on the CPU instead of copying it, and its kernels read whole SIMD packets: the last one goes
up to 60 bytes past the array's end. Where a page ends there, the process dies. So no array is given to Dr.Jit but in
memory that is longer than itself, which is what the functions here see to.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

PACKET_BYTES = 128
"""Bytes of the widest SIMD packet: 16 lanes of 8 bytes."""


def from_numpy(kind: Any, array: np.ndarray) -> Any:
    """Return `array` as a `kind`: `mi.Float` and its like take it flattened, `mi.Point3f` and its like as (3, N).

    It is the inverse of `np.array` of such a `kind`; tensors keep the array's shape.
    """
    array = np.asarray(array)
    if dr.is_tensor_v(kind):
        return kind(from_numpy(dr.array_t(kind), array), array.shape)
    if dr.depth_v(kind) > 1:
        return kind(*(from_numpy(dr.value_t(kind), part) for part in array))
    dtype = _DTYPES[dr.type_v(kind)]
    room = np.zeros(array.size + PACKET_BYTES // dtype().itemsize, dtype)
    room[: array.size] = array.ravel()
    return kind(room[: array.size])


def vectors_from_numpy(kind: Any, rows: np.ndarray) -> Any:
    """Return `rows` (N, k) as N vectors, points, normals or colours of `kind`, such as `mi.Point3f`."""
    return from_numpy(kind, np.asarray(rows).T)


_DTYPES = {
    dr.VarType.Bool: np.bool_,
    dr.VarType.Int32: np.int32,
    dr.VarType.UInt32: np.uint32,
    dr.VarType.UInt64: np.uint64,
    dr.VarType.Float16: np.float16,
    dr.VarType.Float32: np.float32,
    dr.VarType.Float64: np.float64,
}


def to_floats(array: np.ndarray) -> mi.Float:
    """Return `array`, flattened, as floats that Dr.Jit owns.

    A frozen function records anew whenever the alignment of mapped memory changes; arrays that are replaced from frame
    to frame are therefore copied.
    """
    return copy_array(from_numpy(mi.Float, array))


def copy_array(array: Any) -> Any:
    """Return a copy of a Dr.Jit array of any kind in memory of its own."""
    copy = dr.empty(type(array), dr.width(array))
    dr.scatter(copy, array, dr.arange(mi.UInt32, dr.width(array)))
    dr.eval(copy)
    return copy


def matrix_rows(matrices: np.ndarray) -> tuple[mi.Float, mi.Float]:
    """Return the upper three rows of `matrices` (N, 4, 4) and those of their inverses, (N, 12) each."""
    return to_floats(matrices[:, :3, :]), to_floats(np.linalg.inv(matrices)[:, :3, :])
