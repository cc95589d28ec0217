"""Microfacets with the normals of GGX or Beckmann: how many face a way, how much is hidden, and drawing visible ones.

Heights do not matter to one another (Mitsuba's separable Smith term: G = G1(wo) G1(wi)). The mean plane is z = 0 and
`wo` is above it. Sources: Walter et al. 2007, "Microfacet models for refraction through rough surfaces"; Heitz 2014,
"Understanding the masking-shadowing function in microfacet-based BRDFs"; Dupuy and Benyoub 2023, "Sampling visible GGX
normals with spherical caps".
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

_NEWTON_STEPS = 3
"""The distribution is then met within 4.4e-4 at every angle (four: 1.1e-4, six: 4e-6)."""


@dataclass
class Microfacets:
    """A distribution of normals."""

    alpha: mi.Float
    """Width: the root of twice the slopes' variance for Beckmann, the like parameter of GGX; above 0."""
    beckmann: mi.Bool
    """Beckmann where true, else GGX."""
    has_beckmann: bool
    """False leaves Beckmann out of the kernel, whatever the mask says."""


def normal_density(facets: Microfacets, h: mi.Vector3f) -> mi.Float:
    """Return D(h): area of facets with the unit normal `h` per area of the mean plane and solid angle."""
    cosine2 = dr.square(h.z)
    alpha2 = dr.square(facets.alpha)
    slope2 = (dr.square(h.x) + dr.square(h.y)) / alpha2
    density = dr.inv_pi / (alpha2 * dr.square(slope2 + cosine2))
    if facets.has_beckmann:
        gauss = dr.inv_pi * dr.exp(-slope2 / cosine2) / (alpha2 * dr.square(cosine2))
        density = dr.select(facets.beckmann, gauss, density)
    # The tail below is noise of single precision (and 0 / 0 for a normal in the plane).
    return dr.select((h.z > 0.0) & (density * h.z > 1e-20), density, 0.0)


def smith_g1(facets: Microfacets, v: mi.Vector3f, h: mi.Vector3f) -> mi.Float:
    """Return G1(v, h): the visible share of the facets with normal `h`, seen along `v` from either side."""
    sine2 = dr.square(v.x) + dr.square(v.y)
    alpha2_tangent2 = dr.square(facets.alpha) * sine2 / dr.square(v.z)
    visible = 2.0 / (1.0 + dr.sqrt(1.0 + alpha2_tangent2))
    if facets.has_beckmann:
        # Walter's equation 27; its relative error is below 0.35 %.
        a = dr.rsqrt(alpha2_tangent2)
        fit = (3.535 * a + 2.181 * a * a) / (1.0 + 2.276 * a + 2.577 * a * a)
        visible = dr.select(facets.beckmann, dr.select(a < 1.6, fit, 1.0), visible)
    visible = dr.select(sine2 == 0.0, 1.0, visible)
    return dr.select((v.z != 0.0) & (dr.dot(v, h) * v.z > 0.0), visible, 0.0)


def sample_visible(facets: Microfacets, wo: mi.Vector3f, sample: mi.Point2f) -> mi.Vector3f:
    """Return a normal with density D(h) G1(wo, h) max(0, wo . h) / wo.z."""
    # Stretched by alpha, the surface has a width of one.
    stretched = dr.normalize(mi.Vector3f(facets.alpha * wo.x, facets.alpha * wo.y, wo.z))
    h = _sample_cap(stretched, sample)
    if facets.has_beckmann:
        h = dr.select(facets.beckmann, _sample_slopes(stretched, sample), h)
    return dr.normalize(mi.Vector3f(facets.alpha * h.x, facets.alpha * h.y, dr.maximum(h.z, 1e-12)))


def _sample_cap(wo: mi.Vector3f, sample: mi.Point2f) -> mi.Vector3f:
    """Return a visible normal (not of unit length) of a hemisphere, which GGX of width one is."""
    # Reflected directions fill the sphere's cap above -wo.z evenly; the normal is halfway to wo.
    z = (1.0 - sample.y) * (1.0 + wo.z) - wo.z
    sine, cosine = dr.sincos(dr.two_pi * sample.x)
    radius = dr.safe_sqrt(1.0 - z * z)
    return mi.Vector3f(radius * cosine + wo.x, radius * sine + wo.y, z + wo.z)


def _sample_slopes(wo: mi.Vector3f, sample: mi.Point2f) -> mi.Vector3f:
    """Return a visible normal (not of unit length) of Gaussian slopes with density exp(-x^2 - y^2) / pi.

    The slope x, against `wo`, has the density exp(-x^2) max(0, a - x) up to a factor, a = cot of wo's polar angle; the
    slope across is free. Its distribution is inverted by Newton's method over erf x, where it is concave: from the left
    of the root every step stays left of it, so the steps cannot run away.
    """
    sine = dr.maximum(dr.sqrt(dr.square(wo.x) + dr.square(wo.y)), 1e-6)
    a = dr.minimum(wo.z / sine, 1e4)
    u = dr.clip(sample.x, 1e-6, 1.0 - 1e-6)
    last = dr.erf(a)
    whole = _slope_integral(a, a, last)
    # The chord holds where wo is steep, the second is exact at grazing angles; the root is left of both.
    chord = u * (1.0 + last) - 1.0
    grazing = -dr.erf(dr.sqrt(-dr.log(u)))
    y = dr.clip(dr.minimum(chord, dr.lerp(grazing, chord, a / (a + 0.5))), -1.0 + 1e-6, 1.0 - 1e-6)
    for _ in range(_NEWTON_STEPS):
        x = dr.erfinv(y)
        step = (_slope_integral(a, x, y) - u * whole) / dr.maximum(0.5 * (a - x), 1e-6)
        y = dr.clip(y - step, -1.0 + 1e-6, dr.minimum(last, 1.0 - 1e-6))
    along = dr.erfinv(y)
    across = dr.erfinv(dr.clip(2.0 * sample.y - 1.0, -1.0 + 1e-6, 1.0 - 1e-6))
    cosine, sine = dr.select(wo.x * wo.x + wo.y * wo.y > 0.0, wo.x / sine, 1.0), wo.y / sine
    return mi.Vector3f(-(along * cosine - across * sine), -(along * sine + across * cosine), 1.0)


def _slope_integral(a: mi.Float, x: mi.Float, erf_x: mi.Float) -> mi.Float:
    """Return the integral of exp(-t^2) (a - t) / sqrt(pi) over t up to x."""
    return 0.5 * a * (1.0 + erf_x) + 0.5 * dr.rsqrt(dr.pi) * dr.exp(-x * x)
