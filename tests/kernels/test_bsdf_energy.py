"""No material makes light: white furnaces, energy, reciprocity, and finite numbers at every extreme."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.kernels.bsdf import BSDF, BSDFFeatures, BSDFSample, BSDFTables, density, evaluate, make_tables, sample
from luxel.kernels.sampling import sequence_3d

ALL = BSDFFeatures(*[True] * len(BSDFFeatures._fields))
BINS, PER_BIN, POINTS = 16, 8, 1 << 13
ALPHAS = [0.0, 0.0015, 0.01, 0.03, 0.1, 0.3, 0.6, 1.0]


@pytest.fixture(scope="module")
def tables() -> BSDFTables:
    return make_tables(ALL)


def make(tables: BSDFTables, base: Any = 1.0, **more: Any) -> BSDF:
    numbers = {key: dr.opaque(mi.Float, value) if isinstance(value, float) else value for key, value in more.items()}
    return BSDF(mi.Color3f(base), ALL, tables, **numbers)


def points_of(lanes: mi.UInt32) -> tuple[mi.Float, mi.Point2f]:
    x, y, z = sequence_3d(lanes, (mi.UInt32(1), mi.UInt32(2), mi.UInt32(3)))
    return x, mi.Point2f(y, z)


def fan(cosines: np.ndarray) -> tuple[mi.Vector3f, mi.Float, mi.Point2f]:
    """Return `POINTS` lanes for each cosine: the direction, and numbers to sample with."""
    lane = dr.arange(mi.UInt32, len(cosines) * POINTS)
    z = dr.gather(mi.Float, mi.Float(cosines), lane // POINTS)
    return mi.Vector3f(dr.safe_sqrt(1.0 - z * z), 0.0, z), *points_of(lane % POINTS)


def mean_of(value: mi.Float) -> np.ndarray:
    return np.array(dr.block_reduce(dr.ReduceOp.Add, value, POINTS), float) / POINTS


def reflected(bsdf: BSDF) -> np.ndarray:
    """Return the light that comes back in each bin of the cosine: white light all around, the red channel.

    By two ways of drawing together (Veach's balance heuristic): the BSDF's own, and one that dwells on grazing angles,
    where light of several bounces leaves.
    """
    wo, lobe, point = fan((np.arange(BINS * PER_BIN) + 0.5) / (BINS * PER_BIN))
    drawn = sample(bsdf, wo, lobe, point)
    u = dr.clip(point.x, 1e-3, 1.0)
    z = dr.square(dr.square(u))
    sine, cosine = dr.sincos(dr.two_pi * point.y)
    grazing = mi.Vector3f(dr.safe_sqrt(1.0 - z * z) * cosine, dr.safe_sqrt(1.0 - z * z) * sine, z)

    def weigh(wi: mi.Vector3f) -> mi.Float:
        other = 1.0 / (8.0 * dr.pi * dr.power(dr.maximum(wi.z, 1e-12), 0.75))
        return dr.select(wi.z > 0.0, evaluate(bsdf, wo, wi).total.x / (density(bsdf, wo, wi) + other), 0.0)

    own = dr.select(drawn.delta, drawn.weight.x, dr.select(drawn.density > 0.0, weigh(drawn.wi), 0.0))
    return mean_of(own + weigh(grazing)).reshape(BINS, PER_BIN).mean(axis=1)


OPAQUE = {
    "metal": {"metallic": 1.0},
    "Beckmann metal": {"metallic": 1.0, "beckmann": True},
    "dielectric": {"specular": 1.0},
    "dense dielectric": {"specular": 1.0, "ior": 3.0},
    "Beckmann dielectric": {"specular": 1.0, "beckmann": True},
    "half metal": {"specular": 1.0, "metallic": 0.5},
    "diffuse": {},
}


@pytest.mark.parametrize("name", OPAQUE)
@pytest.mark.parametrize("alpha", ALPHAS)
def test_white_surfaces_return_all_light(tables: BSDFTables, name: str, alpha: float) -> None:
    np.testing.assert_allclose(reflected(make(tables, alpha=alpha, compensate=True, **OPAQUE[name])), 1.0, atol=0.02)


def test_without_compensation_rough_metal_loses_light(tables: BSDFTables) -> None:
    """Heitz 2014 and Kulla and Conty: about half is lost at alpha 1."""
    assert reflected(make(tables, alpha=1.0, metallic=1.0)).min() < 0.6


@pytest.mark.parametrize("f0", [0.2, 0.6])
def test_several_bounces_take_the_colour_of_each(tables: BSDFTables, f0: float) -> None:
    """What compensation adds is (1 - E) F^2 m / (1 - F (1 - m)): m the mean of E, F that of Schlick's curve."""
    found = reflected(make(tables, alpha=0.8, metallic=1.0))
    cosine = (np.arange(BINS) + 0.5) / BINS
    mean = float((found * 2.0 * cosine).mean())
    fresnel = f0 + (1.0 - f0) / 21.0
    expected = (1.0 - found) * fresnel**2 * mean / (1.0 - fresnel * (1.0 - mean))
    added = [reflected(make(tables, f0, alpha=0.8, metallic=1.0, compensate=on)) for on in (False, True)]
    np.testing.assert_allclose(added[1] - added[0], expected, atol=2e-3)


@pytest.mark.parametrize("name", ["metal", "dielectric"])
@pytest.mark.parametrize("coat", [0.0, 0.1, 1.0])
def test_a_clear_coat_returns_most_light(tables: BSDFTables, name: str, coat: float) -> None:
    """A white metal loses up to 6 % between coat and rough facets, a white diffuse base 3 %."""
    for alpha in ALPHAS:
        more = {"alpha": alpha, "clearcoat": 1.0, "clearcoat_alpha": coat, "compensate": True, **OPAQUE[name]}
        found = reflected(make(tables, **more))
        assert found.min() > (0.935 if name == "metal" else 0.97) and found.max() < 1.01, (alpha, found)


# ----------------------------------------------------------------------------------------------------------------------
# Any material


def random_bsdfs(tables: BSDFTables, count: int, seed: int, **fixed: Any) -> BSDF:
    """Return `count` materials with fields drawn at random, half of them at their ends."""
    rng = np.random.default_rng(seed)

    def number(ends: tuple[float, ...], low: float = 0.0, high: float = 1.0) -> mi.Float:
        return mi.Float(np.where(rng.random(count) < 0.5, rng.choice(ends, count), rng.uniform(low, high, count)))

    def color(low: float, high: float) -> mi.Color3f:
        return mi.Color3f(*(number((low, high), low, high) for _ in range(3)))

    def flag() -> mi.Bool:
        return mi.Bool(rng.random(count) < 0.5)

    drawn = {
        "metallic": number((0.0, 1.0)), "alpha": number((0.0, 0.0009, 0.001, 0.003, 1.0)), "beckmann": flag(),
        "has_eta": flag(), "eta": color(0.0, 3.0), "k": color(0.0, 5.0),
        "ior": number((1.0, 1.0005, 1.5, 0.66), 1.0, 2.5), "specular": number((0.0, 1.0)),
        "specular_color": color(0.0, 1.0), "transmission": number((0.0, 1.0)), "thin": flag(),
        "clearcoat": number((0.0, 1.0)), "clearcoat_alpha": number((0.0, 0.001, 1.0)), "plastic": flag(),
        "nonlinear": flag(), "compensate": flag(),
    }  # fmt: skip
    return BSDF(color(0.0, 1.0), ALL, tables, **{**drawn, **fixed})


def repeat(bsdf: BSDF, each: int, count: int) -> BSDF:
    """Return `bsdf` with every one of its `count` materials `each` times."""
    index = dr.arange(mi.UInt32, each * count) // each
    fields = {}
    for name in ("base_color", *BSDF.__dataclass_fields__):
        value = getattr(bsdf, name)
        if isinstance(value, (mi.Float, mi.Bool, mi.Color3f)):
            value = dr.gather(type(value), value, index)
        fields[name] = value
    return BSDF(**fields)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_energy_never_exceeds_one(tables: BSDFTables, side: float) -> None:
    """What a unit of light becomes, the narrowing of radiance at a refraction undone, in every channel.

    The bound leaves 1 % for the coat's approximation and for the samples' own noise.
    """
    count = 96
    cosines = np.random.default_rng(5).uniform(0.05, 1.0, count) * side
    wo, lobe, point = fan(cosines)
    bsdf = repeat(random_bsdfs(tables, count, 6), POINTS, count)
    drawn = sample(bsdf, wo, lobe, point)
    eta = bsdf.ior if side > 0.0 else 1.0 / bsdf.ior
    undone = dr.select(drawn.transmitted & ~mi.Bool(bsdf.thin), dr.square(eta), 1.0)
    total = np.array([mean_of(channel * undone) for channel in drawn.weight])
    assert total.max() < 1.01 and total.min() >= 0.0
    assert np.count_nonzero(total > 0.3) > 20


@pytest.mark.parametrize("ior", [0.7, 1.01, 1.5, 2.4])
def test_rough_glass_makes_no_light(tables: BSDFTables, ior: float) -> None:
    for alpha in ALPHAS:
        for side in (1.0, -1.0):
            wo, lobe, point = fan(side * (np.arange(32) + 0.5) / 32)
            drawn = sample(make(tables, alpha=alpha, ior=ior, specular=1.0, transmission=1.0), wo, lobe, point)
            eta = ior if side > 0.0 else 1.0 / ior
            total = mean_of(drawn.weight.x * dr.select(drawn.transmitted, eta**2, 1.0))
            assert total.max() < 1.003
            if alpha == 0.0:
                np.testing.assert_allclose(total, 1.0, atol=2e-3)


def unit_vectors(seed: int, count: int) -> np.ndarray:
    d = np.random.default_rng(seed).normal(size=(3, count))
    return (d / np.linalg.norm(d, axis=0)).astype(np.float32)


def test_reciprocity(tables: BSDFTables) -> None:
    """f(wo, wi) = f(wi, wo), and across an interface f(wo, wi) n_i^2 = f(wi, wo) n_o^2."""
    count = 50000
    bsdf = random_bsdfs(tables, count, 7)
    bsdf.alpha = dr.maximum(bsdf.alpha, 0.02)
    wo, wi = (mi.Vector3f(unit_vectors(seed, count)) for seed in (8, 9))
    there, back = evaluate(bsdf, wo, wi), evaluate(bsdf, wi, wo)
    ratio = dr.select(wo.z > 0.0, dr.square(bsdf.ior), dr.rcp(dr.square(bsdf.ior)))
    ratio = dr.select((wo.z * wi.z > 0.0) | bsdf.thin, 1.0, ratio)
    for one, two in ((there.diffuse, back.diffuse), (there.glossy, back.glossy)):
        left, right = np.array(one / dr.abs(wi.z) * ratio), np.array(two / dr.abs(wo.z))
        assert np.count_nonzero(left) > 1000
        np.testing.assert_allclose(left, right, rtol=5e-3, atol=1e-4)


def test_extremes_stay_finite(tables: BSDFTables) -> None:
    count = 200000
    rng = np.random.default_rng(10)
    bsdf = random_bsdfs(tables, count, 11)
    heights = rng.choice([0.0, 1e-38, 1e-8, 1e-4, 0.5, 1.0 - 1e-7, 1.0], (2, count)) * rng.choice([-1, 1], (2, count))
    turn = rng.choice([0.0, np.pi / 2, np.pi, 1.0], (2, count))
    wo, wi = (
        np.stack([np.sqrt(1 - z**2) * np.cos(a), np.sqrt(1 - z**2) * np.sin(a), z])
        for z, a in zip(heights, turn, strict=True)
    )
    wi = np.where(rng.random(count) < 0.2, -wo, wi)
    wi = np.where(rng.random(count) < 0.2, wo, wi)
    out, light = mi.Vector3f(wo.astype(np.float32)), mi.Vector3f(wi.astype(np.float32))
    lobe = mi.Float(rng.choice([0.0, 0.5, 1.0 - 2.0**-24], count))
    point = mi.Point2f(*(mi.Float(rng.choice([0.0, 0.5, 1.0 - 2.0**-24], count)) for _ in range(2)))
    value, chance = evaluate(bsdf, out, light), density(bsdf, out, light)
    drawn: BSDFSample = sample(bsdf, out, lobe, point)
    for array in (value.diffuse, value.glossy, chance, drawn.diffuse, drawn.glossy, drawn.density):
        found = np.array(array)
        assert np.isfinite(found).all() and found.min() >= 0.0
    np.testing.assert_allclose(np.linalg.norm(np.array(drawn.wi), axis=0), 1.0, atol=1e-4)
    opaque = np.array(bsdf.transmission) == 0.0
    below = np.array(value.total).max(axis=0)[opaque & ((wo[2] < 0.0) | (wi[2] < 0.0))]
    assert len(below) > 1000 and below.max() == 0.0
