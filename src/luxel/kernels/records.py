"""The records that pass between kernels, methods and the frame: points on surfaces, and the light there."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import mitsuba as mi

from luxel.kernels.bsdf import BSDF


@dataclass
class Surface:
    """Points on surfaces, arrays of equal width: pixels, ray hits, texels, free points."""

    p: mi.Point3f
    """World position, metres."""
    p_object: mi.Point3f
    """The same point in its object's space."""
    n_geometric: mi.Normal3f
    """World unit normal of the triangle, on the side of `wo`: what weights use."""
    n_shading: mi.Normal3f
    """World unit normal with vertex normals and normal map, on the side of `wo`: what lighting uses."""
    wo: mi.Vector3f
    """Unit direction towards the viewer (for a ray hit: against the ray)."""
    object_id: mi.UInt32
    """From 1; 0 means no surface."""
    prim_id: mi.UInt32
    """Triangle, counted over the whole scene."""
    barycentric: mi.Point2f
    """Weights of the triangle's second and third corner."""
    uv: mi.Point2f
    uv2: mi.Point2f
    albedo: mi.Color3f
    """Diffuse reflectance, 0..1."""
    emission: mi.Color3f
    """Radiance emitted along `wo`."""
    bsdf: BSDF
    """All that it does with light, in the frame of `bsdf_frame`; under the diffuse condition Lambert's law."""
    front: mi.Bool
    """True where `wo` is on the triangle's front side."""
    active: mi.Bool

    @classmethod
    def at(cls, p: mi.Point3f, n: mi.Normal3f, **known: Any) -> Surface:
        """Return points `p` (world, metres) with unit normals `n`, on no object: what is not `known` has a default.

        They are seen from straight in front, reflect everything and emit nothing. `known` are fields of a surface.
        """
        nowhere = mi.Point2f(0.0)
        default = {
            "p": p, "p_object": p, "n_geometric": n, "n_shading": n, "wo": mi.Vector3f(n),
            "object_id": mi.UInt32(0), "prim_id": mi.UInt32(0), "barycentric": nowhere, "uv": nowhere, "uv2": nowhere,
            "albedo": mi.Color3f(1.0), "emission": mi.Color3f(0.0), "front": mi.Bool(True), "active": mi.Bool(True),
        } | known  # fmt: skip
        return cls(**({"bsdf": BSDF(default["albedo"])} | default))


@dataclass
class PathLight:
    """Radiance at the eye by parts, and what tells them apart: means or sums over paths that see all of the materials.

    Everything is weighed by what the specular chain from the eye to the first rough surface lets through.
    """

    throughput: mi.Color3f
    """What the chain lets through, at its end."""
    albedo: mi.Color3f
    """Diffuse albedo along the chain."""
    emission: mi.Color3f
    """Lamps and sky that are seen at its end."""
    direct: mi.Color3f
    """Light of lamps that diffuse lobes send back."""
    indirect: mi.Color3f
    """All other light that they send back."""
    glossy: mi.Color3f
    """Light that all other lobes send back."""

    def __add__(self, other: PathLight) -> PathLight:
        return PathLight(*(getattr(self, item.name) + getattr(other, item.name) for item in fields(self)))

    def times(self, factor: mi.Float | float) -> PathLight:
        """Return all of it times `factor`."""
        return PathLight(*(getattr(self, item.name) * factor for item in fields(self)))


@dataclass
class Light:
    """What a method answers at a surface."""

    irradiance: mi.Color3f
    """E: indirect irradiance, W/m^2, demodulated (no albedo)."""
    radiance: mi.Color3f
    """Glossy indirect radiance along `wo`; zero for diffuse methods."""
    weight: mi.Float
    """Coverage; 0 means "no answer", never a silent black."""
    seen: PathLight | None = None
    """Of a method that follows all of the light at pixels: the picture, which the frame then takes as it is."""
