"""A `luxel.Material` as Mitsuba's BSDFs, for `oracle.py`.

A file's materials come back as they were: plastics, conductors by index, dielectrics, panes, `principled`, masks, and
blends of those. What Mitsuba has no BSDF for is the nearest that it has: glTF's coat is a plastic with the same
reflectance at normal incidence (under a textured roughness `principled`), a clear coat that of `principled`, which is a
quarter of glTF's, and a rough pane `principledthin`. Scattering between facets (`compensate`) is left out.
"""

from __future__ import annotations

import math
from typing import Any

import mitsuba as mi
import numpy as np

from luxel.scene.diffuse import mean_metallic
from luxel.scene.model import Colour, Material, Texture
from luxel.scene.rules import HIGHEST_IOR
from luxel.scene.textures import to_linear

Description = dict[str, Any]

SMOOTH = 1e-3
"""Microfacets narrower than this (alpha) are a mirror, as in luxel's BSDF."""
LEAST_ROUGHNESS = 0.03
"""Mitsuba's `principled` is no mirror."""
HIGHEST_F0 = 0.9
"""Of a coat: Mitsuba's plastic needs an index, and light has to get into it."""
CLEARCOAT_SHARE, CLEARCOAT_ALPHA = 0.25, (0.1, 0.001)
"""Weight of a full clear coat of `principled`, and its width at gloss 0 and 1."""


def describe_material(material: Material) -> Description:
    """Return the BSDF of `material` as Mitsuba's `load_dict` takes it."""
    bsdf = _describe_surface(material)
    if material.alpha_mode != "opaque":
        bsdf = {"type": "mask", "opacity": _describe_opacity(material), "bsdf": bsdf}
    return bsdf


def describe_medium(material: Material) -> Description | None:
    """Return what fills the glass that `material` bounds, or None where it takes no light."""
    if material.transmission <= 0.0 or material.thin or math.isinf(material.attenuation_distance):
        return None
    colour = np.clip(np.asarray(material.attenuation_color, np.float64), 1e-12, 1.0)
    absorbed = -np.log(colour) / material.attenuation_distance
    if absorbed.max() <= 0.0:
        return None
    # A spectrum of an "rgb" ends at one.
    most = float(absorbed.max())
    return {"type": "homogeneous", "albedo": 0.0, "sigma_t": _rgb(absorbed / most), "scale": most}


def passes_straight(material: Material) -> bool:
    """Return whether shadow rays get through the surface, or light is lost inside: `path` of Mitsuba knows neither."""
    pane = material.thin and material.transmission > 0.0
    return material.alpha_mode != "opaque" or pane or describe_medium(material) is not None


# ---------- Surfaces ----------


def _describe_surface(material: Material) -> Description:
    """Return the BSDF but for holes: a mixture of metal, glass and what scatters, each under its interface."""
    solid = material.transmission > 0.0 and not material.thin
    if _is_principled(material):
        whole = _describe_principled(material)
        return _on_both_sides(material, _bend(material, whole), material.transmission <= 0.0)
    both = material.reflect_back and material.transmission > 0.0 and not solid
    opaque, metal = _describe_opaque(material), _describe_metal(material)
    share = _describe_share(material.transmission, material.transmission_texture, 0)
    dielectric = _blend(share, _on_both_sides(material, opaque, both), _describe_glass(material))
    metallic = _describe_share(material.metallic, material.metallic_roughness_texture, 2)
    whole = _bend(material, _blend(metallic, dielectric, _on_both_sides(material, metal, both)))
    return _on_both_sides(material, whole, not both and material.transmission <= 0.0)


def _is_principled(material: Material) -> bool:
    """Return whether Mitsuba's `principled` is the nearest to all of the surface."""
    coated = material.specular > 0.0 and (material.transmission < 1.0 or material.transmission_texture is not None)
    varies = material.metallic_roughness_texture is not None and material.eta is None
    by_gltf = material.interface == "gltf" and coated and varies
    return material.interface == "principled" or material.clearcoat > 0.0 or by_gltf


def _describe_opaque(material: Material) -> Description:
    """Return what scatters evenly, under its coat."""
    base = describe_color(material.base_color, material.base_color_texture, limit=1.0)
    bare: Description = {"type": "diffuse", "reflectance": base}
    if material.specular <= 0.0 or material.metallic >= 1.0 and material.metallic_roughness_texture is None:
        return bare
    plastic = material.interface == "plastic"
    brightest = max(*material.specular_color, 1e-6)
    f0 = 1.0 if material.ior == 0.0 else ((material.ior - 1.0) / (material.ior + 1.0)) ** 2
    # glTF's colour multiplies the reflectance at normal incidence, which is an index; plastic's the reflection.
    f0 = f0 if plastic else min(f0 * brightest, HIGHEST_F0)
    if f0 < 1e-6:
        return bare
    colour = _scaled(material.specular_color, material.specular if plastic else 1.0 / brightest)
    coated = {
        **_facets(material, "plastic", mean=True),
        "diffuse_reflectance": base,
        "specular_reflectance": describe_color(colour, material.specular_color_texture, limit=1.0),
        "int_ior": (1.0 + math.sqrt(f0)) / (1.0 - math.sqrt(f0)),
        "ext_ior": 1.0,
        "nonlinear": material.nonlinear,
    }
    return coated if plastic else _blend(_describe_share(material.specular, material.specular_texture, 3), bare, coated)


def _describe_metal(material: Material) -> Description:
    """Return the metal: by its index, or by its base colour."""
    if material.eta is not None:
        index = {"eta": _rgb(material.eta), "k": _rgb(material.k or (0.0, 0.0, 0.0))}
        tint = describe_color(material.specular_color, material.specular_color_texture, limit=1.0)
        return {**_facets(material, "conductor"), **index, "specular_reflectance": tint}
    return {
        "type": "principled",
        "base_color": describe_color(material.base_color, material.base_color_texture, limit=1.0),
        "roughness": _describe_roughness(material),
        "metallic": 1.0,
    }


def _describe_glass(material: Material) -> Description:
    """Return the glass, tinted by the base colour."""
    base = describe_color(material.base_color, material.base_color_texture, limit=1.0)
    if material.thin and not _is_smooth(material):
        return {"type": "principledthin", "base_color": base, "spec_trans": 1.0, **_describe_pane(material)}
    colour = _scaled(material.specular_color, material.specular)
    return {
        **({"type": "thindielectric"} if material.thin else _facets(material, "dielectric")),
        "specular_transmittance": base,
        "specular_reflectance": describe_color(colour, material.specular_color_texture, limit=1.0),
        "int_ior": material.ior if material.ior > 0.0 else HIGHEST_IOR,
        "ext_ior": 1.0,
    }


def _describe_principled(material: Material) -> Description:
    thin = material.thin and material.transmission > 0.0
    base = describe_color(material.base_color, material.base_color_texture, limit=1.0)
    if material.transmission > 0.0 and not thin:
        base = _describe_glass_color(material)
    share = _describe_share(material.transmission, material.transmission_texture, 0)
    shared = {"base_color": base, "roughness": _describe_roughness(material), "spec_trans": share}
    if thin:
        return {"type": "principledthin", **shared, **_describe_pane(material)}
    index = {"eta": material.ior} if material.ior > 1.001 else {"specular": 0.0}
    weight = min(material.clearcoat / CLEARCOAT_SHARE, 1.0)
    wide, narrow = CLEARCOAT_ALPHA
    gloss = min(max((wide - material.clearcoat_roughness**2) / (wide - narrow), 0.0), 1.0)
    return {
        "type": "principled",
        **shared,
        **(index if material.specular > 0.0 else {"specular": 0.0}),
        "metallic": _describe_share(material.metallic, material.metallic_roughness_texture, 2),
        "clearcoat": _describe_share(weight, material.clearcoat_texture, 0),
        "clearcoat_gloss": gloss,
    }


def _describe_pane(material: Material) -> Description:
    """Return index and roughness of `principledthin`, which reflects as one face does, and lets light spread less."""
    face = ((material.ior - 1.0) / (material.ior + 1.0)) ** 2
    both = min(2.0 * face / (1.0 + face), HIGHEST_F0)
    index = max((1.0 + math.sqrt(both)) / (1.0 - math.sqrt(both)), 1.0001)
    spread = min(0.65 * index - 0.35, 1.0)
    roughness = min(material.roughness / spread, 1.0)
    return {
        "eta": index,
        "roughness": _describe_share(roughness, material.metallic_roughness_texture, 1, floor=LEAST_ROUGHNESS),
    }


def _describe_glass_color(material: Material) -> Description:
    """Return the base colour of `principled`, whose glass is tinted by the root of it: the reader's mixture, undone."""
    clear = (
        1.0 if material.transmission_texture is None else float(to_linear(material.transmission_texture)[..., 0].mean())
    )
    glass = material.transmission * clear * (1.0 - mean_metallic(material))

    def undone(colour: np.ndarray) -> np.ndarray:
        # The root s of s^2 (1 - glass) + s glass = colour.
        root = 2.0 * colour / np.maximum(glass + np.sqrt(glass**2 + 4.0 * (1.0 - glass) * colour), 1e-12)
        return root**2

    texture = material.base_color_texture
    if texture is None:
        return _rgb(undone(np.clip(material.base_color, 0.0, 1.0)))
    image = to_linear(texture)[..., :3] * np.asarray(material.base_color, np.float32)
    return _describe_texture(undone(np.clip(image, 0.0, 1.0)), texture)


def _facets(material: Material, kind: str, *, mean: bool = False) -> Description:
    """Return the type of a smooth or rough BSDF of that `kind`, with the width of its facets; `mean`: one number."""
    if _is_smooth(material):
        return {"type": kind}
    texture, alpha = material.metallic_roughness_texture, max(material.roughness**2, SMOOTH)
    described: Any = alpha
    if texture is not None:
        values = np.maximum((to_linear(texture)[..., 1:2] * material.roughness) ** 2, SMOOTH)
        described = float(values.mean()) if mean else _describe_texture(values, texture)
    return {"type": f"rough{kind}", "alpha": described, "distribution": material.distribution}


def _is_smooth(material: Material) -> bool:
    return material.roughness**2 < SMOOTH


def _describe_roughness(material: Material) -> Any:
    return _describe_share(material.roughness, material.metallic_roughness_texture, 1, floor=LEAST_ROUGHNESS)


def _on_both_sides(material: Material, bsdf: Description, wanted: bool) -> Description:
    return {"type": "twosided", "bsdf": bsdf} if wanted and material.reflect_back else bsdf


def _bend(material: Material, bsdf: Description) -> Description:
    """Return `bsdf` under the normal map, where there is one."""
    if material.normal_texture is None:
        return bsdf
    local = to_linear(material.normal_texture)[..., :3].copy()
    # glTF: +v of the image points down, +green of the map points up.
    local[..., :2] = 0.5 + (local[..., :2] - 0.5) * material.normal_scale * np.array([1.0, -1.0])
    return {"type": "normalmap", "normalmap": _describe_texture(local, material.normal_texture), "bsdf": bsdf}


def _blend(weight: Any, first: Description, second: Description) -> Description:
    """Return `first` where `weight` (a number or a texture) is 0 and `second` where it is 1."""
    if not isinstance(weight, dict) and weight in (0.0, 1.0):
        return second if weight else first
    return {"type": "blendbsdf", "weight": weight, "first": first, "second": second}


# ---------- Values ----------


def describe_color(factor: Colour, texture: Texture | None, limit: float | None) -> Description:
    """Return a colour, or a texture times it, at most `limit`."""
    if texture is None:
        return _rgb([float(channel) if limit is None else min(channel, limit) for channel in factor])
    image = to_linear(texture)[..., :3] * np.asarray(factor, np.float32)
    return _describe_texture(image if limit is None else np.minimum(image, limit), texture)


def describe_emission(material: Material) -> Description:
    """Return the radiance. Mitsuba's masks take nothing from it, ours do: it is weighed by the opacity."""
    texture, base = material.emission_texture, material.base_color_texture
    if material.alpha_mode == "opaque":
        return describe_color(material.emission, texture, limit=None)
    share = _opacity(material)
    if share.ndim == 0:
        return describe_color(_scaled(material.emission, float(share)), texture, limit=None)
    image = share * np.asarray(material.emission, np.float32)
    if texture is not None:
        rows, columns = (np.arange(share.shape[k]) * texture.image.shape[k] // share.shape[k] for k in (0, 1))
        image = image * to_linear(texture)[rows][:, columns, :3]
    assert base is not None
    return _describe_texture(image, base)


def _rgb(values: Any) -> Description:
    return {"type": "rgb", "value": [float(channel) for channel in values]}


def _scaled(colour: Colour, factor: float) -> Colour:
    red, green, blue = (float(channel) * factor for channel in colour)
    return red, green, blue


def _describe_share(factor: float, texture: Texture | None, channel: int, floor: float = 0.0) -> Any:
    """Return a number, or a grey texture of one channel times `factor`; never below `floor`."""
    if texture is None or factor == 0.0:
        return max(float(factor), floor)
    values = np.clip(to_linear(texture)[..., channel : channel + 1] * factor, floor, 1.0)
    return _describe_texture(values, texture)


def _opacity(material: Material) -> np.ndarray:
    """Return the share of rays that the surface stops: one number, or (H, W, 1) on the grid of the base texture."""
    texture = material.base_color_texture
    alpha = np.asarray(material.alpha, np.float32)
    if texture is not None:
        alpha = to_linear(texture)[..., 3:] * alpha
    return (alpha >= material.alpha_cutoff).astype(np.float32) if material.alpha_mode == "mask" else alpha


def _describe_opacity(material: Material) -> Any:
    texture, alpha = material.base_color_texture, _opacity(material)
    return float(alpha) if texture is None else _describe_texture(alpha, texture)


def _describe_texture(image: np.ndarray, texture: Texture) -> Description:
    return {
        "type": "bitmap",
        "bitmap": mi.Bitmap(np.ascontiguousarray(image, np.float32)),
        "raw": True,
        "filter_type": "nearest" if texture.nearest else "bilinear",
        "wrap_mode": texture.wrap_u,
        "to_uv": mi.ScalarTransform3f(np.asarray(texture.transform, np.float64)),
    }
