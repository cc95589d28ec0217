"""Coats, glass and volumes: what the extensions' texts say of factors, channels and defaults."""

from __future__ import annotations

import io
import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from PIL import Image

from luxel.errors import LuxelError
from luxel.kernels.bsdf import evaluate, make_tables
from luxel.kernels.gloss import bsdf_features, gloss_at, make_bsdf
from luxel.kernels.triangle import fetch_triangle, interpolate
from luxel.scene.device import upload
from luxel.scene.digest import hash_scene
from luxel.scene.model import Material, SceneData

if TYPE_CHECKING:
    from conftest import GltfBuilder

PREFIX = "KHR_materials_"


def load(builder: GltfBuilder, pbr: dict[str, Any] | None = None, **parts: Any) -> tuple[Material, SceneData]:
    """Return the material with the extensions `parts`, by their names without the prefix, and its scene."""
    uv = builder.accessor([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    extensions = {PREFIX + name: part for name, part in parts.items() if name != "entry"}
    base = pbr if pbr is not None else {"metallicFactor": 0.0}
    entry = {"name": "thing", "pbrMetallicRoughness": base, "extensions": extensions, **parts.get("entry", {})}
    attributes = {"TEXCOORD_0": uv, "TEXCOORD_1": uv}
    builder.node(mesh=builder.mesh(attributes=attributes, material=builder.add("materials", entry)))
    data = builder.load()
    return data.materials[0], data


def texture(builder: GltfBuilder, *texels: tuple[int, ...], **more: Any) -> dict[str, Any]:
    """Return a texture of one row."""
    stream = io.BytesIO()
    Image.fromarray(np.array([texels], np.uint8)).save(stream, "PNG")
    image = builder.add("images", {"bufferView": builder.view(stream.getvalue())})
    sampler = builder.add("samplers", {"magFilter": 9728})
    return {"index": builder.add("textures", {"source": image, "sampler": sampler}), **more}


def facts(data: SceneData, u: float, v: float = 0.1) -> Any:
    """Return what the device reads at texture coordinates inside the triangle."""
    scene, active = upload(data, materials="full"), mi.Bool(True)
    point = interpolate(scene, fetch_triangle(scene, mi.UInt32(0), active), mi.Point2f(u, v), active)
    return gloss_at(scene, point, active)


def numbers(value: Any) -> list[float]:
    return np.array(value).ravel().tolist()


def srgb_to_linear(byte: int) -> float:
    value = byte / 255.0
    return value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4


def test_a_plain_material_has_gltfs_coat(builder: GltfBuilder) -> None:
    """The core text: a dielectric of index 1.5, so that 4 % are reflected straight back."""
    material, data = load(builder)
    assert (material.ior, material.specular, material.specular_color) == (1.5, 1.0, (1.0, 1.0, 1.0))
    assert ((material.ior - 1.0) / (material.ior + 1.0)) ** 2 == pytest.approx(0.04)
    assert (material.transmission, material.clearcoat, material.eta) == (0.0, 0.0, None)
    assert material.compensate and material.distribution == "ggx" and data.warnings == []


@pytest.mark.parametrize(("ior", "read"), [(1.33, 1.33), (0.0, 0.0), (0.4, 1.0), (2.4, 2.4)])
def test_index_of_refraction(builder: GltfBuilder, ior: float, read: float) -> None:
    material, data = load(builder, ior={"ior": ior})
    assert material.ior == read
    assert any("below 1" in text for text in data.warnings) == (ior != read)


def test_specular_by_factor_and_texture(builder: GltfBuilder) -> None:
    """KHR_materials_specular: the factor by the alpha of its texture, the colour by sRGB and above one."""
    strength = texture(builder, (255, 0, 0, 51), (0, 0, 0, 204))
    tint = texture(builder, (255, 128, 0), (64, 0, 255), texCoord=1)
    part = {"specularFactor": 0.5, "specularTexture": strength, "specularColorFactor": [3.0, 1.0, 1.0],
            "specularColorTexture": tint}  # fmt: skip
    material, data = load(builder, specular=part)
    assert material.specular_texture is not None and material.specular_color_texture is not None
    assert (material.specular_texture.srgb, material.specular_color_texture.srgb) == (False, True)
    assert material.specular_color_texture.uv_set == 1
    left, right = facts(data, 0.25), facts(data, 0.75)
    assert numbers(left.specular) == pytest.approx([0.5 * 51 / 255], abs=0.002)
    assert numbers(right.specular) == pytest.approx([0.5 * 204 / 255], abs=0.002)
    assert numbers(left.specular_color) == pytest.approx([3.0, srgb_to_linear(128), 0.0], abs=0.005)
    assert numbers(right.specular_color) == pytest.approx([3.0 * srgb_to_linear(64), 0.0, 1.0], abs=0.005)


def test_clear_coat_by_factor_and_texture(builder: GltfBuilder) -> None:
    """KHR_materials_clearcoat: the factor by red, its roughness by green."""
    both = texture(builder, (102, 51, 9), (255, 255, 9))
    part = {"clearcoatFactor": 0.8, "clearcoatTexture": both, "clearcoatRoughnessFactor": 0.5,
            "clearcoatRoughnessTexture": both}  # fmt: skip
    _, data = load(builder, clearcoat=part)
    left = facts(data, 0.25)
    assert numbers(left.clearcoat) == pytest.approx([0.8 * 0.4], abs=0.002)
    assert numbers(left.clearcoat_roughness) == pytest.approx([0.5 * 0.2], abs=0.002)


def test_the_defaults_of_extensions_are_their_texts(builder: GltfBuilder) -> None:
    material, _ = load(builder, clearcoat={}, specular={}, ior={}, volume={}, transmission={})
    assert (material.clearcoat, material.clearcoat_roughness) == (0.0, 0.0)
    assert (material.specular, material.specular_color, material.ior) == (1.0, (1.0, 1.0, 1.0), 1.5)
    assert (material.transmission, material.attenuation_color) == (0.0, (1.0, 1.0, 1.0))
    assert material.attenuation_distance == math.inf


def test_glass_without_volume_is_a_pane(builder: GltfBuilder) -> None:
    red = texture(builder, (51, 255, 255), (204, 0, 0))
    pbr = {"baseColorFactor": [0.5, 1.0, 0.25, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.3}
    material, data = load(builder, pbr, transmission={"transmissionFactor": 0.5, "transmissionTexture": red})
    assert material.thin and material.transmission == 0.5 and material.base_color == (0.5, 1.0, 0.25)
    assert (material.alpha, material.alpha_mode) == (1.0, "opaque"), "glass is no hole"
    left = facts(data, 0.25)
    assert numbers(left.transmission) == pytest.approx([0.5 * 0.2], abs=0.002)
    assert numbers(left.base_color) == pytest.approx([0.5, 1.0, 0.25]) and numbers(left.roughness) == [
        pytest.approx(0.3)
    ]


@pytest.mark.parametrize("metres", [0.25, 1.0, 3.0])
def test_a_volume_swallows_by_its_text(builder: GltfBuilder, metres: float) -> None:
    """KHR_materials_volume: after a way of x metres the attenuation colour to the power of x over its distance."""
    colour, distance = (0.5, 0.8, 1.0), 0.5
    volume = {"thicknessFactor": 0.1, "attenuationColor": colour, "attenuationDistance": distance}
    material, data = load(builder, transmission={"transmissionFactor": 1.0}, volume=volume)
    assert not material.thin and material.attenuation_distance == distance
    left = np.exp(-metres * np.array(numbers(facts(data, 0.25).absorption)))
    np.testing.assert_allclose(left, np.array(colour) ** (metres / distance), rtol=1e-5)


def test_volumes_that_cannot_be(builder: GltfBuilder) -> None:
    volume = {"attenuationColor": [0.5, -1.0, 3.0], "attenuationDistance": 0.5}
    material, data = load(builder, transmission={"transmissionFactor": 1.0}, volume=volume)
    assert material.thin and material.attenuation_color == (0.5, 0.0, 1.0)
    assert "Glass without thickness swallows nothing, whatever its attenuation: thing." in data.warnings


def test_an_attenuation_distance_of_zero_is_none(builder: GltfBuilder) -> None:
    volume = {"thicknessFactor": 1.0, "attenuationDistance": 0.0}
    material, data = load(builder, transmission={"transmissionFactor": 1.0}, volume=volume)
    assert material.attenuation_distance == math.inf and any("zero or less" in text for text in data.warnings)


def test_specular_glossiness_reflects_its_colour(builder: GltfBuilder) -> None:
    """The extension: f0 is the specular colour (sRGB texture times factor), roughness one minus glossiness (alpha)."""
    gloss = texture(builder, (255, 128, 0, 51), (64, 0, 255, 255))
    part = {"specularFactor": [0.5, 0.5, 1.0], "glossinessFactor": 0.5, "specularGlossinessTexture": gloss}
    material, data = load(builder, pbrSpecularGlossiness=part)
    assert (material.ior, material.specular, material.metallic) == (0.0, 1.0, 0.0)
    left = facts(data, 0.25)
    f0 = ((numbers(left.ior)[0] - 1.0) / (numbers(left.ior)[0] + 1.0)) ** 2 * np.array(numbers(left.specular_color))
    np.testing.assert_allclose(f0, (0.5, 0.5 * srgb_to_linear(128), 0.0), atol=0.004)
    assert numbers(left.roughness) == pytest.approx([1.0 - 0.5 * 0.2], abs=0.003)


def test_specular_glossiness_defaults(builder: GltfBuilder) -> None:
    material, _ = load(builder, pbrSpecularGlossiness={})
    assert (material.base_color, material.specular_color, material.roughness) == ((1, 1, 1), (1, 1, 1), 0.0)


def test_unlit_surfaces_have_no_coat(builder: GltfBuilder) -> None:
    material, data = load(builder, unlit={}, transmission={"transmissionFactor": 1.0})
    assert (material.specular, material.transmission, material.metallic) == (0.0, 0.0, 0.0)
    assert not upload(data, materials="full").features.gloss


def test_gloss_moves_no_key_of_a_diffuse_truth(builder: GltfBuilder) -> None:
    _, data = load(builder, ior={"ior": 1.2}, clearcoat={"clearcoatFactor": 1.0})
    plain = SceneData("", data.objects, [Material(base_color=(1.0, 1.0, 1.0), roughness=1.0)])
    assert hash_scene(data) == hash_scene(plain) and hash_scene(data, materials="full") != hash_scene(plain)


@pytest.mark.parametrize("name", ["anisotropy", "sheen", "iridescence", "dispersion", "diffuse_transmission"])
def test_what_is_left_out_is_named(builder: GltfBuilder, name: str) -> None:
    builder.json["extensionsUsed"] = [PREFIX + name]
    _, data = load(builder, **{name: {}})
    words = {"dispersion": "split light", "diffuse_transmission": "shines through"}.get(name, name)
    assert any(words in text for text in data.warnings), data.warnings


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ({"ior": {"ior": "glass"}}, "ior of material 0 must be 1 number"),
        ({"specular": {"specularColorFactor": [1.0]}}, "specularColorFactor of material 0 must be 3 number"),
        ({"clearcoat": {"clearcoatTexture": {"index": 7}}}, "texture of material 0 7 is asked for"),
        ({"transmission": {}, "volume": {"thicknessFactor": []}}, "thicknessFactor of material 0 must be 1 number"),
        ({"clearcoat": [1]}, "breaks the glTF schema"),
    ],
)
def test_broken_extensions_are_one_sentence(builder: GltfBuilder, parts: dict[str, Any], words: str) -> None:
    with pytest.raises(LuxelError, match=words) as caught:
        load(builder, **parts)
    assert "\n" not in str(caught.value)


def test_what_full_materials_do_is_told_apart(builder: GltfBuilder) -> None:
    builder.json["extensionsUsed"] = [PREFIX + name for name in ("clearcoat", "sheen", "ior", "transmission")]
    parts = {"ior": {"ior": 1.4}, "volume": {}, "transmission": {"transmissionFactor": 1.0}, "dispersion": {}}
    _, data = load(builder, clearcoat={"clearcoatFactor": 1.0}, **parts)
    always = [text for text in data.warnings if text not in data.diffuse_warnings]
    assert set(data.diffuse_warnings) < set(data.warnings)
    assert (
        len(always) == 2 and any("sheen" in text for text in always) and any("split light" in text for text in always)
    )


def test_metals_are_dark_under_the_diffuse_condition_alone(builder: GltfBuilder) -> None:
    _, data = load(builder, {})
    assert data.warnings == data.diffuse_warnings and "Metals and mirrors" in data.warnings[0]


def appendix_b(base: np.ndarray, roughness: float, wo: np.ndarray, wi: np.ndarray) -> np.ndarray:
    """Return the metal of glTF 2.0, appendix B.3, times the cosine of `wi`: directions (N, 3), normal +z."""
    alpha2 = roughness**4
    h = wo + wi
    h /= np.linalg.norm(h, axis=1, keepdims=True)
    facets = alpha2 / (math.pi * (h[:, 2] ** 2 * (alpha2 - 1.0) + 1.0) ** 2)
    shadowing = 1.0
    for cosine in (wo[:, 2], wi[:, 2]):
        shadowing = shadowing * 2.0 * cosine / (cosine + np.sqrt(alpha2 + (1.0 - alpha2) * cosine**2))
    specular = shadowing * facets / (4.0 * wo[:, 2] * wi[:, 2])
    seen = np.abs(np.einsum("ij,ij->i", wo, h))[:, None]
    return (specular * wi[:, 2])[:, None] * (base + (1.0 - base) * (1.0 - seen) ** 5)


@pytest.mark.parametrize("roughness", [0.3, 0.6, 1.0])
def test_a_metal_is_that_of_appendix_b(builder: GltfBuilder, roughness: float) -> None:
    """But for light that is scattered between facets, which the text leaves out and which only adds."""
    pbr = {"baseColorFactor": [0.9, 0.6, 0.2, 1.0], "roughnessFactor": roughness}
    _, data = load(builder, pbr)
    scene, count = upload(data, materials="full"), 2000
    draws = np.random.default_rng(1).normal(size=(2, count, 3))
    wo, wi = (np.abs(d) / np.linalg.norm(d, axis=1, keepdims=True) for d in draws)
    active = dr.full(mi.Bool, True, count)
    triangle = fetch_triangle(scene, dr.zeros(mi.UInt32, count), active)
    point = interpolate(scene, triangle, mi.Point2f(0.3, 0.3), active)
    bsdf = make_bsdf(scene, gloss_at(scene, point, active), make_tables(bsdf_features(scene)))
    there, here = (mi.Vector3f(np.ascontiguousarray(d.T, np.float32)) for d in (wo, wi))
    text = appendix_b(np.array((0.9, 0.6, 0.2)), roughness, wo, wi)
    plain = np.array(evaluate(replace(bsdf, compensate=False), there, here).total).T
    np.testing.assert_allclose(plain, text, rtol=2e-3, atol=1e-4)
    added = np.array(evaluate(bsdf, there, here).total).T - plain
    assert added.min() > -1e-5 and added.mean() > 0.0
