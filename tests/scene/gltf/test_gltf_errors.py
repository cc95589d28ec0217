"""Bad files: one sentence that names the file and the cause, never a traceback of another kind."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from luxel.errors import LuxelError
from luxel.scene.gltf import load_gltf

if TYPE_CHECKING:
    from conftest import GltfBuilder

NAN = float("nan")


def complaint(path: Path) -> str:
    """The message of the error, checked to be one sentence that names the file."""
    with pytest.raises(LuxelError) as caught:
        load_gltf(path)
    message = str(caught.value)
    assert message.startswith(f"cannot load {path}: ") and message.endswith(".")
    assert "\n" not in message
    return message


def written(folder: Path, content: bytes | str, name: str = "bad.gltf") -> Path:
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def test_missing_file_and_folder(tmp_path: Path) -> None:
    assert "the file does not exist" in complaint(tmp_path / "none.glb")
    assert "cannot be read" in complaint(tmp_path)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "the file is empty"),
        ("not json at all", "not valid JSON"),
        ('{"asset": {"version": "2.0"}', "not valid JSON"),
        (b"\xff\xfe\x00\x01", "not valid JSON"),
        ("[" * 100_000, "not valid JSON"),
        ("[1, 2]", "not glTF"),
        ("{}", "not glTF"),
        ('{"asset": {}}', "not glTF"),
        ('{"asset": {"version": "1.0"}}', "only glTF 2.0 is known"),
        ('{"asset": {"version": "2.1", "minVersion": "2.1"}}', "no triangles"),
        ('{"asset": {"version": "2.0", "minVersion": "2.9"}}', "glTF 2.9"),
        ('{"asset": {"version": "2.0"}, "nodes": "abc"}', "breaks the glTF schema"),
        ('{"asset": {"version": "2.0"}, "nodes": [5]}', "breaks the glTF schema"),
        ('{"asset": {"version": "2.0"}}', "no triangles"),
        (b"glTF\x02", "truncated inside its GLB header"),
        (struct.pack("<4sII", b"glTF", 1, 12), "GLB of version 1"),
        (struct.pack("<4sII", b"glTF", 2, 12), "no JSON chunk"),
        (struct.pack("<4sIII4s", b"glTF", 2, 20, 50, b"JSON"), "chunk is truncated"),
    ],
)
def test_broken_containers(tmp_path: Path, content: bytes | str, words: str) -> None:
    assert words in complaint(written(tmp_path, content))


def test_truncated_glb(builder: GltfBuilder) -> None:
    builder.node(mesh=builder.mesh())
    data = builder.bytes_of_glb()
    for size in (len(data) - 1, len(data) // 2, 40, 13):
        assert "truncated" in complaint(written(builder.folder, data[:size], "bad.glb"))


def set_at(*path: Any) -> Callable[[dict[str, Any]], None]:
    """A change of the JSON: the last argument replaces what the path before it names."""
    *where, last, value = path

    def change(document: dict[str, Any]) -> None:
        for step in where:
            document = document[step]
        document[last] = value

    return change


PRIMITIVE = ("meshes", 0, "primitives", 0)
CASES: dict[str, tuple[Callable[[dict[str, Any]], None], str]] = {
    "accessor": (set_at(*PRIMITIVE, "indices", 77), "accessor 77"),
    "negative accessor": (set_at(*PRIMITIVE, "indices", -1), "accessor -1"),
    "buffer view": (set_at("accessors", 0, "bufferView", 9), "buffer view 9"),
    "buffer": (set_at("bufferViews", 0, "buffer", 3), "buffer 3"),
    "node of the scene": (set_at("scenes", 0, "nodes", [4]), "node 4"),
    "scene": (set_at("scene", 2), "scene 2"),
    "mesh": (set_at("nodes", 0, "mesh", 5), "mesh 5"),
    "material": (set_at(*PRIMITIVE, "material", 8), "material 8"),
    "texture": (set_at("materials", [{"emissiveTexture": {"index": 6}}]), "texture of material 0 6"),
    "skin": (set_at("nodes", 0, "skin", 1), "skin 1"),
    "camera": (set_at("nodes", 0, "camera", 2), "camera 2"),
    "light": (set_at("nodes", 0, "extensions", {"KHR_lights_punctual": {"light": 1}}), "light 1"),
    "child": (set_at("nodes", 0, "children", [12]), "node 12"),
    "own child": (set_at("nodes", 0, "children", [0]), "cycle through node 0"),
    "cycle": (set_at("nodes", [{"children": [1]}, {"children": [2], "mesh": 0}, {"children": [1]}]), "no tree"),
    "ring": (set_at("nodes", [{"mesh": 0}, {"children": [2]}, {"children": [1]}]), "cycle through node 1"),
    "type": (set_at("accessors", 0, "type", "VEC2"), "type VEC2 where VEC3 is needed"),
    "unknown type": (set_at("accessors", 0, "type", "VEC9"), "type VEC9"),
    "component type": (set_at("accessors", 0, "componentType", 5124), "component type 5124"),
    "float indices": (set_at("accessors", 1, "componentType", 5126), "must hold unsigned integers"),
    "count": (set_at("accessors", 0, "count", 4), "past the end of buffer view 0"),
    "huge count": (set_at("accessors", 0, "count", 10**12), "past the end of buffer view 0"),
    "count without data": (
        set_at("accessors", 0, {"componentType": 5126, "type": "VEC3", "count": 300_000_000}),
        "without any data",
    ),
    "negative count": (set_at("accessors", 0, "count", -3), "count -3"),
    "accessor offset": (set_at("accessors", 0, "byteOffset", 4), "past the end of buffer view 0"),
    "view length": (set_at("bufferViews", 0, "byteLength", 10**6), "past the end of buffer 0"),
    "small stride": (set_at("bufferViews", 0, "byteStride", 8), "stride of 8"),
    "buffer length": (set_at("buffers", 0, "byteLength", 10**6), "buffer 0 is truncated"),
    "absent buffer": (set_at("buffers", 0, "uri", "none.bin"), "none.bin is missing"),
    "remote buffer": (set_at("buffers", 0, "uri", "http://example.org/a.bin"), "example.org/a.bin is missing"),
    "broken data URI": (set_at("buffers", 0, "uri", "data:nothing"), "cannot be decoded"),
    "mode": (set_at(*PRIMITIVE, "mode", 9), "mode 9"),
    "lines alone": (set_at(*PRIMITIVE, "mode", 1), "no triangles"),
    "no meshes shown": (set_at("scenes", 0, "nodes", []), "no triangles"),
    "short vector": (set_at("nodes", 0, "translation", [1.0, 2.0]), "translation of node 0 must be 3"),
    "NaN transform": (set_at("nodes", 0, "scale", [1.0, NAN, 1.0]), "scale of node 0 holds NaN"),
    "overflow": (set_at("nodes", 0, "matrix", [1e308] * 16), "transform of node 0 is too large"),
    "text for a number": (set_at("materials", [{"emissiveFactor": "red"}]), "emissiveFactor of material 0 must be 3"),
    "list for a name": (set_at("nodes", 0, "name", ["a"]), "breaks the glTF schema"),
    "wrong kind": (set_at("materials", [{"extensions": {"KHR_materials_emissive_strength": 5}}]), "schema"),
    "weights": (set_at("meshes", 0, "weights", [0.5]), "weights of node 0 must be 0"),
    "unknown extension": (set_at("extensionsRequired", ["ACME_voxels"]), "requires the extension ACME_voxels"),
    "number as an extension": (set_at("extensionsRequired", [5]), "requires the extension 5"),
}


@pytest.mark.parametrize("case", CASES)
def test_broken_content(builder: GltfBuilder, case: str) -> None:
    change, words = CASES[case]
    builder.node(mesh=builder.mesh())
    builder.json["meshes"][0]["primitives"][0]["indices"] = builder.accessor([0, 1, 2], "uint16")
    builder.json["buffers"] = [{"byteLength": len(builder.blob)}]
    assert len(builder.load("whole.glb").objects) == 1, "the file must be sound before the change"
    change(builder.json)
    assert words in complaint(builder.write())


def test_face_beyond_the_vertices(builder: GltfBuilder) -> None:
    builder.node(mesh=builder.mesh(indices=builder.accessor([0, 1, 3], "uint8")))
    assert "names vertex 3 but it has 3 vertices" in complaint(builder.write())


@pytest.mark.parametrize("value", [NAN, float("inf")])
def test_positions_that_are_not_finite(builder: GltfBuilder, value: float) -> None:
    builder.node(mesh=builder.mesh([[0.0, 0.0, 0.0], [1.0, value, 0.0], [0.0, 1.0, 0.0]]))
    assert "a position of mesh 0 is NaN or infinite" in complaint(builder.write())


def test_attributes_of_unequal_length(builder: GltfBuilder) -> None:
    builder.node(mesh=builder.mesh(attributes={"NORMAL": builder.accessor([[0.0, 0.0, 1.0]] * 2)}))
    assert "NORMAL of mesh 0 has 2 entries for 3 vertices" in complaint(builder.write())


def test_sparse_index_beyond_the_end(builder: GltfBuilder) -> None:
    builder.node(mesh=builder.mesh())
    builder.json["accessors"][0]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": builder.view(bytes([3])), "componentType": 5121},
        "values": {"bufferView": builder.view(bytes(12))},
    }
    assert "a sparse index of accessor 0 is 3" in complaint(builder.write())


def test_required_looks_only_warn(builder: GltfBuilder) -> None:
    builder.node(mesh=builder.mesh())
    builder.json["extensionsRequired"] = builder.json["extensionsUsed"] = ["KHR_materials_clearcoat"]
    data = builder.load()
    assert sum("KHR_materials_clearcoat" in warning for warning in data.warnings) == 1


@pytest.mark.parametrize(
    ("times", "values", "words"),
    [
        ([0.0, 2.0, 1.0], [[0.0, 0.0, 0.0]] * 3, "do not increase"),
        ([0.0, NAN], [[0.0, 0.0, 0.0]] * 2, "do not increase"),
        ([0.0, 1.0], [[0.0, 0.0, 0.0]] * 3, "do not match its key times"),
        ([0.0, 1.0], [[0.0, NAN, 0.0]] * 2, "hold NaN or infinity"),
        ([0.0, 1.0], [[0.0, 0.0]] * 2, "type VEC2 where VEC3 is needed"),
    ],
)
def test_broken_animations(builder: GltfBuilder, times: Any, values: Any, words: str) -> None:
    builder.animate(builder.node(mesh=builder.mesh()), "translation", times, values)
    assert words in complaint(builder.write())


def test_animated_weights_of_another_count(builder: GltfBuilder) -> None:
    node = builder.node(mesh=builder.mesh(targets=[{"POSITION": builder.accessor([[1.0, 0.0, 0.0]] * 3)}]))
    builder.animate(node, "weights", [0.0, 1.0], [0.0, 0.0, 1.0, 1.0])
    assert "do not match its 1 morph targets" in complaint(builder.write())


@pytest.mark.parametrize(
    ("joint", "skin", "words"),
    [
        (2, {"joints": [0, 0]}, "names joint 2 but its skin has 2"),
        (0, {"joints": [33]}, "node 33"),
        (0, {"joints": []}, "has no joints"),
        (0, {"joints": [0, 0], "inverseBindMatrices": "one"}, "2 joints but 1 inverse bind matrices"),
    ],
)
def test_broken_skins(builder: GltfBuilder, joint: int, skin: dict[str, Any], words: str) -> None:
    attributes = {
        "JOINTS_0": builder.accessor([[joint, 0, 0, 0]] * 3, "uint8"),
        "WEIGHTS_0": builder.accessor([[1.0, 0.0, 0.0, 0.0]] * 3),
    }
    if "inverseBindMatrices" in skin:
        skin = {**skin, "inverseBindMatrices": builder.accessor(np.eye(4)[None])}
    builder.add("skins", skin)
    builder.node(mesh=builder.mesh(attributes=attributes), skin=0)
    assert words in complaint(builder.write())


def add_extensions(builder: GltfBuilder) -> None:
    """One use of every extension that has numbers of its own."""
    image = builder.add("images", {"uri": "data:image/png;base64,AAAA"})
    transform = {"offset": [0.1, 0.2], "scale": [1.0, 2.0], "rotation": 0.3, "texCoord": 0}
    texture = {
        "index": builder.add("textures", {"source": image, "extensions": {"KHR_texture_basisu": {"source": image}}}),
        "extensions": {"KHR_texture_transform": transform},
    }
    glass = {"transmissionFactor": 0.5, "transmissionTexture": texture}
    gloss = {"diffuseFactor": [1.0, 1.0, 1.0, 1.0], "glossinessFactor": 0.5, "specularGlossinessTexture": texture}
    strength = {"KHR_materials_emissive_strength": {"emissiveStrength": 2.0}}
    materials = [
        {"extensions": {"KHR_materials_transmission": glass, **strength}},
        {"extensions": {"KHR_materials_pbrSpecularGlossiness": gloss}},
    ]
    places = builder.accessor([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    instances = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": places, "SCALE": places}}}
    for entry in materials:
        mesh = builder.mesh(material=builder.add("materials", entry))
        builder.node(mesh=mesh, extensions={**instances, "KHR_node_visibility": {"visible": True}})
    lens = {"xmag": 1.0, "ymag": 1.0, "zfar": 1.0, "znear": 0.1}
    builder.node(camera=builder.add("cameras", {"type": "orthographic", "orthographic": lens}))
    part = {"buffer": 0, "byteOffset": 0, "byteLength": 8, "byteStride": 12, "count": 3, "mode": "ATTRIBUTES"}
    builder.view(bytes(36), extensions={"EXT_meshopt_compression": part})
    draco = {"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}}
    builder.add("meshes", {"primitives": [{"attributes": {"POSITION": 0}, "extensions": draco}]})


def test_random_damage_never_escapes(builder: GltfBuilder) -> None:
    """Any value of the JSON replaced by any other kind: the file loads or is refused in one sentence."""
    attributes = {
        "JOINTS_0": builder.accessor([[0, 0, 0, 0]] * 3, "uint8"),
        "WEIGHTS_0": builder.accessor([[1.0, 0.0, 0.0, 0.0]] * 3),
    }
    material = builder.add("materials", {"emissiveFactor": [1.0, 1.0, 1.0], "alphaMode": "MASK"})
    target = {"POSITION": builder.accessor([[1.0, 0.0, 0.0]] * 3)}
    mesh = builder.mesh(attributes=attributes, material=material, targets=[target])
    builder.add("skins", {"joints": [0]})
    node = builder.node(mesh=mesh, skin=0, children=[], extensions=builder.light(type="spot", color=[1.0, 1.0, 1.0]))
    builder.animate(node, "translation", [0.0, 1.0], [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    add_extensions(builder)
    builder.bytes_of_glb()
    whole = json.dumps(builder.json)

    def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
        items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
        below = [place for key, child in items for place in places(child, (*path, key))]
        return [path, *below] if path else below

    loaded, rng = 0, np.random.default_rng(7)
    everywhere = places(json.loads(whole))
    assert len(everywhere) > 100
    for place in everywhere:
        for value in rng.choice(np.array([None, -1, 10**30, 0.5, 1e308, NAN, "text", [], {}, True], dtype=object), 4):
            builder.json = json.loads(whole)
            set_at(*place, value)(builder.json)
            try:
                loaded += bool(builder.load().objects)
            except LuxelError as error:
                assert "\n" not in str(error)
    assert loaded > 0
