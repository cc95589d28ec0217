"""Materials and textures as tables.

Images are stored once, as RGBA8 words. Colours are stored as their square root, which spends the 8 bits about as the
sRGB curve does and decodes with one multiplication. Under the diffuse condition the albedo base * (1 - metallic) is
combined here, so that a ray hit reads one texture; only where both textures lie in different ways are they read one by
one. Where metals are to be seen, base colour and metallic stay apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from luxel.scene.arrays import from_numpy
from luxel.scene.diffuse import lies_alike
from luxel.scene.gloss import GlossTables, build_gloss_tables, gloss_flags
from luxel.scene.model import Material, SceneData, Texture

WRAP = {"repeat": 0, "clamp": 1, "mirror": 2}
BLEND_CUTOFF = -1.0
"""Stands for a threshold drawn anew at each hit."""
FLAG_REFLECT_BACK, FLAG_EMIT_BACK, FLAG_EMIT_COLORS = 1, 2, 4
"""`gloss.py` has the others."""
TEXTURE_NEAREST, TEXTURE_UV2, TEXTURE_DATA = 16, 32, 64


@dataclass
class MaterialTables:
    """Factors and textures of all materials."""

    factors: mi.Float
    """(M, 16): albedo rgb, alpha | emission rgb, alpha threshold | roughness, specular rgb | normal scale,
    metallic where it is read apart from the colour, 0, 0."""
    slots: mi.UInt32
    """(M, 8): texture rows of albedo, emission, normal, roughness | flags, 0, 0, 0. Row 0 means none."""
    textures: mi.UInt32
    """(T, 4): first texel, width, height, flags."""
    transforms: mi.Float
    """(T, 8): the first two rows of uv' = M (u, v, 1), padded."""
    texels: mi.UInt32
    """RGBA8."""
    has_albedo: bool
    has_emission: bool
    has_normal: bool
    has_roughness: bool
    has_metallic: bool
    """Some material reads its metallic texture apart from its colour."""
    has_transforms: bool
    has_uv2: bool
    one_sided: bool
    """Some material absorbs everything on its back side."""
    gloss: GlossTables
    """One row of nothing under the diffuse condition."""


class TexturePacker:
    """Gathers images into one buffer, each image once."""

    def __init__(self) -> None:
        self.rows: list[tuple[int, int, int, int]] = [(0, 1, 1, 0)]
        self.transforms: list[np.ndarray] = [np.eye(3)[:2]]
        self.chunks: list[np.ndarray] = [np.full(1, 0xFFFFFFFF, np.uint32)]
        self.size = 1
        self.offsets: dict[tuple[int, bool, bool], int] = {}
        self.kept: list[np.ndarray] = []

    def add(self, texture: Texture | None, *, data: bool = False, image: np.ndarray | None = None) -> int:
        """Return the row that reads `texture`; `image` replaces its pixels by linear (H, W, 4) floats."""
        if texture is None:
            return 0
        source = texture.image
        height, width = source.shape[:2]
        # One picture may serve as colour and as data: how its bytes are decoded is part of what is stored.
        key = (id(source), texture.srgb, data) if image is None else (id(image), False, data)
        if key not in self.offsets:
            self.kept.append(source if image is None else image)
            linear = to_linear(texture) if image is None else image
            self.offsets[key] = self.size
            self.chunks.append(_pack(linear, data))
            self.size += width * height
        flags = WRAP[texture.wrap_u] | WRAP[texture.wrap_v] << 2
        flags |= TEXTURE_NEAREST * texture.nearest | TEXTURE_UV2 * (texture.uv_set == 1) | TEXTURE_DATA * data
        self.rows.append((self.offsets[key], width, height, flags))
        self.transforms.append(np.asarray(texture.transform, np.float64)[:2])
        return len(self.rows) - 1


def build_material_tables(data: SceneData, gloss: bool = False) -> MaterialTables:
    """Return the tables of `data.materials`, in their order.

    `gloss`: with what they reflect and refract, and with base colour and metallic apart; else their albedo alone.
    """
    packer = TexturePacker()
    factors = np.zeros((max(len(data.materials), 1), 16), np.float32)
    slots = np.zeros((len(factors), 8), np.uint32)
    combined: dict[tuple[int, int, float], np.ndarray] = {}
    for row, material in enumerate(data.materials):
        apart = gloss or _reads_metallic_apart(material)
        albedo, metallic = (None, 0.0) if apart else _albedo(material, combined)
        base = np.asarray(material.base_color, np.float64)
        factors[row, :4] = [*(base * (1.0 - metallic)), material.alpha]
        factors[row, 4:8] = [*material.emission, _cutoff(material)]
        # Reflectance at normal incidence: 4 % for a dielectric, the base colour for a metal (glTF's metal-rough model).
        mean_metallic = _mean_metallic(material)
        factors[row, 8:12] = [material.roughness, *(0.04 + (base - 0.04) * mean_metallic)]
        factors[row, 12:14] = material.normal_scale, material.metallic if apart else 0.0
        slots[row, 0] = packer.add(material.base_color_texture if apart else _albedo_texture(material), image=albedo)
        emits = max(material.emission) > 0.0
        slots[row, 1] = packer.add(material.emission_texture if emits else None)
        slots[row, 2] = packer.add(material.normal_texture, data=True)
        slots[row, 3] = packer.add(material.metallic_roughness_texture, data=True)
        slots[row, 4] = _flags(material) | gloss_flags(material)
    glossy = build_gloss_tables(data.materials if gloss else (), packer)
    transforms = np.zeros((len(packer.rows), 8), np.float32)
    transforms[:, :6] = np.array(packer.transforms).reshape(-1, 6)
    identity = np.array([1, 0, 0, 0, 1, 0], np.float32)
    return MaterialTables(
        factors=from_numpy(mi.Float, factors),
        slots=from_numpy(mi.UInt32, slots),
        textures=from_numpy(mi.UInt32, np.array(packer.rows, np.uint32)),
        transforms=from_numpy(mi.Float, transforms),
        texels=from_numpy(mi.UInt32, np.concatenate(packer.chunks)),
        has_albedo=bool(slots[:, 0].any()),
        has_emission=bool(slots[:, 1].any()),
        has_normal=bool(slots[:, 2].any()),
        has_roughness=bool(slots[:, 3].any()),
        has_metallic=bool(factors[:, 13].any()),
        has_transforms=bool((np.abs(transforms[:, :6] - identity) > 1e-6).any()),
        has_uv2=any(row[3] & TEXTURE_UV2 for row in packer.rows),
        one_sided=any(not material.reflect_back for material in data.materials),
        gloss=glossy,
    )


def to_linear(texture: Texture) -> np.ndarray:
    """Return the image of `texture` as (H, W, 4) float32, linear; missing alpha is one."""
    image = texture.image
    values = image.astype(np.float32) / (255.0 if image.dtype == np.uint8 else 1.0)
    if values.ndim == 2:
        values = values[..., None]
    out = np.ones((*values.shape[:2], 4), np.float32)
    channels = values.shape[2]
    out[..., :3] = values[..., :3] if channels >= 3 else values[..., :1]
    if channels == 4:
        out[..., 3] = values[..., 3]
    if texture.srgb:
        rgb = out[..., :3]
        out[..., :3] = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    return out


def _pack(linear: np.ndarray, data: bool) -> np.ndarray:
    values = np.clip(linear, 0.0, 1.0).copy()
    if not data:
        values[..., :3] = np.sqrt(values[..., :3])
    bytes_ = np.rint(values * 255.0).astype(np.uint32)
    return (bytes_[..., 0] | bytes_[..., 1] << 8 | bytes_[..., 2] << 16 | bytes_[..., 3] << 24).ravel()


def _flags(material: Material) -> int:
    back = FLAG_REFLECT_BACK * material.reflect_back | FLAG_EMIT_BACK * material.emit_back
    return back | FLAG_EMIT_COLORS * material.emission_uses_colors


def _cutoff(material: Material) -> float:
    """Return the alpha below which rays pass: 0 for opaque, `BLEND_CUTOFF` where chance decides."""
    return {"opaque": 0.0, "mask": material.alpha_cutoff, "blend": BLEND_CUTOFF}[material.alpha_mode]


def _reads_metallic_apart(material: Material) -> bool:
    """Return whether colour and metallic texture put different points of their images on a point of a surface."""
    one, other = material.base_color_texture, material.metallic_roughness_texture
    if one is None or other is None or material.metallic <= 0.0:
        return False
    return not lies_alike(one, other)


def _albedo_texture(material: Material) -> Texture | None:
    if material.base_color_texture is not None:
        return material.base_color_texture
    return material.metallic_roughness_texture if material.metallic > 0.0 else None


def _albedo(material: Material, cache: dict[tuple[int, int, float], np.ndarray]) -> tuple[np.ndarray | None, float]:
    """Return the combined image, or None where the base image serves, and the metallic factor left for the table."""
    rough = material.metallic_roughness_texture
    if material.metallic <= 0.0 or rough is None:
        return None, material.metallic
    base = material.base_color_texture
    key = (id(base.image) if base else 0, id(rough.image), material.metallic)
    if key not in cache:
        metal = to_linear(rough)[..., 2] * material.metallic
        colour = to_linear(base) if base else np.ones((*rough.image.shape[:2], 4), np.float32)
        height, width = len(colour), len(colour[0])
        tall, wide = len(metal), len(metal[0])
        nearest = metal[np.arange(height) * tall // height][:, np.arange(width) * wide // width]
        colour = colour.copy()
        colour[..., :3] *= 1.0 - nearest[..., None]
        cache[key] = colour
    return cache[key], 0.0


def _mean_metallic(material: Material) -> float:
    rough = material.metallic_roughness_texture
    return material.metallic * (1.0 if rough is None else float(to_linear(rough)[..., 2].mean()))
