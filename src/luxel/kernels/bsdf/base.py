"""The diffuse base under an interface: coupled by albedos as under glTF's, or as Mitsuba's plastics have it.

Sources: Kelemen and Szirmay-Kalos 2001, "A microfacet based coupled specular-matte BRDF model"; Mitsuba 3's pages on
plastic and roughplastic.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from luxel.kernels.bsdf import tables as tabulated
from luxel.kernels.bsdf.clearcoat import coats_together
from luxel.kernels.bsdf.fresnel import dielectric_fresnel
from luxel.kernels.bsdf.several import base_coat
from luxel.kernels.bsdf.view import LEAST, View


def diffuse_factor(
    view: View, cosine: mi.Float, pair: tuple[mi.Float, mi.Float], attenuation: mi.Float, active: mi.Bool
) -> mi.Color3f:
    """Return what multiplies base colour and cosine / pi: what gets through the interface to the base, and out.

    `pair` is `fetch_pair`'s at `cosine`, `attenuation` the clear coat's.

    glTF's mix by the Fresnel term at the facet gives a white base up to 1.9 times the light at grazing angles; the
    base coupled by albedos (Kelemen and Szirmay-Kalos) gives back just what the interface does not reflect.
    """
    features = view.features
    passed = mi.Float(1.0)
    if features.specular:
        below = (1.0 - view.base_coat) * (1.0 - base_coat(view, pair))
        passed = below / dr.maximum(1.0 - view.mean_base_coat + coats_together(view), LEAST)
        passed = dr.select(mi.Bool(view.bsdf.added), 1.0, passed)
    factor = mi.Color3f(passed)
    if features.plastic:
        plastic = view.leaving * _plastic_transmittance(view, cosine, active)
        factor = dr.select(view.plastic, plastic, factor)
    return factor * (view.opaque * attenuation)


def mean_diffuse_factor(view: View) -> mi.Color3f:
    """Return the mean of `diffuse_factor` over the hemisphere, weighted by the cosine."""
    factor = mi.Color3f(dr.select(mi.Bool(view.bsdf.added), 1.0, 1.0 - view.base_coat))
    if view.features.plastic:
        factor = dr.select(view.plastic, view.leaving * view.mean_transmittance, factor)
    # Without compensation what the clear coat throws back inside is lost; the smaller of two means is near their mean.
    kept = 1.0 - dr.select(view.compensate, view.coat, dr.maximum(view.coat, view.mean_coat))
    return factor * (view.opaque * kept)


def view_plastic(view: View, active: mi.Bool) -> None:
    """Set what plastic lets in along `wo`, the mean of that, and what of the base's light leaves along `wo`."""
    bsdf = view.bsdf
    tables = bsdf.tables
    assert tables is not None
    view.transmittance = _plastic_transmittance(view, view.wo.z, active)
    internal, view.mean_transmittance = tabulated.fetch_plastic_means(
        tables, view.roughness, view.dense, view.beckmann, active & view.plastic
    )
    back = internal * dr.select(mi.Bool(bsdf.nonlinear), view.base_color, mi.Color3f(1.0))
    view.leaving = view.transmittance / (dr.square(view.dense) * dr.maximum(1.0 - back, LEAST))


def _plastic_transmittance(view: View, cosine: mi.Float, active: mi.Bool) -> mi.Float:
    """Return what plastic lets in along `cosine`; the table serves where it is rough."""
    tables = view.bsdf.tables
    assert tables is not None
    smooth = 1.0 - dielectric_fresnel(dr.clip(cosine, 0.0, 1.0), view.dense)[0]
    rough = tabulated.fetch_transmittance(
        tables, cosine, view.roughness, view.dense, view.beckmann, active & view.plastic & view.rough
    )
    return dr.select(view.rough, rough, smooth)
