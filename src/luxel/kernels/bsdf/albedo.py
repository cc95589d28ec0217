"""Directional albedos of rough interfaces, integrated on the device with the lobes' own functions.

The integrals run over the two random numbers of visible-normal sampling: there the integrand is the Fresnel term times
the shadowing of the way out. They take less than a second on two cores and depend on no scene.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.kernels.bsdf import tables as axes
from luxel.kernels.bsdf.fresnel import dielectric_fresnel, schlick_rise
from luxel.kernels.bsdf.microfacet import Microfacets, sample_visible, smith_g1
from luxel.kernels.bsdf.record import BSDFFeatures
from luxel.kernels.bsdf.tables import BSDFTables
from luxel.kernels.sampling import sequence_2d, sequence_3d
from luxel.scene.arrays import from_numpy

_ALBEDO_POINTS, _PLASTIC_POINTS, _INTERNAL_POINTS = 1024, 512, 8192
"""Points of a low-discrepancy sequence for each entry: errors below 1e-3. Gauss's rule is no better, for shadowing and
total reflection leave kinks."""


def make_tables(features: BSDFFeatures) -> BSDFTables:
    """Return the tables that a scene with `features` reads; the others are one packet of zeros."""
    kinds = [False, True] if features.beckmann else [False]
    albedo = mean = transmittance = plastic_means = np.zeros(4)
    if features.specular or features.clearcoat or features.compensate:
        albedo, mean = _pack_albedos(kinds)
    if features.plastic:
        transmittance, plastic_means = _pack_plastics(kinds)
    return BSDFTables(*(from_numpy(mi.Float, array) for array in (albedo, mean, transmittance, plastic_means)))


def _pack_albedos(kinds: list[bool]) -> tuple[np.ndarray, np.ndarray]:
    x = np.linspace(0.0, 1.0, axes.ALBEDO_COSINES)
    albedo = np.stack([_white_albedos(x**2, kind) for kind in kinds])  # kind, roughness, cosine, which
    mean = _mean_over_cosine(x, np.moveaxis(albedo, -2, -1))
    return (
        np.concatenate([albedo[..., :-1, :], albedo[..., 1:, :]], axis=-1),
        np.concatenate([mean[:, :-1], mean[:, 1:]], axis=-1),
    )


def _pack_plastics(kinds: list[bool]) -> tuple[np.ndarray, np.ndarray]:
    x = np.linspace(0.0, 1.0, axes.PLASTIC_COSINES)
    largest = (axes.LARGEST_INDEX - 1.0) / (axes.LARGEST_INDEX + 1.0)
    f = largest * np.linspace(0.0, 1.0, axes.PLASTIC_INDICES) ** 2
    ior = (1.0 + f) / (1.0 - f)
    let_in = np.stack([_transmittances(x**2, ior, kind) for kind in kinds])  # kind, index, roughness, cosine
    internal = np.stack([_internal_reflectances(ior, kind) for kind in kinds])  # kind, index, roughness
    rows = np.stack([let_in[..., :-1], let_in[..., 1:]], axis=-1)
    means = np.stack([internal, _mean_over_cosine(x, let_in)], axis=-1)
    return (
        np.concatenate([rows[:, :, :-1], rows[:, :, 1:]], axis=-1),
        np.concatenate([means[:, :, :-1], means[:, :, 1:]], axis=-1),
    )


def _white_albedos(cosine: np.ndarray, beckmann: bool) -> np.ndarray:
    """Return the albedos (roughness, cosine, 2) of facets of reflectance 1 and of (1 - c)^5."""
    roughness = np.linspace(0.0, 1.0, axes.ALBEDO_ROUGHNESSES)
    nodes = np.stack(np.meshgrid(roughness, cosine, indexing="ij")).reshape(2, -1)
    facets, wo, h = _facet_points(nodes[0], nodes[1], beckmann, _ALBEDO_POINTS)
    facing = dr.dot(wo, h)
    out = smith_g1(facets, mi.Vector3f(2.0 * facing * h - wo), h)
    out = dr.select(2.0 * facing * h.z > wo.z, out, 0.0)
    means = [_mean_points(value, _ALBEDO_POINTS) for value in (out, out * schlick_rise(facing))]
    table = np.stack(means, axis=-1).reshape(len(roughness), len(cosine), 2)
    # No roughness is a mirror.
    table[0] = np.stack([np.ones_like(cosine), (1.0 - cosine) ** 5], axis=-1)
    return table


def _transmittances(cosine: np.ndarray, ior: np.ndarray, beckmann: bool) -> np.ndarray:
    """Return what dielectrics let in from outside, (index, roughness, cosine)."""
    roughness = np.linspace(0.0, 1.0, axes.PLASTIC_ROUGHNESSES)
    nodes = np.stack(np.meshgrid(roughness, cosine, indexing="ij")).reshape(2, -1)
    facets, wo, h = _facet_points(nodes[0], nodes[1], beckmann, _PLASTIC_POINTS)
    facing = dr.dot(wo, h)
    # Drawn once for all indices.
    dr.eval(h, facing)
    found = []
    for value in ior:
        eta = dr.opaque(mi.Float, float(value))
        reflected, refracted = dielectric_fresnel(facing, eta)
        wi = mi.Vector3f((facing / eta - refracted) * h - wo / eta)
        through = dr.select(wi.z < 0.0, (1.0 - reflected) * smith_g1(facets, wi, h), 0.0)
        found.append(_mean_points(through, _PLASTIC_POINTS).reshape(len(roughness), len(cosine)))
        smooth, _ = dielectric_fresnel(from_numpy(mi.Float, np.maximum(cosine, 1e-6)), eta)
        found[-1][0] = 1.0 - np.array(smooth)
    return np.stack(found)


def _internal_reflectances(ior: np.ndarray, beckmann: bool) -> np.ndarray:
    """Return what dielectrics throw back inside, the mean over the hemisphere by the cosine, (index, roughness)."""
    roughness = np.linspace(0.0, 1.0, axes.PLASTIC_ROUGHNESSES)
    lane = dr.arange(mi.UInt32, len(roughness) * _INTERNAL_POINTS)
    u, v, w = sequence_3d(lane % _INTERNAL_POINTS, (mi.UInt32(0), mi.UInt32(0), mi.UInt32(0)))
    r = dr.gather(mi.Float, from_numpy(mi.Float, roughness), lane // _INTERNAL_POINTS)
    facets = Microfacets(dr.square(dr.maximum(r, 1e-2)), mi.Bool(beckmann), beckmann)
    cosine = dr.sqrt(dr.maximum(w, 1e-9))
    wo = mi.Vector3f(dr.safe_sqrt(1.0 - dr.square(cosine)), 0.0, cosine)
    h = sample_visible(facets, wo, mi.Point2f(u, v))
    facing = dr.dot(wo, h)
    wi = mi.Vector3f(2.0 * facing * h - wo)
    out = dr.select(wi.z > 0.0, smith_g1(facets, wi, h), 0.0)
    out, facing = dr.select(r > 0.0, out, 1.0), dr.select(r > 0.0, facing, cosine)
    dr.eval(out, facing)
    found = []
    for value in ior:
        reflected, _ = dielectric_fresnel(facing, dr.opaque(mi.Float, 1.0 / float(value)))
        found.append(_mean_points(out * reflected, _INTERNAL_POINTS))
    return np.stack(found)


def _facet_points(
    roughness: np.ndarray, cosine: np.ndarray, beckmann: bool, count: int
) -> tuple[Microfacets, mi.Vector3f, mi.Vector3f]:
    """Return facets, directions `wo` and visible normals: a block of `count` lanes for each node."""
    lane = dr.arange(mi.UInt32, len(roughness) * count)
    alpha = dr.gather(mi.Float, from_numpy(mi.Float, np.maximum(roughness, 1e-2) ** 2), lane // count)
    z = dr.gather(mi.Float, from_numpy(mi.Float, np.maximum(cosine, 1e-6)), lane // count)
    wo = mi.Vector3f(dr.safe_sqrt(1.0 - z * z), 0.0, z)
    facets = Microfacets(alpha, mi.Bool(beckmann), beckmann)
    point = sequence_2d(lane % count, (mi.UInt32(1 << 20), mi.UInt32(1 << 21)))
    return facets, wo, sample_visible(facets, wo, point)


def _mean_points(value: mi.Float, count: int) -> np.ndarray:
    return np.array(dr.block_reduce(dr.ReduceOp.Add, value, count), float) / count


def _mean_over_cosine(x: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the mean of (..., x) over the hemisphere, weighted by the cosine x^2, of what the look-up interpolates."""
    fine = (np.arange(4096) + 0.5) / 4096
    weight = 4.0 * fine**3 / len(fine)
    hats = np.stack([np.interp(fine, x, row) for row in np.eye(len(x))])
    return values @ (hats @ weight)
