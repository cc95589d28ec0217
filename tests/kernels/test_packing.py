"""Normals in one word."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from luxel.kernels.packing import pack_normal, unpack_normal


def test_normals_survive_packing() -> None:
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(10000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.concatenate([normals, np.eye(3), -np.eye(3)]).astype(np.float32)
    n = mi.Normal3f(*(mi.Float(np.ascontiguousarray(normals[:, i])) for i in range(3)))
    word = pack_normal(n)
    assert np.isfinite(np.array(word)).all()
    np.testing.assert_allclose(np.array(unpack_normal(word)).T, normals, atol=2e-3)
