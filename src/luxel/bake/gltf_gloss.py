"""Gloss as glTF says it: what coats, metals and glass become there, and the extensions that hold them.

Files of glTF come back as they were. What only Mitsuba knows takes the nearest form, and is named.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pygltflib as gltf

from luxel.scene.diffuse import mean_metallic
from luxel.scene.gloss import is_glossy
from luxel.scene.gltf.coats import CLEARCOAT, IOR, SPECULAR
from luxel.scene.gltf.glass import TRANSMISSION, VOLUME
from luxel.scene.model import Colour, Material, SceneData, Texture
from luxel.scene.textures import to_linear

DEFAULT_IOR = 1.5
"""Of glTF, where KHR_materials_ior says nothing."""
NAMED = 8
"""Materials that a sentence names."""
ANGLES = 1024
"""Cosines over which a Fresnel term is averaged."""
THINNEST = 1e-6
"""Thickness that glass has at least, in the mesh's units: none at all would make it a pane."""
HALF = 0.5
"""Share of metal or glass from which the texture shows little of a surface."""
DARK = "The texture holds diffuse light, metals are black there and glass lets it through"
CONDUCTOR = "Metals of a complex index stand in the file by the colour that they reflect straight on"
MIXED = "Metals of a complex index that share a surface with another material take the mean colour of both"
PLASTIC = "Plastics stand in the file as a base under glTF's coat"
PRINCIPLED = "Principled materials stand in the file as glTF's metal and coat"
BECKMANN = "Facets of Beckmann's distribution stand in the file with the same roughness, which is read as GGX"
THINNER = "Glass that is thinner inside than outside stands in the file with the index 1"

Info = Callable[[Texture | None, bool], gltf.TextureInfo | None]
"""(texture, is it a colour) -> how the file refers to it."""


def name_approximations(data: SceneData) -> list[str]:
    """Return what of the scene's gloss a .glb holds in another form, one sentence each, with the materials' names."""
    found: dict[str, list[str]] = {}
    for name, material in _used(data):
        for sentence in _differences(material):
            found.setdefault(sentence, []).append(name)
    return [f"{sentence}: {_list(names)}." for sentence, names in found.items()]


def name_dark(data: SceneData) -> list[str]:
    """Return one sentence on the materials of which the texture shows little, as it holds diffuse light; or none."""
    names = [name for name, material in _used(data) if max(mean_metallic(material), material.transmission) >= HALF]
    return [f"{DARK}: {_list(names)}."] if names else []


def as_metal_rough(material: Material) -> Material:
    """Return the material in the terms of glTF: no complex index, no plastic; itself where it has neither."""
    if material.eta is not None and material.metallic > 0.0:
        material = _by_colour(material)
    if material.nonlinear and material.specular > 0.0:
        material = replace(material, base_color=_without_inside(material), nonlinear=False)
    return material


def describe_gloss(material: Material, info: Info, thickness: float) -> dict[str, Any]:
    """Return the extensions of a material in glTF's terms; fields at glTF's default are left out.

    `thickness` of glass, in the mesh's units, is for viewers that do not trace rays.
    """
    parts: dict[str, Any] = {}
    ior = _index(material)
    if not math.isclose(ior, DEFAULT_IOR):
        parts[IOR] = {"ior": ior}
    specular = {
        **_factor("specularFactor", material.specular, 1.0),
        **_texture("specularTexture", info(material.specular_texture, False)),
        **_colour("specularColorFactor", material.specular_color),
        **_texture("specularColorTexture", info(material.specular_color_texture, True)),
    }
    if specular:
        parts[SPECULAR] = specular
    if material.transmission > 0.0:
        parts[TRANSMISSION] = {
            **_factor("transmissionFactor", material.transmission, 0.0),
            **_texture("transmissionTexture", info(material.transmission_texture, False)),
        }
        if not material.thin:
            parts[VOLUME] = _volume(material, thickness)
    if material.clearcoat > 0.0:
        parts[CLEARCOAT] = {
            **_factor("clearcoatFactor", material.clearcoat, 0.0),
            **_texture("clearcoatTexture", info(material.clearcoat_texture, False)),
            **_factor("clearcoatRoughnessFactor", material.clearcoat_roughness, 0.0),
            **_texture("clearcoatRoughnessTexture", info(material.clearcoat_roughness_texture, False)),
        }
    return parts


def find_thickness(data: SceneData, index: int) -> float:
    """Return how thick the solids of material `index` are: the shortest side of their boxes, in the mesh's units."""
    meshes = [mesh for item in data.objects for mesh in item.meshes if mesh.material == index and len(mesh.faces)]
    sides = [float(np.ptp(mesh.positions[np.unique(mesh.faces)], axis=0).min()) for mesh in meshes]
    return max(min(sides, default=0.0), THINNEST)


# ---------- Parts ----------


def _index(material: Material) -> float:
    """Return the index as glTF has it, 0 or from 1: a coat reflects alike with its inverse, glass cannot bend so."""
    if not 0.0 < material.ior < 1.0:
        return float(material.ior)
    return 1.0 if material.transmission > 0.0 or material.interface == "plastic" else 1.0 / material.ior


def _volume(material: Material, thickness: float) -> dict[str, Any]:
    part = {"thicknessFactor": thickness, **_colour("attenuationColor", material.attenuation_color)}
    if np.isfinite(material.attenuation_distance):
        part["attenuationDistance"] = float(material.attenuation_distance)
    return part


def _factor(name: str, value: float, default: float) -> dict[str, Any]:
    return {} if value == default else {name: float(value)}


def _colour(name: str, value: Colour) -> dict[str, Any]:
    return {} if tuple(value) == (1.0, 1.0, 1.0) else {name: [float(channel) for channel in value]}


def _texture(name: str, info: gltf.TextureInfo | None) -> dict[str, Any]:
    if info is None:
        return {}
    moved = {"extensions": info.extensions} if info.extensions else {}
    return {name: {"index": info.index, "texCoord": info.texCoord, **moved}}


# ---------- Other terms ----------


def _by_colour(material: Material) -> Material:
    """Return a metal of a complex index by what it reflects straight on; its colour's texture goes along."""
    eta, k = np.asarray(material.eta), np.asarray(material.k or (0.0, 0.0, 0.0))
    straight = ((eta - 1.0) ** 2 + k**2) / np.maximum((eta + 1.0) ** 2 + k**2, 1e-30)
    metal = np.clip(straight * material.specular_color, 0.0, 1.0)
    share = mean_metallic(material)
    if share < 1.0:
        mixed = share * metal + (1.0 - share) * np.asarray(material.base_color)
        return replace(material, base_color=_triple(mixed), eta=None, k=None)
    texture = material.specular_color_texture
    if material.alpha_mode != "opaque" and material.base_color_texture is not None:
        texture = _alpha_alone(material.base_color_texture)
    return replace(
        material, base_color=_triple(metal), base_color_texture=texture, specular_color=(1.0, 1.0, 1.0),
        specular_color_texture=None, eta=None, k=None,
    )  # fmt: skip


def _alpha_alone(texture: Texture) -> Texture:
    """Return the texture in white: a metal of a complex index has no other colour, only holes."""
    image = texture.image.copy()
    if image.ndim < 3:
        return replace(texture, image=np.full_like(image, 255 if image.dtype == np.uint8 else 1.0))
    image[..., :3] = 255 if image.dtype == np.uint8 else 1.0
    return replace(texture, image=image)


def _without_inside(material: Material) -> Colour:
    """Return the base colour that glTF's coat wants for the plastic's: less by the reflections inside (Mitsuba)."""
    cosine = (np.arange(ANGLES) + 0.5) / ANGLES
    ior = max(material.ior, 1.0)
    inner = np.sqrt(1.0 - (1.0 - cosine**2) / ior**2)
    along = (ior * cosine - inner) / (ior * cosine + inner)
    across = (cosine - ior * inner) / (cosine + ior * inner)
    outside = float((cosine * (along**2 + across**2)).mean())
    inside = 1.0 - (1.0 - outside) / ior**2
    mean = np.asarray(material.base_color)
    texture = material.base_color_texture
    if texture is not None:
        mean = mean * to_linear(texture)[..., :3].mean(axis=(0, 1))
    return _triple(np.asarray(material.base_color) * (1.0 - inside) / (1.0 - mean * inside))


def _triple(values: np.ndarray) -> Colour:
    red, green, blue = values.tolist()
    return red, green, blue


# ---------- Words ----------


def _used(data: SceneData) -> Iterator[tuple[str, Material]]:
    """Yield (name, material) of what surfaces have."""
    for index in sorted({mesh.material for item in data.objects for mesh in item.meshes if len(mesh.faces)}):
        yield f"'{data.materials[index].name or f'material-{index}'}'", data.materials[index]


def _differences(material: Material) -> Iterator[str]:
    if not is_glossy(material):
        return
    if material.eta is not None and material.metallic > 0.0:
        yield CONDUCTOR if mean_metallic(material) == 1.0 else MIXED
    if material.interface == "plastic" and material.specular > 0.0 and material.transmission < 1.0:
        yield PLASTIC
    if material.interface == "principled":
        yield PRINCIPLED
    if material.distribution == "beckmann":
        yield BECKMANN
    if material.transmission > 0.0 and 0.0 < material.ior < 1.0:
        yield THINNER


def _list(names: list[str]) -> str:
    names = list(dict.fromkeys(names))
    return ", ".join(names[:NAMED]) + (f" and {len(names) - NAMED} more" if len(names) > NAMED else "")
