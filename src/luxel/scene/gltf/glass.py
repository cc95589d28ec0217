"""Glass: KHR_materials_transmission and KHR_materials_volume.

Without a volume, or with one of no thickness, glass is a pane that does not bend light. `scene/diffuse.py` says what
the diffuse condition makes of it; what is not lit is named.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from luxel.scene.diffuse import lies_alike, mean_metallic
from luxel.scene.gltf.document import Document
from luxel.scene.gltf.textures import TextureReader
from luxel.scene.model import Material

TRANSMISSION, VOLUME = "KHR_materials_transmission", "KHR_materials_volume"


def read_glass(
    document: Document, textures: TextureReader, material: Material, extensions: dict[str, Any], label: str
) -> bool:
    """Fill what the extensions say of glass; return whether light passes through it under the diffuse condition."""
    part, volume = extensions.get(TRANSMISSION), extensions.get(VOLUME)
    if volume is not None:
        _read_volume(document, material, volume, label)
    if part is None:
        return False
    stated = document.number(part.get("transmissionFactor") or 0.0, f"transmissionFactor of {label}")
    material.transmission = min(max(stated, 0.0), 1.0)
    material.transmission_texture = textures.read(part.get("transmissionTexture"), label, srgb=False)
    thickness = 0.0 if volume is None else volume.get("thicknessFactor", 0.0)
    material.thin = document.number(thickness, f"thicknessFactor of {label}") <= 0.0
    if material.thin and np.isfinite(material.attenuation_distance):
        document.warn("Glass without thickness swallows nothing, whatever its attenuation: {names}.", material.name)
    if material.transmission * (1.0 - mean_metallic(material)) == 0.0:
        return False
    return _name_what_is_left_out(document, material)


def _read_volume(document: Document, material: Material, part: dict[str, Any], label: str) -> None:
    """Fill colour and distance of the attenuation. How thick a volume is, rays find out themselves."""
    colour = document.numbers(part.get("attenuationColor") or (1.0, 1.0, 1.0), 3, f"attenuationColor of {label}")
    red, green, blue = np.clip(colour, 0.0, 1.0).tolist()
    material.attenuation_color = (red, green, blue)
    stated = part.get("attenuationDistance")
    if stated is not None:
        distance = document.number(stated, f"attenuationDistance of {label}")
        if distance <= 0.0:
            document.warn("Attenuation distances of zero or less are none: {names}.", material.name)
        else:
            material.attenuation_distance = distance


def _name_what_is_left_out(document: Document, material: Material) -> bool:
    """Return whether light passes under the diffuse condition: there a lamp of glass still has to be met by rays."""

    def name(sentence: str) -> None:
        document.warn(sentence, material.name, diffuse_only=True)

    if max(material.emission) > 0.0:
        name("Glass that shines lets no light pass, it only reflects less: {names}.")
        return False
    name("Glass is not refracted or tinted, light passes straight through it: {names}.")
    base, texture = material.base_color_texture, material.transmission_texture
    if base is not None and texture is not None and not lies_alike(base, texture):
        name("Transmission textures that lie otherwise than the colour's are averaged: {names}.")
    return True
