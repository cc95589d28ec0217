"""What a material does beside scattering light evenly, at a point of a triangle: factor, texture and vertex colour.

The one evaluation of it, from which the BSDF is made. Only for scenes whose `Features.gloss` is set.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from luxel.kernels.bsdf import BSDF, BSDFFeatures, BSDFTables
from luxel.kernels.material import (
    base_color,
    fetch_flags,
    metallic_share,
    roughness_at,
    transmitted_share,
)
from luxel.kernels.texture import fetch_texture
from luxel.kernels.triangle import TrianglePoint
from luxel.scene.device import Scene
from luxel.scene.gloss import (
    FLAG_ADDED,
    FLAG_BECKMANN,
    FLAG_COMPENSATE,
    FLAG_CONDUCTOR,
    FLAG_NONLINEAR,
    FLAG_PLASTIC,
    FLAG_THIN,
    GLOSS_PACKETS,
    GLOSS_SLOTS,
)


@dataclass
class Gloss:
    """The facts of `luxel.Material` at points, by its names. Kernels pay only for the fields that they go on to use."""

    base_color: mi.Color3f
    """Colour of what scatters evenly, of metals without an index and of glass, 0..1."""
    metallic: mi.Float
    roughness: mi.Float
    """Perceptual; alpha is its square."""
    ior: mi.Float
    """0: the coat reflects `specular_color` at normal incidence."""
    specular: mi.Float
    specular_color: mi.Color3f
    transmission: mi.Float
    """Of what is no metal."""
    has_index: mi.Bool
    """The metal goes by `eta` and `k`."""
    eta: mi.Color3f
    k: mi.Color3f
    absorption: mi.Color3f
    """1/m, inside."""
    clearcoat: mi.Float
    clearcoat_roughness: mi.Float
    flags: mi.UInt32
    """`FLAG_` bits of `scene/gloss.py`: thin, beckmann, compensate, plastic, nonlinear, added."""


def gloss_at(scene: Scene, point: TrianglePoint, active: mi.Bool) -> Gloss:
    """Return what the material does at `point`, whichever side is looked at."""
    first = fetch_gloss(scene, point.material, 0, active)
    second = fetch_gloss(scene, point.material, 1, active)
    eta, k, absorption = (_rgb(fetch_gloss(scene, point.material, packet, active)) for packet in (2, 3, 4))
    specular, specular_color = first.y, _rgb(second)
    clearcoat, clearcoat_roughness = first.w, second.w
    tables = scene.materials
    if tables.gloss.has_textures:
        slots = fetch_gloss_slots(scene, point.material, 0, active)
        last = fetch_gloss_slots(scene, point.material, 1, active)
        texels = [
            fetch_texture(tables, slot, point.uv, point.uv2, active) for slot in (slots.x, slots.y, slots.w, last.x)
        ]
        specular *= texels[0].w
        specular_color *= _rgb(texels[1])
        clearcoat *= texels[2].x
        clearcoat_roughness *= texels[3].y
    flags = fetch_flags(scene, point.material, active)
    return Gloss(
        base_color=dr.clip(base_color(scene, point, active), 0.0, 1.0),
        metallic=metallic_share(scene, point, active),
        roughness=roughness_at(scene, point, active),
        ior=first.x,
        specular=specular,
        specular_color=specular_color,
        transmission=transmitted_share(scene, point, active),
        has_index=(flags & FLAG_CONDUCTOR) != 0,
        eta=eta,
        k=k,
        absorption=absorption,
        clearcoat=clearcoat,
        clearcoat_roughness=clearcoat_roughness,
        flags=flags,
    )


def bsdf_features(scene: Scene) -> BSDFFeatures:
    """Return what any surface of the scene may have; the same constants as those of its tables."""
    tables, features = scene.materials.gloss, scene.features
    return BSDFFeatures(
        gloss=features.gloss,
        specular=tables.has_specular,
        beckmann=tables.has_beckmann,
        conductor=tables.has_conductor,
        plastic=tables.has_plastic,
        transmission=features.transmission,
        clearcoat=tables.has_clearcoat,
        compensate=tables.has_compensate,
    )


def make_bsdf(scene: Scene, gloss: Gloss, tables: BSDFTables) -> BSDF:
    """Return the BSDF of the facts at points; `tables` are `make_tables(bsdf_features(scene))`."""
    flags = gloss.flags
    return BSDF(
        base_color=gloss.base_color,
        features=bsdf_features(scene),
        tables=tables,
        metallic=gloss.metallic,
        alpha=dr.square(gloss.roughness),
        beckmann=(flags & FLAG_BECKMANN) != 0,
        has_eta=gloss.has_index,
        eta=gloss.eta,
        k=gloss.k,
        ior=gloss.ior,
        specular=gloss.specular,
        specular_color=gloss.specular_color,
        transmission=gloss.transmission,
        thin=(flags & FLAG_THIN) != 0,
        clearcoat=gloss.clearcoat,
        clearcoat_alpha=dr.square(gloss.clearcoat_roughness),
        plastic=(flags & FLAG_PLASTIC) != 0,
        added=(flags & FLAG_ADDED) != 0,
        nonlinear=(flags & FLAG_NONLINEAR) != 0,
        compensate=(flags & FLAG_COMPENSATE) != 0,
    )


def fetch_gloss(scene: Scene, material: mi.UInt32, packet: int, active: mi.Bool) -> mi.Vector4f:
    """Return packet 0 to 4 of the material's gloss, as `GlossTables.factors` lists them."""
    return dr.gather(mi.Vector4f, scene.materials.gloss.factors, GLOSS_PACKETS * material + packet, active)


def fetch_gloss_slots(scene: Scene, material: mi.UInt32, packet: int, active: mi.Bool) -> mi.Vector4u:
    """Return packet 0 or 1 of the material's texture rows, as `GlossTables.slots` lists them; 0 means none."""
    return dr.gather(mi.Vector4u, scene.materials.gloss.slots, (GLOSS_SLOTS // 4) * material + packet, active)


def _rgb(packet: mi.Vector4f) -> mi.Color3f:
    return mi.Color3f(packet.x, packet.y, packet.z)
