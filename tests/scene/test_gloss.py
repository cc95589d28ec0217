"""Coats, metals and glass of materials: what may be set, what the device has, what the diffuse condition sees."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

import luxel
from luxel.errors import LuxelError
from luxel.kernels.gloss import Gloss, gloss_at
from luxel.kernels.surface import surface_at
from luxel.kernels.triangle import fetch_triangle, interpolate
from luxel.scene import live
from luxel.scene.device import Scene, upload
from luxel.scene.diffuse import DEFAULTS, GLOSS, as_diffuse
from luxel.scene.digest import hash_scene
from luxel.scene.gloss import FLAG_BECKMANN, FLAG_COMPENSATE, FLAG_NONLINEAR, FLAG_PLASTIC, FLAG_THIN
from luxel.scene.model import Material, Mesh, Object, SceneData, Texture
from luxel.scene.records import clamping

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
UV = CORNERS[:, :2]
LEFT, RIGHT = (0.2, 0.3), (0.7, 0.2)
"""Weights of the second and third corner, and so the texture coordinates, of a point in each half of the images."""


def triangle(index: int, **more: Any) -> Mesh:
    return Mesh(CORNERS + np.float32(2 * index), np.array([[0, 1, 2]], np.uint32), index, uv=UV, **more)


def scene_of(*materials: Material, **more: Any) -> SceneData:
    meshes = [triangle(index, **more) for index in range(len(materials))]
    return SceneData("made", [Object("things", meshes)], list(materials))


def image(left: tuple[float, ...], right: tuple[float, ...], srgb: bool = False) -> Texture:
    """Return a texture of two texels, nearest, so that what is read at a point is one of them."""
    return Texture(np.array([[left, right]], np.float32), srgb=srgb, nearest=True)


def read(scene: Scene, prim: int, place: tuple[float, float]) -> dict[str, np.ndarray]:
    """Return the facts at a point of triangle `prim`, by name."""
    active, row = mi.Bool(True), mi.UInt32(prim)
    point = interpolate(scene, fetch_triangle(scene, row, active), mi.Point2f(*place), active)
    found = gloss_at(scene, point, active)
    return {item.name: np.array(getattr(found, item.name)).ravel() for item in fields(Gloss)}


def albedo(scene: Scene, prim: int, place: tuple[float, float]) -> np.ndarray:
    return np.array(surface_at(scene, mi.UInt32(prim), mi.Point2f(*place), mi.Bool(True)).albedo).ravel()


FULL = Material(
    base_color=(0.5, 0.25, 1.0),
    base_color_texture=image((0.25, 0.64, 0.49), (1.0, 0.0, 0.36)),
    metallic=0.5,
    roughness=0.8,
    metallic_roughness_texture=image((0.0, 0.2, 0.4), (0.0, 1.0, 0.6)),
    ior=1.33,
    specular=0.6,
    specular_texture=image((0.0, 0.0, 0.0, 0.4), (1.0, 1.0, 1.0, 0.8)),
    specular_color=(2.0, 1.0, 0.5),
    specular_color_texture=image((1.0, 0.25, 0.04), (0.16, 0.81, 1.0)),
    transmission=0.9,
    transmission_texture=image((0.2, 0.9, 0.9), (1.0, 0.0, 0.0)),
    attenuation_color=(0.5, 0.1, 1.0),
    attenuation_distance=0.25,
    clearcoat=0.7,
    clearcoat_texture=image((0.4, 1.0, 1.0), (0.6, 0.0, 0.0)),
    clearcoat_roughness=0.5,
    clearcoat_roughness_texture=image((1.0, 0.2, 1.0), (0.0, 0.4, 0.0)),
)


@pytest.mark.parametrize(("place", "texel"), [(LEFT, 0), (RIGHT, 1)])
def test_the_device_has_each_fact_by_factor_and_texture(place: tuple[float, float], texel: int) -> None:
    scene = upload(scene_of(Material(), FULL), materials="full")
    assert scene.features.gloss and scene.features.transmission
    found = read(scene, 1, place)
    base = np.array([(0.25, 0.64, 0.49), (1.0, 0.0, 0.36)][texel]) * (0.5, 0.25, 1.0)
    metallic, transmission = 0.5 * (0.4, 0.6)[texel], 0.9 * (0.2, 1.0)[texel]
    wanted = {
        "base_color": base,
        "metallic": metallic,
        "roughness": 0.8 * (0.2, 1.0)[texel],
        "ior": 1.33,
        "specular": 0.6 * (0.4, 0.8)[texel],
        "specular_color": np.array([(2.0, 0.25, 0.02), (0.32, 0.81, 0.5)][texel]),
        "transmission": transmission,
        "absorption": [-math.log(0.5) / 0.25, -math.log(0.1) / 0.25, 0.0],
        "clearcoat": 0.7 * (0.4, 0.6)[texel],
        "clearcoat_roughness": 0.5 * (0.2, 0.4)[texel],
    }
    for name, value in wanted.items():
        np.testing.assert_allclose(found[name], np.ravel(value), atol=0.004, rtol=1e-4, err_msg=name)
    assert not found["has_index"].any()
    scattered = base * (1.0 - metallic) * (1.0 - transmission)
    np.testing.assert_allclose(albedo(scene, 1, place), scattered, atol=0.004)
    np.testing.assert_allclose(albedo(scene, 0, place), 0.8, rtol=1e-6)


def test_vertex_colours_colour_metals_and_glass() -> None:
    colors = np.array([[0.5, 0.25, 1.0]] * 3, np.float32)
    scene = upload(scene_of(Material(base_color=(0.8, 0.8, 0.4), metallic=1.0), colors=colors), materials="full")
    np.testing.assert_allclose(read(scene, 0, LEFT)["base_color"], (0.4, 0.2, 0.4), rtol=1e-5)
    np.testing.assert_allclose(albedo(scene, 0, LEFT), 0.0)


def test_colours_of_vertices_above_one_end_there() -> None:
    colors = np.array([[5.0, 0.25, 1.0]] * 3, np.float32)
    scene = upload(scene_of(Material(base_color=(0.8, 0.8, 0.4), specular=1.0), colors=colors), materials="full")
    np.testing.assert_allclose(read(scene, 0, LEFT)["base_color"], (1.0, 0.2, 0.4), rtol=1e-5)


def test_conductors_and_flags() -> None:
    gold = Material(metallic=1.0, eta=(0.14, 0.37, 1.44), k=(3.98, 2.38, 1.6), distribution="beckmann", roughness=0.0)
    cup = Material(specular=1.0, interface="plastic", nonlinear=True, ior=1.49)
    pane = Material(transmission=1.0, thin=True, compensate=True)
    scene = upload(scene_of(gold, cup, pane), materials="full")
    metal, plastic, glass = (read(scene, row, LEFT) for row in range(3))
    assert metal["has_index"].all() and not plastic["has_index"].any()
    np.testing.assert_allclose(metal["eta"], (0.14, 0.37, 1.44), rtol=1e-6)
    np.testing.assert_allclose(metal["k"], (3.98, 2.38, 1.6), rtol=1e-6)
    assert metal["roughness"] == 0.0 and metal["flags"][0] & FLAG_BECKMANN
    assert plastic["flags"][0] & FLAG_PLASTIC and plastic["flags"][0] & FLAG_NONLINEAR
    assert glass["flags"][0] & FLAG_THIN and glass["flags"][0] & FLAG_COMPENSATE
    assert not plastic["flags"][0] & (FLAG_THIN | FLAG_COMPENSATE | FLAG_BECKMANN)
    # eta alone is a metal that takes no light in: k = 0.
    clear = upload(scene_of(Material(metallic=1.0, eta=(1.5, 2.0, 3.0))), materials="full")
    lone = read(clear, 0, LEFT)
    assert lone["has_index"].all() and not np.any(lone["k"])
    tables = scene.materials.gloss
    assert tables.has_conductor and tables.has_beckmann and tables.has_plastic and tables.has_compensate
    assert not tables.has_specular
    assert not (tables.has_textures or tables.has_clearcoat or tables.has_absorption)


def test_a_black_attenuation_colour_absorbs_all_but_stays_finite() -> None:
    black = Material(transmission=1.0, attenuation_color=(0.0, 1.0, 0.5), attenuation_distance=2.0)
    found = read(upload(scene_of(black), materials="full"), 0, LEFT)["absorption"]
    assert np.isfinite(found).all() and math.exp(-2.0 * found[0]) < 1e-10
    np.testing.assert_allclose(found[1:], (0.0, math.log(2.0) / 2.0), rtol=1e-6)


def test_scenes_without_gloss_compile_as_ever() -> None:
    plain = scene_of(Material(roughness=0.1), Material(emission=(1.0, 1.0, 1.0)))
    full, known = upload(plain, materials="full"), upload(plain)
    assert full.features == known.features and not full.features.gloss
    glossy = upload(scene_of(FULL, Material(transmission=1.0, thin=True, specular=1.0)))
    assert not glossy.features.gloss and not glossy.features.transmission
    assert len(np.array(glossy.materials.gloss.factors)) == 20


# --- the diffuse condition -----------------------------------------------------------------------------------------


OTHERS: dict[str, Any] = {
    "ior": 1.2, "specular": 0.5, "specular_texture": image((1, 1, 1, 1), (0, 0, 0, 0)), "specular_color": (1, 1, 0),
    "specular_color_texture": image((1, 1, 1), (0, 0, 0)), "thin": True, "attenuation_color": (0.5, 1, 1),
    "attenuation_distance": 2.0, "clearcoat": 1.0, "clearcoat_texture": image((1, 1, 1), (0, 0, 0)),
    "clearcoat_roughness": 0.5, "clearcoat_roughness_texture": image((1, 1, 1), (0, 0, 0)), "eta": (1, 2, 3),
    "k": (1, 2, 3), "distribution": "beckmann", "compensate": True, "interface": "plastic", "nonlinear": True,
    "transmission_texture": image((1, 1, 1), (0, 0, 0)),
}  # fmt: skip


@pytest.mark.parametrize("name", OTHERS)
def test_gloss_enters_the_hash_of_the_full_materials_alone(name: str) -> None:
    data = scene_of(Material("paint", (0.5, 0.4, 0.3)))
    other = scene_of(replace(data.materials[0], **{name: OTHERS[name]}))
    assert hash_scene(other) == hash_scene(data) == hash_scene(data, materials="full")
    assert hash_scene(other, materials="full") != hash_scene(data, materials="full")


def test_every_field_of_gloss_is_known() -> None:
    """A field added to `Material` is either one of the diffuse condition, or goes back to its default there."""
    older = {
        "name", "base_color", "base_color_texture", "metallic", "roughness", "metallic_roughness_texture", "emission",
        "emission_texture", "normal_texture", "normal_scale", "alpha", "alpha_mode", "alpha_cutoff", "reflect_back",
        "emit_back", "emission_uses_colors",
    }  # fmt: skip
    assert {item.name for item in fields(Material)} - older == set(GLOSS) == set(DEFAULTS)
    assert set(GLOSS) == set(OTHERS) | {"transmission", "diffuse"}


def test_glass_lets_light_pass_straight_under_the_diffuse_condition() -> None:
    pane = as_diffuse(Material(base_color=(0.1, 0.2, 0.3), transmission=0.75, thin=True, ior=1.2))
    assert (pane.alpha, pane.alpha_mode, pane.base_color) == (0.25, "blend", (0.1, 0.2, 0.3))
    assert pane.transmission == 0.0 and not pane.thin and pane.ior == 1.5
    assert as_diffuse(Material(transmission=0.75, metallic=1.0)).alpha_mode == "opaque"
    plain = Material(metallic=0.5, roughness=0.2)
    assert as_diffuse(plain) is plain


def test_a_reader_may_know_the_diffuse_condition_better() -> None:
    seen = Material("seen", (0.1, 0.1, 0.1))
    data = scene_of(Material("paint", metallic=1.0, diffuse=seen))
    assert hash_scene(data) == hash_scene(scene_of(seen))
    np.testing.assert_allclose(albedo(upload(data), 0, LEFT), 0.1, rtol=1e-6)
    np.testing.assert_allclose(albedo(upload(data, materials="full"), 0, LEFT), 0.0)
    brighter = as_diffuse(replace(data.materials[0], emission=(1.0, 2.0, 3.0)))
    assert brighter.emission == (1.0, 2.0, 3.0) and brighter.base_color == (0.1, 0.1, 0.1)
    assert live.change(data.materials[0], {"metallic": 0.5}).diffuse is None
    data.materials[0].base_color = (0.3, 0.3, 0.3)
    assert data.materials[0].diffuse is None


# --- live edits, values that cannot be -----------------------------------------------------------------------------


def test_edits_reach_the_device() -> None:
    scene = upload(scene_of(Material(), FULL), materials="full")
    live.set_material(scene, 1, replace(FULL, ior=1.8, metallic=1.0, specular_color=(1.0, 1.0, 1.0)))
    found = read(scene, 1, RIGHT)
    assert found["ior"] == pytest.approx(1.8) and found["metallic"] == pytest.approx(0.6, abs=0.003)
    np.testing.assert_allclose(found["specular_color"], (0.16, 0.81, 1.0), atol=0.004)
    live.set_material(scene, 1, replace(FULL, transmission_texture=None))
    assert read(scene, 1, LEFT)["transmission"] == pytest.approx(0.9)


def test_the_first_gloss_takes_an_upload() -> None:
    plain, coated = upload(scene_of(Material()), materials="full"), Material(specular=1.0)
    assert live.needs_upload(plain, 0, coated) and not live.needs_upload(upload(scene_of(Material())), 0, coated)
    metal = upload(scene_of(Material(metallic=1.0)), materials="full")
    assert not live.needs_upload(metal, 0, coated)
    assert live.needs_upload(metal, 0, Material(transmission=0.5))


@pytest.mark.parametrize(
    ("field", "value", "mended"),
    [
        ("ior", 0.001, 0.01),
        ("ior", math.nan, 1.5),
        ("specular", 2.0, 1.0),
        ("transmission", -0.1, 0.0),
        ("transmission", math.nan, 0.0),
        ("clearcoat", 1.5, 1.0),
        ("clearcoat_roughness", math.inf, 0.0),
        ("specular_color", (-1.0, 2.0, math.nan), (0.0, 2.0, 0.0)),
        ("attenuation_color", (2.0, 0.5, -1.0), (1.0, 0.5, 0.0)),
        ("attenuation_distance", -1.0, math.inf),
        ("eta", (-1.0, 1.0, 1.0), (0.0, 1.0, 1.0)),
    ],
)
def test_values_that_cannot_be(field: str, value: Any, mended: Any) -> None:
    with pytest.raises(LuxelError, match=f"material 'paint': {field} .* cannot be: give"):
        luxel.Material("paint", **{field: value})
    with clamping() as sentences:
        found = Material("paint", **{field: value})
    assert getattr(found, field) == pytest.approx(mended, abs=2e-6) and len(sentences) == 1


@pytest.mark.parametrize(
    ("field", "value"), [("distribution", "phong"), ("eta", "gold"), ("interface", "wood"), ("diffuse", 1)]
)
def test_values_of_the_wrong_kind(field: str, value: Any) -> None:
    with pytest.raises(LuxelError, match=f"{field} .* cannot be: give"):
        luxel.Material("paint", **{field: value})


def test_an_index_of_zero_is_glTFs_endless_one() -> None:  # noqa: N802
    assert Material(ior=0.0).ior == 0.0


def test_edits_of_glass_under_the_diffuse_condition() -> None:
    scene = upload(scene_of(Material(), Material(transmission=0.5)))
    assert scene.features.blended
    live.set_material(scene, 1, Material(transmission=0.25, ior=1.2, base_color=(0.1, 0.2, 0.3)))
    assert np.array(scene.materials.factors).reshape(-1, 16)[1, 3] == pytest.approx(0.75)
    np.testing.assert_allclose(albedo(scene, 1, LEFT), (0.1, 0.2, 0.3), rtol=1e-6)
    assert live.needs_upload(scene, 0, Material(transmission=0.5))


def test_what_is_held_by_a_renderer_stays_so() -> None:
    scene = upload(scene_of(Material(specular=1.0)))
    with pytest.raises(LuxelError, match="call set_material"):
        scene.host.data.materials[0].specular = 0.0
    shown = as_diffuse(scene.host.data.materials[0])
    shown.base_color = (0.1, 0.1, 0.1)
    assert scene.host.data.materials[0].base_color == (0.8, 0.8, 0.8)
