"""The probes' rays: whose they are, how the total is shared out, and what they bring."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.methods.base import Frame
from luxel.methods.ddgi.state import ASLEEP, AWAKE, DEAD, UNUSED, DdgiState
from luxel.methods.ddgi.trace import plan_rays, ray_owner, trace_probes
from luxel.render.renderer import Renderer
from luxel.scene import load
from luxel.scene.device import Scene, upload
from luxel.scene.model import SceneData

SMALL = {"boxes": "0,0,0 size 1.2,1.2,1.2 probes 5,4,3", "extra_probes": 4}


@pytest.fixture(scope="module")
def furnace() -> Scene:
    return upload(load("furnace"))


def planned(state: DdgiState, status: np.ndarray, noise: np.ndarray) -> tuple[DdgiState, np.ndarray, np.ndarray]:
    probes = replace(state.probes, status=mi.UInt32(status.astype(np.uint32)), noise=mi.Float(noise.astype(np.float32)))
    state = replace(state, probes=probes)
    first, count = plan_rays(state)
    return replace(state, rays=replace(state.rays, first=first, count=count)), np.array(first), np.array(count)


@pytest.mark.parametrize("rays_each", [4, 7, 64])
@pytest.mark.parametrize("seed", range(4))
def test_the_total_is_kept_and_every_lane_has_its_owner(bare, build, rays_each: int, seed: int) -> None:
    state = build(bare, **SMALL, ray_budget="variance", num_samples_per_probe=rays_each)
    rng = np.random.default_rng(seed)
    total = state.settings.total
    status = rng.choice([UNUSED, DEAD, ASLEEP, AWAKE], total, p=[0.1, 0.2, 0.3, 0.4])
    noise = 10.0 ** rng.uniform(-6, 6, total)
    noise[:3] = (0.0, 1e30, 5.0)
    state, first, count = planned(state, status, noise)
    assert count.sum() <= total * rays_each
    assert (first == np.cumsum(count) - count).all()
    assert (count[(status == UNUSED) | (status == ASLEEP)] == 0).all() and (count[status == AWAKE] >= 4).all()
    probe, number, its_count, owned = (np.array(v) for v in ray_owner(state, dr.arange(mi.UInt32, total * rays_each)))
    np.testing.assert_array_equal(probe[owned], np.repeat(np.arange(total), count))
    np.testing.assert_array_equal(number[owned], np.concatenate([np.arange(n) for n in count]))
    np.testing.assert_array_equal(its_count[owned], count[probe[owned]])
    assert owned.sum() == count.sum()


def test_more_noise_gets_more_rays(bare, build) -> None:
    state = build(bare, **SMALL, ray_budget="variance")
    total = state.settings.total
    _, _, count = planned(state, np.full(total, AWAKE), np.linspace(0.2, 3.0, total))
    assert (np.diff(count.astype(int)) >= 0).all() and count[-1] > 5 * count[0]
    assert count.sum() > 0.95 * total * 64, "the budget is used"


@pytest.mark.parametrize("status", [UNUSED, ASLEEP, DEAD])
def test_nobody_awake_is_no_trouble(bare, build, status: int) -> None:
    state = build(bare, **SMALL, ray_budget="variance")
    total = state.settings.total
    _, _, count = planned(state, np.full(total, status), np.full(total, np.float32(np.inf)))
    assert count.sum() <= total * 64


def test_uniform_rays_lie_side_by_side(bare, build) -> None:
    state = build(bare, **SMALL, num_samples_per_probe=7)
    probe, number, count, _ = ray_owner(state, dr.arange(mi.UInt32, 70))
    np.testing.assert_array_equal(np.array(probe), np.arange(70) // 7)
    np.testing.assert_array_equal(np.array(number), np.arange(70) % 7)
    assert int(np.array(count).ravel()[0]) == 7


def test_what_rays_bring_in_the_furnace(furnace, build) -> None:
    """First frame, no bounces yet: albedo / pi * direct = 0.5, and never the emission itself."""
    state = build(furnace, **SMALL)
    frame = Frame(dr.opaque(mi.UInt32, 0), dr.opaque(mi.UInt32, 1), dr.opaque(mi.Bool, True))
    results = trace_probes(furnace, state, frame)
    rays = state.settings.total * 64
    rows = np.array(results.direction_depth).reshape(-1, 4)[:rays]
    light = np.array(results.radiance).reshape(-1, 4)[:rays]
    used = np.array(results.hit)
    assert not used[rays:].any(), "nobody wished for a probe"
    used = used[:rays]
    assert used[: 60 * 64].all() and not used[60 * 64 :].any(), "those held back cast nothing"
    np.testing.assert_allclose(np.linalg.norm(rows[used, :3], axis=1), 1.0, atol=1e-5)
    assert light[used, :3].mean() == pytest.approx(0.5, rel=0.05)
    assert not light[~used].any() and (rows[~used, 3] == np.float32(1e30)).all()
    # Positive distances in the open: they end on the walls.
    p = np.repeat(np.array(state.probes.p).T, 64, axis=0)[used] + rows[used, :3] * rows[used, 3:]
    np.testing.assert_allclose(np.abs(p).max(axis=1), 1.0, atol=1e-4)


def test_frames_turn_their_rays(furnace, build) -> None:
    state = build(furnace, **SMALL)
    rows = []
    for index in range(2):
        frame = Frame(dr.opaque(mi.UInt32, index), dr.opaque(mi.UInt32, 1), dr.opaque(mi.Bool, True))
        rows.append(np.array(trace_probes(furnace, state, frame).direction_depth).reshape(-1, 64, 4)[..., :3])
    assert np.abs(rows[0] - rows[1]).max() > 0.5
    assert np.abs(rows[0][0] - rows[0][1]).max() > 0.5, "and probes differ"


def steady(data: SceneData, frames: int, **settings: object) -> np.ndarray:
    params = {"probe_target": 200, "num_samples_per_probe": 16, **settings}
    renderer = Renderer(data, "ddgi", params, size=(32, 32), seed=1)
    renderer.run(frames)
    layers = renderer.layers()
    return layers.indirect[layers.hit].mean(axis=0)


@pytest.mark.parametrize(("dial", "value"), [("ray_budget", "variance"), ("bounces", "path")])
def test_other_ways_to_spend_rays_bring_the_same_light(dial: str, value: str) -> None:
    plain = steady(load("cornell-box"), 60)
    other = steady(load("cornell-box"), 60, **{dial: value})
    np.testing.assert_allclose(other, plain, rtol=0.1)
