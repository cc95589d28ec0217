"""The diffuse condition: what of a material is left where surfaces only scatter light evenly and let it pass straight.

Methods are compared under it, and committed truths are made under it. Albedo is base_color x (1 - metallic), which the
device works out. Glass lets its share of light pass straight on, as a surface with holes in it would: a ray passes
with the probability 1 - alpha, so alpha is what transmission leaves. Other fields of gloss go back to their default.
"""

from __future__ import annotations

from copy import copy
from dataclasses import MISSING, fields, replace
from typing import Any

import numpy as np

from luxel.scene.model import Material, SceneData, Texture

GLOSS = (
    "ior", "specular", "specular_texture", "specular_color", "specular_color_texture", "transmission",
    "transmission_texture", "thin", "attenuation_color", "attenuation_distance", "clearcoat", "clearcoat_texture",
    "clearcoat_roughness", "clearcoat_roughness_texture", "eta", "k", "distribution", "compensate", "interface",
    "nonlinear", "diffuse",
)  # fmt: skip
"""Fields that the diffuse condition does not know."""
SHOWN = (
    "base_color", "base_color_texture", "metallic", "roughness", "metallic_roughness_texture", "alpha", "alpha_mode",
    "alpha_cutoff", "reflect_back",
)  # fmt: skip
"""Fields that are taken of `Material.diffuse`."""
DEFAULTS: dict[str, Any] = {
    item.name: item.default for item in fields(Material) if item.name in GLOSS and item.default is not MISSING
}


def as_diffuse(material: Material) -> Material:
    """Return what the diffuse condition shows of `material`; itself where that is all it has."""
    known = material.diffuse
    if known is None and all(getattr(material, name) == default for name, default in DEFAULTS.items()):
        return material
    # All values have been checked, and files may have thousands of materials: no need to set them one by one.
    plain = copy(material)
    vars(plain).update(DEFAULTS)
    if known is not None:
        vars(plain).update({name: getattr(known, name) for name in SHOWN})
        if max(known.emission) > 0.0:
            plain.emission = known.emission
        return plain
    share = 1.0 - mean_metallic(material)
    if material.transmission * share > 0.0:
        _let_light_pass(plain, material.transmission * share, material.transmission_texture)
    return plain


def as_diffuse_scene(data: SceneData) -> SceneData:
    """Return `data` with `as_diffuse` of each material; itself where that is all they have."""
    materials = [as_diffuse(material) for material in data.materials]
    changed = any(new is not old for new, old in zip(materials, data.materials, strict=True))
    return replace(data, materials=materials) if changed else data


def mean_metallic(material: Material) -> float:
    """Return the share of a material that is metal, in the mean over its texture."""
    texture = material.metallic_roughness_texture
    if texture is None or material.metallic == 0.0:
        return material.metallic
    return material.metallic * float(unit_values(texture.image)[..., 2].mean())


def unit_values(image: np.ndarray) -> np.ndarray:
    """Return the pixels of an image as numbers from 0 to 1, float64."""
    return image / 255.0 if image.dtype == np.uint8 else image.astype(np.float64)


def lies_alike(one: Texture, other: Texture) -> bool:
    """Return whether two textures put the same points of their images on a point of a surface."""
    same = (one.uv_set, one.wrap_u, one.wrap_v) == (other.uv_set, other.wrap_u, other.wrap_v)
    return same and bool(np.allclose(one.transform, other.transform))


def _let_light_pass(material: Material, factor: float, texture: Texture | None) -> None:
    """Lower the alpha of `material` by the share `factor` that passes, which `texture` (red) multiplies.

    A lamp of glass still has to be met by rays: it keeps its emission and loses what it would reflect.
    """
    if max(material.emission) > 0.0:
        mean = 1.0 if texture is None else float(_red(texture).mean())
        red, green, blue = (channel * (1.0 - factor * mean) for channel in material.base_color)
        material.base_color = (red, green, blue)
        return
    if material.alpha_mode == "mask":
        _cut_out(material)
    material.alpha_mode = "blend"
    if texture is None:
        material.alpha *= 1.0 - factor
        return
    kept = 1.0 - factor * _red(texture)
    base = material.base_color_texture
    if base is None:
        image = _pack(np.ones((*kept.shape, 3)), kept)
        material.base_color_texture = replace(texture, image=image, srgb=True)
    elif lies_alike(base, texture):
        colour, alpha = _split(base, max(base.image.shape[0], len(kept)), max(base.image.shape[1], len(kept[0])))
        image = _pack(colour, alpha * _enlarge(kept, *alpha.shape))
        material.base_color_texture = replace(base, image=image)
    else:
        material.alpha *= float(kept.mean())


def _cut_out(material: Material) -> None:
    """Turn a cut-out's alpha into 0 or 1, so that a share of what stands can pass."""
    base, cutoff = material.base_color_texture, material.alpha_cutoff
    if base is not None and base.image.ndim == 3 and base.image.shape[2] == 4:
        colour, alpha = _split(base, *base.image.shape[:2])
        image = _pack(colour, (alpha * material.alpha >= cutoff).astype(np.float64))
        material.base_color_texture = replace(base, image=image)
        material.alpha = 1.0
    else:
        material.alpha = 1.0 if material.alpha >= cutoff else 0.0


def _red(texture: Texture) -> np.ndarray:
    """Return (H, W): the first channel, from 0 to 1."""
    values = unit_values(texture.image)
    return values if values.ndim == 2 else values[..., 0]


def _split(texture: Texture, height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (H, W, 3) colour as stored and (H, W) alpha from 0 to 1, at the given size or above."""
    values = unit_values(texture.image)
    values = _enlarge(values if values.ndim == 3 else values[..., None], height, width)
    colour = values[..., :3] if values.shape[2] >= 3 else np.repeat(values[..., :1], 3, axis=2)
    return colour, values[..., 3] if values.shape[2] == 4 else np.ones(values.shape[:2])


def _enlarge(values: np.ndarray, height: int, width: int) -> np.ndarray:
    """Return `values` (H, W, ...) at another size: each texel from the one it lies in."""
    rows = np.arange(height) * len(values) // height
    columns = np.arange(width) * values.shape[1] // width
    return values[rows][:, columns]


def _pack(colour: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    return np.rint(np.concatenate([colour, alpha[..., None]], axis=2) * 255.0).astype(np.uint8)
