"""From a file's material to the BSDF that the device evaluates: Mitsuba's files point by point against Mitsuba."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.kernels.bsdf import BSDFTables, evaluate, make_tables
from luxel.kernels.gloss import bsdf_features, gloss_at, make_bsdf
from luxel.kernels.triangle import fetch_triangle, interpolate
from luxel.scene import load
from luxel.scene.device import Scene, upload

COUNT = 20000
PLACE = (0.3, 0.3)


def number(name: str, value: float) -> str:
    return f'<float name="{name}" value="{value}"/>'


def word(name: str, value: str) -> str:
    return f'<string name="{name}" value="{value}"/>'


GOLD = word("material", "Au")
GGX = word("distribution", "ggx")
RED = '<rgb name="diffuse_reflectance" value="0.6, 0.2, 0.1"/>'
TINT = '<rgb name="specular_reflectance" value="0.9, 0.7, 0.5"/>'
CASES: dict[str, tuple[str, str, float]] = {
    "diffuse": ("diffuse", "", 1e-4),
    "roughconductor ggx": ("roughconductor", GOLD + GGX + TINT + number("alpha", 0.3), 2e-3),
    "roughconductor beckmann": ("roughconductor", GOLD + number("alpha", 0.5), 2e-3),
    "mirror metal": ("roughconductor", GGX + number("alpha", 0.3), 2e-3),
    "roughplastic": ("roughplastic", RED + TINT + GGX + number("alpha", 0.3), 0.03),
    "roughplastic nonlinear": (
        "roughplastic", RED + number("alpha", 0.2) + '<boolean name="nonlinear" value="true"/>', 0.03
    ),
    "plastic": ("plastic", RED + word("int_ior", "bromine"), 0.03),
    "roughdielectric": ("roughdielectric", GGX + number("alpha", 0.3) + number("int_ior", 1.7), 2e-3),
    "roughdielectric beckmann": ("roughdielectric", number("alpha", 0.4), 2e-3),
}  # fmt: skip


def directions(seed: int) -> mi.Vector3f:
    d = np.random.default_rng(seed).normal(size=(3, COUNT))
    return mi.Vector3f((d / np.linalg.norm(d, axis=0)).astype(np.float32))


def evaluate_at(scene: Scene, tables: BSDFTables, wo: mi.Vector3f, wi: mi.Vector3f) -> np.ndarray:
    """Return (N, 3): the BSDF at one place of the first triangle, times the cosine."""
    active, row = dr.full(mi.Bool, True, COUNT), dr.zeros(mi.UInt32, COUNT)
    point = interpolate(scene, fetch_triangle(scene, row, active), mi.Point2f(*PLACE), active)
    bsdf = make_bsdf(scene, gloss_at(scene, point, active), tables)
    return np.array(evaluate(bsdf, wo, wi).total).T


def open_file(folder: Path, body: str) -> tuple[Scene, Any]:
    """Return the scene of one rectangle with its full materials, and its BSDF as Mitsuba has it."""
    path = folder / "scene.xml"
    path.write_text(f'<scene version="3.0.0"><shape type="rectangle">{body}</shape><emitter type="constant"/></scene>')
    data = load(path)
    assert data.mitsuba_full is not None
    full: Any = data.mitsuba_full()
    return upload(data, materials="full"), full.shapes()[0].bsdf()


def ask_mitsuba(bsdf: Any, wo: mi.Vector3f, wi: mi.Vector3f) -> np.ndarray:
    """Return Mitsuba's values (N, 3); its `wi` is our `wo`."""
    seen = dr.zeros(mi.SurfaceInteraction3f, COUNT)
    seen.wi, seen.uv = wo, mi.Point2f(*PLACE)
    return np.array(bsdf.eval(mi.BSDFContext(), seen, wi)).T


@pytest.mark.parametrize(("kind", "more", "rtol"), CASES.values(), ids=CASES)
def test_the_device_evaluates_what_the_file_says(tmp_path: Path, kind: str, more: str, rtol: float) -> None:
    scene, theirs = open_file(tmp_path, f'<bsdf type="{kind}">{more}</bsdf>')
    wo, wi = directions(1), directions(2)
    value = ask_mitsuba(theirs, wo, wi)
    ours = evaluate_at(scene, make_tables(bsdf_features(scene)), wo, wi)
    assert np.count_nonzero(value[:, 0]) > COUNT // 8
    wrong = np.abs(ours - value) / (np.abs(value) + 1e-2 * value.mean())
    assert np.quantile(wrong, 0.99) < rtol


def test_a_blend_of_paint_and_metal_is_mitsubas(tmp_path: Path) -> None:
    metal = f'<bsdf type="roughconductor">{GOLD}{GGX}{number("alpha", 0.4)}</bsdf>'
    paint = '<bsdf type="diffuse"><rgb name="reflectance" value="0.2, 0.4, 0.6"/></bsdf>'
    body = f'<bsdf type="twosided"><bsdf type="blendbsdf">{number("weight", 0.3)}{paint}{metal}</bsdf></bsdf>'
    scene, theirs = open_file(tmp_path, body)
    wo, wi = directions(1), directions(2)
    front = np.array((wo.z > 0.0) & (wi.z > 0.0))
    value = ask_mitsuba(theirs, wo, wi)[front]
    ours = evaluate_at(scene, make_tables(bsdf_features(scene)), wo, wi)[front]
    np.testing.assert_allclose(ours, value, rtol=5e-3, atol=1e-3 * value.mean())


@pytest.mark.parametrize(
    ("more", "rtol"),
    [
        ("", 0.03),
        (number("roughness", 0.3), 0.03),
        (number("roughness", 0.8), 0.05),
        (number("metallic", 1.0) + number("roughness", 0.4), 2e-3),
        (number("metallic", 0.5), 0.03),
        (number("clearcoat", 1.0) + number("clearcoat_gloss", 0.2), 0.06),
    ],
)
def test_principled_comes_near(tmp_path: Path, more: str, rtol: float) -> None:
    """What it sends back of even light, in the mean over the directions that it is seen from."""
    base = '<rgb name="base_color" value="0.6, 0.3, 0.1"/>'
    body = f'<bsdf type="twosided"><bsdf type="principled">{base}{more}</bsdf></bsdf>'
    scene, theirs = open_file(tmp_path, body)
    wo, wi = (mi.Vector3f(d.x, d.y, dr.abs(d.z)) for d in (directions(1), directions(2)))
    weight = np.array(wo.z)
    value = weight @ ask_mitsuba(theirs, wo, wi)
    ours = weight @ evaluate_at(scene, make_tables(bsdf_features(scene)), wo, wi)
    assert ours.mean() == pytest.approx(value.mean(), rel=rtol)
    np.testing.assert_allclose(ours, value, rtol=2.0 * rtol)
