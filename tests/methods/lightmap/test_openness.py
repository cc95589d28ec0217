"""Closed shells: what faces the open is lit, whichever way the triangles wind; the inside of things is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from luxel.methods.lightmap.flatten.faces import find_faces, still_scene
from luxel.render.renderer import Renderer
from luxel.scene import load
from luxel.scene.device import upload
from luxel.scene.library.shapes import box, quad, sphere
from luxel.scene.model import Camera, Light, Material, Object, SceneData, Sky

SMALL = {"texel_target": 2048, "surfel_target": 512, "rays_per_texel": 128, "probe_target": 64}
GREY = [Material("grey", (0.7, 0.7, 0.7)), Material("lamp", (0.5, 0.5, 0.5), emission=(10.0, 10.0, 10.0))]
GROUND = Object("ground", [quad((-4, 0, 4), (4, 0, 4), (4, 0, -4), (-4, 0, -4), 0)])
LAMP = Object("lamp", [quad((-0.3, 0.95, -0.3), (0.3, 0.95, -0.3), (0.3, 0.95, 0.3), (-0.3, 0.95, 0.3), 1)])
INSIDE = Camera((0.0, 0.0, 0.95), (0.0, 0.0, 0.0), fov=80.0)


def reverse(thing: Object) -> Object:
    return replace(thing, meshes=[replace(mesh, faces=mesh.faces[:, ::-1].copy()) for mesh in thing.meshes])


def lit_sides(data: SceneData, name: str) -> str:
    """Return which sides of an object carry light: "front", "back" or "both", by its triangles' winding."""
    scene = upload(data)
    faces = find_faces(scene, still_scene(scene))
    of_object = faces.unit // 2 == [thing.name for thing in data.objects].index(name) + 1
    backs = faces.back[of_object]
    mesh = data.objects[[thing.name for thing in data.objects].index(name)].meshes[0]
    for side in set(backs.tolist()):
        assert (backs == side).sum() == len(mesh.faces), "all of a side, or nothing"
    assert len(backs), "one side at least"
    return "both" if backs.any() and not backs.all() else "back" if backs.all() else "front"


def room(*others: Object, outward: bool = True, **options: object) -> SceneData:
    settings: dict = {"cameras": [INSIDE], **options}
    walls = Object("walls", [box((-1, -1, -1), (1, 1, 1), 0, inward=not outward)])
    return SceneData("room", [walls, *others], GREY, **settings)


def yard(*others: Object, **options: object) -> SceneData:
    settings: dict = {"cameras": [Camera((2.0, 3.0, 6.0), (0.0, 0.7, 0.0))], "sky": Sky((1.0, 1.0, 1.0)), **options}
    return SceneData("yard", [GROUND, *others], GREY, **settings)


def crate(inward: bool, name: str = "crate", x: float = 0.0) -> Object:
    return Object(name, [box((x - 0.7, 0.0, -0.7), (x + 0.7, 2.0, 0.7), 0, inward=inward)])


def test_boxes_of_reversed_winding_are_lit_as_others_are(cornell: Renderer) -> None:
    data = load("cornell-box")
    data.materials = [replace(material, reflect_back=True) for material in data.materials]
    data.objects[1:3] = [reverse(thing) for thing in data.objects[1:3]]
    renderer = Renderer(data, "lightmap", dict(SMALL), size=(64, 64), seed=1)
    renderer.run(24)
    found, wanted = renderer.layers().indirect, cornell.layers().indirect
    assert found.mean() == pytest.approx(wanted.mean(), rel=0.01)
    assert np.abs(found - wanted).mean() < 0.05 * wanted.mean()
    assert lit_sides(data, data.objects[1].name) == "back"


@pytest.mark.parametrize("inward", [False, True])
def test_a_crate_in_a_yard_is_lit_on_its_outside(inward: bool) -> None:
    for other in (False, True):
        data = yard(crate(inward), crate(other, "other", 2.2))
        assert lit_sides(data, "crate") == ("back" if inward else "front")


@pytest.mark.parametrize("outward", [False, True])
@pytest.mark.parametrize("seen_by", ["camera", "panel", "bulb"])
def test_a_room_is_lit_on_its_inside(outward: bool, seen_by: str) -> None:
    lights = [Light("point", (1.0, 1.0, 1.0))] if seen_by == "bulb" else []
    others = [LAMP] if seen_by == "panel" else []
    data = room(*others, outward=outward, lights=lights, cameras=[INSIDE] if seen_by == "camera" else [])
    assert lit_sides(data, "walls") == ("back" if outward else "front")


def test_what_stands_in_a_reversed_room_may_be_reversed_too() -> None:
    ball = Object("ball", [sphere((0.0, -0.6, 0.0), 0.3, 0, rings=12, sectors=24)])
    hidden = Object("hidden", [box((-0.1, -0.9, -0.6), (0.1, -0.7, -0.5), 0, inward=True)])
    data = room(LAMP, reverse(ball), hidden)
    assert [lit_sides(data, name) for name in ("walls", "ball", "hidden")] == ["back"] * 3


def test_a_house_that_a_camera_looks_at_from_both_sides_is_lit_on_both() -> None:
    data = yard(crate(inward=False), cameras=[Camera((0.0, 1.0, 0.0), (0.0, 1.0, -1.0))])
    assert lit_sides(data, "crate") == "both"


def test_a_camera_outside_a_room_leaves_its_inside_lit() -> None:
    data = room(LAMP, outward=False, cameras=[Camera((0.0, 0.0, 5.0), (0.0, 0.0, 0.0))])
    assert lit_sides(data, "walls") == "both"


def test_nothing_is_lit_within_things_that_stand_in_one_another() -> None:
    crates = [crate(inward, f"crate {x}", x) for x, inward in ((-0.5, False), (0.0, True), (0.5, False))]
    data = yard(*crates)
    assert [lit_sides(data, thing.name) for thing in crates] == ["front", "back", "front"]


@pytest.mark.parametrize("name", ["cornell-box", "two-rooms", "attic", "atrium", "furnace", "moving"])
def test_the_winding_of_built_in_scenes_stands(name: str) -> None:
    data = load(name)
    scene = upload(data)
    faces = find_faces(scene, still_scene(scene))
    fronts = faces.prim[~faces.back]
    assert set(faces.prim[faces.back]) <= set(fronts)
