"""A scene's hash: the same however it is written down, another for whatever changes its light."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from luxel.errors import LuxelError
from luxel.scene import list_scenes, load
from luxel.scene.digest import hash_numbers, hash_scene
from luxel.scene.library.shapes import box, translation
from luxel.scene.model import Camera, Light, Material, Mesh, Object, SceneData, Sky, Texture


def make() -> SceneData:
    """Return a scene that uses most of the model."""
    ticks = np.linspace(0.0, 1.0, 24, dtype=np.float32)
    crate = box((0, 0, 0), (1, 1, 1), 0)
    crate.uv = crate.uv2 = np.stack([ticks, ticks[::-1]], axis=1)[: len(crate.positions)]
    image = np.arange(48, dtype=np.uint8).reshape(4, 4, 3)
    return SceneData(
        "made",
        [Object("crate", [crate]), Object("twin", [crate, box((2, 0, 0), (3, 1, 1), 1)], translation(0, 0, 3.0))],
        [Material("paint", (0.5, 0.4, 0.3), base_color_texture=Texture(image)), Material("lamp", emission=(1, 2, 3))],
        [Light("point", (1.0, 2.0, 3.0), (0.1, 0.2, 0.3))],
        sky=Sky((0.1, 0.2, 0.3)),
    )


def spin(time: float) -> np.ndarray:
    return translation(time, 0.0, 0.0)


def wobble(time: float) -> list[tuple[np.ndarray, np.ndarray | None]]:
    crate = box((0, 0, 0), (1, 1, 1), 0)
    return [(crate.positions * np.float32(1.0 + time), crate.normals)]


CHANGES: dict[str, Callable[[SceneData], Any]] = {
    "uv2": lambda data: setattr(mesh(data), "uv2", mesh(data).uv2 + np.float32(0.01)),
    "uv": lambda data: setattr(mesh(data), "uv", mesh(data).uv * np.float32(0.99)),
    "positions": lambda data: setattr(mesh(data), "positions", mesh(data).positions + np.float32(1e-4)),
    "faces": lambda data: setattr(mesh(data), "faces", mesh(data).faces[:, ::-1]),
    "colors": lambda data: setattr(mesh(data), "colors", np.full((len(mesh(data).positions), 3), 0.5, np.float32)),
    "normals": lambda data: setattr(mesh(data), "normals", mesh(data).positions),
    "material": lambda data: setattr(mesh(data), "material", 1),
    "texel": lambda data: texture(data).image.__setitem__((3, 3, 2), 0),
    "wrap": lambda data: setattr(texture(data), "wrap_u", "clamp"),
    "uv set": lambda data: setattr(texture(data), "uv_set", 1),
    "texture's place": lambda data: move_texture(data.materials[0]),
    "emission": lambda data: setattr(data.materials[1], "emission", (1, 2, 3.01)),
    "back": lambda data: setattr(data.materials[0], "reflect_back", False),
    "alpha": lambda data: setattr(data.materials[0], "alpha_mode", "blend"),
    "matrix": lambda data: setattr(data.objects[1], "to_world", translation(0, 0, 3.001)),
    "objects": lambda data: data.objects.append(data.objects[0]),
    "lights": lambda data: data.lights.append(Light("directional", (1.0, 1.0, 1.0))),
    "light's place": lambda data: setattr(data.lights[0], "position", (0.1, 0.2, 0.31)),
    "light's range": lambda data: setattr(data.lights[0], "range", 7.0),
    "sky": lambda data: setattr(data.sky, "color", (0.1, 0.2, 0.31)),
    "sky image": lambda data: setattr(data.sky, "image", np.ones((2, 4, 3), np.float32)),
    "rotation": lambda data: setattr(data.sky, "rotation", 1.0),
    "hidden": lambda data: setattr(data, "hide_emitters", True),
    "motion": lambda data: setattr(data.objects[0], "motion", lambda time: translation(1.0, 0.0, 0.0)),
    "deform": lambda data: setattr(data.objects[0], "deform", lambda time: wobble(1.0)),
}


def mesh(data: SceneData) -> Any:
    return data.objects[0].meshes[0]


def texture(data: SceneData) -> Texture:
    found = data.materials[0].base_color_texture
    assert found is not None
    return found


def move_texture(material: Material) -> None:
    material.emission_texture, material.base_color_texture = material.base_color_texture, None


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_whatever_changes_the_light_changes_the_hash(change: Callable[[SceneData], Any]) -> None:
    data = make()
    change(data)
    assert hash_scene(data) != hash_scene(make())
    assert hash_scene(make()) == hash_scene(make())


def test_what_changes_no_light_changes_no_hash() -> None:
    data = make()
    data.name, data.duration, data.warnings, data.facts = "other", 5.0, ["so"], {"radiance": 1.0}
    data.cameras, data.flight, data.mitsuba_full = [Camera()], [Camera()], make
    data.objects[0].name = data.materials[0].name = data.lights[0].name = "other"
    assert hash_scene(data) == hash_scene(make())


def test_a_number_is_a_number_however_it_is_held() -> None:
    data = make()
    for item in (part for thing in data.objects for part in thing.meshes):
        item.positions = np.asfortranarray(item.positions.astype(np.float64) + 1e-13)
        item.faces = item.faces.astype(np.int64)
    data.objects[1].to_world = data.objects[1].to_world.astype(np.float32)
    turned = data.objects[1].to_world
    turned[0, 1], turned[1, 0] = -0.0, 1e-17  # what the cosine of a right angle leaves
    data.materials[0].base_color = tuple(np.float32(c) for c in data.materials[0].base_color)  # pyright: ignore
    data.materials[0].reflect_back = np.bool_(True)  # pyright: ignore
    data.materials[1].emission = np.array((1.0, 2.0, 3.0))  # pyright: ignore
    data.lights[0].position = [np.float64(c) for c in data.lights[0].position]  # pyright: ignore
    data.sky.color = (np.float32(0.1), 0.2, 0.3)  # pyright: ignore
    assert hash_scene(data) == hash_scene(make())


def test_a_new_field_at_its_default_changes_no_hash() -> None:
    """A later luxel has more fields; today's classes with one more stand for it."""
    plain = make()
    later = []
    for value in (plain, plain.materials[0], plain.lights[0], mesh(plain), plain.objects[0]):
        kind = type(value)
        grown = dataclasses.make_dataclass(
            kind.__name__, [("invented", float, dataclasses.field(default=0.5))], bases=(kind,), kw_only=True
        )
        later.append(grown(**{item.name: getattr(value, item.name) for item in dataclasses.fields(value)}))
    data, paint, lamp, crate, thing = later
    thing.meshes = [crate]
    data.objects = [thing, Object("twin", [crate, *plain.objects[1].meshes[1:]], plain.objects[1].to_world)]
    data.materials, data.lights = [paint, plain.materials[1]], [lamp]
    assert hash_scene(data) == hash_scene(plain)
    for value in (data, paint, lamp, crate, thing):
        value.invented = 0.25
        assert hash_scene(data) != hash_scene(plain)
        value.invented = 0.5


def test_what_moves_counts_as_it_stands_at_the_time() -> None:
    still, moving = make(), make()
    moving.objects[0].motion, moving.duration = spin, 2.0
    moving.lights[0].motion = spin
    assert hash_scene(moving, 0.0) == hash_scene(still, 0.0) == hash_scene(still, 1.0)
    assert hash_scene(moving, 1.0) != hash_scene(moving, 0.0)
    still.objects[0].to_world = translation(1.0, 0.0, 0.0)
    still.lights[0].position = (1.1, 0.2, 0.3)
    assert hash_scene(moving, 1.0) == hash_scene(still)
    deforming = make()
    deforming.objects[0].deform = wobble
    assert hash_scene(deforming, 0.0) != hash_scene(deforming, 0.5)


def test_arrays_do_not_run_into_one_another() -> None:
    def shapes(*counts: int) -> str:
        rows = np.zeros((4, 3), np.float32)
        meshes = [Mesh(rows[:count], np.zeros((0, 3), np.uint32)) for count in counts]
        return hash_scene(SceneData("", [Object("", meshes)], []))

    assert len({shapes(1, 3), shapes(3, 1), shapes(2, 2), shapes(4), shapes(4, 0), shapes(0, 4)}) == 6
    assert hash_numbers(1.0, 23.0) != hash_numbers(12.0, 3.0)


def test_the_hash_is_the_same_in_another_process() -> None:
    program = (
        "from luxel.scene import load; from luxel.scene.digest import hash_scene; "
        "print(hash_scene(load('atrium')), hash_scene(load('moving'), 0.4))"
    )
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True)
    assert ran.stdout.split() == [hash_scene(load("atrium")), hash_scene(load("moving"), 0.4)]


def test_built_in_scenes_have_hashes_of_their_own() -> None:
    names = [name for name, _, _ in list_scenes()]
    assert len({hash_scene(load(name)) for name in names}) == len(names)


def test_what_has_no_canonical_form_is_refused() -> None:
    data = make()
    vars(data)["hide_emitters"] = {1.0, 2.0}  # past the rules, as a field without one would be
    with pytest.raises(LuxelError, match="holds a set"):
        hash_scene(data)
