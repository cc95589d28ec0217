"""glTF materials, textures and images to `Material` and `Texture`.

Choices where the two models differ:
- alpha OPAQUE: alpha is ignored. MASK: the file's cutoff (0.5 where it names none). BLEND: rays pass where alpha is
  below 0.5, as luxel has no partial coverage.
- A primitive without a material gets a non-metallic one: glTF's default is a full metal, which has no diffuse light.
- An image that is missing or cannot be decoded is named in a warning, and the factor stands alone.
"""

from __future__ import annotations

import io
from typing import Any, Literal

import numpy as np
from PIL import Image
from pygltflib import Material as GltfMaterial
from pygltflib import PbrMetallicRoughness, Sampler

from luxel.scene.gltf_accessors import AccessorReader
from luxel.scene.gltf_document import Document
from luxel.scene.model import Colour, Material, Texture

Wrap = Literal["repeat", "clamp", "mirror"]
AlphaMode = Literal["opaque", "mask", "blend"]

WRAP_MODES: dict[int | None, Wrap] = {None: "repeat", 10497: "repeat", 33071: "clamp", 33648: "mirror"}
FILTER_NEAREST = 9728
DEFAULT_ALPHA_CUTOFF = 0.5
LAST_UV_SET = 1
# Extensions that name another image in a format which Pillow reads.
IMAGE_EXTENSIONS = ("EXT_texture_webp",)


class MaterialTable:
    """The scene's materials, converted on first use in file order; images are decoded once and shared."""

    def __init__(self, document: Document, reader: AccessorReader) -> None:
        self.document = document
        self.reader = reader
        self._images: dict[int, np.ndarray | None] = {}
        self._opaque_images: dict[int, np.ndarray] = {}
        self.materials = [self._convert(i, entry) for i, entry in enumerate(document.gltf.materials or ())]
        self._defaults: dict[bool, int] = {}

    def index_of(self, index: int | None, *, has_colors: bool) -> int:
        """The position in `materials` of a primitive's material; without one, a default is appended.

        The default is the model's grey, or white where vertex colours carry the colour.
        """
        if index is not None:
            self.document.item(self.document.gltf.materials, index, "material")
            return index
        self.document.warn(
            "A primitive without a material is shown as a non-metal (glTF's default, a metal, has no diffuse light)."
        )
        if has_colors not in self._defaults:
            self._defaults[has_colors] = len(self.materials)
            default = Material(name="default")
            if has_colors:
                default = Material(name="default-vertex-colors", base_color=(1.0, 1.0, 1.0))
            self.materials.append(default)
        return self._defaults[has_colors]

    def uv_sets(self, index: int) -> set[int]:
        """Which texture coordinate sets material `index` reads."""
        material = self.materials[index]
        textures = (
            material.base_color_texture,
            material.metallic_roughness_texture,
            material.emission_texture,
            material.normal_texture,
        )
        return {texture.uv_set for texture in textures if texture is not None}

    def _convert(self, index: int, entry: GltfMaterial) -> Material:
        label = f"material {index}"
        pbr = entry.pbrMetallicRoughness or PbrMetallicRoughness()
        base = self._factor(pbr.baseColorFactor, (1.0, 1.0, 1.0, 1.0), f"baseColorFactor of {label}")
        alpha, mode, cutoff = self._alpha(entry, base[3], label)
        if "KHR_materials_unlit" in (entry.extensions or {}):
            return self._unlit(entry, pbr, base, (alpha, mode, cutoff), index)
        strength = (entry.extensions or {}).get("KHR_materials_emissive_strength", {}).get("emissiveStrength", 1.0)
        emission = self._factor(entry.emissiveFactor, (0.0, 0.0, 0.0), f"emissiveFactor of {label}")
        emission = emission * self.document.number(strength, f"emissiveStrength of {label}")
        normal = entry.normalTexture
        scale = 1.0 if normal is None or normal.scale is None else normal.scale
        if entry.occlusionTexture is not None:
            self.document.warn("Occlusion textures are ignored: luxel computes the occlusion itself.")
        return Material(
            name=entry.name or f"material-{index}",
            base_color=_colour(base),
            base_color_texture=self._texture(pbr.baseColorTexture, label, srgb=True, opaque=mode == "opaque"),
            metallic=self._scalar(pbr.metallicFactor, 1.0, f"metallicFactor of {label}"),
            roughness=self._scalar(pbr.roughnessFactor, 1.0, f"roughnessFactor of {label}"),
            metallic_roughness_texture=self._texture(pbr.metallicRoughnessTexture, label, srgb=False),
            emission=_colour(emission),
            emission_texture=self._texture(entry.emissiveTexture, label, srgb=True),
            normal_texture=self._texture(normal, label, srgb=False),
            normal_scale=self.document.number(scale, f"normalTexture.scale of {label}"),
            alpha=alpha,
            alpha_mode=mode,
            alpha_cutoff=cutoff,
            emit_back=bool(entry.doubleSided),
        )

    def _unlit(
        self,
        entry: GltfMaterial,
        pbr: PbrMetallicRoughness,
        base: np.ndarray,
        alpha: tuple[float, AlphaMode, float],
        index: int,
    ) -> Material:
        """Return a surface that is seen as its base colour whatever lights it: it shines so, and reflects nothing."""
        label, (alpha_value, mode, cutoff) = f"material {index}", alpha
        return Material(
            name=entry.name or f"material-{index}",
            base_color=(0.0, 0.0, 0.0),
            base_color_texture=self._texture(pbr.baseColorTexture, label, srgb=True, opaque=False)
            if mode != "opaque"
            else None,
            emission=_colour(base),
            emission_texture=self._texture(pbr.baseColorTexture, label, srgb=True),
            alpha=alpha_value,
            alpha_mode=mode,
            alpha_cutoff=cutoff,
            emit_back=bool(entry.doubleSided),
        )

    def _alpha(self, entry: GltfMaterial, factor: float, label: str) -> tuple[float, AlphaMode, float]:
        """(alpha, alpha_mode, alpha_cutoff) of a material whose base colour has the alpha `factor`."""
        if entry.alphaMode == "MASK":
            cutoff = self._scalar(entry.alphaCutoff, DEFAULT_ALPHA_CUTOFF, f"alphaCutoff of {label}")
            return float(factor), "mask", cutoff
        if entry.alphaMode == "BLEND":
            self.document.warn("Alpha BLEND is treated as a cut-out: rays pass where alpha is below 0.5.")
            return float(factor), "mask", DEFAULT_ALPHA_CUTOFF
        if entry.alphaMode not in ("OPAQUE", None):
            self.document.warn(f"The alpha mode {entry.alphaMode} is unknown and is taken as OPAQUE.")
        return 1.0, "opaque", DEFAULT_ALPHA_CUTOFF

    def _factor(self, value: Any, default: tuple[float, ...], where: str) -> np.ndarray:
        return self.document.numbers(default if value is None else value, len(default), where)

    def _scalar(self, value: Any, default: float, where: str) -> float:
        return self.document.number(default if value is None else value, where)

    def _texture(self, info: Any, label: str, *, srgb: bool, opaque: bool = True) -> Texture | None:
        """The texture behind a textureInfo, or None where there is none to read."""
        if info is None:
            return None
        document = self.document
        texture = document.item(document.gltf.textures, info.index, f"texture of {label}")
        transform = (info.extensions or {}).get("KHR_texture_transform", {})
        uv_set = transform.get("texCoord", info.texCoord or 0)
        if not isinstance(uv_set, int) or not 0 <= uv_set <= LAST_UV_SET:
            document.warn(f"Textures that use TEXCOORD_{uv_set} are ignored: luxel reads sets 0 and 1.")
            return None
        source = texture.source
        for name in IMAGE_EXTENSIONS:
            source = (texture.extensions or {}).get(name, {}).get("source", source)
        if source is None:
            document.warn(f"Texture {info.index} has no image in a known format; the factor is used alone.")
            return None
        image = self._image(source)
        if image is None:
            return None
        if opaque and image.shape[2] == 4:
            image = self._opaque_images.setdefault(source, np.ascontiguousarray(image[:, :, :3]))
        sampler = Sampler()
        if texture.sampler is not None:
            sampler = document.item(document.gltf.samplers, texture.sampler, "sampler")
        return Texture(
            image=image,
            srgb=srgb,
            wrap_u=self._wrap(sampler.wrapS),
            wrap_v=self._wrap(sampler.wrapT),
            nearest=sampler.magFilter == FILTER_NEAREST,
            uv_set=uv_set,
            transform=self._uv_transform(transform, label),
        )

    def _wrap(self, mode: int | None) -> Wrap:
        if mode not in WRAP_MODES:
            self.document.warn(f"The texture wrap mode {mode} is unknown and is taken as repeat.")
        return WRAP_MODES.get(mode, "repeat")

    def _uv_transform(self, entry: dict[str, Any], label: str) -> np.ndarray:
        """(3, 3) of KHR_texture_transform: scale, then rotate counter-clockwise as seen in the image, then shift.

        v grows downwards, so counter-clockwise is [[c, s], [-s, c]]: the extension's prose and its example of the
        lower left quadrant (its GLSL snippet has the sign of the sine the other way round).
        """
        where = f"KHR_texture_transform of {label}"
        shift = self._factor(entry.get("offset"), (0.0, 0.0), where)
        scale = self._factor(entry.get("scale"), (1.0, 1.0), where)
        angle = self._scalar(entry.get("rotation"), 0.0, where)
        cosine, sine = np.cos(angle), np.sin(angle)
        return np.array(
            [
                [cosine * scale[0], sine * scale[1], shift[0]],
                [-sine * scale[0], cosine * scale[1], shift[1]],
                [0.0, 0.0, 1.0],
            ],
            dtype=np.float32,
        )

    def _image(self, index: int) -> np.ndarray | None:
        """Image `index` as (H, W, 3 or 4), decoded once; None where that fails, with a warning."""
        if index not in self._images:
            self._images[index] = self._load_image(index)
        return self._images[index]

    def _load_image(self, index: int) -> np.ndarray | None:
        entry = self.document.item(self.document.gltf.images, index, "image")
        label = f"image {index}"
        if entry.bufferView is not None:
            data = self.reader.view_bytes(entry.bufferView)
        elif entry.uri is None:
            self.document.warn(f"Texture {label} has no data; the factor is used alone.")
            return None
        else:
            label = label if entry.uri.startswith("data:") else f"file {entry.uri}"
            try:
                data = self.document.read_uri(entry.uri)
            except FileNotFoundError:
                self.document.warn(f"Texture {label} is missing; the factor is used alone.")
                return None
            except (OSError, ValueError) as error:
                self.document.warn(f"Texture {label} cannot be read ({error}); the factor is used alone.")
                return None
        try:
            return decode_image(data)
        except Exception as error:  # Pillow's decoders raise many types on damaged data
            cause = type(error).__name__ if isinstance(error, Image.UnidentifiedImageError) else str(error)
            self.document.warn(f"Texture {label} cannot be decoded ({cause}); the factor is used alone.")
            return None


def decode_image(data: bytes) -> np.ndarray:
    """An encoded image as (H, W, 3 or 4) uint8, or float32 in 0..1 for 16-bit grey. Raises what Pillow raises."""
    with Image.open(io.BytesIO(data)) as image:
        if image.mode.startswith("I"):
            grey = np.asarray(image, dtype=np.float32) / np.float32(65535.0)
            return np.repeat(np.clip(grey, 0.0, 1.0)[:, :, None], 3, axis=2)
        has_alpha = "A" in image.getbands() or "transparency" in image.info
        return np.array(image.convert("RGBA" if has_alpha else "RGB"))


def _colour(values: np.ndarray) -> Colour:
    return float(values[0]), float(values[1]), float(values[2])
