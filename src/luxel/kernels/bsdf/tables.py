"""Tables of directional albedo, and how kernels read them.

The axes are x = sqrt(cosine), r = sqrt(alpha) (the roughness) and g = sqrt((ior - 1) / (ior + 1)), the fourth root of
the reflectance at normal incidence: in these the functions bend evenly, and grazing rays are resolved. `albedo.py`
computes the entries.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

ALBEDO_COSINES, ALBEDO_ROUGHNESSES = 48, 48
PLASTIC_COSINES, PLASTIC_ROUGHNESSES, PLASTIC_INDICES = 32, 24, 20
LARGEST_INDEX = 3.0
"""Plastics are tabulated up to this index; a higher one reads the last entry."""


@dataclass
class BSDFTables:
    """Directional albedos of rough interfaces; entries lie in packets of four, neighbours together.

    Each holds GGX's, then Beckmann's where the scene has it; what the scene does not need is one packet of zeros.
    """

    albedo: mi.Float
    """Packets (roughness, cosine): what facets of reflectance 1 reflect, and what those of (1 - cosine)^5 reflect."""
    mean_albedo: mi.Float
    """Packets (roughness): the same two, averaged over the hemisphere by the cosine."""
    transmittance: mi.Float
    """Packets (index, roughness, cosine): what a dielectric lets in."""
    plastic_means: mi.Float
    """Packets (index, roughness): what it throws back from inside, and what it lets in, both averaged likewise."""


def fetch_albedo(
    tables: BSDFTables, cosine: mi.Float, roughness: mi.Float, beckmann: mi.Bool, active: mi.Bool
) -> tuple[mi.Float, mi.Float]:
    """Return the directional albedo of facets of reflectance 1, and of (1 - c)^5, at `cosine` and `roughness`."""
    column, across = _find_cell(dr.safe_sqrt(cosine), ALBEDO_COSINES)
    row, along = _find_cell(roughness, ALBEDO_ROUGHNESSES)
    row += dr.select(beckmann, mi.UInt32(ALBEDO_ROUGHNESSES), 0)
    width = ALBEDO_COSINES - 1
    packets = [dr.gather(mi.Vector4f, tables.albedo, (row + i) * width + column, active) for i in (0, 1)]
    packet = dr.lerp(packets[0], packets[1], along)
    return dr.lerp(packet.x, packet.z, across), dr.lerp(packet.y, packet.w, across)


def fetch_mean_albedo(
    tables: BSDFTables, roughness: mi.Float, beckmann: mi.Bool, active: mi.Bool
) -> tuple[mi.Float, mi.Float]:
    """Return the means of `fetch_albedo` over the hemisphere, weighted by the cosine."""
    row, along = _find_cell(roughness, ALBEDO_ROUGHNESSES)
    row += dr.select(beckmann, mi.UInt32(ALBEDO_ROUGHNESSES - 1), 0)
    packet = dr.gather(mi.Vector4f, tables.mean_albedo, row, active)
    return dr.lerp(packet.x, packet.z, along), dr.lerp(packet.y, packet.w, along)


def fetch_transmittance(
    tables: BSDFTables, cosine: mi.Float, roughness: mi.Float, ior: mi.Float, beckmann: mi.Bool, active: mi.Bool
) -> mi.Float:
    """Return the share of light along `cosine` that a rough dielectric lets in."""
    column, across = _find_cell(dr.safe_sqrt(cosine), PLASTIC_COSINES)
    row, along = _find_cell(roughness, PLASTIC_ROUGHNESSES)
    layer, up = _find_index(ior)
    layer += dr.select(beckmann, mi.UInt32(PLASTIC_INDICES), 0)
    height, width = PLASTIC_ROUGHNESSES - 1, PLASTIC_COSINES - 1
    packets = [
        dr.gather(mi.Vector4f, tables.transmittance, ((layer + i) * height + row) * width + column, active)
        for i in (0, 1)
    ]
    packet = dr.lerp(packets[0], packets[1], up)
    return dr.lerp(dr.lerp(packet.x, packet.y, across), dr.lerp(packet.z, packet.w, across), along)


def fetch_plastic_means(
    tables: BSDFTables, roughness: mi.Float, ior: mi.Float, beckmann: mi.Bool, active: mi.Bool
) -> tuple[mi.Float, mi.Float]:
    """Return the shares of diffuse light that a rough dielectric throws back to its inside, and lets in."""
    row, along = _find_cell(roughness, PLASTIC_ROUGHNESSES)
    layer, up = _find_index(ior)
    layer += dr.select(beckmann, mi.UInt32(PLASTIC_INDICES), 0)
    width = PLASTIC_ROUGHNESSES - 1
    packets = [dr.gather(mi.Vector4f, tables.plastic_means, (layer + i) * width + row, active) for i in (0, 1)]
    packet = dr.lerp(packets[0], packets[1], up)
    return dr.lerp(packet.x, packet.z, along), dr.lerp(packet.y, packet.w, along)


def _find_index(ior: mi.Float) -> tuple[mi.UInt32, mi.Float]:
    largest = (LARGEST_INDEX - 1.0) / (LARGEST_INDEX + 1.0)
    return _find_cell(dr.safe_sqrt((ior - 1.0) / ((ior + 1.0) * largest)), PLASTIC_INDICES)


def _find_cell(x: mi.Float, count: int) -> tuple[mi.UInt32, mi.Float]:
    """Return the node at or before `x` (0..1) among `count`, at most the last but one, and the way to the next."""
    scaled = dr.clip(x, 0.0, 1.0) * (count - 1)
    # The bound is on the integer: a NaN in `x` must not become a read past the table's end.
    cell = dr.minimum(mi.UInt32(scaled), count - 2)
    return cell, scaled - mi.Float(cell)
