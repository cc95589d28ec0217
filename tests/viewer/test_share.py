"""A view as text makes the same picture again."""

from __future__ import annotations

import shlex
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import luxel
from luxel.cli.options import load_scene
from luxel.render.exposure import Exposure
from luxel.scene.edit import DEFAULT_SUN, parse_camera
from luxel.scene.model import Camera, Light
from luxel.viewer import share
from luxel.viewer.stats import Facts, ObjectFacts
from luxel.viewer.world import Choice

CAMERA = Camera((0.3, 0.2, 3.5), (0.1, -0.2, 0.0), fov=41.5)
LAMP = Light("point", (1.0, 2.0, 3.0), position=(0.0, 0.5, 0.0), name="lamp")
RED, GREEN, BLUE = (3.0 * channel / max(DEFAULT_SUN) for channel in DEFAULT_SUN)
SUN = Light("directional", (RED, GREEN, BLUE), direction=(0.0, -1.0, -1.0), name="sun")


def make_facts(**changes: Any) -> Facts:
    facts = Facts(
        structure=0,
        name="cornell-box",
        choice=Choice("gibs", None, {"rays_per_surfel": 2}),
        params=None,
        frozen=False,
        light_scale=1.0,
        sun=None,
        lights=(),
        glowing=((3, "lamp", (18.0, 14.0, 7.0)),),
        objects=(ObjectFacts("room", np.eye(4), np.zeros(3), 1.0), ObjectFacts("box", np.eye(4), np.zeros(3), 1.0)),
        duration=0.0,
        playing=False,
        speed=1.0,
        lower=np.zeros(3),
        upper=np.ones(3),
    )
    return replace(facts, **changes)


VIEW = share.SharedView(CAMERA, (64, 48), 0.0)
LAUNCH = share.describe_launch("cornell-box", {}, make_facts())


def test_the_command_names_method_settings_size_and_camera() -> None:
    words = shlex.split(share.write_command(LAUNCH, make_facts(), VIEW))
    assert words[:3] == ["luxel", "render", "cornell-box"]
    assert words[words.index("--set") + 1] == "rays_per_surfel=2"
    assert words[words.index("--size") + 1] == "64x48"
    text = next(word for word in words if word.startswith("--camera=")).removeprefix("--camera=")
    camera = parse_camera(text, load_scene("cornell-box"))
    np.testing.assert_allclose((*camera.eye, *camera.target, camera.fov), (*CAMERA.eye, *CAMERA.target, CAMERA.fov))
    assert not share.missing_in_command(LAUNCH, make_facts())


def test_stops_from_the_automatic_exposure_are_told() -> None:
    brighter = replace(VIEW, exposure=Exposure(stops=1.5))
    assert "--exposure=+1.5ev" in share.write_command(LAUNCH, make_facts(), brighter)
    assert "renderer.auto_exposure() * 2.0**1.5)" in share.write_python(LAUNCH, make_facts(), brighter)
    assert "renderer.auto_exposure())" in share.write_python(LAUNCH, make_facts(), VIEW)


def test_time_exposure_and_sun_are_told() -> None:
    facts = make_facts(lights=(SUN,), sun=(0.0, 45.0, 3.0, 0.0))
    command = share.write_command(LAUNCH, facts, replace(VIEW, time=1.5, exposure=Exposure(2.0)))
    assert "--time 1.5" in command and "--exposure 2" in command and "--sun 0,45,3 " in command
    soft = replace(SUN, angular_diameter=2.5)
    facts = make_facts(lights=(soft,), sun=(0.0, 45.0, 3.0, 2.5))
    assert "--sun 0,45,3,2.5 " in share.write_command(LAUNCH, facts, VIEW)
    assert "angular_diameter=2.5" in share.write_python(LAUNCH, facts, VIEW)


def test_rounding_is_not_told() -> None:
    view = replace(VIEW, camera=Camera((0.0, 2.388061e-16, 3.9), (0.0, -4.776123e-16, 0.0), (-0.0, 1.0, -1.8e-16)))
    assert "--camera=0,0,3.9;0,0,0;" in share.write_command(LAUNCH, make_facts(), view).replace("'", "")
    assert "luxel.Camera((0, 0, 3.9), (0, 0, 0), (0, 1, 0)" in share.write_python(LAUNCH, make_facts(), view)


def test_the_chosen_animation_is_told() -> None:
    launch = replace(LAUNCH, scene="a.glb", options={"animation": "walk", "sky": "0.5"})
    assert "--animation walk" in share.write_command(launch, make_facts(), VIEW)
    lines = share.write_python(launch, make_facts(), VIEW).splitlines()
    assert "scene = luxel.load('a.glb', animation='walk')" in lines
    assert "edit.apply_sky(scene, '0.5')" in lines and not any("apply_animation" in line for line in lines)


def test_the_seed_is_told() -> None:
    seeded = replace(LAUNCH, seed=7)
    words = shlex.split(share.write_command(seeded, make_facts(), VIEW))
    assert words[words.index("--seed") + 1] == "7" and "--seed" not in share.write_command(LAUNCH, make_facts(), VIEW)
    assert "camera=camera, seed=7, filter=" in share.write_python(seeded, make_facts(), VIEW)
    assert "seed" not in share.write_python(LAUNCH, make_facts(), VIEW)


def test_the_filter_is_told() -> None:
    centres = replace(LAUNCH, pixel_filter="none")
    words = shlex.split(share.write_command(centres, make_facts(), VIEW))
    assert words[words.index("--filter") + 1] == "none"
    assert "--filter" not in share.write_command(LAUNCH, make_facts(), VIEW)
    assert "filter='none')" in share.write_python(centres, make_facts(), VIEW)
    # A renderer smooths nothing unless it is told to.
    assert "filter='box')" in share.write_python(LAUNCH, make_facts(), VIEW)


def test_what_a_command_cannot_say_is_named() -> None:
    held = ObjectFacts("box", np.eye(4), np.zeros(3), 1.0, held=True)
    facts = make_facts(lights=(LAMP,), light_scale=2.0, objects=(make_facts().objects[0], held))
    assert share.missing_in_command(LAUNCH, facts) == ["changed lamps", "moved objects", "the scale of all light"]


@pytest.mark.parametrize("changed", [False, True])
def test_the_python_lines_run(changed: bool, tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    moved = np.eye(4)
    moved[0, 3] = 0.25
    objects = (make_facts().objects[0], ObjectFacts("box", moved, np.zeros(3), 1.0, held=True))
    facts = make_facts(lights=(LAMP,), glowing=((3, "lamp", (1.0, 1.0, 1.0)),), objects=objects, light_scale=0.5)
    lines = share.write_python(LAUNCH, facts if changed else make_facts(), VIEW)
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    exec(lines.replace("renderer.run(64", "renderer.run(2"), names)
    scene = names["scene"]
    assert (tmp_path / "cornell-box-gibs.png").is_file()
    assert len(scene.lights) == changed
    assert (scene.materials[3].emission == (1.0, 1.0, 1.0)) == changed
    assert (scene.objects[1].to_world[0, 3] == 0.25) == changed
    assert names["renderer"].film.width == 64
    assert isinstance(names["camera"], luxel.Camera)


@pytest.mark.parametrize("lights", [(replace(SUN, color=(5.0, 0.0, 0.0)),), (), (SUN, SUN)])
def test_what_the_suns_option_cannot_say_is_named(lights: tuple[Light, ...]) -> None:
    """`--sun` brings one sun of the default tint: a red one, none and two are beyond it."""
    launch = replace(LAUNCH, lights=(replace(SUN, direction=(0.0, -1.0, 0.0)),))
    facts = make_facts(lights=lights, sun=(0.0, 45.0, 5.0, 0.0) if lights else None)
    assert "--sun" not in share.write_command(launch, facts, VIEW)
    assert "changed lamps" in share.missing_in_command(launch, facts)


def test_what_is_shown_of_materials_is_told_where_it_makes_a_difference() -> None:
    for method, materials, command, python in (
        ("path", "full", False, True),
        ("path", "diffuse", True, False),
        ("path", None, False, False),
        ("gibs", "diffuse", False, False),
    ):
        facts = make_facts(choice=Choice(method), materials=materials)
        assert ("--materials diffuse" in share.write_command(LAUNCH, facts, VIEW)) == command
        assert ("materials='full'" in share.write_python(LAUNCH, facts, VIEW)) == python
