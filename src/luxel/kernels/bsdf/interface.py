"""What an interface reflects and lets through: Fresnel terms, the diffuse base below, several bounces, a clear coat.

Sources: Kelemen and Szirmay-Kalos 2001, "A microfacet based coupled specular-matte BRDF model"; Kulla and Conty 2017,
"Revisiting physically based shading at Imageworks"; Walter et al. 2007; appendix B of glTF 2.0 and its extensions
KHR_materials_ior, _specular, _transmission and _clearcoat; Mitsuba 3's pages on plastic and thindielectric.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from luxel.kernels.bsdf import tables as tabulated
from luxel.kernels.bsdf.fresnel import (
    conductor_fresnel,
    dielectric_fresnel,
    mean_conductor_fresnel,
    mean_metal_fresnel,
    metal_fresnel,
    schlick_rise,
)
from luxel.kernels.bsdf.record import ALPHA_FLOOR, BSDF, COAT_F0, BSDFFeatures

_MATCHED = 1e-3
"""Indices that differ by less do not bend light: a rough interface between them lets it pass straight."""
_LEAST = 1e-4
"""Smallest divisor of quotients whose numerators vanish with it."""


@dataclass
class View:
    """A BSDF as seen along `wo`, in a frame that has `wo` above; what does not depend on `wi`, computed once."""

    features: BSDFFeatures
    bsdf: BSDF
    base_color: mi.Color3f
    outside: mi.Bool
    """True where `wo` is on the front side."""
    flip: mi.Bool
    """True where the frame was mirrored."""
    wo: mi.Vector3f
    # From here on only with `features.gloss`.
    metal: mi.Float = 0.0
    opaque: mi.Float = 1.0
    clear: mi.Float = 0.0
    """Weights of metal, opaque dielectric and clear dielectric."""
    eta: mi.Float = 1.0
    """Index on the other side over that on the side of `wo`."""
    f0: mi.Float = 0.0
    """Reflectance of the dielectric at normal incidence."""
    f0_color: mi.Color3f = 0.0
    """The same with the specular colour, without the weight."""
    alpha: mi.Float = 1.0
    roughness: mi.Float = 1.0
    """sqrt(alpha), 0 for delta lobes: the tables' axis."""
    rough: mi.Bool = True
    rough_through: mi.Bool = True
    """False where what passes is delta."""
    matched: mi.Bool = False
    thin: mi.Bool = False
    beckmann: mi.Bool = False
    plastic: mi.Bool = False
    compensate: mi.Bool = False
    narrowing: mi.Float = 1.0
    """Factor of radiance that comes through."""
    dense: mi.Float = 1.0
    """Plastic: index of the base under the interface, 1 or more."""
    transmittance: mi.Float = 1.0
    """Plastic: what the interface lets in along `wo`."""
    internal: mi.Float = 0.0
    """Plastic: what it throws back to the base."""
    white: mi.Float = 1.0
    """Albedo of facets of reflectance 1 along `wo`, and its mean."""
    mean_white: mi.Float = 1.0
    several_metal: mi.Color3f = 0.0
    several_dielectric: mi.Color3f = 0.0
    """Reflectance of light that meets more than one facet."""
    base_coat: mi.Float = 0.0
    """Albedo of the dielectric's reflection along `wo`, largest channel, and its mean."""
    mean_base_coat: mi.Float = 0.0
    clearcoat: mi.Float = 0.0
    coat_alpha: mi.Float = 1.0
    coat_roughness: mi.Float = 0.0
    coat_rough: mi.Bool = True
    coat: mi.Float = 0.0
    """What the clear coat reflects along `wo`, and its mean."""
    mean_coat: mi.Float = 0.0
    p_base: mi.Float = 1.0
    """Probabilities of drawing from the cosine's lobe, the interface's facets, the clear coat."""
    p_facet: mi.Float = 0.0
    p_coat: mi.Float = 0.0


def view_bsdf(bsdf: BSDF, wo: mi.Vector3f, active: mi.Bool) -> View:
    """Return `bsdf` seen along `wo`."""
    outside = wo.z > 0.0
    flip = ~outside
    # A grazing direction must not divide by zero; one in the plane sees the front.
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
        _view_plastic(view, ior, active)
    if features.specular or features.compensate:
        _view_albedo(view, active)
    if features.clearcoat:
        _view_clear_coat(view, active)
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


# ----------------------------------------------------------------------------------------------------------------------
# The interface


def interface_terms(view: View, facing: mi.Float) -> tuple[mi.Color3f, mi.Float]:
    """Return what a facet at wo . h = `facing` reflects, and what it lets through to the other side (untinted)."""
    features, bsdf = view.features, view.bsdf
    facing = dr.clip(facing, 0.0, 1.0)
    base = view.base_color
    metal = metal_fresnel(facing, base, mi.Color3f(bsdf.f82))
    if features.conductor:
        exact = base * conductor_fresnel(facing, mi.Color3f(bsdf.eta), mi.Color3f(bsdf.k))
        metal = dr.select(mi.Bool(bsdf.has_eta), exact, metal)
    reflected = view.metal * metal + view.opaque * dielectric_reflectance(view, facing)
    if not features.transmission:
        return reflected, mi.Float(0.0)
    fresnel, _ = dielectric_fresnel(facing, view.eta)
    total = (fresnel >= 1.0) & ~view.thin
    # A pane sends light to and fro between its faces: R + T R T + T R^3 T + ... = 2 R / (1 + R).
    fresnel = dr.select(view.thin, 2.0 * fresnel / (1.0 + fresnel), fresnel)
    clear = _tint_reflectance(view, fresnel, (fresnel - view.f0) / dr.maximum(1.0 - view.f0, _LEAST))
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


# ----------------------------------------------------------------------------------------------------------------------
# The diffuse base


def diffuse_factor(view: View, cosine: mi.Float, active: mi.Bool) -> mi.Color3f:
    """Return what multiplies base colour and cosine / pi: what gets through the interface to the base, and out.

    glTF's mix by the Fresnel term at the facet gives a white base up to 1.9 times the light at grazing angles; the
    base coupled by albedos (Kelemen and Szirmay-Kalos) gives back just what the interface does not reflect.
    """
    features, bsdf = view.features, view.bsdf
    passed = mi.Float(1.0)
    if features.specular:
        below = (1.0 - view.base_coat) * (1.0 - _base_coat(view, _fetch_pair(view, cosine, active)))
        passed = below / dr.maximum(1.0 - view.mean_base_coat + _coats_together(view), _LEAST)
    factor = mi.Color3f(passed)
    if features.plastic:
        back = view.internal * dr.select(mi.Bool(bsdf.nonlinear), view.base_color, mi.Color3f(1.0))
        inside = dr.square(view.dense) * dr.maximum(1.0 - back, _LEAST)
        through = view.transmittance * _plastic_transmittance(view, cosine, active)
        factor = dr.select(view.plastic, through / inside, factor)
    return factor * (view.opaque * coat_attenuation(view, cosine, False, diffuse=True))


def _view_plastic(view: View, ior: mi.Float, active: mi.Bool) -> None:
    view.transmittance = _plastic_transmittance(view, view.wo.z, active)
    tables = view.bsdf.tables
    assert tables is not None
    view.internal = tabulated.fetch_internal_reflectance(
        tables, view.roughness, view.dense, view.beckmann, active & view.plastic
    )


def _plastic_transmittance(view: View, cosine: mi.Float, active: mi.Bool) -> mi.Float:
    """Return what plastic lets in along `cosine`; the table serves where it is rough."""
    tables = view.bsdf.tables
    assert tables is not None
    smooth = 1.0 - dielectric_fresnel(dr.clip(cosine, 0.0, 1.0), view.dense)[0]
    rough = tabulated.fetch_transmittance(
        tables, cosine, view.roughness, view.dense, view.beckmann, active & view.plastic & view.rough
    )
    return dr.select(view.rough, rough, smooth)


# ----------------------------------------------------------------------------------------------------------------------
# Several bounces between facets


def multiple_scattering(view: View, cosine: mi.Float, active: mi.Bool) -> mi.Color3f:
    """Return what multiplies cosine / pi for light that met several facets (Kulla and Conty 2017)."""
    if not view.features.compensate:
        return mi.Color3f(0.0)
    white, _ = _fetch_pair(view, cosine, active)
    lost = (1.0 - view.white) * (1.0 - white) / dr.maximum(1.0 - view.mean_white, _LEAST)
    color = view.metal * view.several_metal
    if view.features.specular:
        color += dr.select(view.plastic, 0.0, view.opaque) * view.several_dielectric
    return dr.select(active & view.rough, color * lost, mi.Color3f(0.0))


def _view_albedo(view: View, active: mi.Bool) -> None:
    """Set the albedos of the interface along `wo`."""
    bsdf, features = view.bsdf, view.features
    tables = bsdf.tables
    assert tables is not None
    pair = _fetch_pair(view, view.wo.z, active)
    means = tabulated.fetch_mean_albedo(tables, view.roughness, view.beckmann, active)
    view.white, view.mean_white = pair[0], means[0]
    if features.compensate:
        mean = mean_metal_fresnel(view.base_color, mi.Color3f(bsdf.f82))
        if features.conductor:
            exact = view.base_color * mean_conductor_fresnel(mi.Color3f(bsdf.eta), mi.Color3f(bsdf.k))
            mean = dr.select(mi.Bool(bsdf.has_eta), exact, mean)
        view.several_metal = _several(view, mean)
    if features.specular and features.compensate:
        mean = mi.Float(bsdf.specular) * (view.f0_color + (1.0 - view.f0_color) / 21.0)
        view.several_dielectric = _several(view, mean)
    if features.specular:
        view.base_coat = _base_coat(view, pair)
        view.mean_base_coat = _base_coat(view, means)


def _several(view: View, mean_fresnel: mi.Color3f) -> mi.Color3f:
    """Return the reflectance of all bounces after the first, for a single bounce's mean reflectance."""
    lost = 1.0 - view.mean_white
    several = dr.square(mean_fresnel) * view.mean_white / dr.maximum(1.0 - mean_fresnel * lost, _LEAST)
    return dr.select(view.compensate, several, mi.Color3f(0.0))


def _fetch_pair(view: View, cosine: mi.Float, active: mi.Bool) -> tuple[mi.Float, mi.Float]:
    tables = view.bsdf.tables
    assert tables is not None
    return tabulated.fetch_albedo(tables, cosine, view.roughness, view.beckmann, active)


def _base_coat(view: View, pair: tuple[mi.Float, mi.Float]) -> mi.Float:
    """Return the albedo of the opaque dielectric's reflection, all bounces, in its brightest channel."""
    white, rise = pair
    most = dr.max(view.f0_color)
    single = mi.Float(view.bsdf.specular) * (most * white + (1.0 - most) * rise)
    return dr.clip(single + dr.max(view.several_dielectric) * (1.0 - white), 0.0, 1.0)


# ----------------------------------------------------------------------------------------------------------------------
# The clear coat


def clear_coat(view: View, facing: mi.Float) -> mi.Float:
    """Return what a facet of the clear coat reflects; 0 from behind."""
    rise = schlick_rise(dr.clip(facing, 0.0, 1.0))
    return dr.select(view.outside, view.clearcoat * (COAT_F0 + (1.0 - COAT_F0) * rise), 0.0)


def coat_attenuation(view: View, cosine: mi.Float, through: bool, diffuse: bool = False) -> mi.Float:
    """Return what the clear coat leaves of the light of the layers below, on its two ways through.

    Light that comes from behind (`through`) crosses the coat once, outside.
    """
    if not view.features.clearcoat:
        return mi.Float(1.0)
    other = _coat_albedo(view, cosine, view.outside | through)
    if through:
        return 1.0 - dr.select(view.outside, view.coat, other)
    least = 1.0 - dr.maximum(view.coat, other)
    if view.features.compensate:
        # Light that the coat throws back comes again: from its whole width for diffuse and rough lobes, from the one
        # direction for a mirror, where this is 1 - coat.
        wide = 1.0 if diffuse else view.alpha
        back = dr.lerp(dr.minimum(view.coat, other), view.mean_coat, wide)
        again = (1.0 - view.coat) * (1.0 - other) / dr.maximum(1.0 - back, _LEAST)
        least = dr.select(view.compensate, again, least)
    return dr.select(view.outside, least, 1.0)


def _coats_together(view: View) -> mi.Float:
    """Return by how much the mean of the product of two coats' albedos exceeds that of their means, over 1 - mean_coat.

    Both rise at grazing angles. The means of (1 - c)^10 and (1 - c)^5 are 1/66 and 1/21; the roughness was fitted.
    """
    if not view.features.clearcoat:
        return mi.Float(0.0)
    height = view.clearcoat * (1.0 - COAT_F0) * mi.Float(view.bsdf.specular) * (1.0 - dr.max(view.f0_color))
    flat = dr.square((1.0 - view.roughness) * (1.0 - view.coat_roughness))
    return height * (1.0 / 66.0 - 1.0 / 441.0) * flat / (1.0 - view.mean_coat)


def _view_clear_coat(view: View, active: mi.Bool) -> None:
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


# ----------------------------------------------------------------------------------------------------------------------
# Sampling


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
    metal = dr.mean(view.base_color)
    base = view.opaque * metal * let_in
    facet = view.metal * metal + view.opaque * coat + view.clear
    if features.compensate:
        several = dr.select(view.compensate & view.rough, view.metal * metal * (1.0 - view.white), 0.0)
        base, facet = base + several, facet - several
    top = mi.Float(0.0)
    if features.clearcoat:
        top = view.coat
        base, facet = base * (1.0 - top), facet * (1.0 - top)
    total = base + facet + top
    scale = dr.select(total > 0.0, dr.rcp(total), 0.0)
    view.p_base, view.p_facet, view.p_coat = base * scale, facet * scale, top * scale
