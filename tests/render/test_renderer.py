"""The frame as its users see it: sizes, averages, layers, dials, figures."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

from luxel.errors import LuxelError
from luxel.kernels.camera import camera_axes
from luxel.render.flight import fly_through
from luxel.render.floor import count_rays, measure_floor
from luxel.render.renderer import Renderer
from luxel.render.truth import render_truth
from luxel.scene import load
from luxel.scene.library.shapes import quad
from luxel.scene.model import Camera, Material, Object, SceneData, Sky

SMALL = {"surfel_target": 3000}


def make(method: str = "none", scene: str | SceneData = "cornell-box", **options: object) -> Renderer:
    settings: dict[str, Any] = {"size": (48, 48), "params": SMALL if method == "gibs" else None, **options}
    return Renderer(load(scene) if isinstance(scene, str) else scene, method, **settings)


@pytest.mark.parametrize("size", [(1, 1), (17, 5), (33, 70), (64, 1)])
@pytest.mark.parametrize("method", ["path", "gibs"])
def test_odd_sizes(method: str, size: tuple[int, int]) -> None:
    renderer = make(method, size=size)
    renderer.run(3)
    image = renderer.image()
    assert image.shape == (size[1], size[0], 3) and image.dtype == np.float32
    assert np.isfinite(image).all()
    if size == (33, 70):
        assert image.mean() > 0.02


def test_a_view_does_not_depend_on_its_padding() -> None:
    """A 17 x 17 image sees what the middle of the same field of view in 51 x 51 sees."""
    large, small = make(size=(51, 51)), make(size=(17, 17))
    for renderer in (large, small):
        renderer.step()
    every_third = large.layers().albedo[1::3, 1::3]
    different = np.abs(small.layers().albedo - every_third).max(axis=2) > 1e-6
    assert different.mean() < 0.03, "rays that graze an edge may fall to either side"


@pytest.mark.parametrize("size", [(0, 10), (10, -1), (100000, 10)])
def test_bad_sizes_are_refused(size: tuple[int, int]) -> None:
    with pytest.raises(LuxelError, match="cannot be rendered"):
        make(size=size)


@pytest.mark.parametrize("size", [128, (128,), (1, 2, 3), (64.5, 64), "64x64", (True, 4), None])
def test_what_is_no_pair_is_no_size(size: Any) -> None:
    with pytest.raises(LuxelError, match=r"give two whole numbers \(width, height\)"):
        make(size=size)


def test_sizes_of_numpy_are_sizes() -> None:
    renderer = make(size=(np.int64(16), np.uint8(8)))
    renderer.step()
    assert renderer.image().shape == (8, 16, 3)


def test_a_camera_of_the_scene_that_looks_nowhere_is_refused() -> None:
    floor = Object("floor", [quad((-1, 0, -1), (-1, 0, 1), (1, 0, 1), (1, 0, -1), 0)])
    data = SceneData("nowhere", [floor], [Material()], cameras=[Camera((0, 1, 0), (0, 1, 0), name="eye")])
    for camera in (None, 0, "eye"):
        with pytest.raises(LuxelError, match="camera 'eye' looks nowhere"):
            Renderer(data, "none", size=(8, 8), camera=camera)
    with pytest.raises(LuxelError, match="camera 'eye' looks nowhere"):
        render_truth(data, size=(8, 8), spp=2, cache=False)


@pytest.mark.parametrize("spp", [0, -1, 2.5, "many", True])
def test_a_truth_of_no_paths_is_refused(spp: Any) -> None:
    with pytest.raises(LuxelError, match="no number of paths"):
        render_truth("cornell-box", size=(8, 8), spp=spp, cache=False)


def test_unknown_methods_are_refused_and_nothing_rendered_is_said() -> None:
    with pytest.raises(LuxelError, match="did you mean 'gibs'"):
        make("gibbs")
    with pytest.raises(LuxelError, match="nothing has been rendered"):
        make().image()


# ----------------------------------------------------------------------------------- the average of direct light


def noise_of(renderer: Renderer, reference: np.ndarray) -> float:
    layers = renderer.layers()
    return float(np.sqrt(np.mean((layers.direct - reference)[layers.hit] ** 2)))


@pytest.fixture(scope="module")
def converged() -> np.ndarray:
    renderer = make(seed=9)
    renderer.run(2000)
    return renderer.layers().direct


def test_a_still_view_averages_its_noise_away(converged: np.ndarray) -> None:
    renderer = make(seed=1)
    noise = {}
    for frames in (1, 16, 64):
        renderer.run(frames - renderer.frame_index)
        noise[frames] = noise_of(renderer, converged)
    # As independent samples do, or better: a still view goes through a low-discrepancy sequence.
    assert noise[1] / noise[16] >= 3.2
    assert noise[16] / noise[64] >= 1.6


def test_without_averaging_the_noise_stays(converged: np.ndarray) -> None:
    renderer = make(seed=1, average_direct=False)
    renderer.step()
    first = noise_of(renderer, converged)
    renderer.run(40)
    assert noise_of(renderer, converged) == pytest.approx(first, rel=0.15)


def test_a_moving_camera_begins_the_average_anew(converged: np.ndarray) -> None:
    renderer = make(seed=1)
    home = renderer.camera
    renderer.run(64)
    calm = noise_of(renderer, converged)
    aside = Camera((0.3, 0.0, 3.9), (0.0, 0.0, 0.0), fov=home.fov)
    renderer.step(camera=aside)
    moved = renderer.layers()
    assert np.abs(moved.albedo - 0.0).any()
    renderer.step(camera=home)
    fresh = noise_of(renderer, converged)
    single = make(seed=1)
    single.step()
    assert fresh == pytest.approx(noise_of(single, converged), rel=0.2) and fresh > 4.0 * calm
    # Two frames later the average goes on.
    renderer.run(15)
    assert noise_of(renderer, converged) < 0.5 * fresh


def test_a_change_of_light_begins_the_average_anew() -> None:
    renderer = make()
    renderer.run(50)
    renderer.set_light_scale(0.0)
    renderer.step()
    assert not renderer.layers().direct.any() and not renderer.image().any()
    renderer.set_light_scale(3.0)
    renderer.run(200)
    plain = make()
    plain.run(200)
    assert renderer.image().mean() == pytest.approx(3.0 * plain.image().mean(), rel=0.02)


def test_a_moving_scene_is_not_averaged() -> None:
    """At each time the picture is that of a renderer that never saw another one."""
    renderer = make(scene="moving")
    for frame in range(8):
        renderer.step(time=0.25 * frame)
    alone = make(scene="moving")
    alone.step(time=1.75)
    np.testing.assert_allclose(renderer.layers().albedo, alone.layers().albedo, atol=1e-5)
    np.testing.assert_allclose(renderer.layers().direct, alone.layers().direct, rtol=1e-3, atol=1e-4)
    # No time given: the scene stays where it is.
    renderer.run(2)
    np.testing.assert_allclose(renderer.layers().albedo, alone.layers().albedo, atol=1e-5)


# ----------------------------------------------------------------------------------- what comes out


@pytest.mark.parametrize("method", ["path", "gibs"])
def test_layers_compose_to_the_image(method: str) -> None:
    renderer = make(method)
    renderer.run(12)
    layers = renderer.layers()
    composed = layers.emission + layers.albedo / np.pi * (layers.direct + layers.indirect) + layers.glossy
    np.testing.assert_allclose(renderer.image(), composed, rtol=1e-5, atol=1e-6)
    assert layers.weight.shape == layers.hit.shape == (48, 48) and layers.hit.dtype == bool
    assert layers.emission.any() and layers.direct.any() and layers.indirect.any()
    assert not layers.albedo[~layers.hit].any() and not layers.direct[~layers.hit].any()
    assert not layers.indirect[~layers.hit].any() and not layers.weight[~layers.hit].any()


def test_the_background_is_the_sky() -> None:
    floor = Object("floor", [quad((-1, 0, 1), (1, 0, 1), (1, 0, -1), (-1, 0, -1), 0)])
    camera = Camera((0.0, 0.5, 3.0), (0.0, 0.5, 0.0))
    data = SceneData("floor", [floor], [Material()], cameras=[camera], sky=Sky((0.2, 0.4, 0.8)))
    renderer = make("path", data)
    renderer.run(64)
    layers = renderer.layers()
    assert 0.05 < layers.hit.mean() < 0.9
    np.testing.assert_allclose(
        renderer.image()[~layers.hit], np.tile((0.2, 0.4, 0.8), ((~layers.hit).sum(), 1)), rtol=1e-5
    )
    # Nothing but the sky lights the floor, so its irradiance is pi times the sky's radiance, all of it indirect.
    np.testing.assert_allclose(layers.indirect[layers.hit].mean(axis=0), np.pi * np.array((0.2, 0.4, 0.8)), rtol=1e-3)
    assert not layers.direct.any()


def test_images_are_plain_numpy() -> None:
    renderer = make()
    renderer.step()
    image = renderer.image()
    assert isinstance(image, np.ndarray) and image.flags.owndata and image.flags.writeable
    np.testing.assert_array_equal(np.from_dlpack(image), image)
    before = image.copy()
    renderer.run(3)
    np.testing.assert_array_equal(image, before)


def test_irradiance_at_free_points() -> None:
    """Near the wall of the integrating sphere, at its bottom and its side; 20,000 paths a point tell."""
    data = load("sphere")
    renderer = make("path", data)
    points = np.repeat([[0.0, -0.98, 0.0], [0.98, 0.0, 0.0]], 20000, axis=0)
    normals = np.repeat([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]], 20000, axis=0)
    found = renderer.irradiance_at(points, normals)
    assert found.shape == (40000, 3)
    np.testing.assert_allclose(found.reshape(2, 20000, 3).mean(axis=1), data.facts["indirect_irradiance"], rtol=0.03)


def test_irradiance_at_agrees_with_the_picture() -> None:
    """Points of the left wall, above the boxes, against the pixels that show them."""
    renderer = make("gibs", size=(64, 64))
    renderer.run(80)
    wall = np.array([[-1.0, y, z] for y in (0.2, 0.4, 0.6) for z in (-0.6, -0.2, 0.2, 0.6)])
    found = renderer.irradiance_at(wall, np.tile((1.0, 0.0, 0.0), (len(wall), 1)))
    eye, right, up, forward = camera_axes(renderer.camera)
    offset = wall - eye
    scale = 32.0 / (offset @ forward * np.tan(np.radians(renderer.camera.fov) / 2.0))
    column = np.floor(32.0 + offset @ right * scale).astype(int)
    row = np.floor(32.0 - offset @ up * scale).astype(int)
    shown = renderer.layers().indirect[row, column]
    assert found.min() > 0.03
    np.testing.assert_allclose(found, shown, rtol=0.2)
    assert found.mean() == pytest.approx(shown.mean(), rel=0.03)
    # Out of the surfels' reach there is no answer, and no NaN.
    assert not renderer.irradiance_at(np.array([[0.0, 0.0, 50.0]]), np.array([[0.0, 1.0, 0.0]])).any()


# ----------------------------------------------------------------------------------- running and timing


def test_run_tells_its_progress_and_times_every_frame() -> None:
    renderer, told = make(), []
    spent = renderer.run(5, progress=told.append)
    assert told == [1, 2, 3, 4, 5] and len(spent) == 5 and min(spent) > 0.0
    assert renderer.frame_index == 5
    times: list[float] = []

    def time_of(frame: int) -> float:
        times.append(0.1 * frame)
        return times[-1]

    make(scene="moving").run(4, time_of=time_of)
    assert times == pytest.approx([0.0, 0.1, 0.2, 0.3])


def test_stages_have_their_names_and_the_frame_goes_on() -> None:
    renderer = make("gibs")
    renderer.run(10)
    stages = renderer.staged(2)
    assert {"gbuffer", "direct", "compose"} <= set(stages)
    own = {name for name in stages if name.startswith("gibs/")}
    assert {"gibs/trace", "gibs/gather"} <= own
    assert own | {"gbuffer", "direct", "compose"} == set(stages)
    assert all(ms >= 0.0 for ms in stages.values()) and stages["gibs/trace"] > 0.0
    assert renderer.frame_index == 12
    before = renderer.image().mean()
    renderer.run(2)
    assert renderer.image().mean() == pytest.approx(before, rel=0.05)


def test_floor_and_rays() -> None:
    renderer = make("gibs")
    renderer.run(10)
    floor_ms, rays = measure_floor(renderer, 2), count_rays(renderer)
    assert floor_ms is not None and rays is not None
    assert 0.0 < floor_ms < 1000.0
    cast = int(np.array(renderer.state.cast).sum())
    assert rays["closest"] == 48 * 48 + cast and 0 < cast <= renderer.params.most_rays()
    assert count_rays(make("none")) == {"closest": 48 * 48, "shadow": 48 * 48}


@pytest.mark.parametrize("method", ["path", "gibs"])
def test_frozen_frames_equal_traced_ones(method: str) -> None:
    frozen, plain = (make(method, freeze=freeze, seed=4) for freeze in (True, False))
    for renderer in (frozen, plain):
        for frame in range(8):
            renderer.step(camera=renderer.scene.host.data.flight[1] if frame == 4 else None)
    first, second = frozen.image().astype(float), plain.image()
    assert np.abs(first - second).mean() < 2e-3 * second.mean()


def test_two_renderers_share_a_scene() -> None:
    first = make("path")
    second = Renderer(first.scene, "none", size=(16, 16))
    for _ in range(3):
        first.step()
        second.step()
    assert first.image().shape == (48, 48, 3) and second.image().shape == (16, 16, 3)
    dr.sync_thread()


def test_fly_ends_at_home() -> None:
    renderer = make("gibs")
    home = renderer.camera
    renderer.step()
    before = renderer.layers().albedo
    fly_through(renderer, 2)
    assert renderer.camera is home
    np.testing.assert_allclose(renderer.layers().albedo, before, atol=1e-6)


COLLECTS_WHILE_RECORDING = """
import gc
from luxel import runtime
runtime.start("cpu")
from luxel.methods import METHODS
from luxel.methods.trivial import NoIndirect
from luxel.render.renderer import Renderer
from luxel.scene import load

old = []

class Drops(NoIndirect):
    name = "drops"
    def update(self, scene, state, frame):
        old.clear()
        kept = [[] for _ in range(100000)]
        return state

METHODS["drops"] = Drops()
data = load("cornell-box")
Renderer(data, "drops", size=(16, 16)).run(2)
gc.collect()
gc.freeze()
gc.collect()
old.append(Renderer(data, "none", size=(16, 16)))
old[0].run(3)
old[0]._itself = old[0]
gc.set_threshold(100, 1, 1)
Renderer(data, "drops", size=(16, 16)).run(3)
print("survived")
"""


def test_an_old_scene_may_be_collected_at_any_moment() -> None:
    """Dr.Jit aborts the process where a scene is freed while a frame is recorded; the collector comes when it likes."""
    source = Path(__file__).resolve().parents[2] / "src"
    search = os.pathsep.join([str(source), os.environ.get("PYTHONPATH", "")])
    command = [sys.executable, "-c", COLLECTS_WHILE_RECORDING]
    environment = {**os.environ, "PYTHONPATH": search}
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
    assert ran.returncode == 0 and "survived" in ran.stdout, ran.stderr[-500:]
