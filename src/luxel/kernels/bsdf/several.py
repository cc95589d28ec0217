"""Light that meets several facets, and the albedos of an interface (Kulla and Conty 2017).

Source: "Revisiting physically based shading at Imageworks". What single scattering loses, 1 - E(wo), comes back as a
lobe (1 - E(wo)) (1 - E(wi)) / (pi (1 - mean E)), which is reciprocal, times the reflectance of several bounces.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from luxel.kernels.bsdf import tables as tabulated
from luxel.kernels.bsdf.fresnel import mean_conductor_fresnel, mean_metal_fresnel
from luxel.kernels.bsdf.view import LEAST, View


def multiple_scattering(view: View, white: mi.Float, active: mi.Bool) -> mi.Color3f:
    """Return what multiplies cosine / pi for light that met several facets; `white` is `fetch_pair`'s first at `wi`."""
    lost = (1.0 - view.white) * (1.0 - white) / dr.maximum(1.0 - view.mean_white, LEAST)
    color = view.metal * view.several_metal
    if view.features.specular:
        color += dr.select(view.plastic, 0.0, view.opaque) * view.several_dielectric
    return dr.select(active & view.rough, color * lost, mi.Color3f(0.0))


def sample_several(view: View, sample: mi.Point2f) -> mi.Vector3f:
    """Return a direction for light that met several facets: it leaves near the plane, the nearer the smaller alpha.

    The cosine alone would give weights of 300 at alpha 0.01; these stay below 4 for GGX.
    """
    z = dr.maximum(dr.power(dr.maximum(sample.x, 1e-6), dr.rcp(view.rise)), 1e-6)
    radius = dr.safe_sqrt(1.0 - dr.square(z))
    sine, cosine = dr.sincos(dr.two_pi * sample.y)
    return mi.Vector3f(radius * cosine, radius * sine, z)


def several_density(view: View, cosine: mi.Float) -> mi.Float:
    """Return the density of `sample_several`, per steradian."""
    return dr.inv_two_pi * view.rise * dr.power(dr.maximum(cosine, 1e-6), view.rise - 1.0)


def view_albedo(view: View, active: mi.Bool) -> None:
    """Set the albedos of the interface along `wo`."""
    bsdf, features = view.bsdf, view.features
    tables = bsdf.tables
    assert tables is not None
    pair = fetch_pair(view, view.wo.z, active)
    means = tabulated.fetch_mean_albedo(tables, view.roughness, view.beckmann, active)
    view.white, view.mean_white = pair[0], means[0]
    if features.compensate:
        mean = mean_metal_fresnel(view.base_color)
        if features.conductor:
            exact = mi.Color3f(bsdf.specular_color) * mean_conductor_fresnel(mi.Color3f(bsdf.eta), mi.Color3f(bsdf.k))
            mean = dr.select(mi.Bool(bsdf.has_eta), exact, mean)
        view.several_metal = _several(view, mean)
        # Fitted, so that the lobe's weights are even: the cosine's density has 2.
        view.rise = dr.clip(0.15 + 2.6 * view.roughness, 0.2, 2.0)
    if features.specular and features.compensate:
        mean = mi.Float(bsdf.specular) * (view.f0_color + (1.0 - view.f0_color) / 21.0)
        view.several_dielectric = _several(view, mean)
    if features.specular:
        view.base_coat = base_coat(view, pair)
        view.mean_base_coat = base_coat(view, means)


def _several(view: View, mean_fresnel: mi.Color3f) -> mi.Color3f:
    """Return the reflectance of all bounces after the first, for a single bounce's mean reflectance."""
    lost = 1.0 - view.mean_white
    several = dr.square(mean_fresnel) * view.mean_white / dr.maximum(1.0 - mean_fresnel * lost, LEAST)
    return dr.select(view.compensate, several, mi.Color3f(0.0))


def fetch_pair(view: View, cosine: mi.Float, active: mi.Bool) -> tuple[mi.Float, mi.Float]:
    """Return the albedos along `cosine` of the interface's facets: of reflectance 1, and of (1 - c)^5."""
    tables = view.bsdf.tables
    assert tables is not None
    return tabulated.fetch_albedo(tables, cosine, view.roughness, view.beckmann, active)


def base_coat(view: View, pair: tuple[mi.Float, mi.Float]) -> mi.Float:
    """Return the albedo of the opaque dielectric's reflection, all bounces, in its brightest channel."""
    white, rise = pair
    most = dr.max(view.f0_color)
    single = mi.Float(view.bsdf.specular) * (most * white + (1.0 - most) * rise)
    return dr.clip(single + dr.max(view.several_dielectric) * (1.0 - white), 0.0, 1.0)
