"""What a live scene once got wrong: each by arithmetic, or by one sentence where it cannot be."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest

import luxel
from luxel import Camera, Light, LuxelError, Material, Mesh, Object, Renderer, SceneData, Sky, Texture
from luxel.scene.library.shapes import quad
from luxel.scene.model import Node

ABOVE = Camera((0.0, 3.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, -1.0), fov=30.0, name="above")


def floor(size: float = 4.0, **material: Any) -> SceneData:
    """A floor at y = 0 under a sun straight above of 3 W/m^2, seen from above."""
    plane = Object("floor", [quad((-size, 0, size), (size, 0, size), (size, 0, -size), (-size, 0, -size), 0)])
    sun = Light("directional", (3.0, 3.0, 3.0), name="sun")
    return SceneData("floor", [plane], [Material("paint", **material)], lights=[sun], cameras=[ABOVE])


def make(data: SceneData | Any, method: str = "none", **options: Any) -> Renderer:
    return Renderer(data, method, size=(9, 9), device="cpu", **options)


def grey(value: int, alpha: int) -> Texture:
    return Texture(np.full((4, 4, 4), (value, value, value, alpha), np.uint8), srgb=False)


@pytest.mark.parametrize("mode", ["opaque", "mask", "blend"])
def test_a_texture_is_replaced_in_each_alpha_mode(mode: Any) -> None:
    renderer = make(floor(base_color=(1, 1, 1), base_color_texture=grey(51, 255), alpha_mode=mode))
    renderer.run(1)
    np.testing.assert_allclose(renderer.layers().albedo, 0.2, atol=0.01)
    renderer.set_material("paint", base_color_texture=grey(153, 255))
    renderer.run(1)
    np.testing.assert_allclose(renderer.layers().albedo, 0.6, atol=0.01)


def test_a_cut_out_texture_comes_live() -> None:
    renderer = make(floor(base_color=(1, 1, 1), base_color_texture=grey(51, 255), alpha_mode="mask"))
    renderer.set_material("paint", base_color_texture=grey(51, 25))
    renderer.run(1)
    assert not renderer.layers().hit.any()


@pytest.mark.parametrize("scale", [1e-5, 1e-3, 1.0])
def test_a_small_object_may_be_moved(scale: float) -> None:
    """The sun's irradiance on a plate knows no size."""
    data = floor(4.0)
    data.cameras = [Camera((0.0, 3.0 * scale, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, -1.0), fov=30.0)]
    renderer = make(data)
    renderer.move_object("floor", np.diag([scale, scale, scale, 1.0]))
    renderer.run(1)
    assert renderer.layers().hit.all()
    np.testing.assert_allclose(renderer.layers().direct, 3.0, rtol=1e-4)
    with pytest.raises(LuxelError, match="without inverse"):
        renderer.move_object("floor", np.diag([1.0, 1e-13, 1.0, 1.0]))


def test_an_edit_by_another_renderer_does_not_spoil_a_lightmap() -> None:
    baked = make(floor(), "lightmap", params={"texel_target": 256, "surfel_target": 128, "rays_per_texel": 16})
    other = make(baked.scene)
    for act in (
        lambda: other.set_material("paint", base_color=(0.1, 0.1, 0.1)),
        lambda: other.move_object("floor", np.diag([0.5, 0.5, 0.5, 1.0])),
        lambda: other.set_sky(color=(1.0, 1.0, 1.0)),
    ):
        with pytest.raises(LuxelError, match="a scene that a lightmap was baked for"):
            act()
    for renderer in (baked, other):
        renderer.run(1)
        np.testing.assert_allclose(renderer.layers().direct, 3.0, rtol=1e-4)
    del baked
    other.set_material("paint", base_color=(0.1, 0.1, 0.1))
    other.run(1)
    np.testing.assert_allclose(other.layers().albedo, 0.1, rtol=1e-5)


def test_nothing_of_the_held_scene_can_be_written() -> None:
    data = floor()
    data.facts = {"radiance": 2.0}
    data.nodes = [Node("root", None, {"translation": [0.0, 0.0, 0.0]}, np.eye(4))]
    data.objects[0].meshes[0].uv_more = {2: np.zeros((4, 2), np.float32)}
    held = make(data).data
    for act in (
        lambda: held.facts.update(radiance=3.0),
        lambda: held.objects[0].meshes[0].uv_more.clear(),
        lambda: setattr(held.nodes[0], "name", "other"),
        lambda: held.nodes[0].transform["translation"].append(1.0),
        lambda: held.nodes[0].world.fill(2.0),
    ):
        with pytest.raises((LuxelError, ValueError), match="belongs to a renderer|read-only"):
            act()
    free = copy.deepcopy(held)
    free.facts["radiance"], free.nodes[0].name = 4.0, "free"
    free.nodes[0].transform["translation"].append(1.0)
    assert data.facts == {"radiance": 2.0} and data.nodes[0].name == "root"


def test_a_matrix_that_the_owner_writes_into_moves_nothing() -> None:
    data = floor()
    renderer = make(data)
    data.objects[0].to_world[1, 3] = -1.0
    assert renderer.data.objects[0].to_world[1, 3] == 0.0
    renderer.set_material("paint", alpha_mode="blend", alpha=1.0)  # uploads the scene anew
    renderer.run(1)
    # The floor is 3 m below the eye as before; a pixel off the axis sees it where it was.
    assert make(data).data.objects[0].to_world[1, 3] == -1.0
    assert renderer.scene.host.lower[1] == pytest.approx(0.0, abs=1e-6)


BAD = (
    (lambda r: setattr(r, "state", "text"), "state is its own GibsState"),
    (lambda r: setattr(r, "average_direct", "no"), "True or False"),
    (lambda r: r.run(2.5), "no number of frames"),
    (lambda r: r.run(-1), "no number of frames"),
    (lambda r: r.step(camera=np.zeros(3)), "a camera is a luxel.Camera"),
    (lambda r: r.set_time(10**400), "no time"),
    (lambda r: r.set_light_scale(True), "0 or more"),
    (lambda r: r.set_sun(0.0, 20.0, 10**400), "strength"),
    (lambda r: r.set_sun(0.0, 20.0, 1e30), "from 0 to 1e\\+09"),
    (lambda r: r.set_sky(color=(1.0, 1e30, 1.0)), "from 0 to 1e\\+09"),
    (lambda r: r.set_sky(), "changes nothing"),
    (lambda r: r.set_sky(None), r"luxel\.Sky\(\) is no sky"),
    (lambda r: r.move_object(0, 10**400), "finite 4x4 matrix"),
    (lambda r: r.set_params(preset=[]), "no preset"),
    (lambda r: r.set_params(rays_per_surfel=2.5), "takes a whole number, not 2.5"),
    (lambda r: r.set_params(rays_per_surfel=None), "takes a whole number, not None"),
    (lambda r: r.set_params(rays_per_surfel=float("inf")), "takes a whole number, not inf"),
    (lambda r: r.set_params(radius=[1]), "takes a number"),
    (lambda r: r.set_params(fill_bare=2.5), "takes true or false"),
    (lambda r: r.add_light(Light("point", (1, 1, 1), motion=lambda t: 3)), "finite 4x4 matrix"),  # type: ignore[arg-type, return-value]
)


@pytest.mark.parametrize(("act", "words"), BAD)
def test_a_value_of_the_wrong_kind_is_said_in_a_sentence(act: Any, words: str) -> None:
    renderer = BENCH.setdefault("gibs", make(floor(), "gibs", params={"surfel_target": 500}))
    with pytest.raises(LuxelError, match=words) as raised:
        act(renderer)
    assert "\n" not in str(raised.value)
    renderer.run(1)
    np.testing.assert_allclose(renderer.layers().direct, 3.0, rtol=1e-4)


BENCH: dict[str, Renderer] = {}


@pytest.mark.parametrize(
    "given", [{"seed": "a"}, {"seed": None}, {"seed": 1.5}, {"state": 4}, {"method": None}, {"method": 3}]
)
def test_what_a_renderer_is_made_with_is_looked_at(given: dict[str, Any]) -> None:
    with pytest.raises(LuxelError, match="a seed is|a state is|a method is"):
        make(floor(), **given) if "method" not in given else make(floor(), given["method"])


def test_text_takes_text_only() -> None:
    with pytest.raises(LuxelError, match="parameter 'boxes' takes text, not 3"):
        luxel.make_params("ddgi", None, {"boxes": 3})


@pytest.mark.parametrize("name", ["objects", "materials", "lights", "cameras", "flight", "sky", "duration"])
@pytest.mark.parametrize("value", [None, "text", 3 + 1j, [5], object()])
def test_a_scene_is_made_of_records(name: str, value: Any) -> None:
    with pytest.raises(LuxelError, match=f"scene 'floor': {name}") as raised:
        setattr(floor(), name, value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("name", ["objects", "materials", "lights", "cameras"])
def test_what_was_appended_is_looked_at_at_upload(name: str) -> None:
    data = floor()
    getattr(data, name).append(Sky())
    with pytest.raises(LuxelError, match=f"{name} holds something else"):
        make(data)
    data = floor()
    data.objects[0].meshes.append(7)  # type: ignore[arg-type]
    with pytest.raises(LuxelError, match="object 'floor': meshes"):
        make(data)


def test_arrays_have_as_many_columns_as_they_need() -> None:
    for fields in ({"positions": np.zeros((3, 4))}, {"normals": np.zeros((3, 4))}, {"uv": np.zeros((3, 3))}):
        arrays = {"positions": np.zeros((3, 3)), "faces": np.zeros((1, 3), np.uint32), **fields}
        with pytest.raises(LuxelError, match="an array of shape"):
            Mesh(**arrays)  # type: ignore[arg-type]


@pytest.mark.parametrize("motion", [lambda time: 3, lambda: np.eye(4), lambda time: np.full((4, 4), np.nan)])
def test_a_motion_that_is_none_is_refused(motion: Any) -> None:
    data = floor()
    data.objects[0].motion = motion
    with pytest.raises(LuxelError, match="object 'floor': its motion"):
        make(data)
    with pytest.raises(LuxelError, match="camera 'default': its motion"):
        make(floor(), camera=Camera(motion=motion))
