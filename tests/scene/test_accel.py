"""Both ways to trace a scene (groups of their own, one structure for OptiX) answer alike, at any time."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.kernels.trace import trace_closest, trace_occluded
from luxel.scene import load
from luxel.scene.device import set_time, upload
from luxel.scene.library.shapes import quad, translation
from luxel.scene.model import Material, Object, SceneData, Texture

RAYS = 20000


def cut_out_and_deforming() -> SceneData:
    """A chequered cut-out, a still wall, a waving cloth with a transform of its own, and a moving quad."""
    chequer = np.zeros((8, 8, 4), np.uint8)
    chequer[::2, ::2, 3] = chequer[1::2, 1::2, 3] = 255
    leaf = Material("leaf", base_color_texture=Texture(chequer, nearest=True), alpha_mode="mask")
    side = ((-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0))
    cloth, fence, wall, door = (quad(*side, material) for material in (0, 1, 0, 0))

    def wave(time: float) -> list[tuple[np.ndarray, np.ndarray | None]]:
        return [((cloth.positions * (1.0 + time)).astype(np.float32), None)]

    return SceneData(
        "mixed",
        [
            Object("fence", [fence], translation(0.0, 0.0, 0.5)),
            Object("wall", [wall], translation(0.0, 0.0, -1.0)),
            Object("cloth", [cloth], translation(0.3, 0.1, -0.3), deform=wave),
            Object("door", [door], motion=lambda time: translation(time, 0.0, 1.0)),
        ],
        [Material(), leaf],
        duration=1.0,
    )


@pytest.mark.parametrize("name", ["mixed", "moving"])
def test_one_structure_answers_like_many(name: str) -> None:
    if dr.backend_v(mi.Float) == dr.JitBackend.CUDA:
        pytest.skip("OptiX traces one structure a kernel, so there is no other way to compare with")
    data = cut_out_and_deforming() if name == "mixed" else load(name)
    many, one = upload(data, one_accel=False), upload(data, one_accel=True)
    assert many.one is None and one.one is not None
    rng = np.random.default_rng(3)
    active = dr.full(mi.Bool, True, RAYS)
    for time in (0.0, 0.4, 1.0):
        set_time(many, time)
        set_time(one, time)
        start = rng.uniform(many.host.lower - 0.5, many.host.upper + 0.5, (RAYS, 3))
        towards = rng.normal(size=(RAYS, 3))
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        origin = mi.Point3f(*(mi.Float(start[:, i].astype(np.float32)) for i in range(3)))
        direction = mi.Vector3f(*(mi.Float(towards[:, i].astype(np.float32)) for i in range(3)))
        first, second = (trace_closest(scene, origin, direction, active) for scene in (many, one))
        hit = np.array(first.valid)
        assert hit.mean() > 0.02
        # A ray along an edge may go either way.
        agree = (hit == np.array(second.valid)) & (np.array(first.prim_id) == np.array(second.prim_id)) | ~hit
        assert agree.mean() > 0.999
        both = hit & np.array(second.valid)
        np.testing.assert_allclose(np.array(first.t)[both], np.array(second.t)[both], rtol=1e-3, atol=1e-4)
        blocked = [np.array(trace_occluded(scene, origin, direction, mi.Float(1.0), active)) for scene in (many, one)]
        assert (blocked[0] == blocked[1]).mean() > 0.999 and blocked[0].any()
