"""Pictures of scenes of many lights: their noise, and that edits and motion record nothing anew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import luxel
from luxel.kernels.camera import make_pinhole
from luxel.kernels.film import Film
from luxel.kernels.gbuffer import trace_gbuffer
from luxel.scene.library.shapes import box, quad
from luxel.scene.model import Camera, Light, Material, Mesh, Object, SceneData

SIZE = (48, 27)
FLOOR = quad((-20, 0, -20), (-20, 0, 20), (20, 0, 20), (20, 0, -20), 0)
VIEW = Camera(eye=(0.0, 4.0, 12.0), target=(0.0, 0.0, 0.0), fov=60.0)


def street(count: int, reach: float = float("inf"), meshes: tuple[Mesh, ...] = ()) -> SceneData:
    """Return `count` lamps of unlike power at unlike heights over a floor, none in the way of another."""
    rng = np.random.default_rng(count)
    places = rng.uniform((-20.0, 0.7, -20.0), (20.0, 2.0, 20.0), (count, 3))
    powers = 10.0 ** rng.uniform(-1.0, 1.0, count)
    lights = [
        Light("point", (w, w, w), tuple(p), range=reach, name=f"lamp {i}")
        for i, (p, w) in enumerate(zip(places.tolist(), powers.tolist(), strict=True))
    ]
    return SceneData("street", [Object("floor", [FLOOR, *meshes])], [Material()], lights=lights, cameras=[VIEW])


def arithmetic(data: SceneData, p: np.ndarray) -> np.ndarray:
    """Return the irradiance (...) of the lamps of `data` on the floor at `p` (..., 3)."""
    total = np.zeros(p.shape[:-1])
    for light in data.lights:
        offset = np.asarray(light.position) - p
        squared = (offset**2).sum(axis=-1)
        window = np.clip(1.0 - (squared / light.range**2) ** 2, 0.0, 1.0) ** 2
        total += light.color[0] * window * offset[..., 1] / squared**1.5
    return total


@pytest.mark.parametrize("reach", [float("inf"), 4.0])
@pytest.mark.parametrize("count", [100, 1024])
def test_many_lamps_have_little_noise(count: int, reach: float) -> None:
    """The root mean square error over the mean: at most 0.2 after 64 frames, and not from bias."""
    data = street(count, reach)
    renderer = luxel.Renderer(data, "none", size=SIZE)
    film, pinhole = Film(*SIZE), make_pinhole(VIEW, *SIZE, 0.0)
    surface = trace_gbuffer(renderer.scene, film, pinhole, pinhole).surface
    truth = arithmetic(data, film.to_image(surface.p).astype(np.float64))
    hit = film.to_image(surface.active)
    errors = []
    for frames in (1, 63):
        renderer.run(frames)
        error = (renderer.layers().direct[..., 0] - truth)[hit] / truth[hit].mean()
        errors.append(float(np.sqrt((error**2).mean())))
    assert errors[1] <= 0.1
    # A sequence does better than the square root of the frames.
    assert errors[1] < errors[0] / 8.0
    assert abs(error.mean()) < 0.01


def test_a_sun_that_a_roof_keeps_out_takes_no_rays_from_the_lamps() -> None:
    data = street(100)
    truth_of = data.lights
    roof = quad((-200, 40, -200), (200, 40, -200), (200, 40, 200), (-200, 40, 200), 0)
    sun = Light("directional", (100.0, 100.0, 100.0), direction=(0.0, -1.0, 0.0))
    data = replace(data, objects=[*data.objects, Object("roof", [roof])], lights=[*truth_of, sun])
    renderer = luxel.Renderer(data, "none", size=SIZE)
    film, pinhole = Film(*SIZE), make_pinhole(VIEW, *SIZE, 0.0)
    surface = trace_gbuffer(renderer.scene, film, pinhole, pinhole).surface
    truth = arithmetic(replace(data, lights=truth_of), film.to_image(surface.p).astype(np.float64))
    hit = film.to_image(surface.active)
    renderer.run(64)
    error = (renderer.layers().direct[..., 0] - truth)[hit] / truth[hit].mean()
    assert float(np.sqrt((error**2).mean())) <= 0.1
    assert abs(error.mean()) < 0.01


def test_ten_thousand_triangles_have_little_noise() -> None:
    """Cubes that glow hang over a floor; against the light of each as a small source, far enough from the floor."""
    rng = np.random.default_rng(3)
    centres, half = rng.uniform((-20.0, 2.0, -20.0), (20.0, 4.0, 20.0), (840, 3)), 0.01
    cubes = [box(tuple(c - half), tuple(c + half), 1) for c in centres]
    starts = np.cumsum([0, *(len(cube.positions) for cube in cubes)])[:-1]
    faces = np.concatenate([cube.faces + start for cube, start in zip(cubes, starts, strict=True)])
    mesh = Mesh(np.concatenate([cube.positions for cube in cubes]), faces.astype(np.uint32), 1)
    materials = [Material(), Material(emission=(1e4, 1e4, 1e4))]
    data = SceneData("cubes", [Object("all", [FLOOR, mesh])], materials, cameras=[VIEW], hide_emitters=True)
    renderer = luxel.Renderer(data, "none", size=SIZE)
    assert renderer.scene.lights.entry_count >= 10_000
    film, pinhole = Film(*SIZE), make_pinhole(VIEW, *SIZE, 0.0)
    surface = trace_gbuffer(renderer.scene, film, pinhole, pinhole).surface
    p, hit = film.to_image(surface.p).astype(np.float64), film.to_image(surface.active)
    truth = np.zeros(p.shape[:-1])
    for centre in centres:
        offset = centre - p
        squared = (offset**2).sum(axis=-1)
        # What a small cube shows: the sum over its faces of area times cosine.
        shown = 4.0 * half**2 * np.abs(offset).sum(axis=-1) / np.sqrt(squared)
        truth += 1e4 * shown * offset[..., 1] / squared**1.5
    renderer.run(64)
    error = (renderer.layers().direct[..., 0] - truth)[hit] / truth[hit].mean()
    assert np.sqrt((error**2).mean()) <= 0.1
    assert abs(error.mean()) < 0.01


def test_edits_and_motion_record_nothing_anew() -> None:
    def rise(time: float) -> np.ndarray:
        matrix = np.eye(4)
        matrix[1, 3] = time
        return matrix

    data = street(40)
    data.lights[3] = Light("point", (5.0, 5.0, 5.0), (0.0, 1.0, 0.0), motion=rise, name="lift")
    glow = Object("glow", [quad((0, 3, 0), (1, 3, 0), (1, 3, 1), (0, 3, 1), 1)], motion=rise)
    data.objects.append(glow)
    data.materials.append(Material("glow", emission=(1.0, 1.0, 1.0)))
    data.duration = 4.0
    renderer = luxel.Renderer(data, "gibs", size=SIZE)
    renderer.run(12)
    renderer.set_time(0.05)
    renderer.run(1)  # when an object first moves, a GPU records once more
    recordings = renderer.compilations
    for step in range(4):
        renderer.set_time(0.1 + 0.3 * step)
        renderer.run(1)
        renderer.set_light("lamp 7", color=(9.0, 1.0, 1.0), position=(0.0, 1.0 + step, 0.0))
        renderer.run(1)
    renderer.set_light("lamp 8", color=(0.0, 0.0, 0.0))
    renderer.run(2)
    assert np.isfinite(renderer.layers().direct).all()
    assert renderer.compilations == recordings
