"""A bake keeps the file: its nodes, its materials, its own coordinates; the light goes where nothing was."""

from __future__ import annotations

import base64
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pygltflib
import pytest
from PIL import Image

import luxel
from luxel.bake.core import bake_scene
from luxel.bake.files import relight, transport_of, write_bake
from luxel.bake.gltf_materials import UNLIT, VARIANTS
from luxel.scene.edit import apply_sun
from luxel.scene.library.shapes import box
from luxel.scene.model import SceneData

from .conftest import SMALL

TURNED = {"rotation": [0.0, np.sin(np.pi / 8), 0.0, np.cos(np.pi / 8)], "translation": [0.0, 0.0, 0.5]}
NODES: list[dict[str, Any]] = [
    {"name": "left crate", "mesh": 1, "translation": [-0.8, 0.0, 0.0]},
    {"name": "hall", "children": [2, 4]},
    {"name": "floor", "mesh": 0},
    {"name": "right crate", "mesh": 1, "translation": [0.8, 0.0, 0.0], "scale": [-1.0, 1.0, 1.5]},
    {"name": "furniture", "children": [0, 3], **TURNED},
    {"name": "bulb", "extensions": {"KHR_lights_punctual": {"light": 0}}, "translation": [0.3, 2.0, 1.0]},
]
"""Two levels, named out of order; both crates are one mesh, one of them mirrored."""


class Parts:
    """The buffer of a .gltf under construction."""

    def __init__(self) -> None:
        self.blob, self.views, self.accessors = bytearray(), [], []

    def view(self, data: bytes) -> int:
        self.blob += b"\0" * (-len(self.blob) % 4)
        self.views.append({"buffer": 0, "byteOffset": len(self.blob), "byteLength": len(data)})
        self.blob += data
        return len(self.views) - 1

    def array(self, values: np.ndarray) -> int:
        values = np.asarray(values)
        kind, shape = (5125, "SCALAR") if values.ndim == 1 else (5126, f"VEC{values.shape[1]}")
        data = values.astype(np.uint32 if values.ndim == 1 else np.float32)
        self.accessors.append(
            {"bufferView": self.view(data.tobytes()), "componentType": kind, "count": len(data), "type": shape}
            | ({} if values.ndim == 1 else {"min": data.min(axis=0).tolist(), "max": data.max(axis=0).tolist()})
        )
        return len(self.accessors) - 1


def write_hall(folder: Path) -> Path:
    """A floor with a texture and its own second coordinates, and two crates of one mesh, with vertex colours."""
    parts, stream = Parts(), io.BytesIO()
    pixels = np.random.default_rng(3).integers(60, 230, (8, 8, 3), dtype=np.uint8)
    Image.fromarray(pixels).save(stream, format="PNG")
    flat = np.array([[-2, 0, -2], [-2, 0, 2], [2, 0, 2], [2, 0, -2]], float)
    own = np.array([[0.1, 0.2], [0.1, 0.9], [0.8, 0.9], [0.8, 0.2]])
    crate = box((-0.4, 0.0, -0.4), (0.4, 0.8, 0.4), 0)
    colors = np.random.default_rng(4).uniform(0.5, 1.0, (len(crate.positions), 3))
    floor_attributes = {
        "POSITION": parts.array(flat), "TEXCOORD_0": parts.array(flat[:, [0, 2]]), "TEXCOORD_1": parts.array(own),
    }  # fmt: skip
    crate_attributes = {"POSITION": parts.array(crate.positions), "COLOR_0": parts.array(colors)}
    floor_indices, crate_indices = parts.array(np.array([0, 1, 2, 0, 2, 3])), parts.array(crate.faces.ravel())
    picture = parts.view(stream.getvalue())
    tiles = {"index": 0, "extensions": {"KHR_texture_transform": {"scale": [0.5, 0.25], "offset": [0.1, 0.2]}}}
    file = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [1, 5]}], "nodes": NODES,
        "meshes": [
            {"primitives": [{"attributes": floor_attributes, "indices": floor_indices, "material": 0}]},
            {"primitives": [{"attributes": crate_attributes, "indices": crate_indices, "material": 1}]},
        ],
        "materials": [
            {"name": "tiles", "pbrMetallicRoughness": {"baseColorFactor": [0.9, 0.8, 0.7, 1], "metallicFactor": 0,
                                                       "roughnessFactor": 0.25, "baseColorTexture": tiles}},
            {"name": "wood", "pbrMetallicRoughness": {"baseColorFactor": [0.3, 0.5, 0.8, 1], "metallicFactor": 0}},
        ],
        "textures": [{"source": 0}], "images": [{"bufferView": picture, "mimeType": "image/png"}],
        "accessors": parts.accessors, "bufferViews": parts.views,
        "buffers": [{"byteLength": len(parts.blob), "uri": "data:application/octet-stream;base64,"
                     + base64.b64encode(parts.blob).decode()}],
        "extensions": {"KHR_lights_punctual": {"lights": [{"type": "point", "intensity": 10}]}},
        "extensionsUsed": ["KHR_lights_punctual", "KHR_texture_transform"],
    }  # fmt: skip
    path = folder / "hall.gltf"
    path.write_text(json.dumps(file))
    return path


@pytest.fixture(scope="module")
def baked(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, dict[str, Any]]:
    """The source, its bake, and what was said of that."""
    folder = tmp_path_factory.mktemp("hall")
    source = write_hall(folder)
    bake = bake_scene(luxel.load(source), "lightmap", {**SMALL, "texel_target": 8192}, frames=12, samples=8)
    return source, folder / "baked.glb", write_bake(bake, folder / "baked.glb")


@pytest.fixture(scope="module")
def file(baked: tuple[Path, Path, dict[str, Any]]) -> Any:
    return pygltflib.GLTF2().load(str(baked[1]))


def read(file: Any, number: int) -> np.ndarray:
    accessor = file.accessors[number]
    view = file.bufferViews[accessor.bufferView]
    kind = {pygltflib.FLOAT: np.float32, pygltflib.UNSIGNED_INT: np.uint32}[accessor.componentType]
    width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[accessor.type]
    return np.frombuffer(file.binary_blob(), kind, accessor.count * width, view.byteOffset).reshape(-1, width)


def test_the_node_tree_is_the_files(file: Any) -> None:
    assert [node.name for node in file.nodes] == [node["name"] for node in NODES]
    assert file.scenes[file.scene].nodes == [1, 5]
    for node, source in zip(file.nodes, NODES, strict=True):
        assert node.children == source.get("children", []) and node.matrix is None
        for key in ("translation", "rotation", "scale"):
            assert getattr(node, key) == (pytest.approx(source[key]) if key in source else None)
        assert (node.mesh is not None) == ("mesh" in source)
    # Each crate has its own light, so its own mesh.
    assert file.nodes[0].mesh != file.nodes[3].mesh


def test_vertices_stand_where_the_file_has_them(file: Any) -> None:
    crate = box((-0.4, 0.0, -0.4), (0.4, 0.8, 0.4), 0)
    for node, wanted in ((2, 6), (0, 36), (3, 36)):
        (part,) = file.meshes[file.nodes[node].mesh].primitives
        indices = read(file, part.indices).ravel()
        corners = read(file, part.attributes.POSITION)[indices].reshape(-1, 3, 3)
        assert len(indices) >= wanted
        if node != 2:
            low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
            np.testing.assert_allclose([low, high], [crate.positions.min(axis=0), crate.positions.max(axis=0)])
        # Counter-clockwise from outside in the node's own space, as the specification wants under any matrix.
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        given = read(file, part.attributes.NORMAL)[indices].reshape(-1, 3, 3)
        assert ((normal[:, None] * given).sum(axis=2) > 0.0).all()
        if node != 2:
            assert ((corners.mean(axis=1) - [0.0, 0.4, 0.0]) * normal).sum(axis=1).min() > 0.0


def test_materials_are_the_files(file: Any) -> None:
    shown = {part.material for mesh in file.meshes for part in mesh.primitives}
    assert sorted(file.materials[index].name for index in shown) == ["tiles", "wood"]
    assert all(UNLIT in file.materials[index].extensions for index in shown)
    assert file.extensions[VARIANTS]["variants"] == [{"name": "own materials"}]
    own = {}
    for mesh in file.meshes:
        for part in mesh.primitives:
            (mapping,) = part.extensions[VARIANTS]["mappings"]
            assert mapping["variants"] == [0]
            material = file.materials[mapping["material"]]
            assert material.name == file.materials[part.material].name and UNLIT not in (material.extensions or {})
            own[material.name] = material.pbrMetallicRoughness
    assert own["tiles"].baseColorFactor == pytest.approx([0.9, 0.8, 0.7, 1.0])
    assert own["wood"].baseColorFactor == pytest.approx([0.3, 0.5, 0.8, 1.0])
    assert own["tiles"].roughnessFactor == 0.25 and own["tiles"].metallicFactor == 0.0
    texture = own["tiles"].baseColorTexture
    moved = texture.extensions["KHR_texture_transform"]
    assert moved["scale"] == pytest.approx([0.5, 0.25]) and moved["offset"] == pytest.approx([0.1, 0.2])
    assert moved["rotation"] == pytest.approx(0.0) and texture.texCoord == 0
    view = file.bufferViews[file.images[file.textures[texture.index].source].bufferView]
    pixels = np.asarray(Image.open(io.BytesIO(file.binary_blob()[view.byteOffset :][: view.byteLength])))
    np.testing.assert_array_equal(pixels, np.random.default_rng(3).integers(60, 230, (8, 8, 3), dtype=np.uint8))


def test_own_coordinates_stay_and_the_light_has_a_set_of_its_own(
    file: Any, baked: tuple[Path, Path, dict[str, Any]]
) -> None:
    assert baked[2]["texcoord"] == 2 and file.asset.extras["texCoord"] == 2
    (part,) = file.meshes[file.nodes[2].mesh].primitives
    assert file.materials[part.material].pbrMetallicRoughness.baseColorTexture.texCoord == 2
    place = read(file, part.attributes.POSITION)
    np.testing.assert_allclose(read(file, part.attributes.TEXCOORD_0), place[:, [0, 2]], atol=1e-6)
    flat = {(-2, -2): (0.1, 0.2), (-2, 2): (0.1, 0.9), (2, 2): (0.8, 0.9), (2, -2): (0.8, 0.2)}
    wanted = [flat[round(x), round(z)] for x, _, z in place.tolist()]
    np.testing.assert_allclose(read(file, part.attributes.TEXCOORD_1), wanted, atol=1e-6)
    light = read(file, part.attributes.TEXCOORD_2)
    assert light.min() >= 0.0 and light.max() <= 1.0 and len(np.unique(light, axis=0)) >= 4
    # Vertex colours stay too, where no viewer multiplies the light by them.
    (crate,) = file.meshes[file.nodes[0].mesh].primitives
    assert crate.attributes.COLOR_0 is None
    colors = read(file, crate.attributes._COLOR_0)
    given = np.random.default_rng(4).uniform(0.5, 1.0, (24, 3))
    assert np.abs(colors[:, None, :3] - given).max(axis=2).min(axis=1).max() < 1e-6


def test_no_set_of_the_file_is_taken(tmp_path: Path) -> None:
    """A third set that nothing reads stays, and so does the second where the textures read the third."""
    path = write_hall(tmp_path)
    content = json.loads(path.read_text())
    content["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_2"] = 2
    content["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["texCoord"] = 2
    path.write_text(json.dumps(content))
    bake = bake_scene(luxel.load(path), "lightmap", dict(SMALL), frames=2, samples=1)
    assert write_bake(bake, tmp_path / "baked.glb")["texcoord"] == 3
    file: Any = pygltflib.GLTF2().load(str(tmp_path / "baked.glb"))
    (part,) = file.meshes[file.nodes[2].mesh].primitives
    attributes = vars(part.attributes)
    np.testing.assert_array_equal(read(file, attributes["TEXCOORD_1"]), read(file, attributes["TEXCOORD_2"]))
    assert read(file, attributes["TEXCOORD_2"]).min() >= 0.1 and read(file, attributes["TEXCOORD_2"]).max() <= 0.9
    assert file.materials[part.material].pbrMetallicRoughness.baseColorTexture.texCoord == 3
    own = file.materials[part.extensions[VARIANTS]["mappings"][0]["material"]]
    assert own.pbrMetallicRoughness.baseColorTexture.texCoord == 2
    again = luxel.load(tmp_path / "baked.glb").objects[0].meshes[0]
    assert again.uv2 is not None and again.uv2_set == 3 and set(again.uv_more) == {1, 2}


def image_of(data: SceneData, camera: luxel.Camera, spp: int) -> np.ndarray:
    return luxel.render_truth(data, camera=camera, size=(64, 64), spp=spp, cache=False).layers.image()


@pytest.mark.parametrize("relit", [False, True], ids=["baked", "relit"])
def test_it_shows_the_radiance_that_was_there(
    baked: tuple[Path, Path, dict[str, Any]], relit: bool, tmp_path: Path
) -> None:
    source, place, written = baked
    camera = luxel.Camera((0.5, 3.0, 4.0), (0.0, 0.3, 0.0), fov=50.0)
    data = luxel.load(source)
    if relit:
        data = apply_sun(data, "40,50,4")
        place, transport = tmp_path / "relit.glb", transport_of(place)
        written = write_bake(relight(transport, data), place)
    wanted = image_of(data, camera, 256) * written["exposure"]
    again = luxel.load(place)
    assert not again.warnings and [item.name for item in again.objects] == [item.name for item in data.objects]
    for before, after in zip(data.objects, again.objects, strict=True):
        np.testing.assert_allclose(before.to_world, after.to_world, atol=1e-12)
    seen = image_of(again, camera, 2)
    plain = (wanted.max(axis=2) > 0.0) & (wanted.max(axis=2) < 0.98)
    assert plain.mean() > 0.4 and seen[plain].mean() == pytest.approx(wanted[plain].mean(), rel=0.02)
    off = np.abs(seen - wanted)[plain].mean(axis=1)
    assert np.median(off) < 0.02
    # No pixel lost its surface: nothing is turned inside out or out of place.
    assert ((seen.max(axis=2) > 0.0) == (wanted.max(axis=2) > 0.0)).mean() > 0.99
