"""`luxel.load`: which files get the default light, and what `--sky`, `--envmap` and `--sun` leave of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

import luxel
from luxel.cli.options import load_scene
from luxel.render.loading import is_left_dark
from luxel.scene.library.shapes import box
from luxel.scene.model import SceneData

WhiteFile = Callable[..., Path]
WHITE: dict[str, Any] = {"pbrMetallicRoughness": {"baseColorFactor": [0.8, 0.8, 0.8, 1.0], "metallicFactor": 0.0}}
METAL: dict[str, Any] = {"pbrMetallicRoughness": {"baseColorFactor": [0.9, 0.9, 0.9, 1.0], "metallicFactor": 1.0}}
UNLIT: dict[str, Any] = {**WHITE, "extensions": {"KHR_materials_unlit": {}}}


def glow(radiance: float) -> dict[str, Any]:
    strength = {"KHR_materials_emissive_strength": {"emissiveStrength": radiance}}
    return {"emissiveFactor": [1.0, 1.0, 1.0], "extensions": strength}


def block(low: tuple[float, ...], high: tuple[float, ...], inward: bool = False) -> np.ndarray:
    mesh = box(low, high, 0, inward=inward)  # type: ignore[arg-type]
    return mesh.positions[mesh.faces]


def plane(half: float, y: float = 0.0, down: bool = False) -> np.ndarray:
    """Two triangles of a square about the Y axis, facing up or down."""
    a, b, c, d = ((-half, y, -half), (-half, y, half), (half, y, half), (half, y, -half))
    return np.array([[a, c, b], [a, d, c]] if down else [[a, b, c], [a, c, d]])


APPLIANCE = block((-0.5, 0.0, -0.3), (0.5, 0.6, 0.3))
LED = block((0.4, 0.5, 0.295), (0.42, 0.52, 0.301))


def added(data: SceneData) -> bool:
    """Whether the default light came; the warning and the light always come together."""
    says = [text for text in data.warnings if "default sky and sun" in text and "--sky none" in text]
    lit = data.sky.color == (0.7, 0.85, 1.0) and [light.kind for light in data.lights] == ["directional"]
    assert len(says) == int(lit)
    return lit


@pytest.mark.parametrize("material", [WHITE, METAL], ids=["white", "metal"])
def test_a_lamp_of_two_centimetres_is_not_the_light_of_an_appliance(
    write_gltf: WhiteFile, material: dict[str, Any]
) -> None:
    plain = luxel.load(write_gltf("plain.gltf", [("appliance", APPLIANCE, material)]))
    with_led = luxel.load(write_gltf("led.gltf", [("appliance", APPLIANCE, material), ("led", LED, glow(5.0))]))
    assert added(plain) and added(with_led)
    assert "no light" in plain.warnings[-1] and "glowing surfaces" in with_led.warnings[-1]


def test_a_room_that_a_glowing_panel_lights_gets_nothing(write_gltf: WhiteFile) -> None:
    room = block((-2.0, 0.0, -2.0), (2.0, 2.5, 2.0), inward=True)
    data = luxel.load(write_gltf("room.gltf", [("room", room, WHITE), ("panel", plane(0.5, 2.45, True), glow(10.0))]))
    assert not added(data) and not data.lights and max(data.sky.color) == 0.0


def test_surfaces_that_nothing_can_light_ask_for_no_light(write_gltf: WhiteFile) -> None:
    assert not added(luxel.load(write_gltf("unlit.gltf", [("appliance", APPLIANCE, UNLIT)])))
    # An unlit sign on an ordinary appliance lights it no more than an LED does.
    assert added(luxel.load(write_gltf("sign.gltf", [("appliance", APPLIANCE, WHITE), ("sign", LED, UNLIT)])))


def test_a_lamp_or_a_sky_of_the_file_decides_without_a_render(
    write_gltf: WhiteFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(data: SceneData) -> bool:
        raise AssertionError(f"{data.name} was rendered")

    monkeypatch.setattr("luxel.render.loading.is_left_dark", refuse)
    lamp = {"KHR_lights_punctual": {"lights": [{"type": "point", "intensity": 1e-6}]}}
    parts = [("appliance", APPLIANCE, WHITE), ("led", LED, glow(5.0))]
    nodes = [
        {"mesh": 0}, {"mesh": 1}, {"extensions": {"KHR_lights_punctual": {"light": 0}}, "translation": [0, 9, 0]},
    ]  # fmt: skip
    scenes = [{"nodes": [0, 1, 2]}]
    data = luxel.load(write_gltf("lamp.gltf", parts, nodes=nodes, scenes=scenes, extensions=lamp))
    assert len(data.lights) == 1 and max(data.sky.color) == 0.0
    luxel.load(write_gltf("none.gltf", parts[:1]))
    luxel.load("cornell-box")


def test_the_decision_leaves_the_scene_alone(write_gltf: WhiteFile) -> None:
    file = write_gltf("led.gltf", [("appliance", APPLIANCE, WHITE), ("led", LED, glow(5.0))])
    data = load_scene(str(file), sky="none")
    before = repr((data.lights, data.sky, data.warnings, data.cameras))
    assert is_left_dark(data) and is_left_dark(data)
    assert repr((data.lights, data.sky, data.warnings, data.cameras)) == before


# ---------- What the options leave of it ----------


@pytest.fixture
def flat_map(tmp_path: Path) -> str:
    mi.Bitmap(np.full((4, 8, 3), 0.5, np.float32)).write(str(tmp_path / "flat.exr"))
    return str(tmp_path / "flat.exr")


def radiance_of(data: SceneData) -> np.ndarray:
    """Return the truth of a plane that is seen from above: a constant sky L gives albedo * L."""
    data.cameras = [luxel.Camera((0.0, 1.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, -1.0), 40.0)]
    truth = luxel.render_truth(data, size=(16, 16), spp=16, cache=False)
    return truth.layers.image()


@pytest.mark.parametrize("led", [False, True], ids=["no light", "an LED"])
def test_sky_and_envmap_give_that_light_alone(write_gltf: WhiteFile, flat_map: str, led: bool) -> None:
    sign = [("led", plane(0.01, -3.0), glow(5.0))] if led else []
    file = str(write_gltf("plane.gltf", [("plane", plane(4.0), WHITE), *sign]))
    assert np.all(radiance_of(load_scene(file, sky="none")) == 0.0)
    for options in ({"sky": "0.5"}, {"envmap": flat_map}):
        data = load_scene(file, **options)
        assert not data.lights and not any("default" in text for text in data.warnings)
        np.testing.assert_allclose(radiance_of(data), 0.8 * 0.5, rtol=1e-3)
    # Both given: that sun and that sky.
    both = load_scene(file, sun="0,90,3", sky="0.5")
    assert len(both.lights) == 1 and not any("default" in text for text in both.warnings)


@pytest.mark.parametrize("led", [False, True], ids=["no light", "an LED"])
def test_a_sun_replaces_the_default_one_and_leaves_the_sky(write_gltf: WhiteFile, led: bool) -> None:
    sign = [("led", plane(0.01, -3.0), glow(5.0))] if led else []
    data = load_scene(str(write_gltf("plane.gltf", [("plane", plane(4.0), WHITE), *sign])), sun="0,90,3")
    (sun,) = data.lights
    assert max(sun.color) == pytest.approx(3.0) and data.sky.color == (0.7, 0.85, 1.0)
    said = [text for text in data.warnings if "default" in text]
    assert len(said) == 1 and "sun" not in said[0] and "--sky none" in said[0]
    # Straight from above: E / pi of the sun, and the sky's radiance, times the albedo.
    expected = 0.8 * (np.array(sun.color) / math.pi + np.array(data.sky.color))
    np.testing.assert_allclose(radiance_of(data).mean(axis=(0, 1)), expected, rtol=1e-3)


def test_a_sun_of_the_file_stays_under_another_sky(write_gltf: WhiteFile) -> None:
    sun = {"KHR_lights_punctual": {"lights": [{"type": "directional", "intensity": 10.0, "name": "sun"}]}}
    nodes = [{"mesh": 0}, {"extensions": {"KHR_lights_punctual": {"light": 0}}}]
    file = write_gltf(
        "sun.gltf", [("plane", plane(4.0), WHITE)], nodes=nodes, scenes=[{"nodes": [0, 1]}], extensions=sun
    )
    assert [light.name for light in load_scene(str(file), sky="0.5").lights] == ["sun"]


def test_a_mitsuba_file_is_lit_by_its_own_emitter_alone(tmp_path: Path) -> None:
    """A lamp of 2 cm over a floor of 4 m leaves it far below the limit; Mitsuba adds no sky, and so do we not."""
    path = tmp_path / "lamp.xml"
    path.write_text(
        """<scene version="3.0.0"><integrator type="path"/>
        <sensor type="perspective"><transform name="to_world"><lookat origin="0,3,4" target="0,0,0" up="0,1,0"/>
          </transform><film type="hdrfilm"><integer name="width" value="32"/><integer name="height" value="32"/>
          <rfilter type="box"/></film></sensor>
        <shape type="rectangle"><transform name="to_world"><rotate x="1" angle="-90"/><scale value="4"/></transform>
          <bsdf type="diffuse"/></shape>
        <shape type="rectangle"><transform name="to_world"><scale value="0.01"/><rotate x="1" angle="90"/>
          <translate y="2"/></transform><emitter type="area"><rgb name="radiance" value="100"/></emitter></shape>
        </scene>"""
    )
    data = luxel.load(path)
    assert not data.lights and max(data.sky.color) == 0.0 and data.warnings == []
    ours = luxel.render_truth(data, size=(32, 32), spp=64, cache=False).layers.image()
    theirs = np.array(mi.render(mi.load_file(str(path)), spp=64))[..., :3]  # type: ignore[arg-type]
    assert np.median(theirs) < 1e-4 * 100.0
    assert np.median(ours) == pytest.approx(np.median(theirs), rel=0.02)
