"""The truth of full materials in closed form: furnaces, absorption, chains; what cannot be; where it is kept."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from luxel import Renderer
from luxel.errors import LuxelError
from luxel.kernels.surface import free_surface
from luxel.render import truth as truth_module
from luxel.render.truth import Truth, cache_key, render_truth
from luxel.scene.device import upload
from luxel.scene.library.shapes import box, quad, sphere
from luxel.scene.model import Camera, Light, Material, Mesh, Object, SceneData, Sky

GLASS: dict[str, Any] = {"base_color": (1.0, 1.0, 1.0), "specular": 1.0, "transmission": 1.0, "roughness": 0.0}
AHEAD = Camera(eye=(0.0, 0.0, 5.0), target=(0.0, 0.0, 0.0), fov=40.0)
LEAVES = (0.5, 0.8, 0.2)


def scene_of(*parts: tuple[Mesh, Material], sky: float = 1.0, lights: list[Light] | None = None) -> SceneData:
    """Return meshes, each of its own material, in an even sky."""
    objects, materials = [], []
    for index, (mesh, material) in enumerate(parts):
        mesh.material = index
        objects.append(Object(f"part {index}", [mesh]))
        materials.append(material)
    return SceneData("parts", objects, materials, lights=lights or [], sky=Sky((sky, sky, sky)))


def render(data: SceneData, camera: Camera = AHEAD, spp: int = 64, size: int = 16, materials: Any = "full") -> Truth:
    return render_truth(data, camera=camera, size=(size, size), spp=spp, cache=False, materials=materials)


def ball(radius: float = 1.0) -> Mesh:
    return sphere((0.0, 0.0, 0.0), radius, 0, rings=32, sectors=64)


@pytest.mark.parametrize(
    ("material", "least"),
    [
        (Material(**GLASS, interface="plastic"), 0.998),
        (Material(**GLASS, thin=True), 0.998),
        (Material(base_color=(1, 1, 1), metallic=1.0, roughness=0.0), 0.998),
        (Material(base_color=(1, 1, 1), metallic=1.0, roughness=0.7, compensate=True), 0.98),
        (Material(base_color=(1, 1, 1), specular=1.0, roughness=0.5, compensate=True), 0.97),
        (Material(**{**GLASS, "roughness": 0.5}, interface="plastic"), 0.9),
    ],
    ids=["glass", "pane", "mirror", "rough metal", "coated white", "rough glass"],
)
def test_in_an_even_sky_what_loses_nothing_cannot_be_seen(material: Material, least: float) -> None:
    image = render(scene_of((ball(), material)), spp=256).layers.image()
    assert least <= float(image.mean()) <= 1.002
    assert float(image[6:10, 6:10].mean()) <= 1.02


def slab(material: Material, back: float = -0.5) -> tuple[Mesh, Material]:
    return box((-3.0, -3.0, back), (3.0, 3.0, back + 1.0), 0), material


def test_glass_absorbs_by_the_way_inside_it() -> None:
    """Of an index of 1, so that nothing bends and nothing is reflected: one metre of it straight ahead, by Beer."""
    clear = {**GLASS, "ior": 1.0, "interface": "plastic"}
    dark = Material(**clear, attenuation_color=LEAVES, attenuation_distance=2.0)
    image = render(scene_of(slab(dark)), camera=Camera((0, 0, 5), (0, 0, 0), fov=1.0)).layers.image()
    np.testing.assert_allclose(image[8, 8], np.sqrt(LEAVES), rtol=2e-3)
    inside = render(scene_of(slab(dark)), camera=Camera((0, 0, 0.25), (0, 0, -1), fov=1.0)).layers.image()
    np.testing.assert_allclose(inside[8, 8], np.array(LEAVES) ** 0.375, rtol=2e-3)


def test_what_lies_in_glass_is_seen_and_lit_through_it() -> None:
    """A white ball in absorbing glass of index 1, in an even sky: light comes in and goes out through the same metres.

    Straight on: out along one way, in along all ways, of which none is shorter.
    """
    clear = {**GLASS, "ior": 1.0, "interface": "plastic"}
    dark = Material(**clear, attenuation_color=LEAVES, attenuation_distance=1.0)
    white = Material(base_color=(1.0, 1.0, 1.0))
    straight = Camera((0, 0, 5), (0, 0, 0), fov=2.0)
    found = render(scene_of((ball(1.0), dark), (ball(0.4), white)), straight, spp=1024).layers.image()[8, 8]
    # At the ball's front point, in direction mu from the normal: sqrt(1 - 0.16 (1 - mu^2)) - 0.4 mu metres to go.
    mu = (np.arange(4000) + 0.5) / 4000
    ways = np.sqrt(1.0 - 0.16 * (1.0 - mu**2)) - 0.4 * mu
    arrives = np.array([np.mean(2.0 * mu * leave**ways) for leave in LEAVES])
    np.testing.assert_allclose(found, np.array(LEAVES) ** 0.6 * arrives, rtol=0.03)


def test_a_mirror_shows_its_colour_as_throughput_and_what_it_reflects_behind_it() -> None:
    """Seen straight on, a metal mirror before a grey wall behind the camera: all layers are the wall's times its."""
    tint, grey = (0.9, 0.6, 0.3), 0.5
    mirror = quad((-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0), 0)
    wall = quad((9, -9, 6), (-9, -9, 6), (-9, 9, 6), (9, 9, 6), 0)
    parts = (
        (mirror, Material(base_color=tint, metallic=1.0, roughness=0.0)),
        (wall, Material(base_color=(grey, grey, grey))),
    )
    lamp = Light("directional", (2.0, 2.0, 2.0), direction=(0.0, 0.0, 1.0))
    data = scene_of(*parts, sky=0.0, lights=[lamp])
    layers = render(data, Camera((0, 0, 5), (0, 0, 0), fov=2.0)).layers
    assert layers.throughput is not None
    np.testing.assert_allclose(layers.throughput[8, 8], tint, rtol=2e-3)
    np.testing.assert_allclose(layers.albedo[8, 8], np.multiply(tint, grey), rtol=2e-3)
    # The lamp shines along +z: from behind the mirror it meets the wall, but for the mirror's shadow on the axis.
    assert np.allclose(layers.direct[8, 8], 0.0)
    np.testing.assert_allclose(layers.glossy[8, 8], 0.0, atol=1e-6)


def test_a_lamp_behind_glass_is_seen_whole_and_lights_as_indirect_light() -> None:
    lamp = quad((-1, 3, 1), (-1, 3, -1), (1, 3, -1), (1, 3, 1), 0)
    floor = quad((-9, -1, 9), (9, -1, 9), (9, -1, -9), (-9, -1, -9), 0)
    cover = box((-2.0, 2.0, -2.0), (2.0, 3.5, 2.0), 0)
    glow = Material(base_color=(0, 0, 0), emission=(5.0, 5.0, 5.0), emit_back=True)
    glass = Material(**GLASS, ior=1.0, interface="plastic")
    data = scene_of((lamp, glow), (floor, Material(base_color=(0.5, 0.5, 0.5))), (cover, glass), sky=0.0)
    down = Camera((0.0, 1.0, 0.0), (0.0, -1.0, 0.0), up=(0, 0, 1), fov=2.0)
    layers = render(data, down, spp=4096, size=4).layers
    # E under the middle of a square of side 2 at 4 m, by four corners' form factors.
    x = 1.0 / 4.0
    corner = x / math.sqrt(1 + x * x) * math.atan(x / math.sqrt(1 + x * x)) / math.pi
    right = math.pi * 5.0 * 4.0 * corner
    assert float(layers.direct.max()) == 0.0
    assert float(layers.indirect.mean()) == pytest.approx(right, rel=0.05)
    up = Camera((0.0, 1.0, 0.0), (0.0, 3.0, 0.0), up=(0, 0, 1), fov=2.0)
    np.testing.assert_allclose(render(data, up, size=4).layers.image(), 5.0, rtol=1e-3)


def test_irradiance_at_a_free_point_comes_through_glass_and_off_mirrors() -> None:
    """Of a square lamp above, behind glass, and of a sky that a mirror shows: what `bake` and `query` ask for."""
    lamp = quad((-1, 3, 1), (-1, 3, -1), (1, 3, -1), (1, 3, 1), 0)
    cover = box((-2.0, 2.0, -2.0), (2.0, 3.5, 2.0), 0)
    glow = Material(base_color=(0, 0, 0), emission=(5.0, 5.0, 5.0), emit_back=True)
    glass = Material(**GLASS, ior=1.0, interface="plastic")
    point = free_surface(np.tile([[0.0, -1.0, 0.0]], (4096, 1)), np.tile([[0.0, 1.0, 0.0]], (4096, 1)))
    x = 1.0 / 4.0
    lamp_alone = math.pi * 5.0 * 4.0 * x / math.sqrt(1 + x * x) * math.atan(x / math.sqrt(1 + x * x)) / math.pi

    def indirect(*parts: tuple[Mesh, Material], sky: float) -> float:
        renderer = Renderer(scene_of(*parts, sky=sky), "path", {"samples": 16}, size=(8, 8), materials="full")
        return float(np.mean(renderer.method.query(renderer.scene, renderer.state, point).irradiance))

    assert indirect((lamp, glow), (cover, glass), sky=0.0) == pytest.approx(lamp_alone, rel=0.03)
    # A mirror over half of what it sees shows the other half of an even sky.
    mirror = quad((1, -9999, 9999), (1, -9999, -9999), (1, 9999, -9999), (1, 9999, 9999), 0)
    silver = Material(base_color=(0.8, 0.8, 0.8), metallic=1.0, roughness=0.0)
    # By Schlick's curve at each angle, over directions that follow the cosine with the floor.
    angle, radius = np.meshgrid(2 * np.pi * (np.arange(400) + 0.5) / 400, np.sqrt((np.arange(400) + 0.5) / 400))
    across = radius * np.cos(angle)
    right = np.where(across > 0.0, 0.8 + 0.2 * (1.0 - np.abs(across)) ** 5, 1.0).mean()
    assert indirect((mirror, silver), sky=1.0) / math.pi == pytest.approx(right, abs=0.003)


def test_nested_open_and_broken_glass_stays_finite() -> None:
    """A bubble in a ball in a slab that lacks a side, a sheet with one side only, and cameras in all of them."""
    dark = Material(**GLASS, attenuation_color=(0.0, 0.5, 1.0), attenuation_distance=0.1)
    rough = Material(
        **{**GLASS, "roughness": 0.4}, ior=2.4, attenuation_color=(0.1, 0.0, 0.3), attenuation_distance=0.2
    )
    black = Material(base_color=(0, 0, 0), metallic=1.0, roughness=0.0)
    open_sheet = quad((-2, -2, -1), (2, -2, -1), (2, 2, -1), (-2, 2, -1), 0)
    lid = quad((-9, -1, 9), (9, -1, 9), (9, -1, -9), (-9, -1, -9), 0)
    lamps = [Light("point", (9.0, 9.0, 9.0), (0.0, 0.2, 0.0)), Light("point", (9.0, 9.0, 9.0), (0.0, 4.0, 3.0))]
    parts = (ball(1.0), dark), (ball(0.5), rough), (ball(0.2), black), (open_sheet, rough), (lid, dark)
    data = scene_of(*parts, lights=lamps)
    for eye in ((0.0, 0.0, 5.0), (0.0, 0.0, 0.8), (0.0, 0.0, 0.4), (0.0, 0.0, 0.1), (0.0, -1.0, 3.0)):
        made = render(data, Camera(eye, (0.05, 0.0, -3.0), fov=90.0), spp=16)
        for layer in vars(made.layers).values():
            assert np.isfinite(layer).all()
        assert made.image_halves is not None and made.layers.image().min() >= 0.0


def test_the_key_has_the_materials_only_where_they_count() -> None:
    shiny = scene_of((ball(), Material(metallic=1.0, roughness=0.2)))
    camera = AHEAD
    full, plain = upload(shiny, materials="full"), upload(shiny)
    arguments = camera, (8, 8), 4, 0, 0.0
    assert cache_key(full, *arguments, "full") != cache_key(plain, *arguments)
    other = upload(scene_of((ball(), Material(metallic=1.0, roughness=0.3))), materials="full")
    assert cache_key(full, *arguments, "full") != cache_key(other, *arguments, "full")
    assert cache_key(plain, *arguments) == cache_key(upload(shiny), *arguments)


def test_it_is_kept_and_read_again_and_without_gloss_it_is_the_diffuse_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("LUXEL_CACHE", str(tmp_path))
    shiny = scene_of((ball(), Material(base_color=(0.7, 0.4, 0.2), specular=1.0, roughness=0.3)))
    words: dict[str, Any] = {"camera": AHEAD, "size": (8, 8), "spp": 8}
    made = render_truth(shiny, **words, materials="full")
    monkeypatch.setattr(truth_module, "_render", None)  # whatever is rendered now fails
    found = render_truth(shiny, **words, materials="full")
    assert made.layers.throughput is not None and made.image_halves is not None and found.image_halves is not None
    for name, layer in vars(made.layers).items():
        np.testing.assert_array_equal(getattr(found.layers, name), layer)
    np.testing.assert_array_equal(found.image_halves, made.image_halves)
    monkeypatch.undo()
    monkeypatch.setenv("LUXEL_CACHE", str(tmp_path))
    plain = scene_of((ball(), Material()))
    kept = render_truth(plain, **words)
    monkeypatch.setattr(truth_module, "_render", None)
    same = render_truth(plain, **words, materials="full")
    assert same.image_halves is None and same.layers.throughput is None
    np.testing.assert_array_equal(same.halves, kept.halves)


def test_words_that_cannot_be() -> None:
    data = scene_of((ball(), Material(metallic=1.0)))
    with pytest.raises(LuxelError, match="shiny"):
        render(data, materials="shiny")
    with pytest.raises(LuxelError, match="shiny"):
        Renderer(data, "path", materials="shiny")  # type: ignore[arg-type]
    with pytest.raises(LuxelError, match="uploaded with diffuse"):
        render_truth(upload(data), camera=AHEAD, size=(8, 8), spp=2, materials="full", cache=False)


def test_path_averages_a_still_view_and_starts_anew_after_a_turn() -> None:
    data = scene_of((ball(), Material(base_color=(0.9, 0.5, 0.2), specular=1.0, roughness=0.3)))
    renderer = Renderer(data, "path", size=(16, 16), camera=AHEAD, materials="full")
    noise = []
    for _ in range(64):
        renderer.step()
        noise.append(float(np.std(renderer.layers().image()[6:10, 6:10, 1])))
    assert noise[-1] < 0.4 * noise[0]
    renderer.step(camera=Camera(eye=(0.0, 0.3, 5.0), target=(0.0, 0.0, 0.0), fov=40.0))
    assert float(np.std(renderer.layers().image()[6:10, 6:10, 1])) > 2.0 * noise[-1]


@pytest.mark.parametrize(
    ("fields", "right"),
    [
        ({"metallic": 1.0, "base_color": (0.9, 0.6, 0.3)}, (0.9, 0.6, 0.3)),
        # ((n - 1)^2 + k^2) / ((n + 1)^2 + k^2), straight on.
        ({"metallic": 1.0, "eta": (1.0, 2.0, 0.5), "k": (2.0, 3.0, 4.0)}, (4 / 8, 10 / 18, 16.25 / 18.25)),
        # R = 0.04 on each face, to and fro between them: 1 / 13 comes back, the rest passes, tinted.
        ({"transmission": 1.0, "thin": True, "base_color": (0.5, 1.0, 0.25)}, (7 / 13, 1.0, 4 / 13)),
    ],
    ids=["metal", "metal by index", "tinted pane"],
)
def test_a_live_edit_shows_what_the_first_material_of_a_kind_does(
    fields: dict[str, Any], right: tuple[float, float, float]
) -> None:
    """A plate of a scene with gloss, but none of that kind, seen straight on in an even sky of 1."""
    plate = quad((-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0), 0)
    coated = Material(base_color=(0.5, 0.5, 0.5), specular=1.0, roughness=0.0)
    view = Camera((0, 0, 5), (0, 0, 0), fov=2.0)
    renderer = Renderer(scene_of((plate, coated)), "path", {"samples": 512}, size=(8, 8), camera=view, materials="full")
    renderer.step()
    renderer.set_material(0, **fields)
    renderer.step()
    np.testing.assert_allclose(renderer.layers().image().mean(axis=(0, 1)), right, atol=0.01)
