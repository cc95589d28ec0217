"""Truth and `path` with all that materials do, beside `mi.render` of the same file: a ball on a floor under a lamp.

1,024 paths a pixel by both. What is compared are the mean of the picture and means over 8 x 8 pixels; the noise of
both, told from their halves, is said beside them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from luxel import Renderer
from luxel.kernels import full_path
from luxel.render.truth import render_truth
from luxel.scene import load

SIZE, BLOCK, FINER, PATHS = 48, 8, 4, 1024
LIMITS = (0.005, 0.02)
"""Of the mean and of the blocks' RMSE, both over the mean."""

SKY = '<emitter type="constant"><rgb name="radiance" value="0.5, 0.6, 0.7"/></emitter>'
FLOOR_AND_LAMP = """
  <shape type="rectangle"><transform name="to_world"><rotate x="1" angle="-90"/><scale value="6"/></transform>
    <bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="0.5, 0.45, 0.4"/></bsdf></bsdf></shape>
  <shape type="rectangle"><transform name="to_world"><rotate x="1" angle="90"/>
    <translate x="-1.5" y="4" z="1"/></transform>
    <emitter type="area"><rgb name="radiance" value="8, 8, 8"/></emitter></shape>"""
BALL = """<shape type="sphere"><point name="center" x="0" y="1" z="0"/><float name="radius" value="1"/>{}</shape>"""
SHEET = """<shape type="rectangle"><transform name="to_world"><rotate x="1" angle="-70"/><scale value="1.2"/>
  <translate x="-0.7" y="2.6" z="0.5"/></transform>{}</shape>"""
ROUGH = '<float name="alpha" value="{}"/><string name="distribution" value="{}"/>'
GOLD = '<bsdf type="roughconductor"><string name="material" value="Au"/>' + ROUGH + "</bsdf>"
RED = '<rgb name="{}" value="0.6, 0.3, 0.1"/>'
THINNER = '<float name="int_ior" value="1.0"/><float name="ext_ior" value="1.33"/>'
"""A bubble of air in water."""
CLEAR_SHEET = SHEET.format('<bsdf type="thindielectric"/>')


def write(folder: Path, body: str, sky: str = SKY, eye: str = "1.5, 2.5, 5") -> Path:
    path = folder / "scene.xml"
    path.write_text(
        f"""<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="-1"/></integrator>
        <sensor type="perspective"><float name="fov" value="40"/>
        <transform name="to_world"><lookat origin="{eye}" target="0, 0.8, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="{SIZE}"/><integer name="height" value="{SIZE}"/>
        <rfilter type="box"/></film></sensor>{FLOOR_AND_LAMP}{sky}{body}</scene>"""
    )
    return path


def of_luxel(path: Path, materials: Any = "full") -> np.ndarray:
    """Return two independent halves (2, H, W, 3); rays go through pixel centres, so of a finer picture's blocks."""
    data = load(path)
    size = (SIZE * FINER, SIZE * FINER)
    truth = render_truth(
        data, camera=data.cameras[0], size=size, spp=PATHS // FINER**2, cache=False, materials=materials
    )
    halves = truth.image_halves
    assert halves is not None or materials == "diffuse"
    whole = truth.layers.image()
    if halves is None:
        halves = [whole, whole]
    np.testing.assert_allclose(0.5 * (halves[0] + halves[1]), whole, rtol=1e-3, atol=1e-4)
    return np.stack([coarse(half) for half in halves])


def coarse(image: np.ndarray) -> np.ndarray:
    return image.reshape(SIZE, FINER, SIZE, FINER, 3).mean(axis=(1, 3))


def of_mitsuba(path: Path) -> np.ndarray:
    scene: Any = mi.load_file(str(path))
    return np.stack([np.array(mi.render(scene, spp=PATHS // 2, seed=seed), float)[..., :3] for seed in (1, 2)])


def compare(ours: np.ndarray, theirs: np.ndarray) -> tuple[float, float, float]:
    """Return how far the means are apart, the blocks, and how much of that may be noise, over the mean."""

    def rmse(a: np.ndarray, b: np.ndarray) -> float:
        blocks = (a - b).reshape(SIZE // BLOCK, BLOCK, SIZE // BLOCK, BLOCK, 3).mean(axis=(1, 3))
        return float(np.sqrt((blocks**2).mean())) / float(theirs.mean())

    noise = 0.5 * float(np.hypot(rmse(ours[0], ours[1]), rmse(theirs[0], theirs[1])))
    return float(ours.mean() / theirs.mean()) - 1.0, rmse(ours.mean(axis=0), theirs.mean(axis=0)), noise


def judge(path: Path, limits: tuple[float, float]) -> None:
    mean, blocks, noise = compare(of_luxel(path), of_mitsuba(path))
    said = f"mean {mean:+.4f} (limit {limits[0]}), blocks {blocks:.4f} (limit {limits[1]}), noise {noise:.4f}"
    assert noise < 0.75 * limits[1], f"too noisy to judge: {said}"
    assert abs(mean) <= limits[0] and blocks <= limits[1], said


@pytest.mark.parametrize(
    ("bsdf", "limits"),
    [
        ('<bsdf type="conductor"><string name="material" value="Cu"/></bsdf>', LIMITS),
        (GOLD.format(0.05, "ggx"), LIMITS),
        (GOLD.format(0.3, "beckmann"), LIMITS),
        (GOLD.format(0.5, "ggx"), LIMITS),
        ('<bsdf type="dielectric"/>', LIMITS),
        ('<bsdf type="roughdielectric">' + ROUGH.format(0.3, "ggx") + "</bsdf>", LIMITS),
        ('<bsdf type="thindielectric"/>', LIMITS),
        ('<bsdf type="dielectric">' + THINNER + "</bsdf>", LIMITS),
        ('<bsdf type="roughdielectric">' + THINNER + ROUGH.format(0.3, "beckmann") + "</bsdf>", LIMITS),
        ('<bsdf type="thindielectric">' + THINNER + "</bsdf>", LIMITS),
        ('<bsdf type="mask"><float name="opacity" value="0.4"/>' + GOLD.format(0.3, "ggx") + "</bsdf>", LIMITS),
        ('<bsdf type="plastic">' + RED.format("diffuse_reflectance") + "</bsdf>", LIMITS),
        (
            '<bsdf type="roughplastic"><float name="alpha" value="0.2"/>'
            + RED.format("diffuse_reflectance")
            + "</bsdf>",
            (0.02, 0.04),
        ),
        (
            '<bsdf type="principled"><float name="roughness" value="0.4"/>' + RED.format("base_color") + "</bsdf>",
            (0.03, 0.06),
        ),
        (
            '<bsdf type="principled"><float name="spec_trans" value="1"/><float name="roughness" value="0.3"/>'
            + RED.format("base_color")
            + "</bsdf>",
            (0.01, 0.02),
        ),
    ],
    ids=["conductor", "gold 0.05", "gold 0.3", "gold 0.5", "dielectric", "roughdielectric", "thindielectric",
         "bubble", "rough bubble", "thin bubble", "mask", "plastic", "roughplastic", "principled", "principled glass"],
)  # fmt: skip
def test_a_ball_is_mitsubas(tmp_path: Path, bsdf: str, limits: tuple[float, float]) -> None:
    judge(write(tmp_path, BALL.format(bsdf)), limits)


@pytest.mark.parametrize(
    "bsdf",
    [
        '<bsdf type="conductor"><string name="material" value="Cu"/></bsdf>',
        GOLD.format(0.3, "beckmann"),
        '<bsdf type="dielectric"/>',
        '<bsdf type="roughdielectric">' + ROUGH.format(0.3, "ggx") + "</bsdf>",
        '<bsdf type="thindielectric"/>',
        '<bsdf type="mask"><float name="opacity" value="0.4"/>' + GOLD.format(0.3, "ggx") + "</bsdf>",
    ],
    ids=["conductor", "gold 0.3", "dielectric", "roughdielectric", "thindielectric", "mask"],
)
def test_a_lamp_keeps_its_gloss(tmp_path: Path, bsdf: str) -> None:
    """What a surface emits comes beside what it reflects and lets through."""
    glow = '<emitter type="area"><rgb name="radiance" value="0.3, 0.5, 0.2"/></emitter>'
    judge(write(tmp_path, BALL.format(bsdf + glow)), LIMITS)


def test_shadow_rays_pass_a_pane_and_nothing_counts_twice(tmp_path: Path) -> None:
    """The lamp's light on a metal ball behind a clear sheet: both samplers find it."""
    judge(write(tmp_path, BALL.format(GOLD.format(0.3, "ggx")) + CLEAR_SHEET), LIMITS)


@pytest.mark.parametrize(("clear", "rough"), [(0.8, 0.3), (1.0, 0.4)])
def test_a_principled_pane_comes_near_mitsubas(tmp_path: Path, clear: float, rough: float) -> None:
    values = f'<float name="spec_trans" value="{clear}"/><float name="roughness" value="{rough}"/>'
    pane = f'<bsdf type="principledthin">{values}{RED.format("base_color")}</bsdf>'
    judge(write(tmp_path, SHEET.format(pane)), (0.03, 0.06))


def test_lamps_without_size_shine_through_rough_glass(tmp_path: Path) -> None:
    """On both sides of a frosted sheet, and more than get a shadow ray each: the tree has to look to either side."""
    lamps = "".join(
        f'<emitter type="point"><point name="position" x="{k - 4.5}" y="{1 + k % 3}" z="{-2 if k % 4 else 4}"/>'
        f'<rgb name="intensity" value="2, {k / 4}, 1"/></emitter>'
        for k in range(10)
    )
    sheet = '<shape type="rectangle"><transform name="to_world"><scale value="6"/></transform>{}</shape>'
    glass = '<bsdf type="roughdielectric">' + ROUGH.format(0.4, "ggx") + "</bsdf>"
    judge(write(tmp_path, sheet.format(glass), sky=lamps), (0.015, 0.04))


def test_a_bright_sky_is_weighed_against_gloss(tmp_path: Path) -> None:
    image = np.full((32, 64, 3), 0.3, np.float32)
    image[6:8, 20:23] = 60.0
    mi.Bitmap(image).write(str(tmp_path / "sky.exr"))
    sky = '<emitter type="envmap"><string name="filename" value="sky.exr"/></emitter>'
    judge(write(tmp_path, BALL.format(GOLD.format(0.3, "ggx")), sky=sky), (0.01, 0.02))


def test_a_camera_inside_glass_sees_what_mitsubas_does(tmp_path: Path) -> None:
    judge(write(tmp_path, BALL.format('<bsdf type="dielectric"/>'), eye="0.3, 1.2, 0.4"), LIMITS)


def test_the_diffuse_part_alone_is_told_apart(tmp_path: Path) -> None:
    path = write(tmp_path, BALL.format(GOLD.format(0.5, "ggx")))
    mean, blocks, _ = compare(of_luxel(path, "diffuse"), of_mitsuba(path))
    assert abs(mean) > 5 * LIMITS[0] and blocks > 5 * LIMITS[1]


@pytest.mark.parametrize("packed_from", [1, full_path.PACKED_FROM], ids=["packed", "not packed"])
def test_path_comes_to_the_same_picture_and_compiles_nothing_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, packed_from: int
) -> None:
    monkeypatch.setattr(full_path, "PACKED_FROM", packed_from)
    path = write(tmp_path, BALL.format('<bsdf type="plastic">' + RED.format("diffuse_reflectance") + "</bsdf>"))
    renderer = Renderer(load(path), "path", {"samples": 4}, size=(SIZE * FINER, SIZE * FINER), materials="full", seed=3)
    for _ in range(8):
        renderer.step()
    recorded = renderer.compilations
    for _ in range(8):
        renderer.step()
    assert renderer.compilations == recorded
    image = coarse(renderer.layers().image())
    mean, blocks, _ = compare(np.stack([image, image]), of_mitsuba(path))
    assert abs(mean) <= LIMITS[0] and blocks <= LIMITS[1], (mean, blocks)
