"""Truth and path tracer under sky images with bright places: light as summed by NumPy, shadows, and noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.skies import look_up

from luxel.methods import path_tracer
from luxel.render.renderer import Renderer
from luxel.render.truth import Truth, render_truth
from luxel.scene.library.shapes import quad
from luxel.scene.model import Camera, Material, Object, SceneData, Sky

SIZE = (32, 24)


def patch_sky(rows: int = 64, size: float = 10.0, elevation: float = 50.0, peak: float = 30.0) -> np.ndarray:
    """Return a dim blue sky with a bright disc of `size` degrees at `elevation`, towards -Z."""
    theta, phi = np.meshgrid((np.arange(rows) + 0.5) / rows, (np.arange(2 * rows) + 0.5) / rows - 1.0, indexing="ij")
    theta, phi = theta * np.pi, phi * np.pi
    d = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi)], axis=-1)
    towards = (0.0, np.sin(np.radians(elevation)), -np.cos(np.radians(elevation)))
    image = np.full((rows, 2 * rows, 3), (0.2, 0.3, 0.4), np.float32)
    image[d @ np.array(towards) > np.cos(np.radians(0.5 * size))] = peak
    return image


def glow_sky(rows: int = 64) -> np.ndarray:
    """Return a dim sky with a glow along the horizon."""
    height = np.cos((np.arange(rows) + 0.5) / rows * np.pi)
    return (0.2 + 4.0 * np.exp(-((height / 0.15) ** 2)))[:, None, None] * np.ones((1, 2 * rows, 3), np.float32)


def plain(
    image: np.ndarray | None, color: tuple[float, float, float] = (1.0, 1.0, 1.0), wall: float = 0.0
) -> SceneData:
    """A floor of 20 x 20 m seen from above, with a black wall across it, `wall` metres high."""
    meshes = [quad((-10, 0, 10), (10, 0, 10), (10, 0, -10), (-10, 0, -10), 0)]
    if wall:
        meshes += [quad((-10, 0, -1), (10, 0, -1), (10, wall, -1), (-10, wall, -1), 1)]
    camera = Camera((0.0, 3.0, 1.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0), fov=50.0)
    materials = [Material(base_color=(0.5, 0.5, 0.5)), Material(base_color=(0.0, 0.0, 0.0))]
    return SceneData("plain", [Object("all", meshes)], materials, cameras=[camera], sky=Sky(color, image))


def irradiance_above(image: np.ndarray, free: np.ndarray | None = None, rows: int = 1024) -> np.ndarray:
    """Return the irradiance of a facing-up plane that sees the sky of `image` where `free` (of `grid`) says so."""
    d, angle = grid(rows)
    weight = angle * np.maximum(d[:, 1], 0.0) * (1.0 if free is None else free)
    return (look_up(image, d) * weight[:, None]).sum(axis=0)


def grid(rows: int = 1024) -> tuple[np.ndarray, np.ndarray]:
    edges = np.linspace(0.0, 0.5 * np.pi, rows + 1)
    theta, phi = np.meshgrid(0.5 * (edges[1:] + edges[:-1]), (np.arange(2 * rows) + 0.5) * np.pi / rows - np.pi)
    angle = np.broadcast_to((np.cos(edges[:-1]) - np.cos(edges[1:])) * np.pi / rows, theta.shape)
    d = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi)], axis=-1)
    return d.reshape(-1, 3), angle.ravel()


def noise_of(truth: Truth) -> float:
    """Return the deviation of a pixel's light over its mean, from the truth's halves."""
    first, second = (half.mean(axis=2) for half in truth.halves)
    return float(np.sqrt(np.mean((first - second) ** 2)) / 2.0 / truth.layers.indirect.mean())


def truth_of(data: SceneData, spp: int = 256) -> Truth:
    return render_truth(data, size=SIZE, spp=spp, cache=False)


@pytest.mark.parametrize("sky", [patch_sky(), patch_sky(size=40.0, peak=8.0), glow_sky()], ids=["10", "40", "glow"])
def test_an_open_plain_gets_the_irradiance_of_its_sky(sky: np.ndarray) -> None:
    truth = truth_of(plain(sky))
    assert not truth.layers.direct.any(), "the sky stays indirect light"
    found = truth.layers.indirect.reshape(-1, 3)
    error = 5.0 * found.std(axis=0) / np.sqrt(len(found)) + 2e-3 * found.mean()
    assert (np.abs(found.mean(axis=0) - irradiance_above(sky)) < error).all()


def test_a_black_wall_keeps_the_bright_patch_away() -> None:
    """Beside a wall that hides half of the sky, the patch behind it included, there is only the other half's light."""
    sky = patch_sky()
    truth = truth_of(plain(sky, wall=30.0), spp=512)
    seen = truth.layers.indirect[-4:].mean(axis=(0, 1))
    d, _ = grid()
    # Of the lowest rows of the image: about 2.2 m before the wall, of which 30 m stand 9 m to each side.
    point = np.array((0.0, 0.0, 2.0))
    reach = np.where(d[:, 2] < 0.0, -(point[2] + 1.0) / np.minimum(d[:, 2], -1e-9), np.inf)
    hit = np.where(np.isfinite(reach), reach, 0.0)[:, None] * d
    free = ~((d[:, 2] < 0.0) & (np.abs(hit[:, 0]) < 10.0) & (hit[:, 1] < 30.0))
    expected = irradiance_above(sky, free)
    assert irradiance_above(sky).mean() > 2.0 * expected.mean(), "the wall hides the patch"
    np.testing.assert_allclose(seen, expected, rtol=0.04)


@pytest.mark.parametrize(("sky", "share"), [(patch_sky(), 0.2), (glow_sky(), 0.5)], ids=["patch", "glow"])
def test_bright_places_are_found(sky: np.ndarray, share: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """At equal paths the noise is a fifth of what cosine rays alone have, and the mean the same."""
    sought = truth_of(plain(sky, wall=1.5))
    monkeypatch.setattr(path_tracer, "is_sky_sampled", lambda scene: False)
    blind = truth_of(plain(sky, wall=1.5), spp=2048)
    assert noise_of(sought) < share * noise_of(blind) * np.sqrt(2048 / 256)
    assert sought.layers.indirect.mean() == pytest.approx(blind.layers.indirect.mean(), rel=0.02)


@pytest.mark.parametrize("image", [None, np.full((8, 16, 3), 0.6, np.float32), np.zeros((8, 16, 3), np.float32)])
def test_an_even_sky_casts_no_ray_of_its_own(image: np.ndarray | None, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise AssertionError("a sky without bright places was sampled")

    monkeypatch.setattr(path_tracer, "sample_sky", fail)
    truth = truth_of(plain(image, (0.5, 0.5, 0.5)), spp=16)
    value = 0.0 if image is not None and not image.any() else 0.5 * (1.0 if image is None else 0.6)
    np.testing.assert_allclose(truth.layers.indirect, np.pi * value, rtol=1e-4)


@pytest.mark.parametrize("method", ["path", "gibs", "ddgi"])
def test_live_edits_of_the_sky_are_followed_and_compile_nothing(method: str) -> None:
    settings = {"path": {}, "gibs": {"surfel_target": 300}, "ddgi": {"probe_target": 64, "extra_probes": 0}}[method]
    renderer = Renderer(plain(patch_sky()), method, settings, size=SIZE)
    renderer.run(8)
    compilations = renderer.compilations
    steps = [
        {"rotation": 120.0},
        {"color": (0.5, 1.0, 2.0)},
        {"image": glow_sky()},
        {"image": patch_sky(size=30.0), "rotation": 0.0, "color": (1.0, 1.0, 1.0)},
    ]
    for step in steps:
        renderer.set_sky(**step)
        renderer.run(8)
    assert renderer.compilations == compilations
    if method != "ddgi":
        renderer.run(256)
        expected = irradiance_above(patch_sky(size=30.0)).mean()
        assert renderer.layers().indirect.mean() == pytest.approx(expected, rel=0.02)


def test_a_dimmed_sky_is_dimmer() -> None:
    bright, dim = (truth_of(plain(patch_sky(), (c, c, c)), 64).layers.indirect.mean() for c in (1.0, 0.25))
    assert dim == pytest.approx(0.25 * bright, rel=1e-4)
    turned = plain(patch_sky())
    turned.sky = replace(turned.sky, rotation=77.0)
    assert truth_of(turned).layers.indirect.mean() == pytest.approx(bright, rel=0.02)
