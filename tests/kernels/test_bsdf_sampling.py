"""Sampling against density by chi-square, weights against integrals, and no compilation by a parameter's value."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.kernels.bsdf import (
    BSDF,
    LOBE_DIFFUSE,
    LOBE_NONE,
    BSDFFeatures,
    BSDFTables,
    density,
    diffuse_albedo,
    evaluate,
    make_tables,
    sample,
)

ALL = BSDFFeatures(*[True] * len(BSDFFeatures._fields))
METAL = {"metallic": 1.0}
GLASS = {"transmission": 1.0, "specular": 1.0}
MATERIALS: dict[str, dict[str, Any]] = {
    "diffuse": {},
    "GGX metal": {**METAL, "alpha": 0.3},
    "smooth GGX metal": {**METAL, "alpha": 0.1},
    "GGX metal of alpha 1": {**METAL, "alpha": 1.0},
    "Beckmann metal": {**METAL, "alpha": 0.3, "beckmann": True},
    "smooth Beckmann metal": {**METAL, "alpha": 0.1, "beckmann": True},
    "Beckmann metal of alpha 1": {**METAL, "alpha": 1.0, "beckmann": True},
    "compensated metal": {**METAL, "alpha": 0.6, "compensate": True},
    "glass": {**GLASS, "alpha": 0.3},
    "Beckmann glass": {**GLASS, "alpha": 0.3, "beckmann": True},
    "rough glass": {**GLASS, "alpha": 1.0},
    "frosted pane": {**GLASS, "alpha": 0.3, "thin": True},
    "coated dielectric": {"specular": 1.0, "alpha": 0.3, "clearcoat": 0.7, "clearcoat_alpha": 0.15},
    "plastic": {"specular": 1.0, "alpha": 0.3, "plastic": True},
    "everything": {
        "metallic": 0.3, "specular": 0.8, "transmission": 0.4, "alpha": 0.4, "clearcoat": 0.5, "clearcoat_alpha": 0.2,
        "compensate": True,
    },
    "black metal": {"metallic": 1.0, "alpha": 0.4, "base": 0.0},
    "polished plastic under glass": {"specular": 1.0, "alpha": 0.0, "transmission": 0.5},
}  # fmt: skip


@pytest.fixture(scope="module")
def tables() -> BSDFTables:
    return make_tables(ALL)


def make(tables: BSDFTables, name: str) -> BSDF:
    more = dict(MATERIALS[name])
    return BSDF(mi.Color3f(0.8, 0.5, 0.2) * more.pop("base", 1.0), ALL, tables, **more)


def direction(degrees: float) -> mi.Vector3f:
    angle = np.deg2rad(degrees)
    return mi.Vector3f(float(np.sin(angle) * 0.6), float(np.sin(angle) * 0.8), float(np.cos(angle)))


ANGLES = [0.0, 35.0, 80.0]


def passes_chi_square(bsdf: BSDF, wo: mi.Vector3f, wrong: float = 1.0) -> bool:
    """Return whether directions drawn with `bsdf` have its density, that times `wrong` in one quarter.

    The cells of the test crowd at the poles, so the surface is turned away from them.
    """
    turned = mi.Frame3f(dr.normalize(mi.Vector3f(0.3, 0.5, 0.7)))

    def draw(numbers: list[mi.Float]) -> tuple[mi.Vector3f, mi.Float]:
        drawn = sample(bsdf, wo, numbers[0], mi.Point2f(numbers[1], numbers[2]))
        return turned.to_world(drawn.wi), dr.select((drawn.lobe != LOBE_NONE) & ~drawn.delta, mi.Float(1.0), 0.0)

    def weigh(wi: mi.Vector3f) -> mi.Float:
        wi = turned.to_local(wi)
        return density(bsdf, wo, wi) * dr.select((wi.x < 0.0) & (wi.y < 0.0), wrong, 1.0)

    test = mi.chi2.ChiSquareTest(
        mi.chi2.SphericalDomain(), draw, weigh, sample_dim=3, sample_count=400000, res=101, ires=12, seed=3
    )
    return test.run(significance_level=0.01, test_count=len(MATERIALS) * len(ANGLES), quiet=True)


@pytest.mark.parametrize("degrees", ANGLES)
@pytest.mark.parametrize("name", MATERIALS)
def test_directions_are_drawn_with_the_density(tables: BSDFTables, name: str, degrees: float) -> None:
    assert passes_chi_square(make(tables, name), direction(degrees))


@pytest.mark.parametrize("name", ["glass", "frosted pane", "everything"])
def test_directions_are_drawn_with_the_density_from_behind(tables: BSDFTables, name: str) -> None:
    assert passes_chi_square(make(tables, name), direction(145.0))


def test_the_chi_square_test_can_fail(tables: BSDFTables) -> None:
    assert not passes_chi_square(make(tables, "GGX metal"), direction(35.0), 1.05)


@pytest.mark.parametrize("name", MATERIALS)
def test_the_mean_weight_is_the_integral(tables: BSDFTables, name: str) -> None:
    """Of lobes that are not delta: drawn, against a sum over 1,024 x 1,024 cells of the sphere."""
    bsdf, wo = make(tables, name), direction(50.0)
    count = 1 << 19
    numbers = np.random.default_rng(1).random((3, count)).astype(np.float32)
    drawn = sample(bsdf, wo, mi.Float(numbers[0]), mi.Point2f(numbers[1:]))
    value = evaluate(bsdf, wo, sphere_of(1024))
    for weight, part in ((drawn.diffuse, value.diffuse), (drawn.glossy, value.glossy)):
        rough = np.array(dr.select(drawn.delta, mi.Color3f(0.0), weight), float)
        noise = rough.std(axis=1) / np.sqrt(count)
        integral = np.array(part, float).mean(axis=1) * 4.0 * np.pi
        assert (np.abs(rough.mean(axis=1) - integral) < 5.0 * noise + 2e-3 * integral + 1e-6).all()


@pytest.mark.parametrize("name", [name for name in MATERIALS if name != "black metal"])
def test_the_diffuse_albedo_is_the_integral(tables: BSDFTables, name: str) -> None:
    for degrees in (0.0, 50.0, 80.0):
        bsdf, wo = make(tables, name), direction(degrees)
        value = evaluate(bsdf, wo, sphere_of(1024)).diffuse
        expected = np.array(value, float).mean(axis=1) * 4.0 * np.pi
        # An approximation under a clear coat that does not compensate.
        rtol = 0.03 if name == "coated dielectric" else 5e-3
        np.testing.assert_allclose(np.array(diffuse_albedo(bsdf, wo))[:, 0], expected, rtol=rtol, atol=1e-5)


def sphere_of(side: int) -> mi.Vector3f:
    """Return the middles of side^2 cells of equal solid angle."""
    cell = dr.arange(mi.UInt32, side * side)
    z = 1.0 - 2.0 * (mi.Float(cell // side) + 0.5) / side
    sine, cosine = dr.sincos(dr.two_pi * (mi.Float(cell % side) + 0.5) / side)
    radius = dr.safe_sqrt(1.0 - z * z)
    return mi.Vector3f(radius * cosine, radius * sine, z)


def test_lambert_alone_is_a_lambert(tables: BSDFTables) -> None:
    """Without features nothing but the base colour counts, and nothing else is compiled."""
    wo, wi = direction(35.0), direction(80.0)
    bsdf = BSDF(mi.Color3f(0.8, 0.5, 0.2), metallic=1.0, specular=1.0, alpha=0.1)
    expected = np.array([0.8, 0.5, 0.2]) * np.cos(np.deg2rad(80.0)) / np.pi
    np.testing.assert_allclose(np.array(evaluate(bsdf, wo, wi).total)[:, 0], expected, rtol=1e-5)
    assert float(density(bsdf, wo, wi)[0]) == pytest.approx(np.cos(np.deg2rad(80.0)) / np.pi, rel=1e-5)
    drawn = sample(bsdf, wo, mi.Float(0.9), mi.Point2f(0.2, 0.7))
    np.testing.assert_allclose(np.array(drawn.weight)[:, 0], [0.8, 0.5, 0.2], rtol=1e-5)
    assert drawn.lobe[0] == LOBE_DIFFUSE
    below = mi.Vector3f(wo.x, wo.y, -wo.z)
    assert np.array(evaluate(bsdf, below, wi).total).max() == 0.0 and np.array(density(bsdf, below, wi)).max() == 0.0
    assert sample(bsdf, below, mi.Float(0.9), mi.Point2f(0.2, 0.7)).lobe[0] == LOBE_NONE


def test_inactive_lanes_answer_nothing(tables: BSDFTables) -> None:
    wo, off = direction(35.0), mi.Bool(False)
    for name in MATERIALS:
        bsdf = make(tables, name)
        drawn = sample(bsdf, wo, mi.Float(0.4), mi.Point2f(0.2, 0.7), off)
        value = evaluate(bsdf, wo, drawn.wi, off).total
        assert np.array(value).max() == np.array(drawn.weight).max() == np.array(drawn.density).max() == 0.0
        assert np.array(density(bsdf, wo, drawn.wi, off)).max() == 0.0 and drawn.lobe[0] == LOBE_NONE


def test_no_compilation_by_values(tables: BSDFTables) -> None:
    count = 1000
    compiled = []
    for value in (0.2, 0.5, 0.9):
        number = dr.full(mi.Float, value, count)
        dr.make_opaque(number)
        bsdf = BSDF(
            mi.Color3f(number), ALL, tables, metallic=number, alpha=number, beckmann=number > 0.4, ior=1.0 + number,
            specular=number, transmission=number, thin=number > 0.4, clearcoat=number, clearcoat_alpha=number,
            compensate=number > 0.4,
        )  # fmt: skip
        wo = mi.Vector3f(dr.sqrt(1.0 - number * number), 0.0, number)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            drawn = sample(bsdf, wo, number, mi.Point2f(number, number))
            dr.eval(drawn, evaluate(bsdf, wo, drawn.wi))
            dr.sync_thread()
            history = dr.kernel_history([dr.KernelType.JIT])
        compiled.append([not kernel["cache_hit"] for kernel in history])
    assert len(compiled[0]) == 1 and not any(compiled[1] + compiled[2])


def test_a_path_of_several_bounces_runs_in_a_loop(tables: BSDFTables) -> None:
    """A symbolic loop that builds the BSDF inside: what the path tracer will do. White diffuse keeps all light."""
    count = 1000
    albedo = dr.opaque(mi.Float, 0.5, count)

    def bounce(i: mi.UInt32, weight: mi.Color3f, seed: mi.UInt32) -> tuple[mi.UInt32, mi.Color3f, mi.UInt32]:
        bsdf = BSDF(mi.Color3f(albedo), ALL, tables, alpha=albedo, metallic=0.0)
        numbers = [mi.Float((seed * mi.UInt32(k)) >> 8) * 2.0**-24 for k in (1664525, 22695477, 1103515245)]
        drawn = sample(bsdf, mi.Vector3f(0.6, 0.0, 0.8), numbers[0], mi.Point2f(numbers[1], numbers[2]))
        return i + 1, weight * drawn.weight, seed * 747796405 + 2891336453

    state = (mi.UInt32(0), mi.Color3f(1.0), dr.arange(mi.UInt32, count) + 17)
    _, weight, _ = dr.while_loop(state, lambda i, weight, seed: i < 4, bounce, mode="symbolic")
    np.testing.assert_allclose(np.array(weight), 0.5**4, rtol=1e-4)
