"""Fresnel terms of an interface: what one facet reflects and what it lets through.

Sources: appendix B of glTF 2.0 and its extensions KHR_materials_ior, _specular and _transmission; Mitsuba 3's pages on
plastic, dielectric and thindielectric.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from luxel.kernels.bsdf.fresnel import conductor_fresnel, dielectric_fresnel, metal_fresnel, schlick_rise
from luxel.kernels.bsdf.view import LEAST, View


def interface_terms(view: View, facing: mi.Float) -> tuple[mi.Color3f, mi.Float]:
    """Return what a facet at wo . h = `facing` reflects, and what it lets through to the other side (untinted)."""
    features, bsdf = view.features, view.bsdf
    facing = dr.clip(facing, 0.0, 1.0)
    metal = metal_fresnel(facing, view.base_color)
    if features.conductor:
        exact = mi.Color3f(bsdf.specular_color) * conductor_fresnel(facing, mi.Color3f(bsdf.eta), mi.Color3f(bsdf.k))
        metal = dr.select(mi.Bool(bsdf.has_eta), exact, metal)
    reflected = view.metal * metal + view.opaque * dielectric_reflectance(view, facing)
    if not features.transmission:
        return reflected, mi.Float(0.0)
    fresnel, _ = dielectric_fresnel(facing, view.eta)
    total = (fresnel >= 1.0) & ~view.thin
    # A pane sends light to and fro between its faces: R + T R T + T R^3 T + ... = 2 R / (1 + R).
    fresnel = dr.select(view.thin, 2.0 * fresnel / (1.0 + fresnel), fresnel)
    clear = _tint_reflectance(view, fresnel, (fresnel - view.f0) / dr.maximum(1.0 - view.f0, LEAST))
    # Total reflection keeps all light whatever the weight of the interface; Mitsuba's factor multiplies it, too.
    clear = dr.select(total & ~view.plastic, mi.Color3f(1.0), clear)
    passed = 1.0 - dr.select(view.plastic, fresnel, dr.max(clear))
    passed = dr.select(total, 0.0, dr.clip(passed, 0.0, 1.0))
    return reflected + view.clear * clear, view.clear * passed


def dielectric_reflectance(view: View, facing: mi.Float) -> mi.Color3f:
    """Return what a facet of the opaque dielectric reflects: Schlick's curve for glTF, the exact one for plastic."""
    rise = schlick_rise(facing)
    if not view.features.plastic:
        return _tint_reflectance(view, mi.Float(0.0), rise) if view.features.specular else mi.Color3f(0.0)
    return _tint_reflectance(view, dielectric_fresnel(facing, view.dense)[0], rise)


def _tint_reflectance(view: View, fresnel: mi.Float, rise: mi.Float) -> mi.Color3f:
    """Return the weighted, coloured reflectance: of glTF, which `rise` takes from F0 to 1, or `fresnel` of plastic."""
    specular = mi.Float(view.bsdf.specular)
    tinted = dr.maximum(view.f0_color + (1.0 - view.f0_color) * rise, 0.0)
    if view.features.plastic:
        tinted = dr.select(view.plastic, fresnel * mi.Color3f(view.bsdf.specular_color), tinted)
    return specular * tinted


def reflect_share(reflected: mi.Color3f, transmitted: mi.Float) -> mi.Float:
    """Return the probability with which sampling reflects at a facet, else transmits."""
    mean = dr.mean(reflected)
    return dr.select(transmitted > 0.0, mean / (mean + transmitted), 1.0)
