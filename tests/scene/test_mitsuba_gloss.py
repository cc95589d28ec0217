"""Coats, metals and glass of Mitsuba files, against what Mitsuba's own BSDFs answer and what their pages say."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from luxel.scene import load
from luxel.scene.device import upload
from luxel.scene.diffuse import as_diffuse
from luxel.scene.digest import hash_scene
from luxel.scene.model import Material, SceneData, Texture

GREY = '<bsdf type="diffuse"><rgb name="reflectance" value="0.2, 0.4, 0.6"/></bsdf>'
CHECKER = '<texture type="checkerboard" name="{}"><float name="color0" value="{}"/><float name="color1" value="{}"/></texture>'  # noqa: E501


def bsdf(kind: str, more: str = "") -> str:
    return f'<bsdf type="{kind}" id="thing">{more}</bsdf>'


def number(name: str, value: float) -> str:
    return f'<float name="{name}" value="{value}"/>'


def rgb(name: str, *value: float) -> str:
    return f'<rgb name="{name}" value="{", ".join(map(str, value))}"/>'


def read(folder: Path, text: str, around: str = "") -> tuple[Material, SceneData]:
    path = folder / "scene.xml"
    path.write_text(
        f'<scene version="3.0.0"><shape type="rectangle">{text}{around}</shape><emitter type="constant"/></scene>'
    )
    data = load(path)
    return data.materials[0], data


def theirs(data: SceneData) -> Any:
    """Return the BSDF as Mitsuba loaded it."""
    assert data.mitsuba_full is not None
    scene: Any = data.mitsuba_full()
    return scene.shapes()[0].bsdf()


def sample_straight(data: SceneData, first: float) -> Any:
    """Return what Mitsuba's BSDF draws for a ray that comes straight down; `first` picks the lobe."""
    si = mi.SurfaceInteraction3f()
    si.wi, si.uv = mi.Vector3f(0.0, 0.0, 1.0), mi.Point2f(0.25, 0.25)
    si.t = mi.Float(1.0)
    return theirs(data).sample(mi.BSDFContext(), si, mi.Float(first), mi.Point2f(0.5, 0.5))


@pytest.mark.parametrize(
    "more",
    [
        '<string name="material" value="Au"/>',
        '<string name="material" value="Cr"/>' + rgb("specular_reflectance", 0.5, 0.7, 0.9),
        '<string name="material" value="none"/>',
        number("eta", 1.5) + rgb("k", 1.0, 2.0, 3.0),
        '<spectrum name="eta" value="400:1.2, 700:0.4"/><spectrum name="k" value="400:3, 700:5"/>',
        "",
    ],
)
def test_conductors_reflect_as_in_mitsuba(tmp_path: Path, more: str) -> None:
    """At normal incidence a metal reflects ((eta - 1)^2 + k^2) / ((eta + 1)^2 + k^2)."""
    material, data = read(tmp_path, bsdf("conductor", more))
    assert material.eta is not None and material.k is not None
    assert (material.metallic, material.roughness, material.specular) == (1.0, 0.0, 0.0)
    eta, k = np.array(material.eta), np.array(material.k)
    ours = ((eta - 1.0) ** 2 + k**2) / ((eta + 1.0) ** 2 + k**2) * np.array(material.specular_color)
    _, weight = sample_straight(data, 0.5)
    np.testing.assert_allclose(ours, np.array(weight).ravel(), rtol=1e-4)


@pytest.mark.parametrize(
    "more", ["", '<string name="int_ior" value="diamond"/>', number("int_ior", 1.8) + number("ext_ior", 1.33)]
)
def test_dielectrics_have_mitsubas_index(tmp_path: Path, more: str) -> None:
    material, data = read(tmp_path, bsdf("dielectric", more + rgb("specular_transmittance", 0.5, 0.6, 0.7)))
    assert (material.transmission, material.thin, material.roughness) == (1.0, False, 0.0)
    assert (material.alpha, material.alpha_mode) == (1.0, "opaque"), "glass is no hole"
    assert np.allclose(material.base_color, (0.5, 0.6, 0.7)) and material.interface == "plastic"
    drawn, _ = sample_straight(data, 0.0)
    reflected = ((material.ior - 1.0) / (material.ior + 1.0)) ** 2
    assert reflected == pytest.approx(float(np.array(drawn.pdf).ravel()[0]), rel=1e-4)


def test_panes_and_rough_glass(tmp_path: Path) -> None:
    pane, _ = read(tmp_path, bsdf("thindielectric", number("int_ior", 1.6) + number("ext_ior", 1.0)))
    assert pane.thin and pane.transmission == 1.0 and pane.ior == pytest.approx(1.6)
    frosted, _ = read(tmp_path, bsdf("roughdielectric", number("alpha", 0.25)))
    assert frosted.roughness == pytest.approx(0.5) and frosted.distribution == "beckmann" and not frosted.thin
    assert frosted.ior == pytest.approx(1.5046 / 1.000277, rel=1e-4), "bk7 in air, the defaults of Mitsuba's page"


BUBBLE = number("int_ior", 1.0) + number("ext_ior", 1.5)


@pytest.mark.parametrize("kind", ["dielectric", "roughdielectric", "thindielectric"])
def test_glass_may_be_thinner_inside(tmp_path: Path, kind: str) -> None:
    material, data = read(tmp_path, bsdf(kind, BUBBLE))
    assert material.ior == pytest.approx(1.0 / 1.5) and not any("ndices" in text for text in data.warnings)


def test_plastic_that_is_thinner_inside_is_named(tmp_path: Path) -> None:
    material, data = read(tmp_path, bsdf("plastic", BUBBLE))
    assert material.ior == 1.0 and any("below 1 " in text and "thing" in text for text in data.warnings)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        (bsdf("roughdielectric", number("alpha", -1.0)), True),
        (bsdf("roughconductor", number("alpha_u", -0.5) + number("alpha_v", 0.5)), True),
        (bsdf("roughdielectric", CHECKER.format("alpha", -0.5, 0.5)), True),
        (bsdf("conductor", rgb("eta", -1, 0, 0) + rgb("k", 1, 1, 1)), True),
        (bsdf("principled", number("roughness", 2.0)), True),
        (bsdf("principled", number("clearcoat", -2.0)), True),
        (bsdf("roughdielectric", number("alpha", 0.0)), False),
        (bsdf("conductor", '<string name="material" value="Au"/>'), False),
        (bsdf("principled", number("roughness", 1.0) + number("clearcoat", 0.0)), False),
    ],
)
def test_values_that_cannot_be_are_named(tmp_path: Path, text: str, named: bool) -> None:
    """By Mitsuba's pages widths and complex indices are 0 or more, and what `principled` takes is 0 to 1."""
    _, data = read(tmp_path, text)
    assert any("nearest that can be" in said and "thing" in said for said in data.warnings) is named


@pytest.mark.parametrize("kind", ["plastic", "roughplastic"])
def test_plastics(tmp_path: Path, kind: str) -> None:
    more = rgb("diffuse_reflectance", 0.1, 0.2, 0.3) + '<string name="int_ior" value="water"/>'
    more += rgb("specular_reflectance", 0.5, 1.0, 0.5) + '<boolean name="nonlinear" value="true"/>'
    if kind == "roughplastic":
        more += number("alpha", 0.09) + '<string name="distribution" value="ggx"/>'
    material, data = read(tmp_path, bsdf(kind, more))
    assert np.allclose(material.base_color, (0.1, 0.2, 0.3)) and material.specular == 1.0
    assert np.allclose(material.specular_color, (0.5, 1.0, 0.5))
    assert material.interface == "plastic" and material.nonlinear and material.distribution == "ggx"
    assert material.roughness == pytest.approx(0.3 if kind == "roughplastic" else 0.0)
    assert material.ior == pytest.approx(1.333 / 1.000277, rel=1e-4)
    # What the diffuse condition shows follows from the fields, so that a change of the colour is seen there.
    assert material.diffuse is None and as_diffuse(material).specular == 0.0
    assert not read(tmp_path, bsdf(kind))[0].nonlinear


@pytest.mark.parametrize(("said", "found"), [("", "beckmann"), ("ggx", "ggx"), ("beckmann", "beckmann")])
def test_beckmann_is_mitsubas_default(tmp_path: Path, said: str, found: str) -> None:
    more = f'<string name="distribution" value="{said}"/>' if said else ""
    material, _ = read(tmp_path, bsdf("roughconductor", more + number("alpha", 0.3)))
    assert material.distribution == found and material.roughness == pytest.approx(math.sqrt(0.3))
    assert not material.compensate, "Mitsuba's rough metals lose light between their facets"


def test_anisotropy_is_averaged_and_named(tmp_path: Path) -> None:
    material, data = read(tmp_path, bsdf("roughconductor", number("alpha_u", 0.1) + number("alpha_v", 0.3)))
    assert material.roughness == pytest.approx(math.sqrt(0.2))
    assert any("depends on the direction" in text and "thing" in text for text in data.warnings)


def test_roughness_above_one_is_named(tmp_path: Path) -> None:
    material, data = read(tmp_path, bsdf("roughconductor", number("alpha", 1.5)))
    assert material.roughness == 1.0 and "Roughness above 1 is read as 1: thing." in data.warnings


def texel(texture: Texture | None, u: float, v: float) -> np.ndarray:
    assert texture is not None
    s, t, _ = texture.transform @ np.array([u, v, 1.0])
    height, width = texture.image.shape[:2]
    return texture.image[int(t * height) % height, int(s * width) % width] / 255.0


def test_textured_roughness(tmp_path: Path) -> None:
    material, _ = read(tmp_path, bsdf("roughconductor", CHECKER.format("alpha", 0.04, 0.36)))
    texture = material.metallic_roughness_texture
    assert texture is not None and not texture.srgb and (material.roughness, material.metallic) == (1.0, 1.0)
    # A checker's first quarter has color0 as Mitsuba's page shows it: lower left and upper right.
    si = mi.SurfaceInteraction3f()
    for u, v in ((0.25, 0.25), (0.75, 0.25), (0.75, 0.75)):
        si.uv = mi.Point2f(u, v)
        checker: Any = mi.load_dict({"type": "checkerboard", "color0": 0.04, "color1": 0.36})
        alpha = float(np.array(checker.eval_1(si)).ravel()[0])
        assert texel(texture, u, v)[1] ** 2 == pytest.approx(alpha, abs=0.005)
        assert texel(texture, u, v)[2] == 1.0


def test_principled_is_read_and_said_to_be_near(tmp_path: Path) -> None:
    more = rgb("base_color", 0.9, 0.5, 0.1) + number("metallic", 0.25) + number("roughness", 0.4)
    more += number("spec_trans", 0.5) + number("eta", 1.4) + number("clearcoat", 0.6) + number("clearcoat_gloss", 1.0)
    material, data = read(tmp_path, bsdf("principled", more))
    # Mitsuba tints glass by the root of the colour, at each side; 3/8 of this surface is glass.
    colour = np.array((0.9, 0.5, 0.1))
    assert np.allclose(material.base_color, 0.625 * colour + 0.375 * np.sqrt(colour)) and material.metallic == 0.25
    assert material.roughness == pytest.approx(0.4, abs=1e-6) and material.transmission == 0.5
    assert material.ior == pytest.approx(1.4, rel=1e-5) and material.specular == 1.0 and not material.thin
    assert material.clearcoat == pytest.approx(0.25 * 0.6, rel=1e-5) and material.interface == "principled"
    assert material.clearcoat_roughness == pytest.approx(math.sqrt(0.001), rel=1e-4)
    assert (material.alpha, material.eta, material.distribution) == (1.0, None, "ggx")
    assert any("comes near" in text and "thing" in text for text in data.warnings)
    # Under the diffuse condition, as ever: what scatters evenly, dark where it refracts.
    assert np.allclose(as_diffuse(material).base_color, np.array((0.9, 0.5, 0.1)) * 0.75 * 0.5)


def test_principled_by_specular_and_left_out(tmp_path: Path) -> None:
    """Mitsuba's page: `specular` 0 to 1 maps to an index of 1 to 1.8 (8 % at normal incidence)."""
    material, data = read(tmp_path, bsdf("principled", number("specular", 1.0) + number("sheen", 0.5)))
    assert ((material.ior - 1.0) / (material.ior + 1.0)) ** 2 == pytest.approx(0.08, rel=1e-4)
    assert any("Sheen" in text for text in data.warnings)
    thin, _ = read(tmp_path, bsdf("principledthin", number("spec_trans", 0.3)))
    assert thin.thin and thin.transmission == pytest.approx(0.3)
    # A pane of luxel's reflects 2 R / (1 + R), that one R: 4 % at normal incidence for its index of 1.5.
    face = ((thin.ior - 1.0) / (thin.ior + 1.0)) ** 2
    assert 2.0 * face / (1.0 + face) == pytest.approx(0.04, rel=1e-4)


def test_textured_metallic_of_principled(tmp_path: Path) -> None:
    more = rgb("base_color", 0.9, 0.5, 0.1) + CHECKER.format("metallic", 0.0, 1.0) + CHECKER.format("clearcoat", 1, 0)
    material, data = read(tmp_path, bsdf("principled", more + CHECKER.format("spec_trans", 0.0, 0.5)))
    assert material.base_color == pytest.approx((0.9, 0.5, 0.1)) and material.base_color_texture is None
    seen = {round(float(texel(material.metallic_roughness_texture, u, 0.25)[2]), 2) for u in (0.25, 0.75)}
    assert seen == {0.0, 1.0}
    assert {round(float(texel(material.transmission_texture, u, 0.25)[0]), 2) for u in (0.25, 0.75)} == {0.0, 0.5}
    assert {round(float(texel(material.clearcoat_texture, u, 0.25)[0]), 2) for u in (0.25, 0.75)} == {0.0, 0.25}
    assert material.transmission == material.clearcoat == material.metallic == 1.0, "the textures hold the values"
    assert upload(data, materials="full").features.transmission


def test_glass_of_principled_has_a_colour_of_its_own(tmp_path: Path) -> None:
    """Squares of glass take the root of the colour that the others scatter (stored as sRGB, IEC 61966-2-1)."""
    more = rgb("base_color", 0.9, 0.5, 0.1) + CHECKER.format("spec_trans", 0.0, 1.0)
    material, _ = read(tmp_path, bsdf("principled", more))
    stored = np.array([texel(material.base_color_texture, u, 0.25)[:3] for u in (0.25, 0.75)])
    linear = sorted((((stored + 0.055) / 1.055) ** 2.4).tolist())
    colour = np.array((0.9, 0.5, 0.1))
    np.testing.assert_allclose(linear, [colour, np.sqrt(colour)], atol=0.01)
    pane, _ = read(tmp_path, bsdf("principledthin", more))
    assert pane.base_color == pytest.approx((0.9, 0.5, 0.1)), "a pane is met once"


# --- nested --------------------------------------------------------------------------------------------------------


METAL = bsdf("roughconductor", '<string name="material" value="Cu"/>' + number("alpha", 0.25)).replace(
    "thing", "copper"
)


def test_masked_metal_keeps_its_holes(tmp_path: Path) -> None:
    material, _ = read(tmp_path, bsdf("mask", number("opacity", 0.3) + METAL))
    assert material.alpha == pytest.approx(0.3) and material.alpha_mode == "blend" and material.metallic == 1.0
    glass, _ = read(tmp_path, bsdf("mask", CHECKER.format("opacity", 0, 1) + bsdf("dielectric").replace("thing", "g")))
    assert glass.alpha_mode == "mask" and glass.transmission == 1.0
    assert glass.base_color_texture is not None and glass.base_color_texture.image.shape[2] == 4
    assert as_diffuse(glass).alpha == 0.0


def test_a_blend_of_paint_and_metal_shares_the_surface(tmp_path: Path) -> None:
    material, data = read(tmp_path, bsdf("blendbsdf", number("weight", 0.25) + GREY + METAL))
    assert material.metallic == pytest.approx(0.25) and material.specular == 0.0
    assert material.roughness == pytest.approx(0.5) and np.allclose(material.base_color, (0.2, 0.4, 0.6))
    single, _ = read(tmp_path, METAL)
    assert material.eta == pytest.approx(single.eta) and material.k == pytest.approx(single.k)
    # Nothing is lost: evenly scattered light and a metal's have nothing in common. A plastic's coat and a metal have.
    assert not any("mean roughness" in text for text in data.warnings)
    coated = bsdf("plastic").replace("thing", "coated")
    _, mixed = read(tmp_path, bsdf("blendbsdf", number("weight", 0.25) + coated + METAL))
    assert any("mean roughness" in text for text in mixed.warnings)
    # Blended, a Lambert and a metal are what the mixture by `metallic` is.
    assert np.allclose(as_diffuse(material).base_color, 0.75 * np.array((0.2, 0.4, 0.6)))


def test_a_blend_of_glass_and_plastic(tmp_path: Path) -> None:
    inner = bsdf("dielectric", number("int_ior", 1.8) + number("ext_ior", 1.0)).replace("thing", "one")
    cup = bsdf("plastic", number("int_ior", 1.4) + number("ext_ior", 1.0)).replace("thing", "two")
    material, _ = read(tmp_path, bsdf("blendbsdf", number("weight", 0.25) + inner + cup))
    assert material.transmission == pytest.approx(0.75) and material.ior == pytest.approx(0.75 * 1.8 + 0.25 * 1.4)
    assert np.allclose(material.base_color, 0.5), "the plastic's own reflectance"
    assert as_diffuse(material).alpha == pytest.approx(0.25)


def test_a_hole_in_a_blend_is_one(tmp_path: Path) -> None:
    material, _ = read(tmp_path, bsdf("blendbsdf", number("weight", 0.25) + '<bsdf type="null"/>' + METAL))
    assert material.alpha == pytest.approx(0.25) and material.alpha_mode == "blend" and material.metallic == 1.0


def test_two_sides_and_one(tmp_path: Path) -> None:
    one, _ = read(tmp_path, METAL)
    both, _ = read(tmp_path, bsdf("twosided", METAL))
    assert not one.reflect_back and both.reflect_back
    assert as_diffuse(one).reflect_back, "black on both sides, as ever"
    _, data = read(tmp_path, bsdf("twosided", bsdf("plastic").replace("thing", "cup") + GREY))
    front, back = data.materials
    assert front.specular == 1.0 and back.specular == 0.0


def test_relief_and_gloss_together(tmp_path: Path) -> None:
    bumps = '<texture type="checkerboard" name="arbitrary"/>'
    material, _ = read(tmp_path, bsdf("bumpmap", bumps + METAL))
    assert material.metallic == 1.0 and material.eta is not None


def test_lamps_of_metal_and_of_glass(tmp_path: Path) -> None:
    lamp = '<emitter type="area"><rgb name="radiance" value="3, 2, 1"/></emitter>'
    metal, _ = read(tmp_path, METAL, lamp)
    assert metal.metallic == 1.0 and metal.emission == (3.0, 2.0, 1.0) == as_diffuse(metal).emission
    glass, data = read(tmp_path, bsdf("dielectric"), lamp)
    assert glass.transmission == 1.0 and glass.alpha_mode == "opaque" and glass.emission == (3.0, 2.0, 1.0)
    shown = as_diffuse(glass)
    assert shown.transmission == 0.0 and shown.alpha_mode == "opaque" and shown.emission == (3.0, 2.0, 1.0)
    assert any("through a lamp" in text for text in data.diffuse_warnings)
    parts = number("weight", 0.5) + '<bsdf type="dielectric"/>' + GREY
    half, data = read(tmp_path, bsdf("blendbsdf", parts), lamp)
    assert half.transmission == pytest.approx(0.5) and half.alpha_mode == "opaque" and half.emission == (3.0, 2.0, 1.0)
    # Under the diffuse condition half of the rays go by, and the others find twice the light.
    assert as_diffuse(half).emission == pytest.approx((6.0, 4.0, 2.0)) and as_diffuse(half).alpha == pytest.approx(0.5)


def test_lamps_with_holes(tmp_path: Path) -> None:
    """Mitsuba's shine all over: what some rays miss, the others make up for, where all places are alike."""
    lamp = '<emitter type="area"><rgb name="radiance" value="3, 2, 1"/></emitter>'
    even, data = read(tmp_path, f'<bsdf type="mask">{number("opacity", 0.5)}{METAL}</bsdf>', lamp)
    assert even.metallic == 1.0 and even.alpha_mode == "blend" and even.emission == pytest.approx((6.0, 4.0, 2.0))
    assert not any("lamp" in text for text in data.warnings)
    for inner in (METAL, bsdf("plastic")):
        holes, data = read(tmp_path, f'<bsdf type="mask">{CHECKER.format("opacity", 0.2, 1.0)}{inner}</bsdf>', lamp)
        assert holes.alpha_mode == "opaque" and holes.emission == (3.0, 2.0, 1.0)
        assert holes.metallic == holes.specular == 0.0
        said = [text for text in data.warnings if "lamp" in text]
        assert len(said) == 2 and "Reflections" in said[0] and "through" in said[1]
        assert not set(said) & set(data.diffuse_warnings)


def test_diffuse_files_have_no_gloss(tmp_path: Path) -> None:
    material, data = read(tmp_path, bsdf("twosided", GREY))
    assert material.diffuse is None and as_diffuse(material) is material
    assert not upload(data, materials="full").features.gloss
    assert hash_scene(data) == hash_scene(data, materials="full")


def test_what_full_materials_do_is_told_apart(tmp_path: Path) -> None:
    for text in (METAL, bsdf("dielectric"), bsdf("roughplastic"), bsdf("principled", number("spec_trans", 0.5))):
        _, data = read(tmp_path, text)
        assert data.diffuse_warnings and set(data.diffuse_warnings) <= set(data.warnings)
        assert not [said for said in data.warnings if "left out" in said and said not in data.diffuse_warnings]
    _, data = read(tmp_path, bsdf("hair"))
    assert data.warnings and not data.diffuse_warnings, "hair is left out by full materials too"
