"""Evaluate, weigh and sample a BSDF in the local frame of the surface.

`wo` points to the viewer and `wi` to the light, both away from the surface. Transport is that of radiance: light that
enters a denser medium is narrowed by the square of the index, as Mitsuba's TransportMode.Radiance has it.

All lobes of an interface share one microfacet: a direction `wi` fixes its normal h (halfway, mirrored or refracted),
and metal, dielectric reflection and transmission weigh in by their Fresnel terms at wo . h.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from luxel.kernels.bsdf.base import diffuse_factor, mean_diffuse_factor
from luxel.kernels.bsdf.clearcoat import clear_coat, coat_attenuation
from luxel.kernels.bsdf.fresnel import dielectric_fresnel
from luxel.kernels.bsdf.interface import interface_terms, reflect_share
from luxel.kernels.bsdf.microfacet import Microfacets, normal_density, sample_visible, smith_g1
from luxel.kernels.bsdf.prepare import view_bsdf
from luxel.kernels.bsdf.record import (
    BSDF,
    LOBE_COAT,
    LOBE_DIFFUSE,
    LOBE_NONE,
    LOBE_REFLECTION,
    LOBE_TRANSMISSION,
    BSDFSample,
    BSDFValue,
)
from luxel.kernels.bsdf.several import fetch_pair, multiple_scattering, sample_several, several_density
from luxel.kernels.bsdf.view import View


def evaluate(bsdf: BSDF, wo: mi.Vector3f, wi: mi.Vector3f, active: mi.Bool | bool = True) -> BSDFValue:
    """Return BSDF times |wi.z|, per steradian, diffuse and glossy apart; delta lobes are left out."""
    return evaluate_and_density(bsdf, wo, wi, active)[0]


def density(bsdf: BSDF, wo: mi.Vector3f, wi: mi.Vector3f, active: mi.Bool | bool = True) -> mi.Float:
    """Return the density, per steradian, with which `sample` draws `wi` from lobes that are not delta."""
    return evaluate_and_density(bsdf, wo, wi, active)[1]


def evaluate_and_density(
    bsdf: BSDF, wo: mi.Vector3f, wi: mi.Vector3f, active: mi.Bool | bool = True
) -> tuple[BSDFValue, mi.Float]:
    """Return `evaluate` and `density`, which share most of their work: what multiple importance sampling asks for."""
    active = mi.Bool(active)
    view = view_bsdf(bsdf, wo, active)
    return _respond(view, _flip(wi, view.flip), active)


def diffuse_albedo(bsdf: BSDF, wo: mi.Vector3f, active: mi.Bool | bool = True) -> mi.Color3f:
    """Return the share of even light from all around that the diffuse part sends along `wo`.

    Where the irradiance E is all that is known of the light, E times this over pi is the diffuse part's radiance.
    """
    active = mi.Bool(active)
    view = view_bsdf(bsdf, wo, active)
    albedo = view.base_color
    if view.features.gloss:
        albedo *= mean_diffuse_factor(view)
    return dr.select(active & view.outside, albedo, mi.Color3f(0.0))


def straight_transmittance(bsdf: BSDF, wo: mi.Vector3f, active: mi.Bool | bool = True) -> mi.Color3f:
    """Return the share of light along -`wo` that passes without a bend: through clear panes and matched indices.

    What a shadow ray is multiplied by where it meets the surface; frosted panes and glass bodies stop it.
    """
    active = mi.Bool(active)
    view = view_bsdf(bsdf, wo, active)
    if not view.features.transmission:
        return mi.Color3f(0.0)
    _, transmitted = interface_terms(view, view.wo.z)
    coat = coat_attenuation(view, view.wo.z, active)
    passes = active & ~view.rough_through & (view.thin | view.matched)
    return dr.select(passes, transmitted * view.base_color * coat.through, mi.Color3f(0.0))


def sample(
    bsdf: BSDF, wo: mi.Vector3f, lobe_sample: mi.Float, point: mi.Point2f, active: mi.Bool | bool = True
) -> BSDFSample:
    """Return a direction drawn from the lobes; `lobe_sample` (0..1) picks the lobe, `point` (0..1) the direction."""
    active = mi.Bool(active)
    view = view_bsdf(bsdf, wo, active)
    if not view.features.gloss:
        return _sample_diffuse(view, point, active)
    features = view.features
    from_base = lobe_sample < view.p_base
    begin = view.p_base + view.p_several
    from_several = ~from_base & (lobe_sample < begin)
    from_coat = mi.Bool(False)
    if features.clearcoat:
        from_coat = lobe_sample >= begin + view.p_facet
    from_facet = ~from_base & ~from_several & ~from_coat
    # What is left of the number after the choice picks between reflection and transmission.
    rest = dr.clip((lobe_sample - begin) / dr.maximum(view.p_facet, 1e-9), 0.0, 1.0)

    alpha = dr.select(from_coat, view.coat_alpha, view.alpha)
    rough = dr.select(from_coat, view.coat_rough, view.rough)
    facets = Microfacets(alpha, view.beckmann & ~from_coat, features.beckmann)
    h = dr.select(rough, sample_visible(facets, view.wo, point), mi.Vector3f(0.0, 0.0, 1.0))
    facing = dr.dot(view.wo, h)
    reflected, transmitted = interface_terms(view, facing)
    share = reflect_share(reflected, transmitted)
    through = mi.Bool(False)
    if features.transmission:
        through = from_facet & (rest >= share) & (transmitted > 0.0)
    wi = mi.Vector3f(2.0 * facing * h - view.wo)
    if features.transmission:
        wi = dr.select(through, _transmit(view, h, facing, wi), wi)
    if features.compensate:
        wi = dr.select(from_several, sample_several(view, point), wi)
    wi = dr.select(from_base, mi.warp.square_to_cosine_hemisphere(point), wi)
    wi = dr.normalize(wi)

    delta = (from_facet & dr.select(through, ~view.rough_through, ~view.rough)) | (from_coat & ~view.coat_rough)
    valid = active & dr.select(through, wi.z < 0.0, wi.z > 0.0) & dr.select(from_facet, view.p_facet > 0.0, True)
    value, chance = _respond(view, wi, valid & ~delta)
    inverse = dr.select(chance > 0.0, dr.rcp(chance), 0.0)
    coat = coat_attenuation(view, dr.abs(wi.z), valid & delta)
    weight = reflected * coat.glossy
    chance_delta = view.p_facet * dr.select(through, 1.0 - share, share)
    if features.transmission:
        tint = transmitted * view.base_color * (coat.through * view.narrowing)
        weight = dr.select(through, tint, weight)
    if features.clearcoat:
        weight = dr.select(from_coat, mi.Color3f(clear_coat(view, view.wo.z)), weight)
        chance_delta = dr.select(from_coat, view.p_coat, chance_delta)
    glossy = dr.select(delta, weight / dr.maximum(chance_delta, 1e-9), value.glossy * inverse)
    chance = dr.select(delta, chance_delta, chance)
    valid &= chance > 0.0
    lobe = dr.select(through, mi.UInt32(LOBE_TRANSMISSION), LOBE_REFLECTION)
    lobe = dr.select(from_base, LOBE_DIFFUSE, dr.select(from_coat, LOBE_COAT, lobe))
    black = mi.Color3f(0.0)
    return BSDFSample(
        dr.select(valid, _flip(wi, view.flip), mi.Vector3f(0.0, 0.0, 1.0)),
        dr.select(valid & ~delta, value.diffuse * inverse, black),
        dr.select(valid, glossy, black),
        dr.select(valid, chance, 0.0),
        valid & delta,
        valid & through,
        dr.select(valid, lobe, LOBE_NONE),
    )


def _sample_diffuse(view: View, point: mi.Point2f, active: mi.Bool) -> BSDFSample:
    wi = mi.warp.square_to_cosine_hemisphere(point)
    valid = active & view.outside & (wi.z > 0.0)
    black, never = mi.Color3f(0.0), mi.Bool(False)
    return BSDFSample(
        wi,
        dr.select(valid, view.base_color, black),
        black,
        dr.select(valid, wi.z * dr.inv_pi, 0.0),
        never,
        never,
        dr.select(valid, mi.UInt32(LOBE_DIFFUSE), LOBE_NONE),
    )


def _flip(v: mi.Vector3f, flip: mi.Bool) -> mi.Vector3f:
    """Mirror `v` at the surface where the viewer is behind it: lobes are the same about every azimuth."""
    return mi.Vector3f(v.x, v.y, dr.select(flip, -v.z, v.z))


def _transmit(view: View, h: mi.Vector3f, facing: mi.Float, mirrored: mi.Vector3f) -> mi.Vector3f:
    """Return where light from `wo` goes through a facet `h`; a pane's is its mirror image behind the pane."""
    _, refracted = dielectric_fresnel(facing, view.eta)
    wi = mi.Vector3f((facing / view.eta - refracted) * h - view.wo / view.eta)
    wi = dr.select(view.thin, mi.Vector3f(mirrored.x, mirrored.y, -mirrored.z), wi)
    return dr.select(view.matched & ~view.thin, -view.wo, wi)


def _respond(view: View, wi: mi.Vector3f, active: mi.Bool) -> tuple[BSDFValue, mi.Float]:
    """Return value and density of all lobes that are not delta, for `wi` in the frame that has `wo` above."""
    features = view.features
    above = active & view.outside & (wi.z > 0.0)
    cosine = dr.select(above, wi.z * dr.inv_pi, 0.0)
    if not features.gloss:
        return BSDFValue(view.base_color * cosine, mi.Color3f(0.0)), cosine

    # Find the facet that turns wo to wi: halfway, or what refraction needs.
    wo = view.wo
    same_side = wi.z > 0.0
    seen = wi
    h = wo + wi
    if features.transmission:
        seen = mi.Vector3f(wi.x, wi.y, dr.select(view.thin, dr.abs(wi.z), wi.z))
        h = dr.select(same_side, h, dr.select(view.thin, wo + seen, wo + view.eta * wi))
    # Opposite directions of equal length leave no normal; nothing is reflected or refracted there.
    h = dr.select(dr.squared_norm(h) > 0.0, dr.normalize(h), mi.Vector3f(0.0, 0.0, 1.0))
    h = dr.select(h.z < 0.0, -h, h)
    facing = dr.dot(wo, h)
    reflected, transmitted = interface_terms(view, facing)
    share = reflect_share(reflected, transmitted)

    # Count the facets that face this way, those that wo sees, and those that wi sees.
    facets = Microfacets(view.alpha, view.beckmann, features.beckmann)
    visible = normal_density(facets, h) * smith_g1(facets, wo, h) / wo.z
    lit = smith_g1(facets, seen, h)
    mirror = 0.25 * visible
    rough = active & same_side & view.rough
    glossy = dr.select(rough, reflected * (mirror * lit), mi.Color3f(0.0))
    chance = dr.select(rough, view.p_facet * share * mirror, 0.0)

    # Add the diffuse base, and light that met several facets.
    pair = mi.Float(1.0), mi.Float(0.0)
    if features.specular or features.compensate:
        pair = fetch_pair(view, wi.z, above)
    coat = coat_attenuation(view, dr.abs(wi.z), active)
    diffuse = view.base_color * (diffuse_factor(view, wi.z, pair, coat.diffuse, above) * cosine)
    chance += view.p_base * cosine
    if features.compensate:
        glossy += multiple_scattering(view, pair[0], above) * cosine
        chance += dr.select(above, view.p_several * several_density(view, wi.z), 0.0)
    glossy *= coat.glossy

    # Let light through, with the Jacobian from facets to directions (Walter's equation 17).
    if features.transmission:
        facing_in = dr.dot(wi, h)
        jacobian = dr.abs(facing_in * facing) * dr.square(view.eta / (facing + view.eta * facing_in))
        jacobian = dr.select(view.thin, 0.25, jacobian)
        passes = active & (wi.z < 0.0) & view.rough_through & (facing > 0.0) & (view.thin | (facing_in < 0.0))
        passing = dr.select(passes, visible * jacobian, 0.0)
        tint = view.base_color * coat.through
        glossy += dr.select(passes, tint * (transmitted * passing * lit * view.narrowing), mi.Color3f(0.0))
        chance += dr.select(passes, view.p_facet * (1.0 - share) * passing, 0.0)

    if features.clearcoat:
        facets = Microfacets(view.coat_alpha, mi.Bool(False), False)
        mirror = 0.25 * normal_density(facets, h) * smith_g1(facets, wo, h) / wo.z
        coated = above & view.coat_rough
        glossy += dr.select(coated, clear_coat(view, facing) * mirror * smith_g1(facets, wi, h), 0.0)
        chance += dr.select(coated, view.p_coat * mirror, 0.0)
    # A GPU fuses products: one minus an albedo of one may round to less than nothing.
    # Shares that should add up to one may do so but for rounding.
    return BSDFValue(dr.maximum(diffuse, 0.0), dr.maximum(glossy, 0.0)), dr.maximum(chance, 0.0)
