"""glTF materials to `Material`.

Choices where the two models differ:
- alpha OPAQUE: alpha is not read. MASK: the file's cutoff (0.5 where it names none). BLEND: a ray passes with the
  probability 1 - alpha.
- KHR_materials_pbrSpecularGlossiness becomes a coat of index 0, which reflects the specular colour at normal incidence,
  over the diffuse colour; it is no metal.
- A primitive without a material has glTF's default one, a white metal.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from luxel.scene.diffuse import mean_metallic, unit_values
from luxel.scene.gltf.accessors import AccessorReader
from luxel.scene.gltf.coats import read_coats
from luxel.scene.gltf.document import Document
from luxel.scene.gltf.glass import read_glass
from luxel.scene.gltf.schema import GltfMaterial, PbrMetallicRoughness
from luxel.scene.gltf.textures import TextureReader
from luxel.scene.model import Colour, Material, Texture

AlphaMode = Literal["opaque", "mask", "blend"]

DEFAULT_ALPHA_CUTOFF = 0.5
DEFAULT_NAME = "glTF's default material"
UNLIT = "KHR_materials_unlit"
GLOSSINESS = "KHR_materials_pbrSpecularGlossiness"
STRENGTH = "KHR_materials_emissive_strength"
METAL_SHARE = 0.5
"""A surface is called a metal where this share of it, in the mean, is metallic: most of its diffuse light is gone."""
METALS = "Metals and mirrors are black to diffuse light, their reflections are left out: {names}."
DARK, BRIGHT = 0.04, 0.5
"""Below and above: the diffuse and specular colours of a specular-glossiness metal."""
LEFT_OUT = {
    "KHR_materials_diffuse_transmission": "Diffuse light that shines through is left out: {names}.",
    "KHR_materials_dispersion": "Glass does not split light into colours: {names}.",
}
LEFT_OUT_DIFFUSE = {
    "KHR_materials_ior": "The index of refraction is not used: {names}.",
    "KHR_materials_volume": "What glass swallows inside is left out, it is clear: {names}.",
}


class MaterialTable:
    """The scene's materials, in file order; a default is appended where a primitive has none."""

    def __init__(self, document: Document, reader: AccessorReader) -> None:
        self.document = document
        self.textures = TextureReader(document, reader)
        self._opaque_glass: set[int] = set()
        self._second_sets: dict[int, int] = {}
        self._dark: dict[int, bool] = {}
        self.materials = [self._convert(i, entry) for i, entry in enumerate(document.gltf.materials)]
        self._default: int | None = None

    def index_of(self, index: int | None) -> int:
        """The position in `materials` of a primitive's material; metals are named, as they are dark."""
        if index is None:
            if self._default is None:
                self._default = len(self.materials)
                self.materials.append(self._convert(self._default, GltfMaterial(name=DEFAULT_NAME)))
            index = self._default
        material = self.document.item(self.materials, index, "material")
        if index not in self._dark:
            self._dark[index] = mean_metallic(material) >= METAL_SHARE
        if self._dark[index]:
            self.document.warn(METALS, material.name, diffuse_only=True)
        return index

    def ignores_alpha(self, index: int) -> bool:
        """Return whether the alpha of vertex colours has no meaning: the file calls the material opaque."""
        return index in self._opaque_glass

    def uv_sets(self, index: int) -> set[int]:
        """Which texture coordinate sets material `index` reads."""
        material = self.materials[index]
        return {value.uv_set for value in vars(material).values() if isinstance(value, Texture)}

    def second_set(self, index: int) -> int:
        """Return which of the file's texture coordinates stand in `Mesh.uv2` under material `index`."""
        return self._second_sets.get(index, 1)

    def _convert(self, index: int, entry: GltfMaterial) -> Material:
        """Return a material, and keep which second texture coordinates it reads."""
        self.textures.second_set = None
        material = self._read(index, entry)
        if self.textures.second_set is not None:
            self._second_sets[index] = self.textures.second_set
        return material

    def _read(self, index: int, entry: GltfMaterial) -> Material:
        label, name = f"material {index}", entry.name or f"material-{index}"
        for extension, sentence in (LEFT_OUT | LEFT_OUT_DIFFUSE).items():
            if extension in entry.extensions:
                self.document.warn(sentence, name, diffuse_only=extension in LEFT_OUT_DIFFUSE)
        material = Material(name=name, emit_back=bool(entry.doubleSided))
        glossy = entry.extensions.get(GLOSSINESS)
        if UNLIT in entry.extensions:
            self._set_unlit(material, entry, label)
        elif glossy is not None:
            self._set_glossy(material, entry, glossy, index)
        else:
            self._set_metal_rough(material, entry, label)
        if UNLIT in entry.extensions:
            return material
        self._set_emission(material, entry, label)
        normal = entry.normalTexture
        scale = 1.0 if normal is None or normal.scale is None else normal.scale
        material.normal_texture = self.textures.read(normal, label, srgb=False)
        material.normal_scale = self.document.number(scale, f"normalTexture.scale of {label}")
        if entry.occlusionTexture is not None:
            self.document.warn("Occlusion textures are ignored: luxel computes the occlusion itself.")
        passes = read_glass(self.document, self.textures, material, entry.extensions, label)
        if passes and material.alpha_mode == "opaque":
            self._opaque_glass.add(index)
        return material

    def _set_metal_rough(self, material: Material, entry: GltfMaterial, label: str) -> None:
        pbr = entry.pbrMetallicRoughness or PbrMetallicRoughness()
        base = self._factor(pbr.baseColorFactor, (1.0, 1.0, 1.0, 1.0), f"baseColorFactor of {label}")
        self._set_base(material, entry, base, pbr.baseColorTexture, label)
        material.metallic = self._share(pbr.metallicFactor, f"metallicFactor of {label}")
        material.roughness = self._share(pbr.roughnessFactor, f"roughnessFactor of {label}")
        material.metallic_roughness_texture = self.textures.read(pbr.metallicRoughnessTexture, label, srgb=False)
        read_coats(self.document, self.textures, material, entry.extensions, label)

    def _set_glossy(self, material: Material, entry: GltfMaterial, part: dict[str, Any], index: int) -> None:
        """Fill what KHR_materials_pbrSpecularGlossiness says: the diffuse colour as it stands, coat and roughness."""
        label = f"material {index}"
        base = self._factor(part.get("diffuseFactor"), (1.0, 1.0, 1.0, 1.0), f"diffuseFactor of {label}")
        self._set_base(material, entry, base, part.get("diffuseTexture"), label)
        specular = self._factor(part.get("specularFactor"), (1.0, 1.0, 1.0), f"specularFactor of {label}")
        glossiness = self._share(part.get("glossinessFactor"), f"glossinessFactor of {label}")
        material.roughness = 1.0 - glossiness
        texture = self.textures.read(part.get("specularGlossinessTexture"), label, srgb=False, opaque=False)
        red, green, blue = np.maximum(specular, 0.0).tolist()
        material.ior, material.specular, material.specular_color = 0.0, 1.0, (red, green, blue)
        material.compensate = True
        bright = specular
        if texture is not None:
            colour = self.textures.read(part.get("specularGlossinessTexture"), label, srgb=True)
            material.specular_color_texture = colour
            values = unit_values(texture.image)
            bright = specular * values[..., :3].mean(axis=(0, 1))
            gloss = glossiness * (values[..., 3] if values.shape[2] == 4 else 1.0)
            rough = np.zeros((*values.shape[:2], 3), np.float32)
            rough[..., 1] = 1.0 - gloss
            texture.image = np.rint(rough * 255.0).astype(np.uint8)
            material.roughness, material.metallic_roughness_texture = 1.0, texture
        diffuse = base[:3]
        if material.base_color_texture is not None:
            diffuse = diffuse * unit_values(material.base_color_texture.image)[..., :3].mean(axis=(0, 1))
        self._dark[index] = bool(diffuse.max() < DARK and bright.max() > BRIGHT)

    def _set_base(self, material: Material, entry: GltfMaterial, base: np.ndarray, info: Any, label: str) -> None:
        """Fill base colour and alpha from the factor `base` (4,) and its texture."""
        if (base < 0.0).any() or (base > 1.0).any():
            self.document.warn("Base colours outside 0 to 1 are cut off there: {names}.", material.name)
            base = np.clip(base, 0.0, 1.0)
        material.alpha, material.alpha_mode, material.alpha_cutoff = self._alpha(entry, base[3], label)
        material.base_color = _colour(base)
        opaque = material.alpha_mode == "opaque"
        material.base_color_texture = self.textures.read(info, label, srgb=True, opaque=opaque)

    def _set_unlit(self, material: Material, entry: GltfMaterial, label: str) -> None:
        """Let the surface be seen as its base colour whatever lights it: it shines so, and reflects nothing."""
        pbr = entry.pbrMetallicRoughness or PbrMetallicRoughness()
        base = self._factor(pbr.baseColorFactor, (1.0, 1.0, 1.0, 1.0), f"baseColorFactor of {label}")
        self._set_base(material, entry, base, pbr.baseColorTexture, label)
        material.emission, material.base_color = material.base_color, (0.0, 0.0, 0.0)
        material.emission_uses_colors = True
        material.emission_texture = self.textures.read(pbr.baseColorTexture, label, srgb=True)
        if material.alpha_mode == "opaque":
            material.base_color_texture = None

    def _set_emission(self, material: Material, entry: GltfMaterial, label: str) -> None:
        strength = entry.extensions.get(STRENGTH, {}).get("emissiveStrength", 1.0)
        emission = self._factor(entry.emissiveFactor, (0.0, 0.0, 0.0), f"emissiveFactor of {label}")
        emission = emission * self.document.number(strength, f"emissiveStrength of {label}")
        material.emission = _colour(self.document.power(emission, f"emission of {label}", material.name))
        material.emission_texture = self.textures.read(entry.emissiveTexture, label, srgb=True)

    def _alpha(self, entry: GltfMaterial, factor: float, label: str) -> tuple[float, AlphaMode, float]:
        """(alpha, alpha_mode, alpha_cutoff) of a material whose base colour has the alpha `factor`."""
        if entry.alphaMode == "MASK":
            cutoff = DEFAULT_ALPHA_CUTOFF if entry.alphaCutoff is None else entry.alphaCutoff
            return float(factor), "mask", self.document.number(cutoff, f"alphaCutoff of {label}")
        if entry.alphaMode == "BLEND":
            return float(factor), "blend", DEFAULT_ALPHA_CUTOFF
        if entry.alphaMode not in ("OPAQUE", None):
            self.document.warn(f"The alpha mode {entry.alphaMode} is unknown and is taken as OPAQUE.")
        return 1.0, "opaque", DEFAULT_ALPHA_CUTOFF

    def _factor(self, value: Any, default: tuple[float, ...], where: str) -> np.ndarray:
        return self.document.numbers(default if value is None else value, len(default), where)

    def _share(self, value: Any, where: str) -> float:
        """A factor from 0 to 1, which is 1 where the file says nothing."""
        return min(max(self.document.number(1.0 if value is None else value, where), 0.0), 1.0)


def _colour(values: np.ndarray) -> Colour:
    return float(values[0]), float(values[1]), float(values[2])
