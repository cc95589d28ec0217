"""Pictures of materials: `path` with full materials beside Mitsuba's own renderer."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

import luxel
from luxel.image.tonemap import to_display
from luxel.render.exposure import auto_exposure
from luxel.render.full_scene import render_full
from luxel.scene.edit import default_camera
from luxel.scene.model import SceneData

PATHS = 2048
"""A pixel, of each of the two."""
AMPLIFY = 4.0

BSDFS = (
    '<bsdf type="diffuse"><rgb name="reflectance" value="0.6 0.15 0.1"/></bsdf>',
    '<bsdf type="plastic"><rgb name="diffuse_reflectance" value="0.1 0.3 0.6"/></bsdf>',
    '<bsdf type="roughplastic"><float name="alpha" value="0.25"/>'
    '<rgb name="diffuse_reflectance" value="0.15 0.5 0.2"/></bsdf>',
    '<bsdf type="conductor"><string name="material" value="Ag"/></bsdf>',
    '<bsdf type="roughconductor"><string name="material" value="Au"/><float name="alpha" value="0.1"/></bsdf>',
    '<bsdf type="roughconductor"><string name="material" value="Cu"/><float name="alpha" value="0.4"/></bsdf>',
    '<bsdf type="dielectric"/>',
    '<bsdf type="roughdielectric"><float name="alpha" value="0.2"/></bsdf>',
    '<bsdf type="thindielectric"/>',
)
"""Of the row of spheres, from left to right."""


def describe_spheres() -> str:
    """Return a Mitsuba file with a row of spheres over a floor, under a lamp and an even sky."""
    places = np.arange(len(BSDFS)) - 0.5 * (len(BSDFS) - 1)
    spheres = "".join(
        f'<shape type="sphere"><float name="radius" value="0.44"/><point name="center" x="{x:g}" y="0.45" z="0"/>'
        f"{bsdf}</shape>"
        for x, bsdf in zip(places, BSDFS, strict=True)
    )
    return (
        '<scene version="3.0.0"><sensor type="perspective"><float name="fov" value="38"/><transform name="to_world">'
        '<lookat origin="0 3.2 14" target="0 0.35 0" up="0 1 0"/></transform></sensor>'
        '<shape type="rectangle"><transform name="to_world"><scale value="12"/><rotate x="1" angle="-90"/></transform>'
        '<bsdf type="diffuse"><texture type="checkerboard" name="reflectance"><rgb name="color0" value="0.25"/>'
        '<rgb name="color1" value="0.6"/><transform name="to_uv"><scale value="24"/></transform></texture>'
        "</bsdf></shape>"
        '<shape type="rectangle"><transform name="to_world"><scale x="5" y="0.8"/><rotate x="1" angle="60"/>'
        '<translate y="5" z="3"/></transform><bsdf type="diffuse"/>'
        '<emitter type="area"><rgb name="radiance" value="9 8.5 8"/></emitter></shape>'
        f'<emitter type="constant"><rgb name="radiance" value="0.35 0.45 0.6"/></emitter>{spheres}</scene>'
    )


def picture_spheres() -> list[tuple[str, np.ndarray]]:
    """Return the row of spheres by `path` and by Mitsuba."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "spheres.xml"
        file.write_text(describe_spheres())
        return picture_full(luxel.load(str(file)), (720, 180))


def picture_full(data: SceneData, size: tuple[int, int]) -> list[tuple[str, np.ndarray]]:
    """Return `path` with full materials, Mitsuba's picture of the same scene, and four times their difference."""
    # A path a frame: all paths of one frame see the same layer of what is blended.
    renderer = luxel.Renderer(data, "path", size=size, materials="full")
    renderer.run(PATHS)
    exposure = auto_exposure(renderer.layers())
    oracle = render_full(data, default_camera(data, size[0] / size[1]), size=size, spp=PATHS)
    shown, wanted = to_display(renderer.image(), exposure), to_display(oracle, exposure)
    difference = np.clip(AMPLIFY * np.abs(shown - wanted), 0.0, 1.0)
    print(f"{data.name}: mean {renderer.image().mean() / oracle.mean():.4f} of Mitsuba's")
    return [("luxel, path", shown), ("Mitsuba", wanted), (f"difference x{AMPLIFY:.0f}", difference)]
