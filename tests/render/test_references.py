"""Committed truths belong to one scene and view, and a damaged one is no obstacle."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from luxel.render.references import find_reference, reference_key
from luxel.render.truth import render_truth
from luxel.scene import load
from luxel.scene.device import upload
from luxel.scene.edit import default_camera
from luxel.scene.model import SceneData, Texture


def key_of(data: SceneData, size: tuple[int, int] = (256, 256)) -> str:
    return reference_key(upload(data), default_camera(data), size, 0.0)


def test_the_committed_truths_are_found() -> None:
    for name in ("cornell-box", "two-rooms", "atrium", "attic"):
        found = find_reference(key_of(load(name)), 4096)
        assert found is not None and found[3]["scene"] == name


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
