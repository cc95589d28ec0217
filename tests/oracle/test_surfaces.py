"""Materials with a diffuse part, and both sides of every shape, beside `mi.render`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from luxel.scene.model import SceneData

Judge = Callable[..., SceneData]

LIGHT = """<emitter type="constant"><rgb name="radiance" value="0.35"/></emitter>
  <emitter type="directional"><vector name="direction" value="-0.5, -1, -0.5"/>
  <rgb name="irradiance" value="2"/></emitter>"""
SOFT_LIGHT = """<emitter type="constant"><rgb name="radiance" value="0.35"/></emitter>
  <shape type="rectangle"><transform name="to_world"><scale value="1.5"/><rotate x="1" angle="110"/>
  <translate x="1" y="4" z="2.5"/></transform><emitter type="area"><rgb name="radiance" value="3"/></emitter>
  <bsdf type="diffuse"/></shape>"""
RED = '<bsdf type="diffuse"><rgb name="reflectance" value="0.7, 0.2, 0.1"/></bsdf>'
GREEN = '<bsdf type="diffuse"><rgb name="reflectance" value="0.1, 0.6, 0.2"/></bsdf>'
ORANGE = '<rgb name="base_color" value="0.9, 0.5, 0.1"/>'
BITMAP = '<string name="filename" value="texture.png"/>'


def on_cards(bsdf: str) -> str:
    """Two upright cards, one seen from the front and one from the back."""
    cards = ((0, -0.5), (180, 1.3))
    return "".join(
        f"""<shape type="rectangle"><transform name="to_world"><scale value="0.8"/><rotate y="1" angle="{turn + 10}"/>
        <translate x="{x}" y="0.9" z="0.3"/></transform>{bsdf}</shape>"""
        for turn, x in cards
    )


def nested(kind: str, inner: str, more: str = "") -> str:
    return f'<bsdf type="{kind}">{more}{inner}</bsdf>'


def textured(kind: str, slot: str, texture: str, more: str = "") -> str:
    return f'<bsdf type="{kind}">{texture.replace("<texture ", f"""<texture name="{slot}" """)}{more}</bsdf>'


CHECKERS = """<texture type="checkerboard"><rgb name="color0" value="0.1, 0.2, 0.7"/>
  <rgb name="color1" value="0.8, 0.5, 0.1"/><transform name="to_uv"><scale x="2" y="3"/></transform></texture>"""
IMAGE = f'<texture type="bitmap">{BITMAP}</texture>'
HALVES = """<texture type="checkerboard"><float name="color0" value="0.2"/>
  <float name="color1" value="0.9"/></texture>"""

PLAIN = {
    "diffuse": RED,
    "twosided": nested("twosided", RED),
    "two different sides": nested("twosided", RED + GREEN),
    "two textured sides": nested(
        "twosided", textured("diffuse", "reflectance", CHECKERS) + textured("diffuse", "reflectance", IMAGE)),
    "blend of textures": nested(
        "blendbsdf", textured("diffuse", "reflectance", CHECKERS) + textured("diffuse", "reflectance", IMAGE),
        '<float name="weight" value="0.4"/>'),
    "checkerboard": textured("diffuse", "reflectance", CHECKERS),
    "bitmap in twosided": nested("twosided", textured("diffuse", "reflectance", IMAGE)),
    "mask": nested("mask", RED, '<float name="opacity" value="0.3"/>'),
    "twosided in mask": nested("mask", nested("twosided", RED), '<float name="opacity" value="0.6"/>'),
    "two sides in mask": nested("mask", nested("twosided", RED + GREEN), '<float name="opacity" value="0.4"/>'),
    "mask by texture": textured("mask", "opacity", HALVES, nested("twosided", RED)),
    "blendbsdf": nested("blendbsdf", RED + GREEN, '<float name="weight" value="0.3"/>'),
    "blendbsdf by texture": textured("blendbsdf", "weight", HALVES, RED + GREEN),
    "blendbsdf of sides": nested("blendbsdf", nested("twosided", RED) + GREEN, '<float name="weight" value="0.3"/>'),
    "blendbsdf with null": nested("blendbsdf", RED + '<bsdf type="null"/>', '<float name="weight" value="0.3"/>'),
    "null": '<bsdf type="null"/>',
    "spectrum": '<bsdf type="diffuse"><spectrum name="reflectance" value="400:0.1, 500:0.2, 600:0.7, 700:0.8"/></bsdf>',
    "flat normalmap": nested(
        "normalmap", RED, '<texture type="bitmap" name="normalmap"><string name="filename" value="flat.png"/>'
        '<boolean name="raw" value="true"/></texture>'),
    "steep normalmap": nested("normalmap", RED, '<texture type="bitmap" name="normalmap"><string name="filename"'
    ' value="steep.png"/><boolean name="raw" value="true"/></texture>'),
    "bitmap normalmap": nested(
        "normalmap", RED, '<texture type="bitmap" name="normalmap"><string name="filename" value="bumps.png"/>'
        '<boolean name="raw" value="true"/></texture>'),
    "bump map": textured("bumpmap", "arbitrary", IMAGE, RED + '<float name="scale" value="0.7"/>'),
    # Their gloss gives back what it takes from the diffuse part, seen from the front.
    "plastic": '<bsdf type="plastic"><rgb name="diffuse_reflectance" value="0.1, 0.3, 0.7"/></bsdf>',
    "roughplastic": '<bsdf type="roughplastic"><rgb name="diffuse_reflectance" value="0.1, 0.3, 0.7"/></bsdf>',
    "rough diffuse": '<bsdf type="principled"><rgb name="base_color" value="0.6, 0.2, 0.1"/>'
    '<float name="roughness" value="1"/><float name="specular" value="0"/></bsdf>',
}  # fmt: skip


@pytest.mark.parametrize("bsdf", PLAIN.values(), ids=PLAIN.keys())
def test_diffuse_parts(stage: Any, judge: Judge, bsdf: str) -> None:
    write_images(stage.folder)
    # To the light of points and suns Mitsuba's path tracer takes masks for solid; light that rays can meet it lets in.
    light = SOFT_LIGHT if "mask" in bsdf or "null" in bsdf else LIGHT
    judge(stage.write(light + on_cards(bsdf)))


# Under a mirroring matrix Mitsuba's one-sided bump maps are black.
@pytest.mark.parametrize(
    ("kind", "side"), [("normalmap", ""), ("normalmap", '<scale x="-1"/>'), ("bumpmap", "")],
    ids=["normalmap", "mirrored normalmap", "bumpmap"],
)  # fmt: skip
def test_relief_leans_as_in_mitsuba(stage: Any, judge: Judge, kind: str, side: str) -> None:
    """Two cards with a slope to one side, under a lamp from the side: leaning the wrong way it would be dark."""
    slope = np.tile(np.linspace(0, 255, 8), (8, 1)).astype(np.uint8).T
    image = slope if kind == "bumpmap" else np.full((8, 8, 3), (128, 90, 248), np.uint8)
    mi.Bitmap(image).write(str(stage.folder / "relief.png"))
    slot = "normalmap" if kind == "normalmap" else "height"
    scale = '<float name="scale" value="0.25"/>' if kind == "bumpmap" else ""
    paint = f"""<bsdf type="{kind}">{scale}<texture type="bitmap" name="{slot}"><boolean name="raw" value="true"/>
      <string name="filename" value="relief.png"/></texture>{RED}</bsdf>"""
    body = "".join(
        f"""<shape type="rectangle"><transform name="to_world"><scale value="0.8"/>{side}<rotate z="1" angle="{turn}"/>
        <translate x="{x}" y="0.9" z="0.3"/></transform>{paint}</shape>"""
        for turn, x in ((0, -0.5), (70, 1.3))
    )
    judge(stage.write(LIGHT + body))


GLOSSY = {
    "principled in twosided": nested("twosided", f'<bsdf type="principled">{ORANGE}</bsdf>'),
    "principled, metal by texture": f'<bsdf type="principled">{ORANGE}'
    + HALVES.replace("<texture ", '<texture name="metallic" ') + "</bsdf>",
    "principled": f'<bsdf type="principled">{ORANGE}<float name="roughness" value="0.4"/></bsdf>',
    "principled metal": f'<bsdf type="principled">{ORANGE}<float name="metallic" value="1"/></bsdf>',
    "conductor": '<bsdf type="conductor"/>',
    "roughconductor": '<bsdf type="roughconductor"/>',
    "dielectric": '<bsdf type="dielectric"/>',
    "blend with metal": nested(
        "blendbsdf", RED + '<bsdf type="roughconductor"/>', '<float name="weight" value="0.5"/>'),
}  # fmt: skip


@pytest.mark.parametrize("bsdf", GLOSSY.values(), ids=GLOSSY.keys())
def test_gloss(stage: Any, judge: Judge, bsdf: str) -> None:
    write_images(stage.folder)
    judge(stage.write(LIGHT + on_cards(bsdf)), spp=96, materials="full")


def write_images(folder: Any) -> None:
    pixels = np.random.default_rng(3).integers(20, 230, (4, 4, 3)).astype(np.uint8)
    mi.Bitmap(pixels).write(str(folder / "texture.png"))
    mi.Bitmap(np.full((4, 4, 3), (128, 128, 255), np.uint8)).write(str(folder / "flat.png"))
    mi.Bitmap(np.full((4, 4, 3), (190, 80, 210), np.uint8)).write(str(folder / "steep.png"))
    bumps = np.random.default_rng(8).integers((60, 60, 200), (196, 196, 255), (4, 4, 3)).astype(np.uint8)
    mi.Bitmap(bumps).write(str(folder / "bumps.png"))


SHAPES = ("rectangle", "disk", "sphere", "cylinder", "cube", "ply", "bare ply", "faceted ply", "obj")
PLACES = {
    "identity": "",
    "turned": '<rotate x="1" angle="-35"/><rotate y="1" angle="25"/>',
    "mirrored": '<scale x="-1"/><rotate z="1" angle="20"/>',
    "squashed": '<scale x="1.2" y="0.6" z="-0.8"/><rotate x="1" angle="30"/>',
}


@pytest.mark.parametrize("flip", [False, True], ids=["", "flipped"])
@pytest.mark.parametrize("place", PLACES.values(), ids=PLACES.keys())
def test_one_sided_shapes(stage: Any, judge: Judge, place: str, flip: bool) -> None:
    """All kinds of shapes in one file, each one-sided: a shape that is inside out is black, or is not."""
    write_half_ball(stage.folder)
    body = ""
    for index, name in enumerate(SHAPES):
        kind = name.split()[-1]
        file = {"ply": name.replace(" ", "-") + ".ply", "obj": "ball.obj"}.get(kind)
        given = f'<string name="filename" value="{file}"/>' if file else ""
        given += '<boolean name="face_normals" value="true"/>' if "faceted" in name else ""
        given += '<boolean name="flip_normals" value="true"/>' if flip else ""
        x, y = index % 5 * 0.75 - 1.3, index // 5 * 1.1 + 0.6
        body += f"""<shape type="{kind}">{given}<transform name="to_world"><scale value="0.36"/>{place}
          <translate x="{x}" y="{y}" z="0.3"/></transform>{RED}</shape>"""
    judge(stage.write(LIGHT + body))


def write_half_ball(folder: Any) -> None:
    """Write half a ball open to -Z: with normals and half of its faces wound against them, and without normals."""
    rows, columns = 6, 12
    angle, turn = np.meshgrid(
        np.linspace(0.02, np.pi / 2, rows + 1), np.linspace(0, 2 * np.pi, columns + 1), indexing="ij")  # fmt: skip
    points = np.stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)], -1).reshape(-1, 3)
    first = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    good = np.stack([first, first + columns + 1, first + columns + 2], axis=1)
    good = np.concatenate([good, np.stack([first, first + columns + 2, first + 1], axis=1)])
    mixed = good.copy()
    mixed[::2] = mixed[::2, ::-1]
    for name, faces, smooth in (("ply", mixed, True), ("faceted-ply", mixed, True), ("bare-ply", good, False)):
        mesh = mi.Mesh(name, len(points), len(faces), has_vertex_normals=smooth)
        parameters = mi.traverse(mesh)
        parameters["vertex_positions"] = points.astype(np.float32).ravel()
        if smooth:
            parameters["vertex_normals"] = points.astype(np.float32).ravel()
        parameters["faces"] = faces.astype(np.uint32).ravel()
        parameters.update()
        mesh.write_ply(str(folder / f"{name}.ply"))
    lines = [f"v {x} {y} {z}\nvn {x} {y} {z}" for x, y, z in points]
    lines += [f"f {a + 1}//{a + 1} {b + 1}//{b + 1} {c + 1}//{c + 1}" for a, b, c in mixed]
    (folder / "ball.obj").write_text("\n".join(lines) + "\n")
