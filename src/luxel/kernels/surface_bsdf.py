"""The BSDF of a surface: made from the material's facts there, and the frame in which it is asked.

Under the diffuse condition it is Lambert's law with the surface's albedo, and nothing else is compiled.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from luxel.kernels.bsdf import BSDF, make_tables
from luxel.kernels.gloss import bsdf_features, gloss_at, make_bsdf
from luxel.kernels.material import fetch_flags, roughness_at
from luxel.kernels.records import Surface
from luxel.kernels.triangle import TrianglePoint, fetch_triangle
from luxel.scene.device import Scene
from luxel.scene.gloss import FLAG_THIN
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


def bsdf_at(scene: Scene, point: TrianglePoint, albedo: mi.Color3f, active: mi.Bool) -> BSDF:
    """Return the BSDF at a point of a triangle; `albedo` is all of it under the diffuse condition."""
    if not scene.features.gloss:
        return BSDF(albedo, alpha=dr.square(roughness_at(scene, point, active)))
    return make_bsdf(scene, gloss_at(scene, point, active), scene.materials.gloss.bsdf)


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
