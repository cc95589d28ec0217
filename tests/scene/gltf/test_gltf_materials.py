"""Materials, textures and images."""

from __future__ import annotations

import base64
import io
import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from PIL import Image

from luxel import scene as scenes
from luxel.scene.gltf.textures import decode_image
from luxel.scene.model import Material, SceneData

if TYPE_CHECKING:
    from conftest import GltfBuilder

PIXELS = np.array([[[255, 0, 0, 255], [0, 255, 0, 64]], [[0, 0, 255, 255], [10, 20, 30, 0]]], dtype=np.uint8)


NO_METAL = {"metallicFactor": 0.0}


def encode(pixels: np.ndarray, kind: str = "PNG") -> bytes:
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, kind, lossless=True)
    return stream.getvalue()


def load(builder: GltfBuilder, **entry: Any) -> tuple[Material, SceneData]:
    uv = builder.accessor([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    material = builder.add("materials", entry)
    builder.node(mesh=builder.mesh(attributes={"TEXCOORD_0": uv, "TEXCOORD_1": uv}, material=material))
    data = builder.load()
    return data.materials[data.objects[0].meshes[0].material], data


def add_texture(builder: GltfBuilder, pixels: np.ndarray = PIXELS, **sampler: Any) -> int:
    image = builder.add("images", {"bufferView": builder.view(encode(pixels)), "mimeType": "image/png"})
    entry = {"source": image}
    if sampler:
        entry["sampler"] = builder.add("samplers", sampler)
    return builder.add("textures", entry)


def base_color(index: int, **more: Any) -> dict[str, Any]:
    return {"pbrMetallicRoughness": {"baseColorTexture": {"index": index, **more}, "metallicFactor": 0.0}}


def test_factors(builder: GltfBuilder) -> None:
    pbr = {"baseColorFactor": [0.1, 0.2, 0.3, 0.4], "metallicFactor": 0.25, "roughnessFactor": 0.75}
    material, data = load(builder, name="paint", pbrMetallicRoughness=pbr, emissiveFactor=[0.5, 0.25, 1.0])
    assert material.name == "paint"
    assert material.base_color == (0.1, 0.2, 0.3)
    assert (material.metallic, material.roughness) == (0.25, 0.75)
    assert material.emission == (0.5, 0.25, 1.0)
    assert (material.alpha, material.alpha_mode) == (1.0, "opaque")
    assert material.reflect_back and not material.emit_back
    assert data.warnings == []


def test_defaults_are_those_of_gltf(builder: GltfBuilder) -> None:
    material, _ = load(builder)
    assert material.base_color == (1.0, 1.0, 1.0)
    assert (material.metallic, material.roughness) == (1.0, 1.0)
    assert material.emission == (0.0, 0.0, 0.0)


def test_emissive_strength_and_two_sides(builder: GltfBuilder) -> None:
    strength = {"KHR_materials_emissive_strength": {"emissiveStrength": 8.0}}
    material, data = load(
        builder, pbrMetallicRoughness=NO_METAL, emissiveFactor=[1.0, 0.5, 0.0], extensions=strength, doubleSided=True
    )
    assert material.emission == (8.0, 4.0, 0.0)
    assert material.emit_back and material.reflect_back
    assert data.warnings == []


def test_unlit_surfaces_shine_and_reflect_nothing(builder: GltfBuilder) -> None:
    color = {"baseColorFactor": [0.2, 0.4, 0.6, 1.0]}
    material, data = load(builder, pbrMetallicRoughness=color, extensions={"KHR_materials_unlit": {}})
    assert material.emission == pytest.approx((0.2, 0.4, 0.6)) and material.base_color == (0.0, 0.0, 0.0)
    assert material.emission_uses_colors, "vertex colours multiply the base colour, which is what shines"
    assert not material.emit_back and data.warnings == []


@pytest.mark.parametrize(
    ("entry", "alpha", "cutoff"),
    [
        ({}, 1.0, 0.5),
        ({"alphaMode": "OPAQUE"}, 1.0, 0.5),
        ({"alphaMode": "MASK"}, 0.4, 0.5),
        ({"alphaMode": "MASK", "alphaCutoff": 0.3}, 0.4, 0.3),
        ({"alphaMode": "BLEND"}, 0.4, 0.5),
    ],
)
def test_alpha_modes(builder: GltfBuilder, entry: dict[str, Any], alpha: float, cutoff: float) -> None:
    pbr = {"baseColorFactor": [1.0, 1.0, 1.0, 0.4], "metallicFactor": 0.0}
    material, data = load(builder, pbrMetallicRoughness=pbr, **entry)
    assert (material.alpha, material.alpha_cutoff) == (alpha, cutoff)
    assert material.alpha_mode == entry.get("alphaMode", "OPAQUE").lower()
    assert data.warnings == []


def test_base_colour_texture(builder: GltfBuilder) -> None:
    texture = add_texture(builder, wrapS=33071, wrapT=33648, magFilter=9728)
    material, data = load(builder, alphaMode="MASK", **base_color(texture, texCoord=1))
    found = material.base_color_texture
    assert found is not None
    assert found.image.tolist() == PIXELS.tolist()
    assert found.image.dtype == np.uint8
    assert (found.wrap_u, found.wrap_v, found.nearest) == ("clamp", "mirror", True)
    assert (found.srgb, found.uv_set) == (True, 1)
    assert found.transform.tolist() == np.eye(3).tolist()
    assert data.warnings == []


def test_opaque_material_drops_the_alpha_channel(builder: GltfBuilder) -> None:
    material, _ = load(builder, **base_color(add_texture(builder)))
    assert material.base_color_texture is not None
    assert material.base_color_texture.image.tolist() == PIXELS[:, :, :3].tolist()
    assert (material.base_color_texture.wrap_u, material.base_color_texture.nearest) == ("repeat", False)


def test_the_other_textures(builder: GltfBuilder) -> None:
    texture = add_texture(builder)
    material, data = load(
        builder,
        pbrMetallicRoughness={"metallicRoughnessTexture": {"index": texture}},
        normalTexture={"index": texture, "scale": 0.5, "texCoord": 1},
        emissiveTexture={"index": texture},
        occlusionTexture={"index": texture},
    )
    roughness, normal, emission = (
        material.metallic_roughness_texture,
        material.normal_texture,
        material.emission_texture,
    )
    assert roughness is not None and normal is not None and emission is not None
    assert (roughness.srgb, normal.srgb, emission.srgb) == (False, False, True)
    assert (normal.uv_set, material.normal_scale) == (1, 0.5)
    assert roughness.image is normal.image, "an image is decoded once and shared"
    assert data.warnings == ["Occlusion textures are ignored: luxel computes the occlusion itself."]


def transformed(builder: GltfBuilder, **entry: Any) -> np.ndarray:
    material, _ = load(builder, **base_color(add_texture(builder), extensions={"KHR_texture_transform": entry}))
    assert material.base_color_texture is not None
    return material.base_color_texture.transform


def test_texture_transform_scales_then_shifts(builder: GltfBuilder) -> None:
    matrix = transformed(builder, offset=[0.1, 0.2], scale=[2.0, 3.0])
    np.testing.assert_allclose(matrix @ [1.0, 1.0, 1.0], [2.1, 3.2, 1.0], atol=1e-6)


def test_texture_transform_turns_as_in_the_extensions_example(builder: GltfBuilder) -> None:
    # Its own example: "only the lower left quadrant of the source image, rotated clockwise 90 degrees".
    matrix = transformed(builder, offset=[0.0, 1.0], rotation=math.pi / 2, scale=[0.5, 0.5])
    corners = matrix @ np.array([[0, 1, 0, 1], [0, 0, 1, 1], [1, 1, 1, 1]])
    np.testing.assert_allclose([corners[0].min(), corners[0].max()], [0.0, 0.5], atol=1e-6)
    np.testing.assert_allclose([corners[1].min(), corners[1].max()], [0.5, 1.0], atol=1e-6)
    # The picture's upper left corner shows what was the quadrant's lower left.
    np.testing.assert_allclose(corners[:2, 0], [0.0, 1.0], atol=1e-6)


def test_texture_transform_scales_before_it_turns(builder: GltfBuilder) -> None:
    matrix = transformed(builder, rotation=math.pi / 2, scale=[2.0, 3.0])
    np.testing.assert_allclose(matrix @ [1.0, 0.0, 1.0], [0.0, -2.0, 1.0], atol=1e-6)
    np.testing.assert_allclose(matrix @ [0.0, 1.0, 1.0], [3.0, 0.0, 1.0], atol=1e-6)


def test_texture_transform_names_another_set(builder: GltfBuilder) -> None:
    entry = {"KHR_texture_transform": {"texCoord": 1}}
    material, _ = load(builder, **base_color(add_texture(builder), texCoord=0, extensions=entry))
    assert material.base_color_texture is not None and material.base_color_texture.uv_set == 1


def test_higher_coordinate_sets_are_named(builder: GltfBuilder) -> None:
    emissive = {"emissiveFactor": [1, 1, 1], "emissiveTexture": {"index": add_texture(builder), "texCoord": 1}}
    material, data = load(builder, **base_color(add_texture(builder), texCoord=2), **emissive)
    assert material.base_color_texture is not None and material.emission_texture is None
    assert data.warnings == [
        "Textures that use TEXCOORD_1 are ignored: luxel reads set 0 and one more a material.",
        "A textured primitive has no TEXCOORD_2; its textures are read at (0, 0).",
    ]


def test_a_higher_coordinate_set_is_read_in_place_of_the_second(builder: GltfBuilder) -> None:
    index = builder.add("materials", base_color(add_texture(builder), texCoord=3))
    sets = {f"TEXCOORD_{number}": builder.accessor(np.full((3, 2), 0.1 * number)) for number in range(4)}
    builder.node(mesh=builder.mesh(attributes=sets, material=index))
    data = builder.load()
    texture = data.materials[index].base_color_texture
    assert texture is not None and texture.uv_set == 1
    (mesh,) = data.objects[0].meshes
    assert mesh.uv is not None and mesh.uv2 is not None
    np.testing.assert_allclose(mesh.uv, 0.0)
    np.testing.assert_allclose(mesh.uv2, 0.3, rtol=1e-6)
    assert data.warnings == ["The vertex attribute TEXCOORD_2 is not supported and is ignored."]


def test_texture_on_a_mesh_without_coordinates(builder: GltfBuilder) -> None:
    material = builder.add("materials", base_color(add_texture(builder)))
    builder.node(mesh=builder.mesh(material=material))
    data = builder.load()
    uv = data.objects[0].meshes[0].uv
    assert uv is not None and uv.tolist() == [[0.0, 0.0]] * 3
    assert any("no TEXCOORD_0" in warning for warning in data.warnings)


@pytest.mark.parametrize("where", ["data", "file"])
def test_images_outside_the_buffer(builder: GltfBuilder, where: str) -> None:
    data = encode(PIXELS)
    uri = "data:image/png;base64," + base64.b64encode(data).decode()
    if where == "file":
        (builder.folder / "a b.png").write_bytes(data)
        uri = "a%20b.png"
    texture = builder.add("textures", {"source": builder.add("images", {"uri": uri})})
    material, _ = load(builder, alphaMode="MASK", **base_color(texture))
    assert material.base_color_texture is not None
    assert material.base_color_texture.image.tolist() == PIXELS.tolist()


def test_webp_extension(builder: GltfBuilder) -> None:
    image = builder.add("images", {"bufferView": builder.view(encode(PIXELS[:, :, :3], "WEBP"))})
    texture = builder.add("textures", {"extensions": {"EXT_texture_webp": {"source": image}}})
    builder.json["extensionsRequired"] = ["EXT_texture_webp"]
    material, _ = load(builder, **base_color(texture))
    assert material.base_color_texture is not None
    assert material.base_color_texture.image.tolist() == PIXELS[:, :, :3].tolist()


@pytest.mark.parametrize(
    ("image", "words"),
    [
        ({"uri": "none.png"}, "file none.png is missing"),
        ({"uri": "data:image/png;base64,AAAA"}, "image 0 cannot be decoded"),
        ({"uri": "https://example.org/a.png"}, "https://example.org/a.png is missing"),
        ({}, "image 0 has no data"),
    ],
)
def test_broken_images_leave_the_factor(builder: GltfBuilder, image: dict[str, Any], words: str) -> None:
    texture = builder.add("textures", {"source": builder.add("images", image)})
    pbr = {"baseColorTexture": {"index": texture}, "baseColorFactor": [0.5, 0.6, 0.7, 1.0], "metallicFactor": 0.0}
    material, data = load(builder, pbrMetallicRoughness=pbr, emissiveTexture={"index": texture})
    assert material.base_color_texture is None and material.emission_texture is None
    assert material.base_color == (0.5, 0.6, 0.7)
    assert len(data.warnings) == 1
    assert words in data.warnings[0] and "the factor is used alone" in data.warnings[0]


def test_truncated_image(builder: GltfBuilder) -> None:
    noise = np.random.default_rng(0).integers(0, 255, (64, 64, 3)).astype(np.uint8)
    image = builder.add("images", {"bufferView": builder.view(encode(noise)[:3000])})
    material, data = load(builder, **base_color(builder.add("textures", {"source": image})))
    assert material.base_color_texture is None
    assert any("cannot be decoded" in warning for warning in data.warnings)


def test_image_modes() -> None:
    deep = decode_image(encode(np.array([[0, 65535], [13107, 32768]], dtype=np.uint16)))
    assert deep.shape == (2, 2, 3) and deep.dtype == np.float32
    np.testing.assert_allclose(deep[:, :, 1], [[0.0, 1.0], [0.2, 0.50000763]], atol=1e-6)
    assert decode_image(encode(np.array([[7, 9]], dtype=np.uint8))).tolist() == [[[7, 7, 7], [9, 9, 9]]]
    stream = io.BytesIO()
    Image.fromarray(PIXELS[:, :, :3]).quantize(4).save(stream, "PNG")
    assert decode_image(stream.getvalue()).tolist() == PIXELS[:, :, :3].tolist()


METALS = "Metals and mirrors are black to diffuse light, their reflections are left out: "


def test_primitive_without_material_has_that_of_the_specification(builder: GltfBuilder) -> None:
    builder.add("materials", {"name": "unused"})
    builder.node(mesh=builder.mesh())
    builder.node(mesh=builder.mesh(attributes={"COLOR_0": builder.accessor([[1.0, 0.0, 0.0]] * 3)}))
    data = builder.load()
    first, second = (data.materials[item.meshes[0].material] for item in data.objects)
    # glTF 2.0, section 5.19: all properties at their default.
    assert first is second and len(data.materials) == 2
    assert (first.base_color, first.metallic, first.roughness) == ((1.0, 1.0, 1.0), 1.0, 1.0)
    assert data.warnings == [METALS + "glTF's default material."]


@pytest.mark.parametrize(
    ("factor", "blue", "named"),
    [(None, None, True), (0.9, None, True), (0.2, None, False), (1.0, 255, True), (None, 20, False), (0.3, 255, False)],
)
def test_metals_are_named(builder: GltfBuilder, factor: float | None, blue: int | None, named: bool) -> None:
    pbr: dict[str, Any] = {} if factor is None else {"metallicFactor": factor}
    if blue is not None:
        pbr["metallicRoughnessTexture"] = {"index": add_texture(builder, np.full((2, 2, 3), (0, 255, blue), np.uint8))}
    _, data = load(builder, name="brass", pbrMetallicRoughness=pbr)
    assert data.warnings == ([METALS + "brass."] if named else [])


def test_colours_and_light_outside_their_range(builder: GltfBuilder) -> None:
    pbr = {"baseColorFactor": [1.5, -0.5, 0.5, 2.0], "metallicFactor": 0.0}
    material, data = load(builder, name="odd", pbrMetallicRoughness=pbr, alphaMode="MASK", emissiveFactor=[-5, 1, 0])
    assert material.base_color == (1.0, 0.0, 0.5) and material.alpha == 1.0
    assert material.emission == (0.0, 1.0, 0.0)
    assert data.warnings == [
        "Base colours outside 0 to 1 are cut off there: odd.", "Light below zero is read as none: odd."
    ]  # fmt: skip


def test_unused_metals_are_not_named(builder: GltfBuilder) -> None:
    builder.add("materials", {"name": "spare"})
    _, data = load(builder, pbrMetallicRoughness=NO_METAL)
    assert data.warnings == []


def test_a_black_emissive_texture_is_no_light(builder: GltfBuilder) -> None:
    """Exporters write the factor 1 beside an image that is black: the file has no light, and gets the default one."""
    stream = io.BytesIO()
    Image.fromarray(np.zeros((2, 2, 3), np.uint8)).save(stream, "PNG")
    texture = builder.add(
        "textures", {"source": builder.add("images", {"bufferView": builder.view(stream.getvalue())})}
    )
    material = builder.add("materials", {"emissiveFactor": [1, 1, 1], "emissiveTexture": {"index": texture}})
    uv = builder.accessor([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    builder.node(mesh=builder.mesh(material=material, attributes={"TEXCOORD_0": uv}))
    data = scenes.load(builder.write())
    assert [light.kind for light in data.lights] == ["directional"] and "has no light" in data.warnings[-1]
