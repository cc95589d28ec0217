"""KHR_materials_transmission: glass lets its share of light pass straight on, as a surface with holes in it would.

A ray passes with the probability 1 - alpha, so alpha is what transmission leaves. Refraction, tint and roughness of
the glass are left out, and named.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from luxel.scene.gltf.document import Document
from luxel.scene.gltf.textures import TextureReader, unit_values
from luxel.scene.model import Material, Texture

TRANSMISSION = "KHR_materials_transmission"


def let_light_pass(
    document: Document, textures: TextureReader, material: Material, part: dict[str, Any], share: float, label: str
) -> None:
    """Lower the alpha of `material` by what the extension `part` lets pass; `share` of it is no metal.

    A lamp of glass still has to be met by rays: it keeps its emission and loses what it would reflect.
    """
    stated = document.number(part.get("transmissionFactor") or 0.0, f"transmissionFactor of {label}")
    factor = min(max(stated, 0.0), 1.0) * share
    if factor == 0.0:
        return
    texture = textures.read(part.get("transmissionTexture"), label, srgb=False)
    if max(material.emission) > 0.0:
        mean = 1.0 if texture is None else float(unit_values(texture.image)[..., 0].mean())
        document.warn("Glass that shines lets no light pass, it only reflects less: {names}.", material.name)
        red, green, blue = (channel * (1.0 - factor * mean) for channel in material.base_color)
        material.base_color = (red, green, blue)
        return
    document.warn("Glass is not refracted or tinted, light passes straight through it: {names}.", material.name)
    if material.alpha_mode == "mask":
        _cut_out(material)
    material.alpha_mode = "blend"
    if texture is None:
        material.alpha *= 1.0 - factor
        return
    kept = 1.0 - factor * unit_values(texture.image)[..., 0]
    base = material.base_color_texture
    if base is None:
        white = np.ones((*kept.shape, 3))
        texture.image, texture.srgb = _pack(white, kept), True
        material.base_color_texture = texture
    elif _lies_alike(base, texture):
        colour, alpha = _split(base, max(base.image.shape[0], len(kept)), max(base.image.shape[1], len(kept[0])))
        base.image = _pack(colour, alpha * _enlarge(kept, *alpha.shape))
    else:
        document.warn(
            "Transmission textures that lie otherwise than the colour's are averaged: {names}.", material.name
        )
        material.alpha *= float(kept.mean())


def _cut_out(material: Material) -> None:
    """Turn a cut-out's alpha into 0 or 1, so that a share of what stands can pass."""
    base, cutoff = material.base_color_texture, material.alpha_cutoff
    if base is not None and base.image.shape[2] == 4:
        colour, alpha = _split(base, *base.image.shape[:2])
        base.image = _pack(colour, (alpha * material.alpha >= cutoff).astype(np.float64))
        material.alpha = 1.0
    else:
        material.alpha = 1.0 if material.alpha >= cutoff else 0.0


def _lies_alike(one: Texture, other: Texture) -> bool:
    same = (one.uv_set, one.wrap_u, one.wrap_v) == (other.uv_set, other.wrap_u, other.wrap_v)
    return same and bool(np.allclose(one.transform, other.transform))


def _split(texture: Texture, height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """(H, W, 3) colour as stored and (H, W) alpha from 0 to 1, at the given size or above."""
    values = _enlarge(unit_values(texture.image), height, width)
    return values[..., :3], values[..., 3] if values.shape[2] == 4 else np.ones(values.shape[:2])


def _enlarge(values: np.ndarray, height: int, width: int) -> np.ndarray:
    """`values` (H, W, ...) at another size: each texel from the one it lies in."""
    rows = np.arange(height) * len(values) // height
    columns = np.arange(width) * values.shape[1] // width
    return values[rows][:, columns]


def _pack(colour: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    return np.rint(np.concatenate([colour, alpha[..., None]], axis=2) * 255.0).astype(np.uint8)
