"""Materials of `make_full_scene`: a Mitsuba file that luxel has read and built anew renders as the file itself."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel import runtime
from luxel.render.oracle import choose_integrator, make_full_scene, render_full
from luxel.render.oracle_materials import describe_material
from luxel.scene import load
from luxel.scene.model import Camera, Colour, Light, Material, Mesh, Object, SceneData, Texture

SIZE = (40, 30)


def bsdf(kind: str, *more: str) -> str:
    return f'<bsdf type="{kind}">{"".join(more)}</bsdf>'


def number(name: str, value: float) -> str:
    return f'<float name="{name}" value="{value}"/>'


def red(name: str) -> str:
    return f'<rgb name="{name}" value="0.6, 0.2, 0.1"/>'


def word(name: str, value: str) -> str:
    return f'<string name="{name}" value="{value}"/>'


def checker(name: str, one: float, other: float) -> str:
    return f'<texture type="checkerboard" name="{name}">{number("color0", one)}{number("color1", other)}</texture>'


PAPER = bsdf("twosided", bsdf("diffuse", red("reflectance")))
COAT = number("clearcoat", 0.8) + number("clearcoat_gloss", 0.4)
BSDFS = {
    "conductor": bsdf("conductor", word("material", "Cu")),
    "roughconductor": bsdf("roughconductor", word("material", "Au"), number("alpha", 0.3), red("specular_reflectance")),
    "textured-conductor": bsdf("roughconductor", word("distribution", "ggx"), checker("alpha", 0.05, 0.5)),
    "plastic": bsdf("plastic", '<boolean name="nonlinear" value="true"/>', red("diffuse_reflectance")),
    "roughplastic": bsdf("roughplastic", number("alpha", 0.2), number("int_ior", 1.7), red("diffuse_reflectance")),
    "dielectric": bsdf("dielectric", number("int_ior", 1.4), red("specular_transmittance")),
    "roughdielectric": bsdf("roughdielectric", number("alpha", 0.3)),
    "thindielectric": bsdf("thindielectric"),
    "principled": bsdf(
        "principled",
        number("metallic", 0.4),
        number("roughness", 0.3),
        COAT,
        number("specular", 0.7),
        red("base_color"),
    ),
    "principled-glass": bsdf(
        "principled", number("spec_trans", 0.7), number("roughness", 0.4), number("eta", 1.4), red("base_color")
    ),
    "principledthin": bsdf(
        "principledthin", number("spec_trans", 0.6), number("roughness", 0.5), number("eta", 1.4), red("base_color")
    ),
    "mask": bsdf("mask", number("opacity", 0.4), bsdf("conductor")),
    "textured-mask": bsdf("mask", checker("opacity", 0.0, 1.0), bsdf("roughplastic")),
    "blend": bsdf(
        "blendbsdf",
        number("weight", 0.3),
        bsdf("diffuse"),
        bsdf("roughconductor", number("alpha", 0.2), word("material", "Ag")),
    ),
}
"""By name: what a block and a sheet are made of. All reflect on their front alone, or are glass."""
MIRRORS = ("conductor", "dielectric", "thindielectric", "mask")


def place(*steps: str) -> str:
    return f'<transform name="to_world">{"".join(steps)}</transform>'


def shape(kind: str, *more: str) -> str:
    return f'<shape type="{kind}">{"".join(more)}</shape>'


def scene_file(folder: Path, surface: str) -> SceneData:
    """Return a block on a floor and an upright sheet, under a lamp and a sky: no curve that meshes round off."""
    parts = [
        shape("cube", place('<scale value="0.5"/><rotate y="1" angle="30"/><translate x="-0.5" y="0.51"/>'), surface),
        shape("rectangle", place('<scale value="0.6"/><translate x="0.8" y="0.61" z="-0.2"/>'), surface),
        shape("rectangle", place('<scale value="3"/><rotate x="1" angle="-90"/>'), PAPER),
        shape(
            "rectangle",
            place('<scale value="0.6"/><rotate x="1" angle="90"/><translate y="3" z="1"/>'),
            '<emitter type="area"><rgb name="radiance" value="6, 5, 4"/></emitter>',
        ),
        '<emitter type="constant"><rgb name="radiance" value="0.3"/></emitter>',
        '<sensor type="perspective"><float name="fov" value="60"/>',
        place('<lookat origin="0.2, 1.6, 3" target="0, 0.5, 0" up="0, 1, 0"/>'),
        "</sensor>",
    ]
    path = folder / "scene.xml"
    path.write_text(f'<scene version="3.0.0">{"".join(parts)}</scene>')
    return load(path)


@pytest.fixture(autouse=True)
def started() -> None:
    runtime.start()


@pytest.mark.parametrize("name", BSDFS)
def test_a_file_built_anew_renders_as_itself(name: str, tmp_path: Path) -> None:
    data = scene_file(tmp_path, BSDFS[name])
    theirs = render_full(data, data.cameras[0], size=SIZE, spp=64)
    data.mitsuba_full = None
    ours = render_full(data, data.cameras[0], size=SIZE, spp=64)
    blocks = [image.reshape(6, 5, 8, 5, 3).mean(axis=(1, 3)) for image in (ours, theirs)]
    error = float(np.sqrt(((blocks[0] - blocks[1]) ** 2).mean()) / theirs.mean())
    print(f"{name}: mean {ours.mean() / theirs.mean():.4f}, blocks {error:.4f}")
    assert ours.mean() == pytest.approx(theirs.mean(), rel=0.01)
    assert error < 0.03


@pytest.mark.parametrize("name", [name for name in BSDFS if name not in MIRRORS])
def test_a_bsdf_built_anew_answers_as_the_files(name: str, tmp_path: Path) -> None:
    """For light and view from all around; mirrors, which answer none, are left to the pictures."""
    data = scene_file(tmp_path, BSDFS[name])
    assert data.mitsuba_full is not None
    scenes: Any = data.mitsuba_full(), make_full_scene(data)
    count = 256
    numbers = [mi.Float(column) for column in np.random.default_rng(0).random((6, count)).astype(np.float32)]
    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.wi = mi.warp.square_to_uniform_sphere(mi.Point2f(numbers[0], numbers[1]))
    # Amid the squares of a checkerboard: at its edges luxel's images are a texel wide.
    si.uv = 0.1 + 0.3 * mi.Point2f(numbers[2], numbers[3]) + mi.Point2f(dr.select(numbers[2] > 0.5, 0.5, 0.0), 0.0)
    si.t = mi.Float(1.0)
    wo = mi.warp.square_to_uniform_sphere(mi.Point2f(numbers[4], numbers[5]))
    theirs, ours = (np.array(scene.shapes()[0].bsdf().eval(mi.BSDFContext(), si, wo)) for scene in scenes)
    assert theirs.max() > 1e-3
    np.testing.assert_allclose(ours, theirs, rtol=0.01, atol=1e-3)


def eval_bsdf(material: Material, wi: Colour, wo: Colour) -> np.ndarray:
    """Return Mitsuba's BSDF times cosine at (u, v) = (0.25, 0.25); directions are taken to unit length."""
    found: Any = mi.load_dict(describe_material(material))
    si = mi.SurfaceInteraction3f()
    si.wi, si.uv, si.t = dr.normalize(mi.Vector3f(*wi)), mi.Point2f(0.25, 0.25), mi.Float(1.0)
    value = found.eval(mi.BSDFContext(), si, dr.normalize(mi.Vector3f(*wo)))
    return np.array(value).ravel()


def test_a_gltf_coat_reflects_what_its_index_says() -> None:
    """At normal incidence, of a black base: F0 D / 4, where GGX has D = 1 / (pi alpha^2)."""
    black = Material(base_color=(0, 0, 0), roughness=0.5, specular=1.0, ior=1.8, specular_color=(1.0, 0.5, 1.2))
    f0 = (0.8 / 2.8) ** 2 * np.array([1.0, 0.5, 1.2])
    np.testing.assert_allclose(eval_bsdf(black, (0, 0, 1), (0, 0, 1)), f0 / (4 * np.pi * 0.25**2), rtol=0.01)
    black.specular = 0.25
    np.testing.assert_allclose(eval_bsdf(black, (0, 0, 1), (0, 0, 1)), 0.25 * f0 / (4 * np.pi * 0.25**2), rtol=0.01)
    black.ior = 0.0
    black.specular, black.specular_color = 1.0, (0.3, 0.2, 0.1)
    spec_gloss = np.array([0.3, 0.2, 0.1]) / (4 * np.pi * 0.25**2)
    np.testing.assert_allclose(eval_bsdf(black, (0, 0, 1), (0, 0, 1)), spec_gloss, rtol=0.01)


def test_a_half_metal_is_half_metal_half_diffuse() -> None:
    base = (0.8, 0.4, 0.2)
    half = Material(base_color=base, metallic=0.5, roughness=1.0)
    # Off the mirror direction a smooth metal adds nothing: half of base / pi times the cosine is left.
    half.roughness = 0.05
    value = eval_bsdf(half, (1, 0, 1), (1, 0, 1))
    np.testing.assert_allclose(value, 0.5 * np.array(base) / np.pi * np.cos(np.pi / 4), rtol=1e-3)


def test_weights_are_read_from_their_channels() -> None:
    """A texture has metallic in blue, transmission in red, the coat's weight in alpha."""

    def flat(*values: int) -> Texture:
        return Texture(np.tile(np.array(values, np.uint8), (2, 2, 1)), srgb=False)

    away = ((1.0, 0.0, 1.0), (1.0, 0.0, 1.0))
    metal = Material(base_color=(1, 1, 1), metallic=1.0, roughness=0.1, metallic_roughness_texture=flat(0, 255, 51))
    assert eval_bsdf(metal, *away) == pytest.approx(0.8 / np.pi * np.cos(np.pi / 4), rel=0.01)
    glass = Material(base_color=(1, 1, 1), transmission=1.0, transmission_texture=flat(51, 255, 255), roughness=0.0)
    assert eval_bsdf(glass, *away) == pytest.approx(0.8 / np.pi * np.cos(np.pi / 4), rel=0.01)
    coat = Material(base_color=(0, 0, 0), specular=1.0, specular_texture=flat(255, 255, 255, 51), roughness=0.5)
    assert eval_bsdf(coat, (0, 0, 1), (0, 0, 1)) == pytest.approx(0.2 * 0.04 / (4 * np.pi * 0.25**2), rel=0.01)


def looking_through(glass: list[Mesh], material: Material) -> SceneData:
    """A white glowing wall at z = -2, seen along -Z through `glass` (the first object's material)."""
    wall = Mesh(np.array([[-9, -9, -2], [9, -9, -2], [9, 9, -2], [-9, 9, -2]], np.float32), QUAD, 1)
    glow = Material("wall", (0, 0, 0), emission=(1, 1, 1))
    camera = Camera((0, 0, 3), (0, 0, 0), fov=5.0)
    return SceneData("glass", [Object("glass", glass), Object("wall", [wall])], [material, glow], cameras=[camera])


QUAD = np.array([[0, 1, 2], [0, 2, 3]], np.uint32)


def test_glass_takes_light_over_its_length() -> None:
    """Beer and Lambert's law through 0.5 m, and (1 - F0)^2 for the two faces (inner reflections add below 1 %)."""
    from luxel.scene.library.shapes import box

    glass = Material("glass", (1, 1, 1), ior=1.5, specular=1.0, transmission=1.0, roughness=0.0, interface="plastic")
    glass.attenuation_color, glass.attenuation_distance = (0.5, 0.25, 0.8), 1.0
    data = looking_through([box((-1, -1, -0.5), (1, 1, 0.0), 0)], glass)
    assert choose_integrator(data) == "volpath"
    image = render_full(data, data.cameras[0], size=(8, 8), spp=256)
    passed = np.sqrt([0.5, 0.25, 0.8])
    once = 0.96**2 * passed
    np.testing.assert_allclose(image.mean(axis=(0, 1)), once / (1 - (0.04 * passed) ** 2), rtol=0.02)
    glass.attenuation_distance = float("inf")
    assert choose_integrator(data) == "path"


@pytest.mark.parametrize("width", [0.0, 20.0])
def test_the_sun_shines_through_panes_and_curtains(width: float) -> None:
    """Sharp or a disc. Mitsuba's `path` would stop a sharp one; shadows are as light as what passes."""
    floor = Mesh(np.array([[-4, 0, -4], [-4, 0, 4], [4, 0, 4], [4, 0, -4]], np.float32), QUAD, 1)
    roof = Mesh(np.array([[-4, 1, -4], [-4, 1, 4], [4, 1, 4], [4, 1, -4]], np.float32), QUAD, 0)
    curtain = Material("curtain", (0, 0, 0), alpha=0.3, alpha_mode="blend")
    pane = Material(
        "pane", (1, 0.5, 1), ior=1.5, specular=1.0, transmission=1.0, thin=True, interface="plastic", roughness=0.0
    )
    for cover, passed in ((curtain, np.full(3, 0.7)), (pane, (1 - 2 * 0.04 / 1.04) * np.array([1, 0.5, 1]))):
        data = SceneData(
            "sun", [Object("floor", [floor]), Object("roof", [roof])], [cover, Material("floor", (0.5, 0.5, 0.5))]
        )
        data.lights = [Light("directional", (np.pi, np.pi, np.pi), direction=(0.0, -1.0, 0.0), angular_diameter=width)]
        data.cameras = [Camera((0, 0.5, 0), (0, 0, 0), (0, 0, -1), 40.0)]
        image = render_full(data, data.cameras[0], size=(8, 8), spp=64)
        assert image.mean(axis=(0, 1)) == pytest.approx(0.5 * passed, rel=0.06), cover.name


def test_every_material_of_the_built_in_scenes_is_described() -> None:
    data = load("glossy")
    assert isinstance(make_full_scene(data), mi.Scene)
    kinds = {describe_material(material)["type"] for material in data.materials}
    assert "mask" in kinds and "thindielectric" in kinds and "dielectric" in kinds
