"""Materials: what a surface reflects and lets through, one BSDF for every file format."""

from __future__ import annotations

from luxel.kernels.bsdf.albedo import make_tables
from luxel.kernels.bsdf.model import (
    density,
    diffuse_albedo,
    evaluate,
    evaluate_and_density,
    sample,
    straight_transmittance,
)
from luxel.kernels.bsdf.record import (
    ALPHA_FLOOR,
    BSDF,
    LOBE_COAT,
    LOBE_DIFFUSE,
    LOBE_NONE,
    LOBE_REFLECTION,
    LOBE_TRANSMISSION,
    BSDFFeatures,
    BSDFSample,
    BSDFValue,
)
from luxel.kernels.bsdf.tables import BSDFTables

__all__ = [
    "ALPHA_FLOOR",
    "BSDF",
    "LOBE_COAT",
    "LOBE_DIFFUSE",
    "LOBE_NONE",
    "LOBE_REFLECTION",
    "LOBE_TRANSMISSION",
    "BSDFFeatures",
    "BSDFSample",
    "BSDFTables",
    "BSDFValue",
    "density",
    "diffuse_albedo",
    "evaluate",
    "evaluate_and_density",
    "make_tables",
    "sample",
    "straight_transmittance",
]
