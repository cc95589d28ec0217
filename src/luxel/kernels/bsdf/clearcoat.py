"""A clear coat over everything: glTF's KHR_materials_clearcoat, made reciprocal."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from luxel.kernels.bsdf import tables as tabulated
from luxel.kernels.bsdf.fresnel import schlick_rise
from luxel.kernels.bsdf.record import ALPHA_FLOOR, COAT_F0
from luxel.kernels.bsdf.view import LEAST, View


def clear_coat(view: View, facing: mi.Float) -> mi.Float:
    """Return what a facet of the clear coat reflects; 0 from behind."""
    rise = schlick_rise(dr.clip(facing, 0.0, 1.0))
    return dr.select(view.outside, view.clearcoat * (COAT_F0 + (1.0 - COAT_F0) * rise), 0.0)


@dataclass
class CoatAttenuation:
    """What the clear coat leaves of the light of the layers below."""

    diffuse: mi.Float
    glossy: mi.Float
    through: mi.Float
    """Of light that goes through to the other side: it crosses the coat once, outside."""


def coat_attenuation(view: View, cosine: mi.Float, active: mi.Bool) -> CoatAttenuation:
    """Return the attenuation between `wo` and a `wi` of the given |cosine|."""
    if not view.features.clearcoat:
        return CoatAttenuation(mi.Float(1.0), mi.Float(1.0), mi.Float(1.0))
    other = _coat_albedo(view, cosine, active)
    through = 1.0 - dr.select(view.outside, view.coat, other)
    diffuse = glossy = 1.0 - dr.maximum(view.coat, other)
    if view.features.compensate:
        # Light that the coat throws back comes again: from its whole width for diffuse and rough lobes, from the one
        # direction for a mirror, where this is 1 - coat.
        both = (1.0 - view.coat) * (1.0 - other)
        back = dr.lerp(dr.minimum(view.coat, other), view.mean_coat, view.alpha)
        diffuse = dr.select(view.compensate, both / dr.maximum(1.0 - view.mean_coat, LEAST), diffuse)
        glossy = dr.select(view.compensate, both / dr.maximum(1.0 - back, LEAST), glossy)
    one = mi.Float(1.0)
    return CoatAttenuation(dr.select(view.outside, diffuse, one), dr.select(view.outside, glossy, one), through)


def coats_together(view: View) -> mi.Float:
    """Return by how much the mean of the product of two coats' albedos exceeds that of their means, over 1 - mean_coat.

    Both rise at grazing angles. The means of (1 - c)^10 and (1 - c)^5 are 1/66 and 1/21; the roughness was fitted.
    """
    if not view.features.clearcoat:
        return mi.Float(0.0)
    height = view.clearcoat * (1.0 - COAT_F0) * mi.Float(view.bsdf.specular) * (1.0 - dr.max(view.f0_color))
    flat = dr.square((1.0 - view.roughness) * (1.0 - view.coat_roughness))
    return height * (1.0 / 66.0 - 1.0 / 441.0) * flat / (1.0 - view.mean_coat)


def view_clear_coat(view: View, active: mi.Bool) -> None:
    """Set the coat's lobe and its albedo along `wo`."""
    bsdf = view.bsdf
    alpha = mi.Float(bsdf.clearcoat_alpha)
    view.clearcoat = mi.Float(bsdf.clearcoat)
    view.coat_rough = alpha >= ALPHA_FLOOR
    view.coat_alpha = dr.clip(alpha, ALPHA_FLOOR, 1.0)
    view.coat_roughness = dr.select(view.coat_rough, dr.sqrt(view.coat_alpha), 0.0)
    view.coat = dr.select(view.outside, _coat_albedo(view, view.wo.z, active), 0.0)
    tables = bsdf.tables
    assert tables is not None
    white, rise = tabulated.fetch_mean_albedo(tables, view.coat_roughness, mi.Bool(False), active)
    view.mean_coat = view.clearcoat * (COAT_F0 * white + (1.0 - COAT_F0) * rise)


def _coat_albedo(view: View, cosine: mi.Float, active: mi.Bool) -> mi.Float:
    tables = view.bsdf.tables
    assert tables is not None
    white, rise = tabulated.fetch_albedo(tables, cosine, view.coat_roughness, mi.Bool(False), active)
    return view.clearcoat * (COAT_F0 * white + (1.0 - COAT_F0) * rise)
