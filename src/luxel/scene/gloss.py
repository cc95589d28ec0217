"""What materials do beside scattering light evenly, as tables: coats, metals, glass.

They stand apart from the tables of the diffuse condition, which such a scene alone has: there they have one row, and
no kernel reads it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np

from luxel.scene.arrays import from_numpy, to_floats
from luxel.scene.model import Material

if TYPE_CHECKING:
    from luxel.scene.textures import TexturePacker

FLAG_THIN, FLAG_BECKMANN, FLAG_COMPENSATE, FLAG_PLASTIC, FLAG_NONLINEAR, FLAG_CONDUCTOR = 8, 16, 32, 64, 128, 256
FLAG_ADDED = 512
"""Beside those of `textures.py`, in the same word."""
GLOSS_PACKETS = 5
"""Packets of four floats a material."""
GLOSS_SLOTS = 8
DARKEST = 1e-12
"""Share of light that glass of a black `attenuation_color` leaves: absorption has to be finite."""


@dataclass
class GlossTables:
    """Factors and textures of all materials; packets of four."""

    factors: mi.Float
    """(M, 20): ior, specular, transmission, clearcoat | specular colour rgb, clearcoat roughness | eta rgb, 0 |
    k rgb, 0 | absorption rgb 1/m, 0."""
    slots: mi.UInt32
    """(M, 8): texture rows of specular (alpha), specular colour, transmission (red), clearcoat (red) | clearcoat
    roughness (green), 0, 0, 0. Row 0 means none."""
    has_textures: bool
    has_specular: bool
    """Some coat is no plastic's, over what is not all glass."""
    has_clearcoat: bool
    has_conductor: bool
    """Some metal has a complex index."""
    has_beckmann: bool
    has_plastic: bool
    has_compensate: bool
    has_absorption: bool
    has_thin: bool
    """Some material is a pane."""
    bsdf: Any = None
    """The `BSDFTables` that `kernels/surface_bsdf.py` makes for them; None until then."""
    bsdf_features: tuple[bool, ...] = ()
    """The `BSDFFeatures` that those serve."""


HAS = [item.name for item in fields(GlossTables) if item.name.startswith("has_")]


def is_glossy(material: Material) -> bool:
    """Return whether a material does more than scatter light evenly and let it pass straight."""
    weights = (material.specular, material.metallic, material.transmission, material.clearcoat)
    return max(weights) > 0.0


def is_glass(material: Material) -> bool:
    """Return whether light enters a material's surface."""
    return material.transmission > 0.0


def build_gloss_tables(materials: Sequence[Material], packer: TexturePacker) -> GlossTables:
    """Return the tables of `materials`, in their order; their textures go to `packer`."""
    factors = np.zeros((max(len(materials), 1), 4 * GLOSS_PACKETS), np.float32)
    slots = np.zeros((len(factors), GLOSS_SLOTS), np.uint32)
    absorptions = [_absorption(material) for material in materials]
    for row, material in enumerate(materials):
        factors[row, :4] = material.ior, material.specular, material.transmission, material.clearcoat
        factors[row, 4:8] = [*material.specular_color, material.clearcoat_roughness]
        factors[row, 8:11] = material.eta or (0.0, 0.0, 0.0)
        factors[row, 12:15] = material.k or (0.0, 0.0, 0.0)
        factors[row, 16:19] = absorptions[row]
        slots[row, 0] = packer.add(material.specular_texture, data=True)
        slots[row, 1] = packer.add(material.specular_color_texture)
        slots[row, 2] = packer.add(material.transmission_texture, data=True)
        slots[row, 3] = packer.add(material.clearcoat_texture, data=True)
        slots[row, 4] = packer.add(material.clearcoat_roughness_texture, data=True)
    return GlossTables(
        factors=from_numpy(mi.Float, factors),
        slots=from_numpy(mi.UInt32, slots),
        has_textures=bool(slots.any()),
        has_specular=any(map(_has_coat, materials)),
        has_clearcoat=any(material.clearcoat > 0.0 for material in materials),
        has_conductor=any(material.eta is not None and material.metallic > 0.0 for material in materials),
        has_beckmann=any(material.distribution == "beckmann" for material in materials),
        has_plastic=any(material.interface == "plastic" for material in materials),
        has_compensate=any(material.compensate for material in materials),
        has_absorption=any(values.any() for values in absorptions),
        has_thin=any(material.thin and is_glass(material) for material in materials),
    )


def with_gloss_row(tables: GlossTables, single: GlossTables, index: int) -> GlossTables:
    """Return `tables` with the factors of the one material of `single` at `index`; textures stay."""
    factors = np.array(tables.factors).reshape(-1, 4 * GLOSS_PACKETS)
    factors[index] = np.array(single.factors)
    # What a scene has had once its kernels keep.
    has = {name: getattr(tables, name) or getattr(single, name) for name in HAS if name != "has_textures"}
    return replace(tables, factors=to_floats(factors), **has)


def gloss_flags(material: Material) -> int:
    """Return the material's `FLAG_` bits of this file."""
    flags = FLAG_THIN * material.thin | FLAG_BECKMANN * (material.distribution == "beckmann")
    flags |= FLAG_COMPENSATE * material.compensate | FLAG_NONLINEAR * material.nonlinear
    flags |= FLAG_PLASTIC * (material.interface == "plastic") | FLAG_ADDED * (material.interface == "principled")
    return flags | FLAG_CONDUCTOR * (material.eta is not None)


def _has_coat(material: Material) -> bool:
    scatters = material.transmission < 1.0 or material.transmission_texture is not None
    return material.specular > 0.0 and material.interface != "plastic" and scatters


def _absorption(material: Material) -> np.ndarray:
    """Return (3,) 1/m: what e to the minus this a metre leaves the attenuation colour after its distance."""
    colour = np.clip(np.asarray(material.attenuation_color, np.float64), DARKEST, 1.0)
    return -np.log(colour) / material.attenuation_distance + 0.0
