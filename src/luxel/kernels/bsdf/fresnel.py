"""Fresnel reflectance of dielectrics and metals, by the exact equations and by Schlick's approximation.

Cosines are those between a direction and the (micro)normal, 0..1.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

_GAUSS_NODES = (0.21234054, 0.59053314, 0.91141204)
_GAUSS_WEIGHTS = (0.13965396, 0.45848221, 0.40186383)
"""Gauss and Jacobi's rule of three nodes for the mean of f(c) over c in 0..1, weighted by 2 c."""


def dielectric_fresnel(cosine: mi.Float, eta: mi.Float) -> tuple[mi.Float, mi.Float]:
    """Return the unpolarised reflectance and the cosine of the refracted direction (0 in total reflection).

    `eta` is the index beyond the interface over the index on the side of the ray.
    """
    sine2 = (1.0 - dr.square(cosine)) / dr.square(eta)
    refracted = dr.safe_sqrt(1.0 - sine2)
    across = (cosine - eta * refracted) / (cosine + eta * refracted)
    along = (eta * cosine - refracted) / (eta * cosine + refracted)
    reflectance = 0.5 * (dr.square(across) + dr.square(along))
    reflectance = dr.select(sine2 >= 1.0, 1.0, reflectance)
    return dr.select(eta == 1.0, 0.0, reflectance), refracted


def conductor_fresnel(cosine: mi.Float, eta: mi.Color3f, k: mi.Color3f) -> mi.Color3f:
    """Return the unpolarised reflectance of a metal with the relative complex index `eta` + i `k` in air."""
    cosine2 = dr.square(cosine)
    sine2 = 1.0 - cosine2
    real = dr.square(eta) - dr.square(k) - sine2
    modulus = dr.sqrt(dr.square(real) + 4.0 * dr.square(eta * k))
    cross = 2.0 * cosine * dr.safe_sqrt(0.5 * (modulus + real))
    total = modulus + cosine2
    across = (total - cross) / (total + cross)
    first = cosine2 * modulus + dr.square(sine2)
    second = cross * sine2
    along = across * (first - second) / dr.maximum(first + second, 1e-20)
    return 0.5 * (across + along)


def mean_conductor_fresnel(eta: mi.Color3f, k: mi.Color3f) -> mi.Color3f:
    """Return the mean of `conductor_fresnel` over the hemisphere, weighted by the cosine."""
    total = mi.Color3f(0.0)
    for node, weight in zip(_GAUSS_NODES, _GAUSS_WEIGHTS, strict=True):
        total += weight * conductor_fresnel(mi.Float(node), eta, k)
    return total


def schlick_rise(cosine: mi.Float) -> mi.Float:
    """Return (1 - c)^5: how far the reflectance has risen from normal to grazing incidence (Schlick 1994)."""
    rest = dr.clip(1.0 - cosine, 0.0, 1.0)
    return dr.square(dr.square(rest)) * rest


def metal_fresnel(cosine: mi.Float, f0: mi.Color3f) -> mi.Color3f:
    """Return Schlick's reflectance of a metal that reflects `f0` at normal incidence.

    It has no dip before grazing incidence, as that of many metals has near 82 degrees: glTF says none of it, and where
    a file knows the metal's complex index, `conductor_fresnel` has it exactly.
    """
    return dr.clip(f0 + (1.0 - f0) * schlick_rise(cosine), 0.0, 1.0)


def mean_metal_fresnel(f0: mi.Color3f) -> mi.Color3f:
    """Return the mean of `metal_fresnel` over the hemisphere, weighted by the cosine."""
    # The mean of (1 - c)^5 is 1/21.
    return dr.clip(f0 + (1.0 - f0) / 21.0, 0.0, 1.0)
