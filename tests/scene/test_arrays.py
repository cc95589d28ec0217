"""NumPy arrays on their way to Dr.Jit, judged by NumPy and by the system's memory protection."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.scene.arrays import copy_array, from_numpy, to_floats, vectors_from_numpy

SOURCE = Path(__file__).resolve().parents[2] / "src" / "luxel"


@pytest.mark.parametrize(
    ("kind", "dtype"),
    [("Float", "f4"), ("UInt32", "u4"), ("Int32", "i4"), ("UInt64", "u8"), ("Bool", "?"), ("Float16", "f2")],
)
def test_values_arrive(kind: str, dtype: str) -> None:
    values = np.arange(37).astype(dtype)
    found = from_numpy(getattr(mi, kind), values.reshape(37, 1))
    assert isinstance(found, getattr(mi, kind))
    np.testing.assert_array_equal(np.array(found), values)


def test_vectors_matrices_and_tensors_arrive() -> None:
    rows = np.random.default_rng(0).normal(size=(11, 3))
    np.testing.assert_array_equal(np.array(vectors_from_numpy(mi.Point3f, rows)), rows.T.astype(np.float32))
    matrices = np.random.default_rng(1).normal(size=(3, 3, 5)).astype(np.float32)
    np.testing.assert_array_equal(np.array(from_numpy(mi.Matrix3f, matrices)), matrices)
    image = np.random.default_rng(2).normal(size=(4, 5, 3)).astype(np.float32)
    np.testing.assert_array_equal(np.array(from_numpy(mi.TensorXf, image)), image)


def test_empty_arrays_stay_empty() -> None:
    assert dr.width(from_numpy(mi.Float, np.zeros(0))) == 0


def test_copies_are_their_own() -> None:
    values = np.arange(5.0, dtype=np.float32)
    copy, other = to_floats(values), copy_array(from_numpy(mi.UInt32, np.arange(5)))
    values[:] = 9.0
    np.testing.assert_array_equal(np.array(copy), np.arange(5.0))
    np.testing.assert_array_equal(np.array(other), np.arange(5))


GUARDED = """
import ctypes, mmap, sys
from luxel import runtime
runtime.start("cpu")
import mitsuba as mi, numpy as np
from luxel.scene.arrays import from_numpy
page = mmap.PAGESIZE
memory = mmap.mmap(-1, 2 * page)
whole = np.frombuffer(memory, np.uint8)
# Nothing behind the first page may be read.
assert ctypes.CDLL(None).mprotect(ctypes.c_void_p(whole.ctypes.data + page), page, 0) == 0
values = np.frombuffer(memory, np.float32, 10, page - 40)
array = mi.Float(values) if sys.argv[1] == "mapped" else from_numpy(mi.Float, values)
assert np.array(array + 1.0).sum() == 10.0
"""


@pytest.mark.skipif(os.name != "posix", reason="memory is protected by mprotect")
def test_no_kernel_reads_past_the_end_of_an_array() -> None:
    """NumPy's own memory ends where a page may end; a kernel that reads a whole packet there kills the process."""
    run = [sys.executable, "-c", GUARDED]
    assert subprocess.run([*run, "padded"], capture_output=True, timeout=300).returncode == 0
    # This one shows that the test can fail. Where it no longer does, Dr.Jit has mended it, and the padding can go.
    assert subprocess.run([*run, "mapped"], capture_output=True, timeout=300).returncode != 0


def test_no_array_is_mapped_any_other_way() -> None:
    """Each call `mi.Float(...)` and its like is free of NumPy: arrays go through `from_numpy`."""
    kinds = {"Float", "UInt32", "Int32", "UInt64", "Bool", "TensorXf", "Float64"}
    kinds |= {f"{name}{size}" for name in ("Point", "Vector", "Normal", "Color") for size in ("2f", "3f", "4f")}
    kinds = {f"mi.{kind}" for kind in kinds}
    found = []
    for path in sorted(SOURCE.glob("**/*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and ast.unparse(node.func) in kinds:
                text = ast.unparse(node)
                if any(word in text for word in ("np.", ".astype(", ".ravel(", ".T)")):
                    found.append(f"{path.relative_to(SOURCE)}:{node.lineno}: {text}")
    assert not found, found
