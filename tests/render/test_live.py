"""Edits of a scene under way: each ends where arithmetic says it must, and what cannot be changes nothing."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import luxel
from luxel import Camera, Light, LuxelError, Material, Mesh, Object, Renderer, SceneData, Sky, Texture
from luxel.kernels.camera import camera_axes
from luxel.scene.library.shapes import quad

SIZE = (33, 33)
ABOVE = Camera((0.0, 3.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, -1.0), fov=50.0, name="above")
LAMP = Light("point", (8.0, 4.0, 2.0), position=(0.0, 2.0, 0.0), name="lamp")


def floor(**changes: Any) -> SceneData:
    """A floor of 8 x 8 m at y = 0, seen from above, under one lamp 2 m up."""
    plane = Object("floor", [quad((-4, 0, 4), (4, 0, 4), (4, 0, -4), (-4, 0, -4), 0)])
    data = SceneData("floor", [plane], [Material("paint", (0.5, 0.5, 0.5))], lights=[replace(LAMP)], cameras=[ABOVE])
    return replace(data, **changes)


def box(albedo: float, emission: float) -> SceneData:
    """A closed cube that glows inside: the radiance is emission / (1 - albedo) everywhere."""
    walls = [
        quad((-1, -1, 1), (1, -1, 1), (1, -1, -1), (-1, -1, -1), 0),
        quad((-1, 1, -1), (1, 1, -1), (1, 1, 1), (-1, 1, 1), 0),
        quad((-1, -1, -1), (1, -1, -1), (1, 1, -1), (-1, 1, -1), 0),
        quad((1, -1, 1), (-1, -1, 1), (-1, 1, 1), (1, 1, 1), 0),
        quad((-1, -1, 1), (-1, -1, -1), (-1, 1, -1), (-1, 1, 1), 0),
        quad((1, -1, -1), (1, -1, 1), (1, 1, 1), (1, 1, -1), 0),
    ]
    material = Material("wall", (albedo, albedo, albedo), emission=(emission, emission, emission))
    return SceneData("box", [Object("box", walls)], [material], cameras=[Camera((0, 0, 0.9), (0, 0, 0))])


def make(data: SceneData, method: str = "none", **options: Any) -> Renderer:
    return Renderer(data, method, size=SIZE, **options)


def ground(height: float = 0.0) -> np.ndarray:
    """Return where the pixels' middles meet the plane y = `height`, (33, 33, 3)."""
    eye, right, up, forward = camera_axes(ABOVE)
    half = np.tan(np.radians(ABOVE.fov) / 2.0)
    across = (np.arange(33) + 0.5) * 2.0 / 33 - 1.0
    rays = forward + half * (across[None, :, None] * right - across[:, None, None] * up)
    return eye + rays * ((height - eye[1]) / rays[..., 1:2])


def lit_by(color: Any, position: Any, height: float = 0.0) -> np.ndarray:
    """E = I cos / r^2 of a point light at every pixel of the plane y = `height`."""
    offset = np.asarray(position) - ground(height)
    squared = (offset**2).sum(axis=2, keepdims=True)
    return np.asarray(color) * offset[..., 1:2] / squared**1.5


def direct_after(renderer: Renderer, frames: int = 1) -> np.ndarray:
    renderer.run(frames)
    return renderer.layers().direct


# ----------------------------------------------------------------------------------- light


def test_a_light_takes_new_values_at_once() -> None:
    """One frame after the edit nothing is left of what the running mean held."""
    renderer = make(floor())
    np.testing.assert_allclose(direct_after(renderer, 20), lit_by(LAMP.color, LAMP.position), rtol=1e-4)
    renderer.set_light("lamp", color=(1.0, 2.0, 3.0), position=(0.5, 1.5, -0.2))
    np.testing.assert_allclose(direct_after(renderer), lit_by((1.0, 2.0, 3.0), (0.5, 1.5, -0.2)), rtol=1e-4)
    renderer.set_light(0, color=(0.0, 0.0, 0.0))
    assert not direct_after(renderer).any()


def test_lights_are_added_and_removed() -> None:
    renderer = make(floor())
    renderer.run(3)
    assert renderer.add_light(Light("point", (1.0, 1.0, 1.0), position=(1.0, 1.0, 0.0), name="second")) == 1
    first, second = lit_by(LAMP.color, LAMP.position), lit_by((1.0, 1.0, 1.0), (1.0, 1.0, 0.0))
    np.testing.assert_allclose(direct_after(renderer), first + second, rtol=1e-4)
    renderer.remove_light("lamp")
    np.testing.assert_allclose(direct_after(renderer), second, rtol=1e-4)
    renderer.remove_light(0)
    assert not direct_after(renderer).any()
    # More than get a ray each: they are sampled, and all of one place and power are known exactly.
    for _ in range(10):
        renderer.add_light(replace(LAMP))
    np.testing.assert_allclose(direct_after(renderer), 10.0 * first, rtol=1e-3)


def test_the_sun_stands_where_it_is_put() -> None:
    """Elevation 30 degrees: half of its strength on the floor."""
    renderer = make(floor(lights=[Light("directional", (4.0, 2.0, 1.0), direction=(0.0, -1.0, 0.0))]))
    renderer.run(2)
    renderer.set_sun(90.0, 30.0, 8.0)
    np.testing.assert_allclose(direct_after(renderer), np.broadcast_to((4.0, 2.0, 1.0), (33, 33, 3)), rtol=1e-4)
    renderer.set_sun(0.0, 90.0)
    np.testing.assert_allclose(direct_after(renderer), np.broadcast_to((8.0, 4.0, 2.0), (33, 33, 3)), rtol=1e-4)
    renderer.set_sun(0.0, 90.0, diameter=60.0)
    renderer.run(30)
    np.testing.assert_allclose(direct_after(renderer).mean(axis=(0, 1)), (8.0, 4.0, 2.0), rtol=2e-3)
    renderer.set_sun(0.0, 60.0)
    assert renderer.data.lights[0].angular_diameter == 60.0, "the width stays"


def test_a_sky_over_an_open_floor_gives_pi_times_its_radiance() -> None:
    renderer = make(floor(lights=[]), "path")
    renderer.run(3)
    assert not renderer.image().any()
    image = np.full((4, 8, 3), 2.0, np.float32)
    for color, picture, radiance in (((1.0, 2.0, 3.0), None, (1.0, 2.0, 3.0)), ((0.5, 0.5, 0.5), image, (1, 1, 1))):
        renderer.set_sky(color=color, image=picture)
        renderer.run(2)
        wanted = np.broadcast_to(np.pi * np.asarray(radiance), (33, 33, 3))
        np.testing.assert_allclose(renderer.layers().indirect, wanted, rtol=1e-3)
    renderer.set_sky(Sky())
    renderer.run(1)
    assert not renderer.image().any()


def test_the_scale_of_light_outlives_other_edits() -> None:
    renderer = make(floor())
    renderer.set_light_scale(0.5)
    renderer.set_light("lamp", color=(1.0, 1.0, 1.0))
    renderer.set_material("paint", base_color=(0.1, 0.1, 0.1))
    renderer.move_object("floor", np.eye(4))
    np.testing.assert_allclose(direct_after(renderer), 0.5 * lit_by((1, 1, 1), LAMP.position), rtol=1e-4)
    assert renderer.light_scale == 0.5


# ----------------------------------------------------------------------------------- materials


def test_a_material_takes_new_values_at_once() -> None:
    renderer = make(floor())
    renderer.run(20)
    renderer.set_material("paint", base_color=(0.1, 0.2, 0.3), emission=(4.0, 5.0, 6.0))
    renderer.run(1)
    layers = renderer.layers()
    np.testing.assert_allclose(layers.albedo, np.broadcast_to((0.1, 0.2, 0.3), (33, 33, 3)), atol=1e-6)
    np.testing.assert_allclose(layers.emission, np.broadcast_to((4.0, 5.0, 6.0), (33, 33, 3)), rtol=1e-6)
    np.testing.assert_allclose(layers.direct, lit_by(LAMP.color, LAMP.position), rtol=1e-3)
    renderer.set_material(0, metallic=0.5, emission=(0.0, 0.0, 0.0))
    renderer.run(1)
    # A half metal: half of its base colour is diffuse.
    np.testing.assert_allclose(renderer.layers().albedo[16, 16], (0.05, 0.1, 0.15), atol=1e-6)
    assert not renderer.layers().emission.any()


def test_a_texture_comes_and_goes() -> None:
    renderer = make(floor())
    renderer.run(2)
    green = Texture(np.broadcast_to(np.array((0, 255, 0), np.uint8), (2, 2, 3)).copy())
    mesh = renderer.data.objects[0].meshes[0]
    assert mesh.uv is None or len(mesh.uv) == 4
    renderer.set_material("paint", base_color=(1.0, 1.0, 1.0), base_color_texture=green)
    renderer.run(1)
    np.testing.assert_allclose(renderer.layers().albedo, np.broadcast_to((0.0, 1.0, 0.0), (33, 33, 3)), atol=0.01)
    renderer.set_material("paint", base_color_texture=None)
    renderer.run(1)
    np.testing.assert_allclose(renderer.layers().albedo, 1.0, atol=1e-6)


@pytest.mark.parametrize(("method", "frames"), [("path", 200), ("gibs", 120), ("ddgi", 120)])
def test_a_furnace_settles_at_its_new_value(method: str, frames: int) -> None:
    """L = emission / (1 - albedo), after a change of both."""
    settings = {"surfel_target": 2000} if method == "gibs" else None
    renderer = make(box(0.5, 1.0), method, params=settings)
    renderer.run(frames)
    assert renderer.image().mean() == pytest.approx(1.0 / (1.0 - 0.5), rel=0.05)
    renderer.set_material("wall", base_color=(0.25, 0.25, 0.25), emission=(3.0, 3.0, 3.0))
    renderer.run(frames)
    assert renderer.image().mean() == pytest.approx(3.0 / (1.0 - 0.25), rel=0.05)


def test_something_opaque_becomes_see_through() -> None:
    """Alpha 0 lets every ray pass, so that the floor is gone and the sky is seen; half of alpha is above the cut."""
    renderer = make(floor(sky=Sky((1.0, 1.0, 1.0))))
    renderer.run(2)
    assert renderer.layers().hit.all()
    renderer.set_material("paint", alpha_mode="mask", alpha=0.0)
    renderer.run(1)
    assert not renderer.layers().hit.any()
    recordings = renderer.compilations
    renderer.set_material("paint", alpha=0.6)
    renderer.run(2)
    assert renderer.layers().hit.all() and renderer.compilations == recordings


def test_a_pane_fades_live() -> None:
    """A floor that glows and lets 1 - alpha of the sky behind it pass: alpha L + (1 - alpha) L_sky."""
    veil = Material("paint", (0.0, 0.0, 0.0), emission=(4.0, 4.0, 4.0), alpha=0.5, alpha_mode="blend")
    renderer = make(floor(materials=[veil], lights=[], sky=Sky((1.0, 1.0, 1.0))))
    renderer.run(150)
    assert renderer.image().mean() == pytest.approx(0.5 * 4.0 + 0.5 * 1.0, rel=0.02)
    recordings = renderer.compilations
    renderer.set_material("paint", alpha=0.25)
    renderer.run(150)
    assert renderer.image().mean() == pytest.approx(0.25 * 4.0 + 0.75 * 1.0, rel=0.02)
    assert renderer.compilations == recordings
    renderer.set_material("paint", alpha_mode="opaque")
    renderer.run(2)
    assert renderer.image().mean() == pytest.approx(4.0, rel=1e-5)


# ----------------------------------------------------------------------------------- objects, time, camera


def lifted(height: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[1, 3] = height
    return matrix


@pytest.mark.parametrize("first", [False, True])
def test_a_moved_object_is_lit_where_it_is(first: bool) -> None:
    """The floor 1 m higher is 1 m under the lamp: E = I there, four times what it was."""
    data = floor()
    renderer = make(data)
    renderer.run(5)
    if not first:
        renderer.move_object("floor", lifted(0.25))
        renderer.run(5)
    renderer.move_object("floor", lifted(1.0))
    direct = direct_after(renderer)
    np.testing.assert_allclose(direct, lit_by(LAMP.color, LAMP.position, 1.0), rtol=1e-3)
    np.testing.assert_allclose(direct[16, 16], LAMP.color, rtol=1e-3)
    np.testing.assert_array_equal(data.objects[0].to_world, np.eye(4))


def test_a_moved_box_is_seen_as_in_a_scene_that_has_it_there() -> None:
    """The truth of the edited scene is a path tracer's picture of a scene built with the box elsewhere."""
    data, elsewhere = luxel.load("cornell-box"), luxel.load("cornell-box")
    moved = lifted(0.4) @ data.objects[2].to_world
    elsewhere.objects[2].to_world = moved
    truth = luxel.render_truth(elsewhere, size=SIZE, spp=64).layers
    renderer = make(data, "path")
    renderer.run(2)
    renderer.move_object(2, moved)
    renderer.run(64)
    layers = renderer.layers()
    assert (np.abs(layers.albedo - truth.albedo).max(axis=2) > 1e-3).mean() < 0.02  # rounding at edges
    for ours, theirs in ((layers.direct, truth.direct), (layers.indirect, truth.indirect)):
        assert ours.mean() == pytest.approx(theirs.mean(), rel=0.04)
        assert np.abs(ours - theirs).mean() < 0.25 * theirs.mean()


def test_moves_after_the_first_record_nothing_and_are_followed() -> None:
    renderer = make(floor(), "gibs", params={"surfel_target": 500})
    renderer.move_object("floor", lifted(0.1))
    renderer.run(10)
    recordings, surfels = renderer.compilations, renderer.cache()["surfel_count"]
    for step in range(8):
        renderer.move_object("floor", lifted(0.1 + 0.01 * step))
        renderer.run(1)
    assert renderer.compilations == recordings
    assert renderer.cache()["surfel_count"] >= surfels > 0


def test_time_goes_where_it_is_set() -> None:
    def rise(seconds: float) -> np.ndarray:
        return lifted(0.5 * seconds)

    data = floor()
    data.objects[0].motion, data.duration = rise, 2.0
    renderer = make(data)
    renderer.set_time(2.0)
    np.testing.assert_allclose(direct_after(renderer), lit_by(LAMP.color, LAMP.position, 1.0), rtol=1e-3)
    renderer.time = 0.0
    np.testing.assert_allclose(direct_after(renderer), lit_by(LAMP.color, LAMP.position), rtol=1e-3)


def test_the_camera_is_set_by_call_name_and_assignment() -> None:
    away = Camera((0.0, 3.0, 0.0), (0.0, 6.0, 0.0), (0.0, 0.0, 1.0), fov=30.0, name="up")
    renderer = make(floor(cameras=[ABOVE, away]))
    seen = []
    for act in (
        lambda: None,
        lambda: renderer.set_camera("up"),
        lambda: renderer.set_camera(ABOVE),
        lambda: setattr(renderer, "camera", away),
    ):
        act()
        renderer.run(1)
        seen.append(bool(renderer.layers().hit.any()))
    assert seen == [True, False, True, False]
    # A camera of its own values is the same view, and one that its owner has changed since is another.
    own = replace(ABOVE)
    renderer.step(camera=own)
    own.eye, own.target = (0.0, 3.0, 0.0), (0.0, 6.0, 0.001)
    assert renderer.camera.target == ABOVE.target
    renderer.step(camera=own)
    assert not renderer.layers().hit.any()


def test_a_view_that_is_set_again_stays_still() -> None:
    renderer = make(box(0.5, 1.0))
    for _ in range(30):
        renderer.step(camera=Camera((0, 0, 0.9), (0, 0, 0)))
    assert renderer._view.still_frames == 29


def test_parameters_are_set_by_call_and_assignment() -> None:
    renderer = make(box(0.5, 1.0), "gibs", params={"surfel_target": 500})
    renderer.run(3)
    assert renderer.set_params(rays_per_surfel=2) and renderer.params.rays_per_surfel == 2
    assert renderer.params.surfel_target == 500
    assert not renderer.set_params({"surfel_target": 800}) and renderer.frame_index == 0
    renderer.params = replace(renderer.params, rays_per_surfel=3)
    assert (renderer.params.rays_per_surfel, renderer.params.surfel_target) == (3, 800)
    renderer.run(2)
    assert np.isfinite(renderer.image()).all()
    renderer.set_params(preset="ekberg")
    assert renderer.params == luxel.make_params("gibs", "ekberg")


# ----------------------------------------------------------------------------------- compilations


@pytest.mark.parametrize("method", ["none", "gibs", "ddgi"])
def test_a_changed_value_records_nothing(method: str) -> None:
    """From the first edit on, lamps and glow that go out and come back included."""
    data = luxel.load("cornell-box")
    data.lights, data.sky = [replace(LAMP, position=(0.0, 0.0, 0.5))], Sky((0.1, 0.1, 0.1))
    glow = next(index for index, item in enumerate(data.materials) if max(item.emission) > 0.0)
    renderer = make(data, method)
    renderer.run(8)
    recordings = renderer.compilations
    for act in (
        lambda: renderer.set_light("lamp", color=(1.0, 2.0, 3.0)),
        lambda: renderer.set_light("lamp", color=(0.0, 0.0, 0.0)),
        lambda: renderer.set_light("lamp", position=(0.1, 0.2, 0.3), color=(1.0, 1.0, 1.0)),
        lambda: renderer.set_material(0, base_color=(0.2, 0.3, 0.4)),
        lambda: renderer.set_material(glow, emission=(0.0, 0.0, 0.0)),
        lambda: renderer.set_material(glow, emission=(1.0, 2.0, 3.0)),
        lambda: renderer.set_sky(color=(0.5, 0.4, 0.3)),
        lambda: renderer.set_sky(color=(0.0, 0.0, 0.0)),
        lambda: renderer.set_light_scale(2.0),
    ):
        act()
        renderer.run(2)
    assert renderer.compilations == recordings


# ----------------------------------------------------------------------------------- what cannot be


BAD = (
    ("set_light", ("lamp",), {"kind": "area"}, "one of directional, point, spot"),
    ("set_light", ("lamp",), {"color": (1.0, -1.0, 0.0)}, "0 or more"),
    ("set_light", ("lamp",), {"color": (1.0, float("nan"), 0.0)}, "0 or more"),
    ("set_light", ("lamp",), {"colour": (1.0, 1.0, 1.0)}, "did you mean 'color'"),
    ("set_light", ("lamp",), {"kind": "spot", "direction": (0.0, 0.0, 0.0)}, "direction"),
    ("set_light", ("lamb",), {}, "did you mean 'lamp'"),
    ("set_light", (7,), {}, "no light 7"),
    ("set_light", (-1,), {}, "no light -1"),
    ("set_light", (1.5,), {}, "index or its name"),
    ("add_light", ("lamp",), {}, "no light: give a luxel.Light"),
    ("remove_light", (3,), {}, "no light 3"),
    ("set_sun", (0.0, 120.0), {}, "from -90 to 90"),
    ("set_sun", (float("nan"), 20.0), {}, "azimuth"),
    ("set_sun", (0.0, 20.0, -1.0), {}, "from 0 to"),
    ("set_sun", (0.0, 20.0, 1.0, 91.0), {}, "from 0 to 90"),
    ("set_sun", (0.0, 20.0), {"diameter": float("nan")}, "diameter"),
    ("set_light", ("lamp",), {"angular_diameter": -1.0}, "degrees from 0 to 90"),
    ("set_sky", (), {"color": (-1.0, 0.0, 0.0)}, "from 0 to"),
    ("set_sky", (), {"image": np.full((2, 4, 3), np.nan, np.float32)}, "NaN or infinite"),
    ("set_sky", (), {"image": np.zeros((2, 4), np.float32)}, r"\(H, W, 3\)"),
    ("set_sky", ("blue",), {}, "luxel.Sky"),
    ("set_sky", (), {"turn": 3.0}, "has no field 'turn'"),
    ("set_material", ("paint",), {"base_color": (2.0, 2.0, 2.0)}, "from 0 to 1"),
    ("set_material", ("paint",), {"emission": (-1.0, 0.0, 0.0)}, "0 or more"),
    ("set_material", ("paint",), {"roughness": 1.5}, "from 0 to 1"),
    ("set_material", ("paint",), {"base_color_texture": np.ones((2, 2, 3))}, "luxel.Texture"),
    ("set_material", ("paint",), {"gloss": 1.0}, "has no field 'gloss'"),
    ("set_material", (1,), {}, "no material 1"),
    ("move_object", ("floor", np.zeros((4, 4))), {}, "without inverse"),
    ("move_object", ("floor", np.eye(3)), {}, "finite 4x4 matrix"),
    ("move_object", ("floor", np.full((4, 4), np.nan)), {}, "finite 4x4 matrix"),
    ("move_object", ("flor", np.eye(4)), {}, "did you mean 'floor'"),
    ("set_camera", (Camera((0, 1, 0), (0, 1, 0)),), {}, "looks nowhere"),
    ("set_camera", ("below",), {}, "no camera 'below'"),
    ("set_camera", (3,), {}, "no camera 3"),
    ("set_camera", (3.5,), {}, "luxel.Camera"),
    ("set_time", (float("nan"),), {}, "no time"),
    ("set_time", (None,), {}, "no time"),
    ("set_light_scale", (None,), {}, "0 or more"),
    ("set_sun", ("noon", 20.0), {}, "azimuth"),
    ("set_light_scale", (-1.0,), {}, "0 or more"),
    ("set_light_scale", (float("nan"),), {}, "0 or more"),
    ("set_params", (), {"no_such": 3}, "no_such"),
    ("set_params", (3,), {}, "its own Params"),
    ("set_params", (), {"preset": "none"}, "no preset 'none'"),
)


@pytest.mark.parametrize(("call", "given", "fields", "words"), BAD)
def test_what_cannot_be_is_said_in_a_sentence_and_changes_nothing(
    call: str, given: tuple[Any, ...], fields: dict[str, Any], words: str
) -> None:
    renderer = BENCH.setdefault("floor", make(floor()))
    before = direct_after(renderer, 2)
    with pytest.raises(LuxelError, match=words) as raised:
        getattr(renderer, call)(*given, **fields)
    assert "\n" not in str(raised.value)
    np.testing.assert_allclose(direct_after(renderer), before, rtol=1e-5)
    np.testing.assert_allclose(before, lit_by(LAMP.color, LAMP.position), rtol=1e-4)


BENCH: dict[str, Renderer] = {}
"""One renderer for all that is refused: it must come out of each as it was."""


def test_a_method_takes_its_own_parameters_only() -> None:
    with pytest.raises(LuxelError, match="'ddgi' takes a dict or its own Params, not GibsParams"):
        make(floor(), "ddgi", params=luxel.make_params("gibs"))


def test_a_deforming_object_is_not_moved_by_hand() -> None:
    data = floor()
    mesh = data.objects[0].meshes[0]
    data.objects[0].deform = lambda _: [(mesh.positions, mesh.normals)]
    with pytest.raises(LuxelError, match="deforms"):
        make(data).move_object("floor", lifted(1.0))


# ----------------------------------------------------------------------------------- plain assignments


def assign(target: Any, name: str, value: Any) -> None:
    setattr(target, name, value)


ASSIGNED = (
    (lambda r: assign(r, "scene", floor()), "cannot be assigned"),
    (lambda r: assign(r, "size", (8, 8)), "nothing that it has"),
    (lambda r: assign(r, "film", None), "settled when it is made"),
    (lambda r: assign(r, "method", "gibs"), "cannot be assigned"),
    (lambda r: assign(r, "exposure", 2.0), "nothing that it has"),
    (lambda r: assign(r.params, "surfel_target", 3), r"set_params\(surfel_target=3\)"),
    (lambda r: assign(r.camera, "fov", 20.0), "call set_camera"),
    (lambda r: assign(r.scene.host, "data", floor()), "keeps its data"),
    (lambda r: assign(r.scene.host.data, "lights", []), "call set_light, add_light"),
    (lambda r: assign(r.data.lights[0], "color", (1, 1, 1)), "light 'lamp' .* call set_light"),
    (lambda r: assign(r.data.materials[0], "emission", (1, 1, 1)), "call set_material"),
    (lambda r: assign(r.data.sky, "color", (1, 1, 1)), "call set_sky"),
    (lambda r: assign(r.data.objects[0], "to_world", np.eye(4)), "call move_object"),
    (lambda r: assign(r.data.objects[0].meshes[0], "material", 0), "make a new renderer"),
    (lambda r: r.data.lights.append(LAMP), "cannot be changed"),
    (lambda r: r.data.objects.clear(), "cannot be changed"),
    (lambda r: r.data.lights.__setitem__(0, LAMP), "cannot be changed"),
)


@pytest.mark.parametrize(("act", "words"), ASSIGNED)
def test_an_assignment_that_would_be_ignored_says_what_to_call(act: Any, words: str) -> None:
    renderer = BENCH.setdefault("gibs", make(floor(), "gibs", params={"surfel_target": 500}))
    with pytest.raises(LuxelError, match=words) as raised:
        act(renderer)
    assert "\n" not in str(raised.value)


def test_arrays_of_the_held_scene_cannot_be_written() -> None:
    renderer = make(floor())
    with pytest.raises(ValueError, match="read-only"):
        renderer.data.objects[0].meshes[0].positions[0] = 3.0


def test_the_owners_scene_stays_free_and_may_be_uploaded_again() -> None:
    data = floor()
    renderer = make(data)
    before = direct_after(renderer)
    data.lights[0].color = (1.0, 1.0, 1.0)
    data.lights.append(replace(LAMP, color=(1.0, 1.0, 1.0)))
    np.testing.assert_allclose(direct_after(renderer), before, rtol=1e-5)
    renderer.set_light("lamp", color=(3.0, 3.0, 3.0))
    assert data.lights[0].color == (1.0, 1.0, 1.0)
    np.testing.assert_allclose(direct_after(make(data)), 2.0 * lit_by((1, 1, 1), LAMP.position), rtol=1e-4)


@pytest.mark.parametrize("make_copy", [copy.deepcopy, lambda data: pickle.loads(pickle.dumps(data))])
def test_a_copy_of_the_held_scene_is_free(make_copy: Any) -> None:
    renderer = make(floor(), "gibs")
    free = make_copy(renderer.data)
    free.lights[0].color = (1.0, 1.0, 1.0)
    free.lights.append(LAMP)
    free.objects[0].meshes[0].positions[0] += 0.0
    assert make_copy(renderer.params) == renderer.params
    assert len(renderer.data.lights) == 1


def test_meshes_and_images_that_are_shared_stay_shared() -> None:
    mesh = quad((-4, 0, 4), (4, 0, 4), (4, 0, -4), (-4, 0, -4), 0)
    image = np.full((2, 2, 3), 128, np.uint8)
    materials = [Material("one", base_color_texture=Texture(image)), Material("two", base_color_texture=Texture(image))]
    objects = [Object("a", [mesh]), Object("b", [mesh], lifted(-1.0))]
    held = make(SceneData("shared", objects, materials, cameras=[ABOVE], lights=[LAMP])).data
    assert held.objects[0].meshes[0] is held.objects[1].meshes[0]
    first, second = (material.base_color_texture for material in held.materials)
    assert first is not None and second is not None and first.image is second.image
    assert isinstance(held.objects[0].meshes[0], Mesh)


# ----------------------------------------------------------------------------------- several renderers, bakes


def test_renderers_of_one_scene_see_each_others_edits() -> None:
    first = make(floor())
    second = Renderer(first.scene, "none", size=SIZE)
    for renderer in (first, second):
        renderer.run(10)
    first.set_light("lamp", color=(1.0, 1.0, 1.0))
    np.testing.assert_allclose(direct_after(second), lit_by((1, 1, 1), LAMP.position), rtol=1e-4)
    second.move_object("floor", lifted(1.0))
    np.testing.assert_allclose(direct_after(first), lit_by((1, 1, 1), LAMP.position, 1.0), rtol=1e-3)


def test_a_lightmap_takes_new_light_and_refuses_what_it_was_not_baked_for() -> None:
    settings = {"texel_target": 1024, "surfel_target": 512, "rays_per_texel": 64}
    data = box(0.5, 1.0)
    renderer = make(data, "lightmap", params=settings)
    renderer.run(60)
    settled = renderer.layers().indirect.mean()
    for act in (
        lambda: renderer.move_object("box", lifted(0.1)),
        lambda: renderer.set_material("wall", base_color=(0.2, 0.2, 0.2)),
        lambda: renderer.set_sky(color=(1.0, 1.0, 1.0)),
    ):
        with pytest.raises(LuxelError, match="an edit of a scene that a lightmap was baked for"):
            act()
    renderer.run(2)
    assert renderer.layers().indirect.mean() == pytest.approx(settled, rel=0.02)
    renderer.set_material("wall", emission=(3.0, 3.0, 3.0))
    renderer.run(60)
    # All light comes from the walls: three times the glow is three times the light.
    assert renderer.layers().indirect.mean() == pytest.approx(3.0 * settled, rel=0.02)
