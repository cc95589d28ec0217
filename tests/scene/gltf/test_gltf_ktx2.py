"""KHR_texture_basisu: KTX2 pictures made by the encoder, against the pixels that went in."""

from __future__ import annotations

import io
import sys
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from PIL import Image

from luxel.scene.model import Material

if TYPE_CHECKING:
    from conftest import GltfBuilder

pytest.importorskip("opengl_basisu", reason="needs the extra `compressed`")
encoder = pytest.importorskip("alktx2", reason="the encoder of these pictures is not installed")

BASIS = "KHR_texture_basisu"


def picture(alpha: bool) -> np.ndarray:
    """(10, 14, 4) uint8: two flat parts that end with a block of 4x4, and a slow ramp of alpha."""
    pixels = np.full((10, 14, 4), 255, np.uint8)
    pixels[:4, :, :3], pixels[4:, :, :3] = (200, 40, 40), (40, 60, 220)
    pixels[..., 3] = np.linspace(40, 255, 14).astype(np.uint8) if alpha else 255
    return pixels


def encode(pixels: np.ndarray, codec: str) -> bytes:
    height, width = pixels.shape[:2]
    has_alpha = bool(pixels[..., 3].min() < 255)
    return encoder.encode_raw_rgba_to_ktx2(
        pixels.tobytes(), width, height, has_alpha, codec=codec, quality=100, threads=1
    )


def material_of(
    builder: GltfBuilder, data: bytes, *, fallback: np.ndarray | None = None, **entry: Any
) -> tuple[Material, list[str]]:
    image = builder.add("images", {"bufferView": builder.view(data), "mimeType": "image/ktx2"})
    texture: dict[str, Any] = {"extensions": {BASIS: {"source": image}}}
    if fallback is not None:
        stream = io.BytesIO()
        Image.fromarray(fallback).save(stream, "PNG")
        texture["source"] = builder.add("images", {"bufferView": builder.view(stream.getvalue())})
    pbr = {"baseColorTexture": {"index": builder.add("textures", texture)}, "metallicFactor": 0.0}
    uv = builder.accessor([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    material = builder.add("materials", {"pbrMetallicRoughness": pbr, **entry})
    builder.node(mesh=builder.mesh(attributes={"TEXCOORD_0": uv}, material=material))
    loaded = builder.load()
    return loaded.materials[0], loaded.warnings


@pytest.mark.parametrize("codec", ["etc1s", "uastc"])
@pytest.mark.parametrize("alpha", [False, True])
@pytest.mark.parametrize("required", [False, True])
def test_basis_pictures(builder: GltfBuilder, codec: str, alpha: bool, required: bool) -> None:
    builder.json["extensionsUsed"] = [BASIS]
    if required:
        builder.json["extensionsRequired"] = [BASIS]
    pixels = picture(alpha)
    material, warnings = material_of(builder, encode(pixels, codec), alphaMode="BLEND" if alpha else "OPAQUE")
    found = material.base_color_texture
    assert found is not None and found.image.shape == (10, 14, 4 if alpha else 3) and warnings == []
    assert np.abs(found.image.astype(int) - pixels[..., : found.image.shape[2]]).mean() < 6.0


def test_missing_decoder(builder: GltfBuilder, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "opengl_basisu", None)
    material, warnings = material_of(builder, encode(picture(False), "etc1s"))
    assert material.base_color_texture is None
    assert len(warnings) == 1 and "pip install 'luxel[compressed]'" in warnings[0]


def test_plain_picture_serves_where_the_other_cannot(builder: GltfBuilder, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "opengl_basisu", None)
    plain = picture(False)[..., :3]
    material, warnings = material_of(builder, encode(picture(False), "etc1s"), fallback=plain)
    assert material.base_color_texture is not None
    assert material.base_color_texture.image.tolist() == plain.tolist() and warnings == []


def test_damaged_pictures_leave_the_factor(builder: GltfBuilder) -> None:
    whole, rng = encode(picture(True), "uastc"), np.random.default_rng(2)
    material, warnings = material_of(builder, whole[: len(whole) // 2])
    assert material.base_color_texture is None and any("cannot be decoded" in warning for warning in warnings)
    view = builder.json["bufferViews"][builder.json["images"][0]["bufferView"]]
    start = view["byteOffset"]
    for _ in range(60):
        damaged = bytearray(whole[: view["byteLength"]])
        for place in rng.integers(0, len(damaged), 4):
            damaged[place] = int(rng.integers(256))
        builder.blob[start : start + len(damaged)] = damaged
        builder.load()
