"""Fresnel terms against Mitsuba's, their means and the tables of albedos against sums by NumPy."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy import integrate

from luxel.kernels.bsdf import BSDFFeatures, fresnel, make_tables
from luxel.kernels.bsdf import tables as tabulated
from luxel.kernels.bsdf.microfacet import Microfacets, normal_density, smith_g1

COSINES = np.linspace(0.0, 1.0, 101)
METALS = {"gold": ((0.143, 0.374, 1.442), (3.983, 2.386, 1.603)), "none": ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)),
          "iron": ((2.9, 2.9, 2.6), (3.1, 2.9, 2.8)), "sapphire": ((1.77, 1.77, 1.78), (0.0, 0.0, 0.0))}  # fmt: skip


@pytest.mark.parametrize("eta", [0.4, 0.66, 1.0, 1.01, 1.5, 3.0])
def test_dielectric_fresnel_is_mitsubas(eta: float) -> None:
    cosine = mi.Float(COSINES)
    ours, refracted = fresnel.dielectric_fresnel(cosine, mi.Float(eta))
    theirs, cosine_t, _, _ = mi.fresnel(cosine, mi.Float(eta))
    if eta == 1.0:  # Mitsuba's is 1 in the plane, where there is nothing to see
        np.testing.assert_array_equal(np.array(ours), 0.0)
    else:
        np.testing.assert_allclose(np.array(ours), np.array(theirs), atol=2e-6)
    np.testing.assert_allclose(np.array(refracted), -np.array(cosine_t), atol=1e-6)


@pytest.mark.parametrize("name", METALS)
def test_conductor_fresnel_is_mitsubas(name: str) -> None:
    eta, k = METALS[name]
    ours = np.array(fresnel.conductor_fresnel(mi.Float(COSINES), mi.Color3f(*eta), mi.Color3f(*k)))
    for channel in range(3):
        theirs = mi.fresnel_conductor(mi.Float(COSINES), mi.Complex2f(eta[channel], k[channel]))
        np.testing.assert_allclose(ours[channel], np.array(theirs), atol=2e-6)


@pytest.mark.parametrize("name", METALS)
def test_the_mean_of_a_conductor_is_its_integral(name: str) -> None:
    eta, k = METALS[name]
    fine = (np.arange(20000) + 0.5) / 20000
    curve = np.array(fresnel.conductor_fresnel(mi.Float(fine), mi.Color3f(*eta), mi.Color3f(*k)), float)
    expected = (curve * 2.0 * fine).mean(axis=1)
    found = np.array(fresnel.mean_conductor_fresnel(mi.Color3f(*eta), mi.Color3f(*k)))[:, 0]
    np.testing.assert_allclose(found, expected, atol=4e-3)


def test_a_metal_by_colour_is_schlicks() -> None:
    """f0 + (1 - f0) (1 - c)^5 as in appendix B of glTF 2.0, and the integral of that as the mean."""
    f0 = np.array([0.9, 0.5, 0.2])
    color = mi.Color3f(f0.tolist())
    for cosine in (1.0, 0.5, 1.0 / 7.0, 0.0):
        expected = f0 + (1.0 - f0) * (1.0 - cosine) ** 5
        np.testing.assert_allclose(np.array(fresnel.metal_fresnel(mi.Float(cosine), color))[:, 0], expected, atol=1e-6)
    for channel in range(3):
        expected = integrate.quad(lambda c, f=f0[channel]: 2.0 * c * (f + (1.0 - f) * (1.0 - c) ** 5), 0.0, 1.0)[0]
        assert np.array(fresnel.mean_metal_fresnel(color))[channel, 0] == pytest.approx(expected, abs=1e-6)


def sphere(count: int) -> tuple[mi.Vector3f, float]:
    """Return the middles of count^2 cells of the upper half of the sphere, and the solid angle of each."""
    cell = dr.arange(mi.UInt32, count * count)
    z = (mi.Float(cell // count) + 0.5) / count
    sine, cosine = dr.sincos(dr.two_pi * (mi.Float(cell % count) + 0.5) / count)
    radius = dr.safe_sqrt(1.0 - z * z)
    return mi.Vector3f(radius * cosine, radius * sine, z), 2.0 * np.pi / count**2


@pytest.mark.parametrize("beckmann", [False, True])
@pytest.mark.parametrize("alpha", [0.2, 0.5, 1.0])
def test_facets_cover_the_plane(beckmann: bool, alpha: float) -> None:
    """The projected area of all facets is one; of those that a direction sees, its cosine (Heitz 2014)."""
    facets = Microfacets(mi.Float(alpha), mi.Bool(beckmann), True)
    h, size = sphere(1500)
    area = normal_density(facets, h)
    assert float(np.array(area * h.z, float).sum()) * size == pytest.approx(1.0, abs=3e-3)
    for z in (0.1, 0.4, 0.9):
        wo = mi.Vector3f(float(np.sqrt(1.0 - z * z)), 0.0, z)
        seen = area * smith_g1(facets, wo, h) * dr.maximum(dr.dot(wo, h), 0.0)
        assert float(np.array(seen, float).sum()) * size == pytest.approx(z, rel=8e-3)


@pytest.mark.parametrize("beckmann", [False, True])
@pytest.mark.parametrize("roughness", [0.4, 0.63, 1.0])
def test_tables_are_the_integrals(beckmann: bool, roughness: float) -> None:
    """Sums over outgoing directions, where the tables' run over random numbers of the normal.

    Beckmann's two ways differ by the error of the fit of G1, which the sampled normals do not have.
    """
    tables = make_tables(BSDFFeatures(True, beckmann=True, compensate=True))
    facets = Microfacets(mi.Float(roughness**2), mi.Bool(beckmann), True)
    wi, size = sphere(1024)
    for z in (0.07, 0.33, 0.81):
        wo = mi.Vector3f(float(np.sqrt(1.0 - z * z)), 0.0, z)
        h = dr.normalize(wo + wi)
        lobe = normal_density(facets, h) * smith_g1(facets, wo, h) * smith_g1(facets, wi, h) / (4.0 * z)
        rise = lobe * (1.0 - dr.dot(wo, h)) ** 5
        found = tabulated.fetch_albedo(tables, mi.Float(z), mi.Float(roughness), mi.Bool(beckmann), mi.Bool(True))
        for mine, sum_of in zip(found, (lobe, rise), strict=True):
            assert float(mine[0]) == pytest.approx(
                float(np.array(sum_of, float).sum()) * size, abs=4e-3 if beckmann else 1.5e-3
            )


@pytest.mark.parametrize("ior", [1.1, 1.33, 1.5, 2.0, 2.8])
def test_smooth_plastic_throws_back_its_share(ior: float) -> None:
    """Mitsuba's fit of the same is 0.012 high at an index of 2.8."""
    tables = make_tables(BSDFFeatures(True, plastic=True))
    off, on = mi.Bool(False), mi.Bool(True)
    found = tabulated.fetch_plastic_means(tables, mi.Float(0.0), mi.Float(ior), off, on)
    cosine = (np.arange(200000) + 0.5) / 200000
    curve = np.array(mi.fresnel(mi.Float(cosine), mi.Float(1.0 / ior))[0], float)
    assert float(found[0][0]) == pytest.approx(float((curve * 2.0 * cosine).mean()), abs=2e-3)
    curve = 1.0 - np.array(mi.fresnel(mi.Float(cosine), mi.Float(ior))[0], float)
    assert float(found[1][0]) == pytest.approx(float((curve * 2.0 * cosine).mean()), abs=2e-3)
