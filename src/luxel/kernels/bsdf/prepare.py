"""What evaluating, weighing and sampling need of a BSDF and `wo`, before any `wi` is known."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from luxel.kernels.bsdf.base import view_plastic
from luxel.kernels.bsdf.clearcoat import view_clear_coat
from luxel.kernels.bsdf.record import ALPHA_FLOOR, BSDF
from luxel.kernels.bsdf.several import view_albedo
from luxel.kernels.bsdf.view import View

_MATCHED = 1e-3
"""Indices that differ by less do not bend light: a rough interface between them lets it pass straight."""


def view_bsdf(bsdf: BSDF, wo: mi.Vector3f, active: mi.Bool) -> View:
    """Return `bsdf` seen along `wo`."""
    outside = wo.z > 0.0
    flip = ~outside
    # A grazing direction must not divide by zero.
    wo = dr.normalize(mi.Vector3f(wo.x, wo.y, dr.maximum(dr.abs(wo.z), 1e-6)))
    view = View(bsdf.features, bsdf, mi.Color3f(bsdf.base_color), outside, flip, wo)
    features = bsdf.features
    if not features.gloss:
        return view
    view.thin = view.matched = mi.Bool(False)
    view.rough_through = view.coat_rough = mi.Bool(True)
    view.plastic = mi.Bool(bsdf.plastic) if features.plastic else mi.Bool(False)
    view.compensate = mi.Bool(bsdf.compensate) if features.compensate else mi.Bool(False)
    view.beckmann = mi.Bool(bsdf.beckmann) if features.beckmann else mi.Bool(False)
    alpha = mi.Float(bsdf.alpha)
    view.rough = alpha >= ALPHA_FLOOR
    view.alpha = dr.clip(alpha, ALPHA_FLOOR, 1.0)
    view.roughness = dr.select(view.rough, dr.sqrt(view.alpha), 0.0)
    ior = dr.maximum(mi.Float(bsdf.ior), 1e-3)
    view.f0 = dr.square((ior - 1.0) / (ior + 1.0))
    view.f0_color = dr.clip(view.f0 * mi.Color3f(bsdf.specular_color), 0.0, 1.0)
    view.dense = dr.maximum(ior, 1.0)
    _weigh_parts(view, ior)
    if features.plastic:
        view_plastic(view, active)
    if features.specular or features.compensate:
        view_albedo(view, active)
    if features.clearcoat:
        view_clear_coat(view, active)
    _share_out(view)
    return view


def _weigh_parts(view: View, ior: mi.Float) -> None:
    """Set the weights of metal, opaque and clear dielectric, and how the last lets light through."""
    bsdf, features = view.bsdf, view.features
    metallic = mi.Float(bsdf.metallic)
    transmission = mi.Float(bsdf.transmission) if features.transmission else mi.Float(0.0)
    view.metal = dr.select(view.outside, metallic, 0.0)
    view.opaque = dr.select(view.outside, (1.0 - metallic) * (1.0 - transmission), 0.0)
    view.clear = (1.0 - metallic) * transmission
    if features.transmission:
        view.thin = mi.Bool(bsdf.thin)
    view.eta = dr.select(view.outside | view.thin, ior, dr.rcp(ior))
    if not features.transmission:
        return
    view.matched = dr.abs(view.eta - 1.0) < _MATCHED
    view.rough_through = view.rough & (view.thin | ~view.matched)
    view.narrowing = dr.select(view.thin | view.matched, 1.0, dr.square(dr.rcp(view.eta)))


def _share_out(view: View) -> None:
    """Set the probabilities of the lobes from what each reflects along `wo`, roughly."""
    bsdf, features = view.bsdf, view.features
    coat, let_in = mi.Float(0.0), mi.Float(1.0)
    if features.specular:
        coat = view.base_coat
        let_in = 1.0 - coat
    if features.plastic:
        reflected = (1.0 - view.transmittance) * mi.Float(bsdf.specular) * dr.mean(mi.Color3f(bsdf.specular_color))
        coat = dr.select(view.plastic, reflected, coat)
        let_in = dr.select(view.plastic, view.transmittance, let_in)
    base = view.opaque * dr.mean(view.base_color) * let_in
    # Even a black metal reflects at grazing angles, Schlick's 1/21 on average.
    metal = view.metal * dr.lerp(dr.mean(view.base_color), 1.0, 1.0 / 21.0)
    facet = metal + view.opaque * coat + view.clear
    several = mi.Float(0.0)
    if features.compensate:
        color = view.metal * view.several_metal + view.opaque * view.several_dielectric
        several = dr.select(view.rough, dr.mean(color) * (1.0 - view.white), 0.0)
        facet -= metal * (1.0 - view.white)
    top = mi.Float(0.0)
    if features.clearcoat:
        top = view.coat
        base, several, facet = ((1.0 - top) * part for part in (base, several, facet))
    total = base + several + facet + top
    scale = dr.select(total > 0.0, dr.rcp(total), 0.0)
    view.p_base, view.p_several, view.p_facet, view.p_coat = (scale * part for part in (base, several, facet, top))
