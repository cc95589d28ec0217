"""What tells bakes apart: all that the transport is made from, and nothing else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from luxel.errors import LuxelError
from luxel.methods.lightmap.bake.bake import bake_scene
from luxel.methods.lightmap.bake.fingerprint import fingerprint_scene
from luxel.methods.lightmap.method import Lightmap
from luxel.methods.lightmap.params import LightmapParams
from luxel.scene import load
from luxel.scene.device import upload
from luxel.scene.library.shapes import quad
from luxel.scene.model import Camera, Light, Material, Object, SceneData, Sky, Texture


def painted() -> SceneData:
    """A floor with a large texture and a lamp, and a wall that stops half of the rays."""
    floor, wall = (
        quad((-5, 0, 5), (5, 0, 5), (5, 0, -5), (-5, 0, -5), 0),
        quad((-5, 0, -5), (5, 0, -5), (5, 3, -5), (-5, 3, -5), 1),
    )
    floor.colors, floor.normals = np.ones((4, 3), np.float32), np.tile(np.array([[0, 1, 0]], np.float32), (4, 1))
    texture, glow = Texture(np.full((512, 512, 3), 255, np.uint8)), Texture(np.full((8, 8, 3), 200, np.uint8))
    materials = [
        Material("floor", (0.5, 0.5, 0.5), base_color_texture=texture),
        Material("wall", (0.5, 0.5, 0.5), emission=(1.0, 1.0, 1.0), emission_texture=glow),
    ]
    camera = Camera((0.0, 2.0, 5.0), (0.0, 0.0, 0.0))
    return SceneData(
        "painted",
        [Object("floor", [floor]), Object("wall", [wall])],
        materials,
        cameras=[camera],
        sky=Sky((1.0, 1.0, 1.0)),
    )


def change_texture(data: SceneData) -> None:
    data.materials[0].base_color_texture = Texture(
        np.repeat(np.array([255, 0], np.uint8), 256 * 512 * 3).reshape(512, 512, 3)
    )


def change_colors(data: SceneData) -> None:
    data.objects[0].meshes[0].colors = np.full((4, 3), 0.1, np.float32)


def change_normals(data: SceneData) -> None:
    data.objects[0].meshes[0].normals = np.tile(np.array([[0.6, 0.8, 0.0]], np.float32), (4, 1))


def change_texture_coordinates(data: SceneData) -> None:
    mesh = data.objects[0].meshes[0]
    assert mesh.uv is not None
    mesh.uv = 7.0 * mesh.uv


def change_back(data: SceneData) -> None:
    data.materials[1].reflect_back = False


def change_cutoff(data: SceneData) -> None:
    data.materials[1].alpha, data.materials[1].alpha_mode = 0.2, "mask"


def change_shape(data: SceneData) -> None:
    data.objects[1].meshes[0].positions = 0.9 * data.objects[1].meshes[0].positions


SURFACE_CHANGES = [
    change_texture, change_colors, change_normals, change_texture_coordinates, change_back, change_cutoff, change_shape
]  # fmt: skip


@pytest.mark.parametrize("change", SURFACE_CHANGES)
def test_changed_surfaces_have_another_fingerprint(small: LightmapParams, change: Callable[[SceneData], None]) -> None:
    data = painted()
    first = fingerprint_scene(upload(data), small)
    assert fingerprint_scene(upload(painted()), small) == first
    change(data)
    assert fingerprint_scene(upload(data), small) != first


def test_another_version_has_another_fingerprint(small: LightmapParams, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = upload(painted())
    first = fingerprint_scene(scene, small)
    monkeypatch.setattr("luxel.methods.lightmap.bake.fingerprint.__version__", "0.0.0")
    assert fingerprint_scene(scene, small) != first


def test_other_lights_and_cameras_take_the_same_bake(tmp_path: Path, small: LightmapParams) -> None:
    tiny = replace(small, texel_target=256, surfel_target=32, rays_per_texel=16, probe_target=1)
    scene, file, dim = upload(painted()), tmp_path / "bake.npz", painted()
    method = Lightmap()
    method.save(method.build(scene, tiny, 0), file)
    dim.materials[1].emission, dim.materials[0].roughness, dim.sky = (0.0, 0.0, 0.0), 0.1, Sky()
    dim.cameras, dim.lights = [], [Light("point", (1.0, 1.0, 1.0), position=(0.0, 1.0, 0.0))]
    method.load(upload(dim), tiny, file)
    method.save(method.build(upload(dim), tiny, 0), file)
    with pytest.raises(LuxelError, match="baked without a sky"):
        method.load(scene, tiny, file)


def test_rows_of_a_bake_with_other_cameras_are_cast_anew(tmp_path: Path, small: LightmapParams) -> None:
    """Cameras tell which piece of a texel is lit, so what another bake left does not fit."""
    tiny = replace(small, rays_per_texel=16, probe_target=1, tree_outlook=0.0)
    data = load("attic")
    bake_scene(upload(data), tiny, 0, workdir=tmp_path)
    data.cameras, data.flight = [Camera((0.0, 30.0, 60.0), (0.0, 0.0, 0.0))], []
    scene = upload(data)
    again, whole = bake_scene(scene, tiny, 0, workdir=tmp_path), bake_scene(scene, tiny, 0)
    np.testing.assert_array_equal(again.words, whole.words)
