"""Committed truths belong to one scene and view, and a damaged one is no obstacle."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from luxel.render.references import find_reference, reference_key, references_folder
from luxel.render.truth import cache_key, render_truth
from luxel.scene import live, load
from luxel.scene.device import upload
from luxel.scene.edit import default_camera, parse_camera
from luxel.scene.host import Looks
from luxel.scene.model import Light, SceneData, Texture


def key_of(data: SceneData, size: tuple[int, int] = (256, 256)) -> str:
    return reference_key(upload(data), default_camera(data), size, 0.0)


VIEWS = {"cornell-box": (256, 256), "two-rooms": (256, 256), "atrium": (256, 256), "attic": (256, 256)}
SPONZA_CAMERA = "-9,2,0;5,2.5,0;65"
BOTH: tuple[Looks, ...] = ("diffuse", "full")


@pytest.mark.parametrize("name", VIEWS)
def test_the_committed_truths_are_found(name: str) -> None:
    found = find_reference(key_of(load(name), VIEWS[name]), 4096)
    assert found is not None and found[3]["scene"] == name


def test_the_committed_truth_of_sponza_is_found(scenes_folder: Path) -> None:
    data = load(scenes_folder / "sponza-crytek" / "Sponza.gltf")
    key = reference_key(upload(data), parse_camera(SPONZA_CAMERA, data), (480, 270), 0.0)
    found = find_reference(key, 4096)
    assert found is not None and found[3]["scene"] == "sponza"


def test_every_committed_truth_belongs_to_a_view() -> None:
    """No file lies about that nothing finds; Sponza's is looked for where that scene is."""
    folder = references_folder()
    assert folder is not None
    keys = {f"{name}-{key_of(load(name), size)}.exr" for name, size in VIEWS.items()}
    files = {path.name for path in folder.glob("*.exr") if not path.name.startswith("sponza-")}
    assert files == keys
    assert len(list(folder.glob("sponza-*.exr"))) == 1


def test_live_edits_are_other_keys_and_undone_they_are_the_old_one() -> None:
    data = live.with_held(load("two-rooms"), 0, np.eye(4))
    scene = upload(data)
    camera, lights = default_camera(data), [replace(light) for light in data.lights]
    glowing = next((i for i, material in enumerate(data.materials) if max(material.emission) > 0.0), None)
    moved = np.eye(4)
    moved[0, 3] = 0.25

    def key() -> str:
        return reference_key(scene, camera, (64, 64), 0.0)

    edits = {
        "scale": (lambda: live.set_light_scale(scene, 0.5), lambda: live.set_light_scale(scene, 1.0)),
        "place": (lambda: live.place_object(scene, 0, moved), lambda: live.place_object(scene, 0, np.eye(4))),
        "lamp": (
            lambda: live.set_lights(scene, [*lights, Light("point", (1.0, 1.0, 1.0))]),
            lambda: live.set_lights(scene, lights),
        ),
    }
    if glowing is not None:
        was = data.materials[glowing]
        brighter = replace(was, emission=(9.0, 8.0, 7.0))
        edits["glow"] = (
            lambda: live.set_material(scene, glowing, brighter),
            lambda: live.set_material(scene, glowing, was),
        )
    plain, seen = key(), set()
    for name, (edit, undo) in edits.items():
        edit()
        seen.add(key())
        assert key() != plain, name
        undo()
        assert key() == plain, name
    assert len(seen) == len(edits)


def test_the_camera_the_size_the_paths_and_the_seed_are_part_of_the_key() -> None:
    data = load("moving")
    scene, camera = upload(data), default_camera(data)
    moving = replace(camera, motion=lambda time: np.eye(4) + time * np.eye(4, k=3))
    keys = [
        cache_key(scene, camera, (32, 32), 8, 0, 0.0),
        cache_key(scene, camera, (32, 16), 8, 0, 0.0),
        cache_key(scene, camera, (32, 32), 9, 0, 0.0),
        cache_key(scene, camera, (32, 32), 8, 1, 0.0),
        cache_key(scene, camera, (32, 32), 8, 0, 0.5),
        cache_key(scene, replace(camera, fov=camera.fov + 0.1), (32, 32), 8, 0, 0.0),
        cache_key(scene, replace(camera, orthographic_width=2.0), (32, 32), 8, 0, 0.0),
        cache_key(scene, moving, (32, 32), 8, 0, 0.0),
        cache_key(scene, moving, (32, 32), 8, 0, 0.5),
    ]
    assert len(set(keys)) == len(keys)
    assert cache_key(scene, replace(camera, name="other"), (32, 32), 8, 0, 0.0) == keys[0]


def test_the_second_uv_set_is_part_of_the_truths_key() -> None:
    keys = []
    for shift in (0.0, 0.25):
        data = load("cornell-box")
        mesh = data.objects[0].meshes[0]
        mesh.uv2 = np.full((len(mesh.positions), 2), shift, np.float32)
        keys.append(cache_key(upload(data), default_camera(data), (16, 16), 2, 0, 0.0))
    assert keys[0] != keys[1]


def test_any_change_of_the_scene_is_another_key() -> None:
    plain = key_of(load("cornell-box"))
    assert key_of(load("cornell-box")) == plain
    assert key_of(load("cornell-box"), (128, 128)) != plain

    def metal(data: SceneData) -> None:
        for material in data.materials:
            material.metallic = 1.0

    def sides(data: SceneData) -> None:
        data.materials[0].reflect_back = True

    def paint(data: SceneData) -> None:
        data.materials[0].base_color_texture = Texture(np.full((4, 4, 3), 100, np.uint8))

    def colours(data: SceneData) -> None:
        mesh = data.objects[0].meshes[0]
        mesh.colors = np.full((len(mesh.positions), 3), 0.5, np.float32)

    def move(data: SceneData) -> None:
        mesh = data.objects[1].meshes[0]
        mesh.positions = mesh.positions + np.float32(0.05)

    def sky(data: SceneData) -> None:
        data.sky.color = (0.1, 0.1, 0.1)

    for change in (metal, sides, paint, colours, move, sky):
        data = load("cornell-box")
        change(data)
        assert key_of(data) != plain, change.__name__


def test_damaged_files_are_made_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LUXEL_CACHE", str(tmp_path))
    monkeypatch.setenv("LUXEL_REFERENCES", str(tmp_path))
    first = render_truth("cornell-box", size=(16, 16), spp=4)
    (file,) = (tmp_path / "truth").iterdir()
    file.write_bytes(file.read_bytes()[:5000])
    again = render_truth("cornell-box", size=(16, 16), spp=4)
    np.testing.assert_allclose(again.layers.indirect, first.layers.indirect, rtol=1e-4, atol=1e-5)
    data = load("cornell-box")
    (tmp_path / f"cornell-box-{key_of(data, (16, 16))}.exr").write_bytes(b"v/1 not an image")
    assert render_truth(data, size=(16, 16), spp=4).spp == 4


def test_materials_are_part_of_a_key_only_where_they_are_not_diffuse() -> None:
    data = load("cornell-box")
    scene, camera = upload(data), default_camera(data)
    plain = reference_key(scene, camera, (256, 256), 0.0)
    diffuse, full = (reference_key(scene, camera, (256, 256), 0.0, materials) for materials in BOTH)
    folder = references_folder()
    assert folder is not None
    # The committed file has its name from before there was a choice.
    assert plain == diffuse and (folder / f"cornell-box-{plain}.exr").exists()
    assert not list(folder.glob(f"*{full}*"))
    plain = cache_key(scene, camera, (256, 256), 4, 0, 0.0)
    diffuse, full = (cache_key(scene, camera, (256, 256), 4, 0, 0.0, materials) for materials in BOTH)
    assert plain == diffuse != full
