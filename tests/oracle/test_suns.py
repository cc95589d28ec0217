"""Suns of sky images and suns of every size beside `mi.render`: their light, their shadows and their discs."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy.ndimage import binary_erosion
from tests.oracle.conftest import HEIGHT, WIDTH, render_luxel, render_mitsuba

from luxel.render.renderer import Renderer
from luxel.scene import load
from luxel.scene.edit import apply_sky, apply_sun
from luxel.scene.model import SceneData

Judge = Callable[..., SceneData]

ROWS, COLUMNS = 181, 360
"""Of sky images: Mitsuba's first and last row are the poles, so a pixel is one degree."""
IRRADIANCE = 4.0
"""Of each sun, W/m^2."""
SKY = (0.25, 0.3, 0.4)


def write_sky(stage: Any, suns: list[tuple[float, float, float]], background: tuple[float, ...] = SKY) -> None:
    """Write sky.exr: for each (row, column, degrees across) a round sun, or one pixel where the size is 0."""
    image = np.tile(np.array(background, np.float32), (ROWS, COLUMNS, 1))
    row, column = np.meshgrid(np.arange(ROWS), np.arange(COLUMNS), indexing="ij")
    theta, phi = np.radians(row), np.radians(column + 0.5)
    for at_row, at_column, size in suns:
        polar, azimuth = math.radians(at_row), math.radians(at_column + 0.5)
        cosine = np.cos(theta) * math.cos(polar) + np.sin(theta) * math.sin(polar) * np.cos(phi - azimuth)
        inside = np.degrees(np.arccos(np.clip(cosine, -1, 1))) <= size / 2
        if size == 0.0:
            inside = (row == at_row) & (column == at_column)
        solid_angle = np.radians(1) ** 2 * np.maximum(np.sin(theta), np.radians(0.25))[inside].sum()
        image[inside] += np.array([1.0, 0.8, 0.6], np.float32) * np.float32(IRRADIANCE / solid_angle)
    mi.Bitmap(image).write(str(stage.folder / "sky.exr"))


def sky_body(transform: str = "", extra: str = "") -> str:
    return f"""<emitter type="envmap"><string name="filename" value="sky.exr"/>{extra}
      <transform name="to_world">{transform}</transform></emitter>"""


SKIES = {
    "one pixel": ([(50, 130, 0.0)], "", 1),
    "three degrees": ([(50, 130, 3.0)], "", 1),
    "on the seam": ([(45, 359.5, 3.0)], "", 1),
    "near the pole": ([(2, 20, 3.0)], "", 1),
    "at the pole": ([(0, 20, 3.0)], "", 1),
    "two": ([(50, 130, 2.0), (35, 250, 0.0)], "", 2),
    "turned": ([(80, 130, 3.0)], '<rotate x="1" angle="-35"/><rotate y="1" angle="25"/>', 1),
    "one pixel, turned": ([(80, 130, 0.0)], '<rotate x="1" angle="-35"/><rotate y="1" angle="25"/>', 1),
    "mirrored": ([(60, 130, 3.0)], '<scale x="-1"/><rotate z="1" angle="20"/>', 1),
    "y and z exchanged": ([(60, 130, 3.0)], '<rotate x="1" angle="90"/><rotate y="1" angle="120"/>', 1),
}


@pytest.mark.parametrize(("suns", "transform", "count"), SKIES.values(), ids=SKIES.keys())
def test_suns_of_sky_images(stage: Any, judge: Judge, suns: Any, transform: str, count: int) -> None:
    write_sky(stage, suns)
    # Mitsuba's own noise is what asks for more at a pole.
    data = judge(stage.write(sky_body(transform)), spp=64 if suns[0][0] > 2 else 256)
    assert len(data.lights) == count and all(light.in_sky for light in data.lights)


@pytest.mark.parametrize("transform", ['<scale value="1.6"/><rotate x="1" angle="-35"/>', '<scale value="0.8"/>'])
def test_a_scaled_sky_keeps_its_sun(stage: Any, transform: str) -> None:
    """`mi.render` of such a sky depends on how it is sampled, so Mitsuba is asked for the radiance itself."""
    write_sky(stage, [(95, 130, 2.0)])
    path = stage.write(sky_body(transform))
    data = load(path)
    (sun,) = data.lights
    towards, around = np.array(sun.direction) * -1.0, np.linspace(-0.06, 0.06, 481)
    frame = np.linalg.svd(towards[None])[2]
    s, t = (axis.ravel() for axis in np.meshgrid(around, around))
    rays = towards + s[:, None] * frame[1] + t[:, None] * frame[2]
    # A step of the plane at distance one, seen from the point.
    omega = (around[1] - around[0]) ** 2 / np.linalg.norm(rays, axis=1) ** 3
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    radiance = evaluate(mi.load_file(str(path)), rays) - np.array(SKY)
    assert (radiance * omega[:, None]).sum(axis=0) == pytest.approx(sun.color, rel=0.01)
    middle = (rays * (radiance.sum(axis=1) * omega)[:, None]).sum(axis=0)
    assert middle / np.linalg.norm(middle) == pytest.approx(towards, abs=2e-3)


def evaluate(scene: Any, rays: np.ndarray) -> np.ndarray:
    """Return the radiance (N, 3) that comes from the unit directions `rays` (N, 3)."""
    si = dr.zeros(mi.SurfaceInteraction3f, len(rays))
    si.wi = mi.Vector3f(*(mi.Float(np.ascontiguousarray(-rays[:, axis], np.float32)) for axis in range(3)))
    return np.array(scene.environment().eval(si), float).T


def test_a_sun_before_a_black_sky(stage: Any, judge: Judge) -> None:
    write_sky(stage, [(50, 130, 2.0)], background=(0.0, 0.0, 0.0))
    assert len(judge(stage.write(sky_body(extra='<float name="scale" value="1.5"/>')), spp=64).lights) == 1


def test_a_sun_in_its_glow(stage: Any, judge: Judge) -> None:
    """The glow exceeds 50 times the median over 9 degrees, the sun in it is 2 degrees wide."""
    write_sky(stage, [(50, 130, 9.0), (50, 130, 2.0), (50, 130, 2.0), (50, 130, 2.0)], background=(0.02, 0.02, 0.02))
    data = judge(stage.write(sky_body()), spp=64)
    assert [light.angular_diameter for light in data.lights] == [pytest.approx(2.0, abs=0.4)]


@pytest.mark.parametrize("diameter", [0.0, 0.53, 5.0, 20.0, 90.0])
def test_suns_of_every_size(stage: Any, judge: Judge, diameter: float) -> None:
    """`--sun` beside a glowing disc far away, or beside Mitsuba's `directional`."""
    azimuth, elevation = math.radians(35.0), math.radians(42.0)
    to_sun = np.array(
        (math.cos(elevation) * math.sin(azimuth), math.sin(elevation), math.cos(elevation) * math.cos(azimuth))
    )
    red, green, blue = IRRADIANCE * np.array([10.0, 9.3, 8.2]) / 10.0
    if diameter == 0.0:
        x, y, z = -to_sun
        body = f"""<emitter type="directional"><vector name="direction" x="{x}" y="{y}" z="{z}"/>
          <rgb name="irradiance" value="{red}, {green}, {blue}"/></emitter>"""
    else:
        radius, far = math.radians(diameter / 2), 5000.0
        each = math.pi * math.sin(radius) ** 2
        place = ", ".join(str(part) for part in far * to_sun)
        body = f"""<shape type="disk"><transform name="to_world"><scale value="{far * math.tan(radius)}"/>
            <lookat origin="{place}" target="0, 0, 0" up="0, 1, 0"/></transform>
          <emitter type="area"><rgb name="radiance" value="{red / each}, {green / each}, {blue / each}"/></emitter>
        </shape>"""
    bare = apply_sky(load(stage.write("", name="bare.xml")), "none")
    data = apply_sun(bare, f"35,42,{IRRADIANCE},{diameter}")
    judge(stage.write(body), 128 if diameter > 10.0 else 64, data)


@pytest.mark.parametrize("aperture", [0.5358, 4.0, 20.0, 80.0])
def test_sunsky_of_every_aperture(stage: Any, judge: Judge, aperture: float) -> None:
    body = f"""<emitter type="sunsky"><vector name="sun_direction" x="0.3" y="0.9" z="0.5"/>
      <transform name="to_world"><rotate x="1" angle="-90"/></transform>
      <float name="sun_aperture" value="{aperture}"/></emitter>"""
    (sun,) = judge(stage.write(body), spp=128).lights
    assert sun.in_sky and sun.angular_diameter == pytest.approx(aperture, rel=0.01)


@pytest.mark.parametrize("size", [0.0, 4.0])
def test_cameras_see_the_disc(stage: Any, size: float) -> None:
    """As much light comes from where the sun stands, and from around it, as in Mitsuba's picture."""
    write_sky(stage, [(50, 130, size)])
    polar, azimuth = math.radians(50), math.radians(130.5)
    x, y, z = math.sin(polar) * math.sin(azimuth), math.cos(polar), -math.sin(polar) * math.cos(azimuth)
    camera = f"""<sensor type="perspective"><float name="fov" value="16"/>
      <transform name="to_world"><lookat origin="0, 9, 0" target="{x}, {9 + y}, {z}" up="0, 1, 0"/></transform>
      <film type="hdrfilm"><integer name="width" value="64"/><integer name="height" value="48"/>
      <rfilter type="box"/></film></sensor>"""
    path = stage.write(sky_body(), camera=camera)
    ours, theirs = (images.mean(axis=0) for images in (render_luxel(load(path), 2), render_mitsuba(path, 64)))
    sky = np.array(SKY)
    assert (ours - sky).sum(axis=(0, 1)) == pytest.approx((theirs - sky).sum(axis=(0, 1)), rel=0.02)
    assert np.abs(ours[:, :8] - theirs[:, :8]).max() < 0.01
    places = np.indices(ours.shape[:2]).reshape(2, -1)
    middles = [np.average(places, axis=1, weights=(image - sky).sum(axis=2).ravel()) for image in (ours, theirs)]
    assert middles[0] == pytest.approx(middles[1], abs=0.3)


PLAIN = """
  <bsdf type="twosided" id="white"><bsdf type="diffuse"><rgb name="reflectance" value="0.5, 0.5, 0.5"/></bsdf></bsdf>
  <shape type="rectangle"><transform name="to_world"><rotate x="1" angle="-90"/><scale value="6"/></transform>
    <ref id="white"/></shape>
  <shape type="cube"><transform name="to_world"><scale x="0.5" y="0.6" z="0.4"/><translate x="-0.2" y="0.6" z="0"/>
    </transform><ref id="white"/></shape>"""
"""A block on a plain."""


@pytest.mark.parametrize("method", ["gibs", "ddgi", "lightmap", "path"])
def test_every_method_shows_a_sky_s_sun_and_its_shadow(stage: Any, method: str) -> None:
    """A sun of two pixels gives most of the light; a few frames show a lit floor and a dark shadow."""
    write_sky(stage, [(50, 130, 0.0), (50, 131, 0.0)], background=(0.05, 0.06, 0.08))
    path = stage.write(sky_body(), room=PLAIN)
    theirs = render_mitsuba(path, 256).mean(axis=0)
    renderer = Renderer(load(path), method, size=(WIDTH, HEIGHT), seed=3)
    renderer.run(24)
    ours = renderer.image()
    floor = np.zeros((HEIGHT, WIDTH), bool)
    floor[30:] = True
    lit = floor & (theirs[..., 0] > 0.9 * np.median(theirs[floor][:, 0]))
    assert np.median(ours[lit], axis=0) == pytest.approx(np.median(theirs[lit], axis=0), rel=0.02)
    shadow = theirs[..., 0] < 0.1 * np.median(theirs[floor][:, 0])
    shadow = np.array(binary_erosion(shadow), bool)
    assert shadow.sum() > 40, "there is a shadow"
    assert np.median(ours[shadow], axis=0) == pytest.approx(np.median(theirs[shadow], axis=0), rel=0.1)
    assert np.quantile(ours[shadow], 0.95) < 0.2 * np.median(ours[lit])
