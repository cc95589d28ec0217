"""The BSDF of a surface: made from the material's facts there, and the frame in which it is asked.

Under the diffuse condition it is Lambert's law with the surface's albedo, and nothing else is compiled.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from luxel.kernels.bsdf import BSDF, BSDFFeatures, make_tables
from luxel.kernels.gloss import gloss_at
from luxel.kernels.material import fetch_flags, roughness_at
from luxel.kernels.records import Surface
from luxel.kernels.triangle import TrianglePoint, fetch_triangle
from luxel.scene.device import Scene
from luxel.scene.gloss import FLAG_BECKMANN, FLAG_COMPENSATE, FLAG_NONLINEAR, FLAG_PLASTIC, FLAG_THIN
from luxel.scene.textures import FLAG_REFLECT_BACK


def prepare_bsdf(scene: Scene) -> None:
    """Give the scene the tables that its BSDFs read, where it has none yet or lacks some: a second at most.

    To be called after an upload, and after an edit that brings the first material of a kind.
    """
    if not scene.features.gloss:
        return
    gloss, features = scene.materials.gloss, bsdf_features(scene)
    if gloss.bsdf_features != tuple(features):
        gloss.bsdf, gloss.bsdf_features = make_tables(features), tuple(features)


def bsdf_features(scene: Scene) -> BSDFFeatures:
    """Return what surfaces of the scene may do, as constants."""
    if not scene.features.gloss:
        return BSDFFeatures()
    gloss = scene.materials.gloss
    return BSDFFeatures(
        gloss=True,
        specular=gloss.has_specular,
        beckmann=gloss.has_beckmann,
        conductor=gloss.has_conductor,
        plastic=gloss.has_plastic,
        transmission=scene.features.transmission,
        clearcoat=gloss.has_clearcoat,
        compensate=gloss.has_compensate,
    )


def bsdf_at(scene: Scene, point: TrianglePoint, albedo: mi.Color3f, active: mi.Bool) -> BSDF:
    """Return the BSDF at a point of a triangle; `albedo` is all of it under the diffuse condition."""
    if not scene.features.gloss:
        return BSDF(albedo, alpha=dr.square(roughness_at(scene, point, active)))
    facts = gloss_at(scene, point, active)

    def has(flag: int) -> mi.Bool:
        return (facts.flags & flag) != 0

    return BSDF(
        base_color=dr.clip(facts.base_color, 0.0, 1.0),
        features=bsdf_features(scene),
        tables=scene.materials.gloss.bsdf,
        metallic=dr.clip(facts.metallic, 0.0, 1.0),
        alpha=dr.square(facts.roughness),
        beckmann=has(FLAG_BECKMANN),
        has_eta=facts.has_index,
        eta=facts.eta,
        k=facts.k,
        ior=facts.ior,
        specular=facts.specular,
        specular_color=facts.specular_color,
        transmission=facts.transmission,
        thin=has(FLAG_THIN),
        clearcoat=facts.clearcoat,
        clearcoat_alpha=dr.square(facts.clearcoat_roughness),
        plastic=has(FLAG_PLASTIC),
        nonlinear=has(FLAG_NONLINEAR),
        compensate=has(FLAG_COMPENSATE),
    )


def bsdf_frame(scene: Scene, surface: Surface) -> mi.Frame3f:
    """Return the frame in which `surface.bsdf` is asked: z is the shading normal, on the BSDF's upper side.

    That is the viewer's side, but for surfaces whose sides differ: glass has its inside behind its front, and what
    reflects on its front only is black behind it.
    """
    n = mi.Vector3f(surface.n_shading)
    if not scene.features.gloss:
        return mi.Frame3f(n)
    on_object = surface.active & (surface.object_id != 0)
    flags = fetch_flags(scene, fetch_triangle(scene, surface.prim_id, on_object).material, on_object)
    is_solid = (surface.bsdf.transmission > 0.0) & ((flags & FLAG_THIN) == 0)
    alike = ~on_object | (((flags & FLAG_REFLECT_BACK) != 0) & ~is_solid)
    return mi.Frame3f(dr.select(surface.front | alike, n, -n))
