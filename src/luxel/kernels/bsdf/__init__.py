"""Materials: what a surface reflects and lets through, one BSDF for every file format."""

from __future__ import annotations

from luxel.kernels.bsdf.albedo import make_tables
from luxel.kernels.bsdf.model import density, evaluate, sample
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
    "evaluate",
    "make_tables",
    "sample",
]
