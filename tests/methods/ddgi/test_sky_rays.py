"""Probes under a sky with a bright disc: their light against sums by NumPy, and what their sky rays must not touch."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.methods.base import Frame
from luxel.methods.ddgi.atlas import texel_direction
from luxel.methods.ddgi.blend import blend_irradiance
from luxel.methods.ddgi.params import MAJERCIK, ROHACEK
from luxel.methods.ddgi.relocate import gather_probe_hits
from luxel.methods.ddgi.state import ASLEEP
from luxel.methods.ddgi.trace import plan_rays, trace_probes
from luxel.methods.ddgi.workload import DdgiWorkload
from luxel.render.renderer import Renderer
from luxel.scene.device import Scene, upload
from luxel.scene.library.shapes import quad
from luxel.scene.model import Camera, Material, Object, SceneData, Sky

SMALL = {"boxes": "0,0,0 size 0.1,0.1,0.1 probes 6,6,6", "extra_probes": 0, "num_samples_per_probe": 32}
RESOLUTION = 8


def disc_sky(rows: int = 64) -> np.ndarray:
    """A dim sky with a bright disc of 12 degrees, half-way up towards +X."""
    theta, phi = np.meshgrid((np.arange(rows) + 0.5) / rows, (np.arange(2 * rows) + 0.5) / rows - 1.0, indexing="ij")
    d = directions_of(np.pi * theta, np.pi * phi)
    image = np.full((rows, 2 * rows, 3), 0.25, np.float32)
    image[d @ np.array((np.sqrt(0.5), np.sqrt(0.5), 0.0)) > np.cos(np.radians(6.0))] = 40.0
    return image


def directions_of(theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
    return np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi)], axis=-1)


def data_of(image: np.ndarray | None) -> SceneData:
    """A black floor of 8 x 8 m, 2 m under the probes."""
    floor = quad((-4, -2, 4), (4, -2, 4), (4, -2, -4), (-4, -2, -4), 0)
    black = Material(base_color=(0.0, 0.0, 0.0))
    sky = Sky((1.0, 1.0, 1.0), image)
    return SceneData("open", [Object("floor", [floor])], [black], cameras=[Camera()], sky=sky)


@pytest.fixture(scope="module")
def open_scene() -> Scene:
    return upload(data_of(disc_sky()))


def frame_of(index: int) -> Frame:
    return Frame(dr.opaque(mi.UInt32, index), dr.opaque(mi.UInt32, 1), dr.opaque(mi.Bool, True))


def expected_light(image: np.ndarray) -> np.ndarray:
    """Return the irradiance (texels,) of a probe at the origin: the image's pixels, without those behind the floor."""
    fine = np.kron(image[..., 0], np.ones((4, 4)))
    rows = len(fine)
    theta, phi = np.meshgrid((np.arange(rows) + 0.5) / rows, (np.arange(2 * rows) + 0.5) / rows - 1.0, indexing="ij")
    d = directions_of(np.pi * theta, np.pi * phi)
    angle = np.sin(np.pi * theta) * (np.pi / rows) ** 2
    hit = d * (-2.0 / np.minimum(d[..., 1], -1e-9))[..., None]
    free = ~((d[..., 1] < 0.0) & (np.abs(hit[..., 0]) < 4.0) & (np.abs(hit[..., 2]) < 4.0))
    n = np.array(texel_direction(dr.arange(mi.UInt32, RESOLUTION**2), RESOLUTION)).T
    return np.array([(fine * angle * free * np.maximum(d @ row, 0.0)).sum() for row in n])


def gathered(scene: Scene, state, frames: int) -> np.ndarray:
    """Return the light of the texels (frames, probes, texels), each frame's rays by themselves, all knowing 0.3."""
    found = []
    for index in range(frames):
        if state.settings.variance_budget:
            first, count = plan_rays(state)
            state = replace(state, rays=replace(state.rays, first=first, count=count))
        width = dr.width(state.irradiance.count)
        level = dr.full(mi.Color3f, 0.3, width)
        known = replace(state.irradiance, mean=level, short=level, count=dr.full(mi.Float, 9.0, width))
        aged = replace(state.probes, age=dr.full(mi.UInt32, 9, state.settings.total))
        state = replace(state, irradiance=known, probes=aged)
        light = blend_irradiance(state, trace_probes(scene, state, frame_of(index))).mean
        found.append(np.array(light)[0].reshape(-1, RESOLUTION**2))
    return np.array(found)


@pytest.mark.parametrize("budget", ["uniform", "variance"])
@pytest.mark.parametrize("sky_rays", [0, 1, 8])
def test_texels_get_the_light_of_the_sky(open_scene, build, sky_rays: int, budget: str) -> None:
    settings = {"sky_rays": sky_rays, "ray_budget": budget, "adaptive_hysteresis": False, "hysteresis": 0.0}
    state = build(open_scene, **SMALL, **settings, irradiance_resolution=RESOLUTION)
    light = gathered(open_scene, state, 12).reshape(-1, RESOLUTION**2)
    expected = expected_light(disc_sky())
    error = 4.5 * light.std(axis=0) / np.sqrt(len(light)) + 0.01 * expected.mean()
    assert (np.abs(light.mean(axis=0) - expected) < error).all()


def test_sky_rays_calm_the_light(open_scene, build) -> None:
    """Eight more rays to thirty-two take far more of the noise away than a fourth more of the others would."""
    spread = []
    for sky_rays in (0, 8):
        settings = {"sky_rays": sky_rays, "adaptive_hysteresis": False, "hysteresis": 0.0}
        state = build(open_scene, **SMALL, **settings, irradiance_resolution=RESOLUTION)
        spread.append(gathered(open_scene, state, 4).reshape(-1, RESOLUTION**2).std(axis=0).mean())
    assert spread[1] < 0.3 * spread[0]


def test_even_rays_alone_say_what_is_near(open_scene, build) -> None:
    """Depth, backs and hits are the same with sky rays and without; only what misses brings less."""
    without, beside = (build(open_scene, **SMALL, sky_rays=count) for count in (0, 8))
    a, b = (trace_probes(open_scene, state, frame_of(3)) for state in (without, beside))
    np.testing.assert_array_equal(np.array(a.direction_depth), np.array(b.direction_depth))
    assert a.sky is None and b.sky is not None
    for one, other in zip(
        vars(gather_probe_hits(without, a)).values(), vars(gather_probe_hits(beside, b)).values(), strict=True
    ):
        np.testing.assert_array_equal(np.array(one), np.array(other))
    light_a, light_b = (np.array(results.radiance).reshape(-1, 4)[:, :3] for results in (a, b))
    assert (light_b <= light_a + 1e-6).all() and light_b.sum() < 0.7 * light_a.sum()


@pytest.mark.parametrize("image", [None, np.full((4, 8, 3), 0.5, np.float32)], ids=["no image", "one value"])
def test_even_skies_get_none(build, image: np.ndarray | None) -> None:
    scene = upload(data_of(image))
    assert trace_probes(scene, build(scene, **SMALL, sky_rays=8), frame_of(0)).sky is None


def test_who_sleeps_casts_none(open_scene, build) -> None:
    state = build(open_scene, **SMALL)
    asleep = replace(state.probes, status=dr.full(mi.UInt32, ASLEEP, state.settings.total))
    results = trace_probes(open_scene, replace(state, probes=asleep), frame_of(0))
    assert results.sky is not None and not np.array(results.sky.light).any()


def test_rays_are_counted_where_they_are_cast() -> None:
    counts = []
    for image in (disc_sky(), None):
        renderer = Renderer(data_of(image), "ddgi", {**SMALL, "sky_rays": 5, "sleep_after": 0}, size=(16, 16))
        renderer.run(2)
        counts.append(DdgiWorkload().ray_counts(renderer.state))
    assert counts[0]["sky"] * 32 == counts[0]["closest"] * 5
    assert "sky" not in counts[1]


def test_presets_of_papers_cast_none() -> None:
    assert ROHACEK["sky_rays"] == MAJERCIK["sky_rays"] == 0
