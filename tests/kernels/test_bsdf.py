"""The BSDF point by point against Mitsuba's plugins: values, densities and delta lobes."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.kernels.bsdf import (
    BSDF,
    BSDFFeatures,
    BSDFTables,
    density,
    evaluate,
    make_tables,
    sample,
    straight_transmittance,
)

COUNT = 20000
FEATURES = BSDFFeatures(True, beckmann=True, conductor=True, plastic=True, transmission=True)
ETA, K = (0.143, 0.374, 1.442), (3.983, 2.386, 1.603)
"""Gold, roughly."""
BASE = (0.7, 0.4, 0.1)
ALPHAS = [0.05, 0.3, 0.5, 1.0]
DISTRIBUTIONS = ["ggx", "beckmann"]


@pytest.fixture(scope="module")
def tables() -> BSDFTables:
    return make_tables(FEATURES)


def plastic(tables: BSDFTables, **more: Any) -> BSDF:
    more = {"specular": 1.0, "plastic": True, **more}
    return BSDF(mi.Color3f(*BASE), FEATURES, tables, **more)


def metal(tables: BSDFTables, **more: Any) -> BSDF:
    more = {"metallic": 1.0, "has_eta": True, "eta": mi.Color3f(*ETA), "k": mi.Color3f(*K), **more}
    return BSDF(mi.Color3f(1.0), FEATURES, tables, **more)


def glass(tables: BSDFTables, **more: Any) -> BSDF:
    more = {"transmission": 1.0, "specular": 1.0, "plastic": True, **more}
    return BSDF(mi.Color3f(1.0), FEATURES, tables, **more)


def directions(seed: int, both_sides: bool, count: int = COUNT) -> mi.Vector3f:
    d = np.random.default_rng(seed).normal(size=(3, count))
    d /= np.linalg.norm(d, axis=0)
    return mi.Vector3f((d if both_sides else np.stack([d[0], d[1], np.abs(d[2])])).astype(np.float32))


def ask_mitsuba(plugin: dict[str, Any], wo: mi.Vector3f, wi: mi.Vector3f) -> tuple[np.ndarray, np.ndarray]:
    """Return Mitsuba's values (N, 3) and densities (N,); its `wi` is our `wo`."""
    seen = dr.zeros(mi.SurfaceInteraction3f, COUNT)
    seen.wi = wo
    value, chance = mi.load_dict(plugin).eval_pdf(mi.BSDFContext(), seen, wi)
    return np.array(value).T, np.array(chance)


def rgb(values: tuple[float, float, float]) -> dict[str, Any]:
    return {"type": "rgb", "value": list(values)}


def near_lobes(bsdf: BSDF, wo: mi.Vector3f, wi: mi.Vector3f) -> mi.Vector3f:
    """Replace half of `wi` by directions drawn from the lobes, where narrow lobes have their values."""
    x, y, z = (mi.Float(np.random.default_rng(9 + i).random(COUNT).astype(np.float32)) for i in range(3))
    drawn = sample(bsdf, wo, x, mi.Point2f(y, z))
    return dr.select((dr.arange(mi.UInt32, COUNT) % 2 == 0) & ~drawn.delta, drawn.wi, wi)


def compare(plugin: dict[str, Any], bsdf: BSDF, both_sides: bool, rtol: float, density_rtol: float = 0.0) -> None:
    """Compare values and densities: 999 of 1,000 within `rtol` (and `density_rtol`, where that is another)."""
    wo, wi = directions(1, both_sides), directions(2, both_sides)
    wi = near_lobes(bsdf, wo, wi)
    value, chance = ask_mitsuba(plugin, wo, wi)
    assert np.count_nonzero(value[:, 0]) > COUNT // 4
    ours = evaluate(bsdf, wo, wi)
    for name, mine, theirs in (
        ("value", np.array(ours.total).T, value), ("density", np.array(density(bsdf, wo, wi)), chance)
    ):  # fmt: skip
        scale = np.abs(theirs) + 1e-3 * np.abs(theirs).mean()
        wrong = np.abs(mine - theirs) / scale
        assert np.quantile(wrong, 0.999) < (density_rtol or rtol if name == "density" else rtol), name


@pytest.mark.parametrize("alpha", ALPHAS)
@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_rough_conductor(tables: BSDFTables, distribution: str, alpha: float) -> None:
    plugin = {"type": "roughconductor", "distribution": distribution, "alpha": alpha, "eta": rgb(ETA), "k": rgb(K)}
    bsdf = metal(tables, alpha=dr.opaque(mi.Float, alpha), beckmann=distribution == "beckmann")
    compare(plugin, bsdf, False, 1e-3)


@pytest.mark.parametrize("alpha", ALPHAS)
@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
@pytest.mark.parametrize("ior", [1.5, 1.1, 2.4, 0.75])
def test_rough_dielectric(tables: BSDFTables, distribution: str, alpha: float, ior: float) -> None:
    plugin = {"type": "roughdielectric", "distribution": distribution, "alpha": alpha, "int_ior": ior, "ext_ior": 1.0}
    bsdf = glass(tables, alpha=dr.opaque(mi.Float, alpha), ior=ior, beckmann=distribution == "beckmann")
    compare(plugin, bsdf, True, 1e-3)


@pytest.mark.parametrize("nonlinear", [False, True])
def test_plastic(tables: BSDFTables, nonlinear: bool) -> None:
    plugin = {
        "type": "plastic", "int_ior": 1.6, "ext_ior": 1.0, "diffuse_reflectance": rgb(BASE), "nonlinear": nonlinear,
    }  # fmt: skip
    compare(plugin, plastic(tables, alpha=0.0, ior=1.6, nonlinear=nonlinear), False, 5e-3)


@pytest.mark.parametrize("alpha", ALPHAS)
@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
@pytest.mark.parametrize(("ior", "nonlinear", "rtol"), [(1.5, False, 0.025), (1.3, True, 0.02), (2.0, False, 0.06)])
def test_rough_plastic(
    tables: BSDFTables, distribution: str, alpha: float, ior: float, nonlinear: bool, rtol: float
) -> None:
    """Mitsuba takes the internal reflectance from 64 nodes with both ends in full: 1 - F is 4 % high at an index of 2.

    A finer sum gives 0.7807 for its 0.7691 (GGX, alpha 0.05), and ours is 0.779.
    """
    plugin = {
        "type": "roughplastic", "distribution": distribution, "alpha": alpha, "int_ior": ior, "ext_ior": 1.0,
        "diffuse_reflectance": rgb(BASE), "nonlinear": nonlinear,
    }  # fmt: skip
    bsdf = plastic(
        tables, alpha=dr.opaque(mi.Float, alpha), ior=ior, nonlinear=nonlinear, beckmann=distribution == "beckmann"
    )
    # How often each lobe is drawn follows the table of what is let in, whose entries are right to 1e-3.
    compare(plugin, bsdf, False, rtol, 0.06)


DELTA = {
    "conductor": ({"type": "conductor", "eta": rgb(ETA), "k": rgb(K)}, metal, {}),
    "dielectric": ({"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}, glass, {"ior": 1.5}),
    "diamond": ({"type": "dielectric", "int_ior": 2.4, "ext_ior": 1.0}, glass, {"ior": 2.4}),
    "bubble": ({"type": "dielectric", "int_ior": 1.0, "ext_ior": 1.33}, glass, {"ior": 1.0 / 1.33}),
    "thin bubble": (
        {"type": "thindielectric", "int_ior": 1.0, "ext_ior": 1.33},
        glass,
        {"ior": 1.0 / 1.33, "thin": True},
    ),
    "thindielectric": ({"type": "thindielectric", "int_ior": 1.5, "ext_ior": 1.0}, glass, {"ior": 1.5, "thin": True}),
}


@pytest.mark.parametrize("name", DELTA)
def test_delta_lobes(tables: BSDFTables, name: str) -> None:
    """The same numbers draw the same direction with the same weight and probability."""
    plugin, make, more = DELTA[name]
    bsdf = make(tables, alpha=0.0, **more)
    wo = directions(3, name != "conductor")
    lobe = mi.Float(np.random.default_rng(4).random(COUNT).astype(np.float32))
    ours = sample(bsdf, wo, lobe, mi.Point2f(0.3, 0.6))
    seen = dr.zeros(mi.SurfaceInteraction3f, COUNT)
    seen.wi = wo
    theirs, weight = mi.load_dict(plugin).sample(mi.BSDFContext(), seen, lobe, mi.Point2f(0.3, 0.6))
    assert np.array(ours.delta).all()
    # Numbers at the border between the lobes may fall on either side of it.
    same = np.all(np.abs(np.array(ours.wi - theirs.wo)) < 1e-4, axis=0)
    assert same.mean() > 0.999
    np.testing.assert_allclose(
        np.array(ours.weight)[:, same], np.broadcast_to(np.array(weight), (3, COUNT))[:, same], rtol=2e-3, atol=1e-4
    )
    np.testing.assert_allclose(
        np.array(ours.density)[same], np.broadcast_to(np.array(theirs.pdf), COUNT)[same], rtol=2e-3, atol=1e-4
    )
    assert np.array(evaluate(bsdf, wo, ours.wi).total).max() == 0.0
    assert np.array(density(bsdf, wo, ours.wi)).max() == 0.0


def test_panes_pass_shadow_rays(tables: BSDFTables) -> None:
    """A pane of two faces passes (1 - R) / (1 + R), here of a green glass; frosted and solid glass stop the ray."""
    wo = directions(5, True)
    tint = np.array([0.5, 1.0, 0.6])
    pane = glass(tables, alpha=0.0, ior=1.5, thin=True)
    pane.base_color = mi.Color3f(tint.tolist())
    reflected = np.array(mi.fresnel(dr.abs(wo.z), mi.Float(1.5))[0], float)
    expected = tint[:, None] * (1.0 - reflected) / (1.0 + reflected)
    np.testing.assert_allclose(np.array(straight_transmittance(pane, wo)), expected, atol=1e-4)
    for other in ({"alpha": 0.3, "thin": True}, {"alpha": 0.0}, {"alpha": 0.3}):
        assert np.array(straight_transmittance(glass(tables, ior=1.5, **other), wo)).max() == 0.0
    np.testing.assert_allclose(np.array(straight_transmittance(glass(tables, alpha=0.3, ior=1.0), wo)), 1.0, atol=1e-6)
