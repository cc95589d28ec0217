"""Glass, blended surfaces and specular-glossiness: what their extensions say, by arithmetic."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from PIL import Image

from luxel.errors import LuxelError
from luxel.scene.diffuse import as_diffuse
from luxel.scene.model import Material, SceneData

if TYPE_CHECKING:
    from conftest import GltfBuilder

TRANSMISSION = "KHR_materials_transmission"
GLOSSINESS = "KHR_materials_pbrSpecularGlossiness"
GLASS_NAMED = "Glass is not refracted or tinted, light passes straight through it: pane."


def load(builder: GltfBuilder, *, colors: Any = None, **entry: Any) -> tuple[Material, SceneData]:
    """Return the material as the diffuse condition shows it, and its scene."""
    uv = builder.accessor([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    attributes = {"TEXCOORD_0": uv, "TEXCOORD_1": uv}
    if colors is not None:
        attributes["COLOR_0"] = builder.accessor(colors)
    material = builder.add("materials", {"name": "pane", **entry})
    builder.node(mesh=builder.mesh(attributes=attributes, material=material))
    data = builder.load()
    return as_diffuse(data.materials[data.objects[0].meshes[0].material]), data


def texture(builder: GltfBuilder, pixels: Any, **more: Any) -> dict[str, Any]:
    stream = io.BytesIO()
    Image.fromarray(np.asarray(pixels, np.uint8)).save(stream, "PNG")
    image = builder.add("images", {"bufferView": builder.view(stream.getvalue())})
    return {"index": builder.add("textures", {"source": image}), **more}


def glass(factor: float, **more: Any) -> dict[str, Any]:
    return {TRANSMISSION: {"transmissionFactor": factor, **more}}


def paint(*color: float, **more: Any) -> dict[str, Any]:
    return {"baseColorFactor": list(color) or [1.0, 1.0, 1.0, 1.0], "metallicFactor": 0.0, **more}


@pytest.mark.parametrize(("factor", "alpha"), [(1.0, 0.0), (0.25, 0.75), (7.0, 0.0)])
@pytest.mark.parametrize("required", [False, True])
def test_glass_lets_its_share_pass(builder: GltfBuilder, factor: float, alpha: float, required: bool) -> None:
    builder.json["extensionsUsed"] = [TRANSMISSION]
    if required:
        builder.json["extensionsRequired"] = [TRANSMISSION]
    material, data = load(builder, pbrMetallicRoughness=paint(0.5, 0.6, 0.7, 0.9), extensions=glass(factor))
    assert (material.alpha, material.alpha_mode) == (alpha, "blend")
    assert material.base_color == (0.5, 0.6, 0.7)
    assert data.warnings == [GLASS_NAMED]


@pytest.mark.parametrize("extensions", [{TRANSMISSION: {}}, glass(0.0)])
def test_transmission_of_nothing_is_opaque(builder: GltfBuilder, extensions: dict[str, Any]) -> None:
    material, data = load(builder, pbrMetallicRoughness=paint(), extensions=extensions)
    assert material.alpha_mode == "opaque" and data.warnings == []


def test_metal_transmits_nothing(builder: GltfBuilder) -> None:
    """The extension: only the dielectric part of a surface transmits."""
    material, _ = load(builder, pbrMetallicRoughness={"metallicFactor": 1.0}, extensions=glass(1.0))
    assert material.alpha_mode == "opaque"
    builder.json["materials"].clear()
    builder.json["nodes"].clear()
    builder.json["scenes"][0]["nodes"].clear()
    builder.json.pop("buffers")
    half, _ = load(builder, pbrMetallicRoughness={"metallicFactor": 0.5}, extensions=glass(1.0))
    assert half.alpha == 0.5


def test_blend_and_transmission_multiply(builder: GltfBuilder) -> None:
    pbr = paint(1.0, 1.0, 1.0, 0.5)
    material, _ = load(builder, pbrMetallicRoughness=pbr, alphaMode="BLEND", extensions=glass(0.5))
    # Half of it is there, and half of that lets light pass.
    assert (material.alpha, material.alpha_mode) == (0.25, "blend")


def test_transmission_texture_is_baked_into_alpha(builder: GltfBuilder) -> None:
    red = texture(builder, [[[255, 0, 9], [51, 200, 9]]])
    material, _ = load(builder, pbrMetallicRoughness=paint(), extensions=glass(1.0, transmissionTexture=red))
    found = material.base_color_texture
    assert found is not None and material.alpha == 1.0 and material.alpha_mode == "blend"
    assert found.image.tolist() == [[[255, 255, 255, 0], [255, 255, 255, 204]]]


def test_transmission_texture_joins_the_colours(builder: GltfBuilder) -> None:
    red = texture(builder, [[[255, 0, 0]], [[0, 0, 0]]])
    colour = texture(builder, [[[10, 20, 30, 40], [50, 60, 70, 80]]])
    pbr = paint(baseColorTexture=colour)
    material, _ = load(builder, pbrMetallicRoughness=pbr, extensions=glass(0.5, transmissionTexture=red))
    found = material.base_color_texture
    assert found is not None and found.srgb
    # The colour's own alpha has no meaning in an opaque material.
    assert found.image.tolist() == [
        [[10, 20, 30, 128], [50, 60, 70, 128]],
        [[10, 20, 30, 255], [50, 60, 70, 255]],
    ]


def test_transmission_texture_that_lies_otherwise_is_averaged(builder: GltfBuilder) -> None:
    red = texture(builder, [[[255, 0, 0], [0, 0, 0]]], texCoord=1)
    pbr = paint(baseColorTexture=texture(builder, [[[1, 2, 3]]]))
    material, data = load(builder, pbrMetallicRoughness=pbr, extensions=glass(1.0, transmissionTexture=red))
    assert material.alpha == 0.5 and any("averaged: pane" in warning for warning in data.warnings)


def test_cut_out_glass_keeps_its_holes(builder: GltfBuilder) -> None:
    pbr = paint(1.0, 1.0, 1.0, 0.5, baseColorTexture=texture(builder, [[[9, 9, 9, 255], [9, 9, 9, 90]]]))
    material, _ = load(builder, pbrMetallicRoughness=pbr, alphaMode="MASK", alphaCutoff=0.4, extensions=glass(0.25))
    found = material.base_color_texture
    assert found is not None and material.alpha == 0.75
    assert found.image[0, :, 3].tolist() == [255, 0]


def test_alpha_of_vertex_colours_means_nothing_in_opaque_glass(builder: GltfBuilder) -> None:
    _, data = load(builder, colors=[[1.0, 0.5, 0.2, 0.1]] * 3, pbrMetallicRoughness=paint(), extensions=glass(0.5))
    colors = data.objects[0].meshes[0].colors
    assert colors is not None and colors.shape == (3, 3)


def test_lamps_of_glass_stay_lamps(builder: GltfBuilder) -> None:
    pbr = paint(0.8, 0.8, 0.8, 1.0)
    material, data = load(builder, pbrMetallicRoughness=pbr, emissiveFactor=[1.0, 1.0, 1.0], extensions=glass(0.75))
    assert material.alpha_mode == "opaque" and material.emission == (1.0, 1.0, 1.0)
    assert material.base_color == pytest.approx((0.2, 0.2, 0.2))
    assert any("shines lets no light pass" in warning for warning in data.warnings)


def test_what_else_glass_does_is_named(builder: GltfBuilder) -> None:
    names = ["volume", "ior", "dispersion", "diffuse_transmission", "clearcoat"]
    builder.json["extensionsUsed"] = [f"KHR_materials_{name}" for name in names]
    _, data = load(
        builder, pbrMetallicRoughness=paint(), extensions={f"KHR_materials_{name}": {} for name in names[:4]}
    )
    said = " ".join(data.warnings)
    for words in ("swallows inside", "index of refraction", "split light into colours", "shines through", "clearcoat"):
        assert words in said
    assert sum("pane" in warning for warning in data.warnings) == 4 and len(data.warnings) == 5


def test_broken_transmission_is_one_sentence(builder: GltfBuilder) -> None:
    with pytest.raises(LuxelError, match="transmissionFactor of material 0 must be 1 number"):
        load(builder, extensions={TRANSMISSION: {"transmissionFactor": "clear"}})


# --- specular-glossiness -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("required", [False, True])
def test_specular_glossiness_keeps_its_diffuse_colour(builder: GltfBuilder, required: bool) -> None:
    builder.json["extensionsUsed"] = [GLOSSINESS]
    if required:
        builder.json["extensionsRequired"] = [GLOSSINESS]
    part = {"diffuseFactor": [0.1, 0.3, 0.8, 0.5], "specularFactor": [0.04, 0.04, 0.04], "glossinessFactor": 0.3,
            "diffuseTexture": texture(builder, [[[200, 100, 50, 25]]])}  # fmt: skip
    material, data = load(builder, alphaMode="BLEND", extensions={GLOSSINESS: part})
    assert material.base_color == (0.1, 0.3, 0.8) and (material.alpha, material.alpha_mode) == (0.5, "blend")
    assert material.metallic == 0.0 and material.roughness == pytest.approx(0.7)
    found = material.base_color_texture
    assert found is not None and found.srgb and found.image.tolist() == [[[200, 100, 50, 25]]]
    assert data.warnings == []


def test_specular_glossiness_goes_before_metal_rough(builder: GltfBuilder) -> None:
    material, _ = load(
        builder,
        pbrMetallicRoughness=paint(1.0, 0.0, 0.0, 1.0),
        extensions={GLOSSINESS: {"diffuseFactor": [0, 1, 0, 1]}},
    )
    assert material.base_color == (0.0, 1.0, 0.0)


def test_glossiness_texture_becomes_roughness(builder: GltfBuilder) -> None:
    part = {"glossinessFactor": 0.5, "specularGlossinessTexture": texture(builder, [[[9, 9, 9, 255], [9, 9, 9, 102]]])}
    material, _ = load(builder, extensions={GLOSSINESS: part})
    found = material.metallic_roughness_texture
    assert found is not None and not found.srgb and material.roughness == 1.0
    np.testing.assert_allclose(found.image[0, :, 1] / 255.0, [0.5, 0.8], atol=0.005)
    assert found.image[..., 2].max() == 0


def test_specular_metals_are_named(builder: GltfBuilder) -> None:
    part = {"diffuseFactor": [0.0, 0.0, 0.0, 1.0], "specularFactor": [0.9, 0.7, 0.4]}
    _, data = load(builder, extensions={GLOSSINESS: part})
    assert any(warning.startswith("Metals and mirrors") and "pane" in warning for warning in data.warnings)
