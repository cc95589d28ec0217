"""Cameras, textures, vertex colours, spectra, instances, includes and the integrator's switches, beside `mi.render`."""

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
RED = '<bsdf type="diffuse"><rgb name="reflectance" value="0.7, 0.2, 0.1"/></bsdf>'
LAMP = """<shape type="rectangle"><transform name="to_world"><scale value="0.5"/><rotate x="1" angle="60"/>
  <translate x="0.8" y="1.5" z="0.3"/></transform>
  <emitter type="area"><rgb name="radiance" value="3"/></emitter></shape>"""
BALL = f"""<shape type="sphere"><point name="center" x="0.5" y="0.8" z="0.2"/><float name="radius" value="0.7"/>{RED}
  </shape>"""
LOOK = '<lookat origin="1.1, 2.6, 5.2" target="0.1, 0.6, 0" up="0.05, 1, 0"/>'
FILM = """<film type="hdrfilm"><integer name="width" value="64"/><integer name="height" value="48"/>
  <rfilter type="box"/>{more}</film>"""


def camera(kind: str, inside: str, before: str = "", film: str = "") -> str:
    place = f'<transform name="to_world">{before}{LOOK}</transform>'
    return f'<sensor type="{kind}">{inside}{place}{FILM.format(more=film)}</sensor>'


CAMERAS = {
    "perspective": camera("perspective", '<float name="fov" value="40"/>'),
    "focal length": camera("perspective", '<string name="focal_length" value="35mm"/>'),
    "fov by y": camera("perspective", '<float name="fov" value="30"/><string name="fov_axis" value="y"/>'),
    "diagonal fov": camera("perspective", '<float name="fov" value="50"/><string name="fov_axis" value="diagonal"/>'),
    "orthographic": camera("orthographic", "", '<scale x="2" y="2"/>'),
    "orthographic, scale of z": camera("orthographic", "", '<scale value="1.7"/>'),
    "orthographic, stretched": camera("orthographic", "", '<scale x="1.5" y="2.6"/>'),
    "mirrored": camera("perspective", '<float name="fov" value="40"/>', '<scale x="-1"/>'),
    "orthographic, mirrored": camera("orthographic", "", '<scale x="2" y="-2"/>'),
    "thinlens": camera(
        "thinlens", '<float name="fov" value="40"/><float name="aperture_radius" value="1e-4"/>'
        '<float name="focus_distance" value="5"/>'),
    "cropped in the middle": camera(
        "perspective", '<float name="fov" value="50"/>', film='<integer name="crop_width" value="64"/>'
        '<integer name="crop_height" value="48"/><integer name="crop_offset_x" value="16"/>'
        '<integer name="crop_offset_y" value="12"/>').replace('"width" value="64"', '"width" value="96"')
        .replace('"height" value="48"', '"height" value="72"'),
    "cropped at the side": camera(
        "perspective", '<float name="fov" value="60"/>', film='<integer name="crop_width" value="64"/>'
        '<integer name="crop_height" value="48"/><integer name="crop_offset_x" value="26"/>'
        '<integer name="crop_offset_y" value="20"/>').replace('"width" value="64"', '"width" value="96"')
        .replace('"height" value="48"', '"height" value="72"'),
    "orthographic, cropped at the side": camera(
        "orthographic", "", '<scale x="2.4" y="2.4"/>', film='<integer name="crop_width" value="64"/>'
        '<integer name="crop_height" value="48"/><integer name="crop_offset_x" value="26"/>'
        '<integer name="crop_offset_y" value="4"/>').replace('"width" value="64"', '"width" value="96"')
        .replace('"height" value="48"', '"height" value="72"'),
    "principal point": camera(
        "perspective", '<float name="fov" value="50"/><float name="principal_point_offset_x" value="0.15"/>'
        '<float name="principal_point_offset_y" value="-0.1"/>'),
    "principal point of a crop": camera(
        "perspective", '<float name="fov" value="60"/><float name="principal_point_offset_x" value="-0.2"/>',
        film='<integer name="crop_width" value="64"/><integer name="crop_height" value="48"/>'
        '<integer name="crop_offset_x" value="26"/><integer name="crop_offset_y" value="20"/>')
        .replace('"width" value="64"', '"width" value="96"').replace('"height" value="48"', '"height" value="72"'),
}  # fmt: skip


@pytest.mark.parametrize("sensor", CAMERAS.values(), ids=CAMERAS.keys())
def test_cameras(stage: Any, judge: Judge, sensor: str) -> None:
    judge(stage.write(LIGHT + BALL, camera=sensor))


@pytest.mark.parametrize("where", ["file", "include", "default"])
def test_hide_emitters(stage: Any, judge: Judge, where: str) -> None:
    value = "$hide" if where == "default" else "true"
    switch = f'<boolean name="hide_emitters" value="{value}"/>'
    inside = f'<integrator type="path"><integer name="max_depth" value="24"/>{switch}</integrator>'
    if where == "include":
        (stage.folder / "way.xml").write_text(f'<scene version="3.0.0">{inside}</scene>')
        inside = '<include filename="way.xml"/>'
    if where == "default":
        inside = '<default name="hide" value="true"/>' + inside
    data = judge(stage.write(LIGHT + LAMP, integrator=inside))
    assert data.hide_emitters


def card(bsdf: str, x: float) -> str:
    return f"""<shape type="rectangle"><transform name="to_world"><scale value="0.8"/>
      <translate x="{x}" y="0.9" z="0.3"/></transform><bsdf type="twosided">{bsdf}</bsdf></shape>"""


@pytest.mark.parametrize("wrap", ["repeat", "clamp", "mirror"])
@pytest.mark.parametrize("texels", ["nearest", "bilinear"])
def test_texture_filters(stage: Any, judge: Judge, texels: str, wrap: str) -> None:
    # Two by two texels: a blurred edge takes half of each.
    pixels = np.array([[(250, 20, 20), (20, 250, 20)], [(20, 20, 250), (240, 240, 240)]], np.uint8)
    mi.Bitmap(pixels).write(str(stage.folder / "four.png"))
    body = LIGHT
    for x, steps in ((-0.6, ""), (1.2, '<scale x="1.5" y="1.5"/><rotate z="1" angle="20"/><translate x="0.2"/>')):
        body += card(
            f"""<bsdf type="diffuse"><texture type="bitmap" name="reflectance"><string name="filename"
            value="four.png"/><string name="filter_type" value="{texels}"/><string name="wrap_mode" value="{wrap}"/>
            <transform name="to_uv">{steps}</transform></texture></bsdf>""", x)  # fmt: skip
    judge(stage.write(body))


BANDS = """<texture type="checkerboard" name="{}"><rgb name="color0" value="0.9, 0.1, 0.1"/>
  <rgb name="color1" value="0.1, 0.2, 0.8"/><transform name="to_uv"><scale x="1.7" y="0.6"/><rotate z="1" angle="10"/>
  </transform></texture>"""


@pytest.mark.parametrize("flip", ["false", "true"])
@pytest.mark.parametrize("kind", ["rectangle", "disk", "sphere", "cylinder", "cube", "ply"])
def test_texture_coordinates(stage: Any, judge: Judge, kind: str, flip: str) -> None:
    """Large bands on every shape, mirrored; the mesh has no coordinates, so Mitsuba takes each triangle's own."""
    write_sail(stage.folder)
    file = '<string name="filename" value="sail.ply"/>' if kind == "ply" else ""
    paint = f'<bsdf type="twosided"><bsdf type="diffuse">{BANDS.format("reflectance")}</bsdf></bsdf>'
    place = """<transform name="to_world"><scale value="0.9"/><rotate x="1" angle="-30"/><scale x="-1"/>
      <rotate y="1" angle="20"/><translate x="0.5" y="1.1" z="0.2"/></transform>"""
    flag = f'<boolean name="flip_normals" value="{flip}"/>'
    judge(stage.write(LIGHT + f'<shape type="{kind}">{file}{flag}{place}{paint}</shape>'))


@pytest.mark.parametrize("kind", ["rectangle", "sphere"])
def test_textured_lamps(stage: Any, judge: Judge, kind: str) -> None:
    place = """<transform name="to_world"><scale value="0.6"/><rotate x="1" angle="50"/><scale x="-1"/>
      <translate x="0.7" y="1.4" z="0.4"/></transform>"""
    pixels = np.array([[(4, 1, 0.2), (0.2, 1, 3)], [(2, 2, 2), (0, 0, 0)]], np.float32)
    mi.Bitmap(pixels).write(str(stage.folder / "four.exr"))
    lamp = """<emitter type="area"><texture type="bitmap" name="radiance"><boolean name="raw" value="true"/>
      <string name="filename" value="four.exr"/><string name="filter_type" value="nearest"/></texture></emitter>"""
    flag = '<boolean name="flip_normals" value="true"/>' if kind == "sphere" else ""
    judge(stage.write(LIGHT + f'<shape type="{kind}">{flag}{place}{lamp}<bsdf type="diffuse"/></shape>'), spp=64)


@pytest.mark.parametrize("turn", [0, 180], ids=["front", "other back"])
@pytest.mark.parametrize("per", ["vertex", "face"])
def test_mesh_attributes(stage: Any, judge: Judge, per: str, turn: int) -> None:
    mesh = mi.Mesh("card", vertex_count=4, face_count=2)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], np.float32).ravel()
    parameters["faces"] = np.array([(0, 1, 2), (0, 2, 3)], np.uint32).ravel()
    parameters.update()
    colours = np.array([(0.9, 0.1, 0.1), (0.1, 0.8, 0.1), (0.1, 0.1, 0.9), (0.8, 0.8, 0.1)], np.float32)
    mesh.add_attribute(f"{per}_color", 3, colours[: 4 if per == "vertex" else 2].ravel())
    mesh.write_ply(str(stage.folder / "card.ply"))
    colour = f'<texture type="mesh_attribute" name="reflectance"><string name="name" value="{per}_color"/></texture>'
    back = '<bsdf type="diffuse"><rgb name="reflectance" value="0.1, 0.7, 0.6"/></bsdf>' if turn else ""
    body = f"""<shape type="ply"><string name="filename" value="card.ply"/><transform name="to_world">
      <rotate y="1" angle="{turn}"/><translate x="0.5" y="1.1" z="0.4"/></transform>
      <bsdf type="twosided"><bsdf type="diffuse">{colour}</bsdf>{back}</bsdf></shape>"""
    judge(stage.write(LIGHT + body))


SPECTRA = {
    "regular": '<spectrum name="radiance" value="400:1, 500:2, 600:5, 700:6"/>',
    "one value": '<spectrum name="radiance" value="3"/>',
    "d65": '<spectrum type="d65" name="radiance"><float name="scale" value="4"/></spectrum>',
    "file": '<spectrum name="radiance" filename="lamp.spd"/>',
}  # fmt: skip


@pytest.mark.parametrize("spectrum", SPECTRA.values(), ids=SPECTRA.keys())
def test_spectra_of_lamps(stage: Any, judge: Judge, spectrum: str) -> None:
    (stage.folder / "lamp.spd").write_text("400 1\n500 4\n600 3\n700 1\n")
    lamp = LAMP.replace('<rgb name="radiance" value="3"/>', spectrum)
    point = f"""<emitter type="point"><point name="position" x="-0.6" y="2" z="1.5"/>
      {spectrum.replace("radiance", "intensity")}</emitter>"""
    sky = f'<emitter type="constant">{spectrum.replace(">", ">", 1)}</emitter>'
    judge(stage.write(lamp + point + (sky if "d65" in spectrum else "")))


GROUP = f"""<shape type="shapegroup" id="pair"><shape type="cube"><transform name="to_world">
  <scale value="0.25"/><translate x="-0.3"/></transform>{RED}</shape>
  <shape type="ply"><string name="filename" value="sail.ply"/><bsdf type="twosided" id="green"><bsdf type="diffuse">
  <rgb name="reflectance" value="0.1, 0.6, 0.2"/></bsdf></bsdf></shape></shape>"""
INSTANCES = "".join(
    f'<shape type="instance"><ref id="pair"/><transform name="to_world">{place}</transform></shape>'
    for place in (
        '<translate x="-0.2" y="0.4" z="1"/>',
        '<rotate y="1" angle="70"/><translate x="1.4" y="0.5" z="0.3"/>',
        '<scale x="-1.5" y="1" z="1"/><translate x="0.3" y="1.5" z="-0.5"/>',
    )
)


def write_sail(folder: Any) -> None:
    mesh = mi.Mesh("sail", vertex_count=3, face_count=1)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = np.array([(0.1, -0.3, 0), (0.8, -0.3, 0.1), (0.1, 0.7, 0)], np.float32).ravel()
    parameters["faces"] = np.array([(0, 1, 2)], np.uint32).ravel()
    parameters.update()
    mesh.write_ply(str(folder / "sail.ply"))


@pytest.mark.parametrize("where", ["file", "include", "folder"])
def test_instances(stage: Any, judge: Judge, where: str) -> None:
    write_sail(stage.folder)
    group = GROUP
    if where != "file":
        folder = stage.folder / "parts" if where == "folder" else stage.folder
        folder.mkdir(exist_ok=True)
        (folder / "group.xml").write_text(f'<scene version="3.0.0">{GROUP}</scene>')
        group = f'<include filename="{"parts/" if where == "folder" else ""}group.xml"/>'
    judge(stage.write(LIGHT + group + INSTANCES))
