"""From rays to texels: the furnace, any level of light, no bias, and depth that forgets what has gone."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.methods.ddgi.atlas import texel_direction
from luxel.methods.ddgi.blend import blend, blend_depth, blend_irradiance
from luxel.methods.ddgi.method import pack
from luxel.methods.ddgi.state import ASLEEP, DEAD, DdgiState
from luxel.methods.ddgi.trace import MISS
from luxel.methods.ddgi.weights import chebyshev_visibility
from luxel.render.renderer import Renderer
from luxel.scene import load
from luxel.scene.device import Scene, upload

SMALL = {"boxes": "0,0,0 size 2,2,2 probes 3,3,3", "extra_probes": 0}
MISSING = 1e30


@pytest.fixture(scope="module")
def moving() -> Scene:
    return upload(load("moving"))


def shown_light(state: DdgiState) -> np.ndarray:
    return np.array(state.irradiance.mean)[0].reshape(state.settings.total, -1)


def shown(state: DdgiState) -> np.ndarray:
    """Return what look-ups read, W/m^2: (probes, 10, 10)."""
    atlas = np.array(state.irradiance_atlas, dtype=np.float32).reshape(state.settings.total, 10, 10, 4)
    return atlas[..., 0] * np.array(state.scale)


def older(state: DdgiState) -> DdgiState:
    """Return the state one frame later: at age 0 a probe knows nothing."""
    return replace(state, probes=replace(state.probes, age=state.probes.age + 1))


def take(scene: Scene, state: DdgiState, results, frame) -> DdgiState:
    found = blend(scene, state, results, frame)
    state = replace(state, irradiance=found.irradiance, depth=found.depth, scale=found.scale, drift=found.drift)
    state = pack(older(replace(state, probes=replace(state.probes, noise=found.noise))))
    dr.eval(state.irradiance, state.depth, state.irradiance_atlas, state.depth_atlas, state.scale, state.probes)
    return state


@pytest.mark.parametrize("light_format", ["float16", "float32"])
@pytest.mark.parametrize("count", [8, 64, 256])
@pytest.mark.parametrize("level", [1e-3, 1.0, 1e4])
def test_one_frame_of_constant_radiance_is_pi_times_it(
    bare, build, rays, frame, light_format: str, count: int, level: float
) -> None:
    state = build(bare, **SMALL, num_samples_per_probe=count, irradiance_format=light_format)
    state = take(bare, state, rays(state, radiance=level), frame)
    np.testing.assert_allclose(shown_light(state), np.pi * level, rtol=1e-5)
    np.testing.assert_allclose(shown(state), np.pi * level, rtol=1e-3 if light_format == "float16" else 1e-5)


@pytest.mark.parametrize("adaptive", [True, False])
def test_a_furnace_stays_one(bare, build, rays, frame, adaptive: bool) -> None:
    state = build(bare, **SMALL, num_samples_per_probe=8, adaptive_hysteresis=adaptive)
    for index in range(30):
        state = take(bare, state, rays(state, radiance=2.0, frame=index), frame)
    np.testing.assert_allclose(shown_light(state), np.pi * 2.0, rtol=1e-4)


@pytest.mark.parametrize("count", [8, 64])
def test_a_gradient_is_found_without_bias(bare, build, rays, count: int) -> None:
    """Radiance 1 + z gives the irradiance pi (1 + 2/3 n.z)."""
    state = build(bare, **SMALL, num_samples_per_probe=count)
    for index in range(40):
        results = rays(state, radiance=lambda d: 1.0 + d[:, 2], frame=index)
        state = older(replace(state, irradiance=blend_irradiance(state, results)))
        dr.eval(state.irradiance)
    n = np.array(texel_direction(dr.arange(mi.UInt32, 64), 8)).T
    np.testing.assert_allclose(shown_light(state).mean(axis=0), np.pi * (1.0 + n[:, 2] * 2.0 / 3.0), rtol=0.02)


@pytest.mark.parametrize("count", [8, 64])
def test_a_small_bright_lamp_is_found_without_bias(bare, build, rays, count: int) -> None:
    """One of 100 rays meets the lamp; samples must not be clipped where they fall short of what is known."""
    state = build(
        bare,
        boxes="0,0,0 size 2,2,2 probes 16,16,16",
        extra_probes=0,
        num_samples_per_probe=count,
        irradiance_resolution=2,
        depth_resolution=2,
        adaptive_hysteresis=False,
        hysteresis=0.0,
    )
    # The texels know the truth already: radiance 100 from 0.02 * 2 pi sr about +Z.
    n = np.array(texel_direction(dr.arange(mi.UInt32, 4), 2)).T.astype(float)
    rng = np.random.default_rng(1)
    z, phi = rng.uniform(0.98, 1.0, 100000), rng.uniform(0.0, 2 * np.pi, 100000)
    lamp = np.stack([np.sqrt(1 - z * z) * np.cos(phi), np.sqrt(1 - z * z) * np.sin(phi), z])
    truth = np.array([np.maximum(row @ lamp, 0.0).mean() for row in n]) * 2 * np.pi * 0.02 * 100.0
    known = mi.Color3f(mi.Float(np.tile(truth, 16**3).astype(np.float32)))
    estimate = replace(state.irradiance, mean=known, short=known, count=dr.full(mi.Float, 100.0, dr.width(known)))
    state = older(replace(state, irradiance=estimate))
    found = []
    for index in range(max(2, 160 // count)):
        results = rays(state, radiance=lambda d: np.where(d[:, 2] > 0.98, 100.0, 0.0), frame=index)
        found.append(np.array(blend_irradiance(state, results).mean)[0].mean())
    assert np.mean(found) == pytest.approx(truth.mean(), rel=0.02)


def test_black_is_exactly_black(bare, build, rays, frame) -> None:
    state = build(bare, **SMALL)
    for index in range(5):
        state = take(bare, state, rays(state, radiance=0.0, frame=index), frame)
    assert not shown_light(state).any() and not shown(state).any()


def test_a_long_night_ends(bare, build, rays, frame) -> None:
    """After hundreds of black frames all is black, not NaN, and the next morning is as bright as the first."""
    state = build(bare, boxes="0,0,0 size 2,2,2 probes 2,2,2", extra_probes=0, num_samples_per_probe=8)
    day = [rays(state, radiance=lambda d: 1.0 + 0.5 * d[:, 2], frame=index) for index in range(4)]
    night = [rays(state, radiance=0.0, frame=index) for index in range(4)]
    for index in range(20):
        state = take(bare, state, day[index % 4], frame)
    noon = shown_light(state).mean()
    for index in range(900):
        state = take(bare, state, night[index % 4], frame)
    assert np.isfinite(shown_light(state)).all() and np.isfinite(np.array(state.scale)).all()
    assert shown_light(state).max() < 1e-3 * noon
    for index in range(60):
        state = take(bare, state, day[index % 4], frame)
    assert np.isfinite(shown(state)).all()
    assert shown(state).mean() == pytest.approx(noon, rel=0.1)


def test_a_flash_of_light_is_shown_by_half_floats(bare, build, rays, frame) -> None:
    state = build(bare, **SMALL)
    for index in range(10):
        state = take(bare, state, rays(state, radiance=1e-3, frame=index), frame)
    state = take(bare, state, rays(state, radiance=1e4, frame=11), frame)
    np.testing.assert_allclose(shown(state)[:, 1:-1, 1:-1].reshape(27, -1), shown_light(state), rtol=1e-3)


def test_the_unit_of_light_stays_where_nobody_is_awake(bare, build, rays, frame) -> None:
    state = take(bare, build(bare, **SMALL), rays(build(bare, **SMALL), radiance=2.0), frame)
    before = float(np.array(state.scale)[0])
    asleep = dr.full(mi.UInt32, ASLEEP, state.settings.total)
    state = replace(state, probes=replace(state.probes, status=asleep))
    state = take(bare, state, rays(state, radiance=0.0), frame)
    assert before > 0.0
    assert float(np.array(state.scale)[0]) == before, "all asleep is not dark: half floats would clip at waking"


@pytest.mark.parametrize("status", [DEAD, ASLEEP])
def test_only_awake_probes_learn(bare, build, rays, frame, status: int) -> None:
    state = build(bare, **SMALL)
    state = take(bare, state, rays(state, radiance=1.0), frame)
    index = dr.arange(mi.UInt32, state.settings.total)
    idle = dr.select(index == 5, mi.UInt32(status), state.probes.status)
    state = replace(state, probes=replace(state.probes, status=idle))
    before = shown_light(state)
    for number in range(10):
        state = take(bare, state, rays(state, radiance=9.0, frame=number), frame)
    after = shown_light(state)
    np.testing.assert_array_equal(after[5], before[5])
    assert (np.delete(after, 5, axis=0) > 2.0 * np.delete(before, 5, axis=0)).all()


@pytest.mark.parametrize("model", ["planes", "moments"])
@pytest.mark.parametrize("far_depth", ["reject", "clamp", "keep"])
def test_what_hid_a_point_and_went_away_is_forgotten(frame, moving, build, rays, model: str, far_depth: str) -> None:
    """A door that opens onto a far view: rejected rays must not keep the closed door in the depth for ever."""
    state = build(moving, **SMALL, depth_model=model, far_depth=far_depth, hysteresis=0.9)
    close = rays(state, distance=0.3)
    for _ in range(4):
        state = older(replace(state, depth=blend_depth(moving, state, close, frame)))
    for index in range(100):
        results = rays(state, distance=MISSING, frame=index)
        state = older(replace(state, depth=blend_depth(moving, state, results, frame)))
        dr.eval(state.depth)
    state = pack(state)
    q = state.probes.p
    sight = chebyshev_visibility(state, dr.arange(mi.UInt32, 27), q, q + mi.Vector3f(0.0, 0.9, 0.0), mi.Bool(True))
    assert np.array(sight).min() > 0.9


@pytest.mark.parametrize("model", ["planes", "moments"])
def test_depth_hides_what_is_behind_and_nothing_before(frame, bare, build, rays, model: str) -> None:
    state = build(bare, **SMALL, depth_model=model)
    for index in range(8):
        state = older(replace(state, depth=blend_depth(bare, state, rays(state, distance=0.8, frame=index), frame)))
    state = pack(state)
    q = state.probes.p

    def sight(distance: float) -> np.ndarray:
        away = mi.Vector3f(0.6 * distance, 0.0, 0.8 * distance)
        return np.array(chebyshev_visibility(state, dr.arange(mi.UInt32, 27), q, q + away, mi.Bool(True)))

    assert sight(0.75).min() > 0.9 and sight(0.95).max() < 0.05


def test_a_miss_is_beyond_every_reach() -> None:
    assert MISS == MISSING


def test_after_a_very_long_night_no_texel_is_lost() -> None:
    renderer = Renderer(
        "furnace", "ddgi", {"probe_target": 30, "num_samples_per_probe": 8, "depth_resolution": 2}, size=(8, 8)
    )
    renderer.run(16)
    noon = renderer.layers().indirect.mean()
    renderer.set_light_scale(0.0)
    renderer.run(2600)
    assert not renderer.layers().indirect.any()
    renderer.set_light_scale(1.0)
    renderer.run(64)
    assert np.isfinite(np.array(renderer.state.irradiance.variance)).all()
    assert renderer.layers().indirect.mean() == pytest.approx(noon, rel=0.1)
