"""What reflects above the base: KHR_materials_ior, _specular and _clearcoat."""

from __future__ import annotations

from typing import Any

import numpy as np

from luxel.scene.gltf.document import Document
from luxel.scene.gltf.textures import TextureReader
from luxel.scene.model import Material

IOR, SPECULAR, CLEARCOAT = "KHR_materials_ior", "KHR_materials_specular", "KHR_materials_clearcoat"


def read_coats(
    document: Document, textures: TextureReader, material: Material, extensions: dict[str, Any], label: str
) -> None:
    """Fill index of refraction, coat and clear coat of a metal-rough material; every such material has a coat."""
    material.specular, material.compensate = 1.0, True
    if IOR in extensions:
        _read_ior(document, material, extensions[IOR], label)
    if SPECULAR in extensions:
        _read_specular(document, textures, material, extensions[SPECULAR], label)
    if CLEARCOAT in extensions:
        _read_clearcoat(document, textures, material, extensions[CLEARCOAT], label)


def _read_ior(document: Document, material: Material, part: dict[str, Any], label: str) -> None:
    ior = document.number(part.get("ior", 1.5), f"ior of {label}")
    if ior != 0.0 and ior < 1.0:
        document.warn("Indices of refraction below 1 are read as 1: {names}.", material.name)
        ior = 1.0
    material.ior = ior


def _read_specular(
    document: Document, textures: TextureReader, material: Material, part: dict[str, Any], label: str
) -> None:
    material.specular = _share(document, part.get("specularFactor", 1.0), f"specularFactor of {label}")
    material.specular_texture = textures.read(part.get("specularTexture"), label, srgb=False, opaque=False)
    color = document.numbers(part.get("specularColorFactor", (1.0, 1.0, 1.0)), 3, f"specularColorFactor of {label}")
    red, green, blue = np.maximum(color, 0.0).tolist()
    material.specular_color = (red, green, blue)
    material.specular_color_texture = textures.read(part.get("specularColorTexture"), label, srgb=True)


def _read_clearcoat(
    document: Document, textures: TextureReader, material: Material, part: dict[str, Any], label: str
) -> None:
    material.clearcoat = _share(document, part.get("clearcoatFactor", 0.0), f"clearcoatFactor of {label}")
    material.clearcoat_texture = textures.read(part.get("clearcoatTexture"), label, srgb=False)
    rough = part.get("clearcoatRoughnessFactor", 0.0)
    material.clearcoat_roughness = _share(document, rough, f"clearcoatRoughnessFactor of {label}")
    material.clearcoat_roughness_texture = textures.read(part.get("clearcoatRoughnessTexture"), label, srgb=False)
    if part.get("clearcoatNormalTexture") is not None:
        document.warn("A clear coat's own normal map is left out, the surface's serves: {names}.", material.name)


def _share(document: Document, value: Any, where: str) -> float:
    return min(max(document.number(value, where), 0.0), 1.0)
