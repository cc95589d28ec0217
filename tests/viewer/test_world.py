"""The world that visitors share is edited by the calls of a live scene: all of each, or nothing."""

from __future__ import annotations

import numpy as np
import pytest

import luxel
from luxel.errors import LuxelError
from luxel.render.shared import CameraView
from luxel.scene.library.shapes import quad, translation
from luxel.scene.model import Camera, Light, Material, Object, SceneData, Sky
from luxel.viewer.stats import describe
from luxel.viewer.world import LIGHT_LIMIT, Choice, World

PAST = Camera((0.0, 0.0, 3.9), (10.0, 0.0, 3.9), fov=40.0)


def make(method: str = "none", **settings: object) -> World:
    return World(luxel.load("cornell-box"), Choice(method, settings=dict(settings)))


def test_an_edit_is_told_to_the_controls_and_to_every_eye() -> None:
    world = make()
    eye = CameraView(world.cache("none"), (16, 16))
    for _ in range(3):
        world.advance([])
        eye.look(PAST)
    assert eye.still_frames == 2
    structure, version = world.structure, world.version
    world.set_sky(color=(1.0, 2.0, 3.0))
    glow = next(index for index, item in enumerate(world.data.materials) if max(item.emission) > 0.0)
    world.set_material(glow, emission=(3.0, 2.0, 1.0))
    world.add_light(Light("directional", (5.0, 5.0, 5.0), direction=(-1.0, -1.0, 0.0), name="sun"))
    world.set_light_scale(2.0)
    assert world.structure == structure + 4 and world.version == version + 4
    facts = describe(world)
    assert facts.glowing[0][2] == (3.0, 2.0, 1.0) and facts.light_scale == 2.0
    assert facts.sun == pytest.approx((90.0, 45.0, 5.0, 0.0), abs=1e-4)
    eye.look(PAST)
    assert eye.still_frames == 0
    np.testing.assert_allclose(eye.layers().emission[8, 8], (2.0, 4.0, 6.0), rtol=1e-6)


def test_what_is_refused_changes_nothing() -> None:
    world = make()
    before = world.structure, world.version
    for act in (
        lambda: world.set_light(0, color=(1.0, 1.0, 1.0)),
        lambda: world.set_sun(0.0, 20.0, -1.0),
        lambda: world.set_material(99, emission=(1.0, 1.0, 1.0)),
        lambda: world.set_light_scale(float("nan")),
        lambda: world.place(2, np.zeros((4, 4))),
    ):
        with pytest.raises(LuxelError):
            act()
    assert (world.structure, world.version) == before and not world.placed
    for _ in range(LIGHT_LIMIT):
        world.add_light(Light("point", (1.0, 1.0, 1.0)))
    with pytest.raises(LuxelError, match=f"takes {LIGHT_LIMIT} lights"):
        world.add_light(Light("point", (1.0, 1.0, 1.0)))
    assert len(world.lights) == LIGHT_LIMIT


def test_a_lightmap_keeps_its_scene() -> None:
    """The room that it was baked for stays, and so does the bake; another method may move the box."""
    world = make("lightmap", texel_target=1024, surfel_target=512, rays_per_texel=64)
    scene, state = world.scene.host, world.cache("lightmap").state
    with pytest.raises(
        LuxelError, match="moving object 'small-box' is an edit of a scene that a lightmap was baked for"
    ):
        world.place(2, translation(0.0, 0.1, 0.0))
    assert world.scene.host is scene and world.cache("lightmap").state is state
    world.switch_method("none")
    world.tick(0.0, [])
    world.place(2, translation(0.0, 0.1, 0.0))
    assert world.scene.host is not scene and world.placed == {2}


def shiny() -> SceneData:
    """Return a white mirror in a white sky: white where gloss is seen, black where it is not."""
    mirror = quad((-9, -9, 0), (9, -9, 0), (9, 9, 0), (-9, 9, 0), 0)
    metal = Material(name="metal", base_color=(1.0, 1.0, 1.0), metallic=1.0, roughness=0.0)
    return SceneData("shiny", [Object("mirror", [mirror])], [metal], sky=Sky((1.0, 1.0, 1.0)))


def seen_by(world: World, method: str) -> float:
    view = CameraView(world.cache(method), (16, 16))
    view.look(Camera((0.0, 0.0, 5.0), (0.0, 0.0, 0.0), fov=40.0))
    return float(view.layers().image().mean())


def test_full_materials_are_shown_as_long_as_all_methods_in_view_can() -> None:
    world = World(shiny(), Choice("path"), materials="full")
    world.tick(0.0, [])
    assert seen_by(world, "path") == pytest.approx(1.0, abs=1e-3) and describe(world).materials == "full"
    structure = world.structure
    assert seen_by(world, "none") == 0.0  # beside the split: both sides are one scene
    assert seen_by(world, "path") == 0.0 and describe(world).materials == "diffuse"
    assert world.structure > structure
    world.tick(0.0, [])
    assert seen_by(world, "path") == pytest.approx(1.0, abs=1e-3)
    world.switch_method("none")
    world.tick(0.0, ["path"])
    assert seen_by(world, "none") == 0.0
    world.switch_method("path")
    world.tick(0.0, [])
    world.set_material("metal", roughness=0.3)
    assert seen_by(world, "path") > 0.5


def test_diffuse_materials_stay_so_whatever_the_method() -> None:
    world = World(shiny(), Choice("path"))
    world.tick(0.0, [])
    assert seen_by(world, "path") == 0.0 and describe(world).materials == "diffuse"
    assert describe(make("path")).materials is None
