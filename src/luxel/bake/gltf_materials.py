"""The materials of a baked file: what is shown, and beside it each surface's own, as glTF says it.

A viewer shows the light alone, unlit. Each material stands in the file twice under one name: as it is shown, and as a
variant (KHR_materials_variants) that a viewer or an editor can switch to. Under full materials that has its gloss; what
is shown is diffuse under either.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pygltflib as gltf

from luxel.bake.gltf_gloss import as_metal_rough, describe_gloss, find_thickness
from luxel.bake.gltf_writer import Writer
from luxel.scene.diffuse import as_diffuse_scene
from luxel.scene.host import Looks
from luxel.scene.model import SceneData, Texture
from luxel.scene.textures import to_linear

UNLIT = "KHR_materials_unlit"
VARIANTS = "KHR_materials_variants"
STRENGTH = "KHR_materials_emissive_strength"
TRANSFORM = "KHR_texture_transform"
OWN = "own materials"
"""Name of the variant that holds the surfaces' own materials."""
CUTOFF = 0.5
"""Share of a texel that is no hole, from which the texel shows."""
WRAPS = {"repeat": gltf.REPEAT, "clamp": gltf.CLAMP_TO_EDGE, "mirror": gltf.MIRRORED_REPEAT}


class MaterialWriter:
    """Gives the numbers of a scene's materials in the file, each written on first use."""

    def __init__(
        self, writer: Writer, data: SceneData, picture: np.ndarray, light_set: int, looks: Looks = "diffuse"
    ) -> None:
        """`picture` (H, W, 3 or 4) is what is shown, by the texture coordinates of the set `light_set`.

        `looks`: what of their own materials surfaces keep.
        """
        # What is shown is that of the diffuse condition.
        self.writer, self.data, self.looks = writer, as_diffuse_scene(data), looks
        # Textures are known by their images, which these keep alive.
        self._kept = [as_metal_rough(item) for item in data.materials] if looks == "full" else self.data.materials
        self._textures: dict[tuple[Any, ...], int] = {}
        self._own: dict[int, int] = {}
        self._shown: dict[tuple[int, bool], int] = {}
        # No mip levels: charts stand a texel apart, and smaller pictures would mix them.
        clamp = gltf.CLAMP_TO_EDGE
        light = writer.texture(picture, "lightmap", (gltf.LINEAR, gltf.LINEAR), (clamp, clamp))
        self._light = gltf.TextureInfo(index=light, texCoord=light_set)
        # One and the same for all meshes of a material.
        self._second = {mesh.material: mesh.uv2_set for item in data.objects for mesh in item.meshes if len(mesh.faces)}
        for index in sorted(self._second):
            self._own[index] = self._add(self._describe(index))
        writer.extensions |= {UNLIT, VARIANTS}
        writer.file.extensions = {VARIANTS: {"variants": [{"name": OWN}]}}

    def shown(self, index: int, cut: bool) -> int:
        """Return the unlit material that shows the light of material `index`; `cut`: with the picture's alpha."""
        if (index, cut) not in self._shown:
            rough = gltf.PbrMetallicRoughness(baseColorTexture=self._light, metallicFactor=0.0, roughnessFactor=1.0)
            name = self.data.materials[index].name or f"material-{index}"
            material = gltf.Material(name=name, pbrMetallicRoughness=rough, extensions={UNLIT: {}})
            if cut and self.data.materials[index].alpha_mode == "blend":
                material.alphaMode = gltf.BLEND
            elif cut:
                material.alphaMode, material.alphaCutoff = gltf.MASK, CUTOFF
            self._shown[index, cut] = self._add(material)
        return self._shown[index, cut]

    def variant(self, index: int) -> dict[str, Any]:
        """Return the extensions of a primitive whose own material is `index`."""
        return {VARIANTS: {"mappings": [{"material": self._own[index], "variants": [0]}]}}

    def _add(self, material: gltf.Material) -> int:
        self.writer.file.materials.append(material)
        return len(self.writer.file.materials) - 1

    def _describe(self, index: int) -> gltf.Material:
        """Return a material as glTF says it: factors, textures, alpha, both sides."""
        material, second = self._kept[index], self._second[index]
        rough = gltf.PbrMetallicRoughness(
            baseColorFactor=[*map(float, material.base_color), float(material.alpha)],
            baseColorTexture=self._info(material.base_color_texture, second, colour=True),
            metallicFactor=float(material.metallic),
            roughnessFactor=float(material.roughness),
            metallicRoughnessTexture=self._info(material.metallic_roughness_texture, second),
        )
        described = gltf.Material(
            name=material.name or f"material-{index}",
            pbrMetallicRoughness=rough,
            emissiveFactor=[*map(float, material.emission)],
            emissiveTexture=self._info(material.emission_texture, second, colour=True),
            alphaMode=material.alpha_mode.upper(),
            alphaCutoff=float(material.alpha_cutoff) if material.alpha_mode == "mask" else None,
            doubleSided=material.emit_back,
        )
        normal = self._info(material.normal_texture, second)
        if normal is not None:
            described.normalTexture = gltf.NormalMaterialTexture(
                index=normal.index, texCoord=normal.texCoord, scale=material.normal_scale, extensions=normal.extensions
            )
        brightest = max(material.emission)
        if brightest > 1.0:
            described.emissiveFactor = [float(channel / brightest) for channel in material.emission]
            described.extensions = {STRENGTH: {"emissiveStrength": float(brightest)}}
        if self.looks == "full":
            gloss = describe_gloss(
                material, lambda texture, colour: self._info(texture, second, colour), find_thickness(self.data, index)
            )
            described.extensions = {**(described.extensions or {}), **gloss}
        self.writer.extensions |= set(described.extensions or {})
        return described

    def _info(self, texture: Texture | None, second: int, colour: bool = False) -> gltf.TextureInfo | None:
        """Return the texture as glTF refers to it; `second` is the file's number of the set that luxel calls 1.

        A `colour` is stored by the sRGB curve, data are not.
        """
        if texture is None:
            return None
        key = (id(texture.image), colour, texture.srgb, texture.wrap_u, texture.wrap_v, texture.nearest)
        if key not in self._textures:
            far = gltf.NEAREST if texture.nearest else gltf.LINEAR_MIPMAP_LINEAR
            reach = (gltf.NEAREST if texture.nearest else gltf.LINEAR, far)
            wrap = (WRAPS[texture.wrap_u], WRAPS[texture.wrap_v])
            name = f"texture-{len(self._textures)}"
            self._textures[key] = self.writer.texture(_pixels(texture, colour), name, reach, wrap)
        info = gltf.TextureInfo(index=self._textures[key], texCoord=second if texture.uv_set else 0)
        if not np.allclose(texture.transform, np.eye(3)):
            info.extensions = {TRANSFORM: _taken_apart(texture.transform)}
            self.writer.extensions.add(TRANSFORM)
        return info


def _pixels(texture: Texture, colour: bool) -> np.ndarray:
    """Return the picture as glTF stores it: colours by the sRGB curve, data as they are."""
    if texture.srgb == colour:
        return texture.image if texture.image.ndim == 3 else texture.image[..., None]
    linear = to_linear(texture)
    if not colour:
        return linear
    rgb = linear[..., :3]
    linear[..., :3] = np.where(rgb <= 0.0031308, 12.92 * rgb, 1.055 * np.maximum(rgb, 1e-9) ** (1.0 / 2.4) - 0.055)
    has_alpha = texture.image.ndim == 3 and texture.image.shape[2] == 4
    return linear if has_alpha else linear[..., :3]


def _taken_apart(matrix: np.ndarray) -> dict[str, Any]:
    """Return offset, rotation and scale of a transform (3, 3) of texture coordinates; a shear is left out."""
    (a, b, x), (c, d, y) = np.asarray(matrix, float)[:2]
    scale = [math.hypot(a, c), math.hypot(b, d)]
    if a * d - b * c < 0.0:
        scale[1] = -scale[1]
    return {"offset": [x, y], "rotation": math.atan2(-c, a), "scale": scale}
