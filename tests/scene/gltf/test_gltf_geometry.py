"""Accessors, buffers and primitives: what the file stores is what the meshes hold."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from luxel.scene.gltf import load_gltf
from luxel.scene.gltf.accessors import AccessorReader
from luxel.scene.gltf.document import open_document

if TYPE_CHECKING:
    from conftest import GltfBuilder

PAINT = {"pbrMetallicRoughness": {"metallicFactor": 0.0}}
SQUARE = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]]
FIVE = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 2.0, 0.0]]


def first_mesh(builder: GltfBuilder, *, node: dict[str, Any] | None = None, **primitive: Any) -> Any:
    builder.node(mesh=builder.mesh(**primitive), **(node or {}))
    return builder.load().objects[0].meshes[0]


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "uint32"])
def test_indices_of_every_type(builder: GltfBuilder, dtype: str) -> None:
    mesh = first_mesh(builder, positions=SQUARE, indices=builder.accessor([0, 1, 2, 0, 2, 3], dtype))
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert mesh.faces.dtype == np.uint32
    assert mesh.positions.tolist() == SQUARE
    assert mesh.positions.dtype == np.float32
    assert mesh.normals is None and mesh.uv is None and mesh.uv2 is None and mesh.colors is None


def test_plain_triangles_need_no_indices(builder: GltfBuilder) -> None:
    mesh = first_mesh(builder, positions=[*SQUARE[:3], *SQUARE[1:]])
    assert mesh.faces.tolist() == [[0, 1, 2], [3, 4, 5]]


def test_strip_turns_every_second_triangle(builder: GltfBuilder) -> None:
    mesh = first_mesh(builder, positions=FIVE, mode=5)
    assert mesh.faces.tolist() == [[0, 1, 2], [1, 3, 2], [2, 3, 4]]
    corner = mesh.positions[mesh.faces]
    facing = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    assert (facing[:, 2] > 0.0).all()


def test_indexed_strip_drops_its_joints(builder: GltfBuilder) -> None:
    mesh = first_mesh(builder, positions=FIVE, mode=5, indices=builder.accessor([0, 1, 2, 2, 2, 3, 4], "uint16"))
    # Triangle 4 of the strip, (2, 3, 4), stands at an even place.
    assert mesh.faces.tolist() == [[0, 1, 2], [2, 3, 4]]


def test_fan_shares_its_first_corner(builder: GltfBuilder) -> None:
    mesh = first_mesh(builder, positions=SQUARE, mode=6)
    assert mesh.faces.tolist() == [[1, 2, 0], [2, 3, 0]]


def test_interleaved_attributes(builder: GltfBuilder) -> None:
    rows = [struct.pack("<3f3f2H", *p, 0.0, 0.0, 1.0, 65535 * i // 3, 13107) for i, p in enumerate(SQUARE)]
    view = builder.view(b"".join(rows), byteStride=28)
    common: dict[str, Any] = {"bufferView": view, "count": 4}
    builder.json["accessors"] = [
        {**common, "componentType": 5126, "type": "VEC3"},
        {**common, "componentType": 5126, "type": "VEC3", "byteOffset": 12},
        {**common, "componentType": 5123, "type": "VEC2", "byteOffset": 24, "normalized": True},
    ]
    attributes = {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2}
    builder.node(mesh=builder.add("meshes", {"primitives": [{"attributes": attributes, "mode": 6}]}))
    mesh = builder.load().objects[0].meshes[0]
    assert mesh.positions.tolist() == SQUARE
    assert mesh.normals is not None and mesh.normals.tolist() == [[0.0, 0.0, 1.0]] * 4
    assert mesh.uv is not None
    np.testing.assert_allclose(mesh.uv, [[0.0, 0.2], [1 / 3, 0.2], [2 / 3, 0.2], [1.0, 0.2]], atol=1e-6)


def test_sparse_values_replace_those_of_the_base(builder: GltfBuilder) -> None:
    sparse = {
        "count": 2,
        "indices": {"bufferView": builder.view(bytes([1, 3])), "componentType": 5121},
        "values": {"bufferView": builder.view(np.array([[5, 6, 7], [8, 9, 10]], np.float32).tobytes())},
    }
    mesh = builder.mesh(SQUARE, mode=6)
    builder.json["accessors"][0]["sparse"] = sparse
    builder.node(mesh=mesh)
    positions = builder.load().objects[0].meshes[0].positions
    assert positions.tolist() == [SQUARE[0], [5.0, 6.0, 7.0], SQUARE[2], [8.0, 9.0, 10.0]]


def test_sparse_without_a_base_starts_from_zero(builder: GltfBuilder) -> None:
    sparse = {
        "count": 2,
        "indices": {"bufferView": builder.view(struct.pack("<2H", 1, 2)), "componentType": 5123},
        "values": {"bufferView": builder.view(np.array([[1, 0, 0], [0, 1, 0]], np.float32).tobytes())},
    }
    builder.add("accessors", {"componentType": 5126, "type": "VEC3", "count": 3, "sparse": sparse})
    builder.node(mesh=builder.add("meshes", {"primitives": [{"attributes": {"POSITION": 0}}]}))
    assert builder.load().objects[0].meshes[0].positions.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]]


@pytest.mark.parametrize(
    ("dtype", "stored", "expected"),
    [("uint8", 255, 1.0), ("uint16", 65535, 1.0), ("int8", -128, -1.0), ("int8", 127, 1.0), ("int16", -32768, -1.0)],
)
def test_normalised_integers(builder: GltfBuilder, dtype: str, stored: int, expected: float) -> None:
    values = np.zeros((3, 2), dtype=dtype)
    values[:, 1] = stored
    mesh = first_mesh(builder, attributes={"TEXCOORD_0": builder.accessor(values, dtype, normalized=True)})
    np.testing.assert_allclose(mesh.uv, [[0.0, expected]] * 3, atol=1e-7)


def test_quantised_positions_keep_their_integers(builder: GltfBuilder) -> None:
    positions = builder.accessor([[0, 0, 0], [100, 0, 0], [0, -300, 0]], "int16")
    builder.json["extensionsRequired"] = ["KHR_mesh_quantization"]
    builder.node(mesh=builder.add("meshes", {"primitives": [{"attributes": {"POSITION": positions}}]}))
    data = builder.load()
    assert data.objects[0].meshes[0].positions.tolist() == [[0, 0, 0], [100, 0, 0], [0, -300, 0]]
    assert not any("quantization" in warning for warning in data.warnings)


def test_colours_of_bytes_are_unit_values_even_unmarked(builder: GltfBuilder) -> None:
    colors = builder.accessor([[255, 0, 51, 255], [0, 255, 0, 0], [0, 0, 255, 102]], "uint8")
    mesh = first_mesh(builder, attributes={"COLOR_0": colors})
    np.testing.assert_allclose(mesh.colors, [[1, 0, 0.2, 1], [0, 1, 0, 0], [0, 0, 1, 0.4]], atol=1e-6)


def test_colours_of_three_floats(builder: GltfBuilder) -> None:
    mesh = first_mesh(builder, attributes={"COLOR_0": builder.accessor([[0.5, 2.0, 0.25]] * 3)})
    assert mesh.colors.tolist() == [[0.5, 2.0, 0.25]] * 3


def test_two_coordinate_sets_and_a_warning_for_more(builder: GltfBuilder) -> None:
    attributes = {f"TEXCOORD_{i}": builder.accessor([[float(i), 0.5]] * 3) for i in range(3)}
    attributes["_CUSTOM"] = attributes["TANGENT"] = builder.accessor([[1.0, 0.0, 0.0, 1.0]] * 3)
    builder.node(mesh=builder.mesh(attributes=attributes, material=builder.add("materials", PAINT)))
    data = builder.load()
    mesh = data.objects[0].meshes[0]
    assert mesh.uv is not None and mesh.uv.tolist() == [[0.0, 0.5]] * 3
    assert mesh.uv2 is not None and mesh.uv2.tolist() == [[1.0, 0.5]] * 3
    assert data.warnings == ["The vertex attribute TEXCOORD_2 is not supported and is ignored."]


def test_broken_normals_are_rebuilt(builder: GltfBuilder) -> None:
    normals = builder.accessor([[0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [np.nan, 0.0, 0.0]])
    builder.node(mesh=builder.mesh(attributes={"NORMAL": normals}))
    data = builder.load()
    found = data.objects[0].meshes[0].normals
    assert found is not None and found.tolist() == [[0, 1, 0], [0, 0, 1], [0, 0, 1]]
    assert any("Normals of zero length" in warning for warning in data.warnings)


def test_lines_and_points_are_skipped_with_one_warning(builder: GltfBuilder) -> None:
    builder.node(mesh=builder.mesh(mode=1))
    builder.node(mesh=builder.mesh(mode=0))
    builder.node(mesh=builder.mesh())
    data = builder.load()
    assert [item.name for item in data.objects] == ["node-2"]
    assert sum("Points and lines" in warning for warning in data.warnings) == 1


def test_matrices_of_bytes_have_padded_columns(builder: GltfBuilder) -> None:
    view = builder.view(bytes([1, 2, 0, 0, 3, 4, 0, 0, 5, 6, 0, 0, 7, 8]))
    builder.add("accessors", {"bufferView": view, "componentType": 5121, "count": 2, "type": "MAT2"})
    reader = AccessorReader(open_document(builder.write()))
    assert reader.read_floats(0, ("MAT2",)).tolist() == [[[1, 3], [2, 4]], [[5, 7], [6, 8]]]


@pytest.mark.parametrize("buffer", [None, "plain.bin", "name with space.bin"])
def test_text_files_with_embedded_and_external_buffers(builder: GltfBuilder, buffer: str | None) -> None:
    builder.node(mesh=builder.mesh(SQUARE, mode=6))
    data = load_gltf(builder.write("room.gltf", buffer=buffer))
    assert data.name == "room"
    assert data.objects[0].meshes[0].positions.tolist() == SQUARE


def test_files_are_told_apart_by_content(builder: GltfBuilder) -> None:
    builder.node(mesh=builder.mesh())
    path = builder.write("scene.glb").rename(builder.folder / "scene.gltf")
    assert len(load_gltf(path).objects) == 1


def test_extras_may_hold_anything(builder: GltfBuilder) -> None:
    builder.node(mesh=builder.mesh(), extras=[1, "two"])
    builder.json["asset"]["extras"] = 5
    assert len(builder.load().objects) == 1


def test_one_mesh_on_two_nodes_makes_two_objects(builder: GltfBuilder) -> None:
    mesh = builder.mesh(name="part")
    builder.node(mesh=mesh, translation=[1.0, 2.0, 3.0])
    builder.node(mesh=mesh)
    first, second = builder.load().objects
    assert (first.name, second.name) == ("part", "part-2")
    assert first.to_world[:3, 3].tolist() == [1.0, 2.0, 3.0]
    assert second.to_world.tolist() == np.eye(4).tolist()
    assert first.meshes[0].positions is second.meshes[0].positions


def test_node_tree_multiplies_from_the_root(builder: GltfBuilder) -> None:
    leaf = builder.node(root=False, mesh=builder.mesh(), translation=[1.0, 0.0, 0.0])
    half = float(np.sqrt(0.5))
    # Column-major: a scale of 2 and a shift by (0, 5, 0).
    matrix = [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 0, 5, 0, 1]
    turn = builder.node(root=False, children=[leaf], rotation=[0.0, 0.0, half, half], scale=[3.0, 1.0, 1.0])
    builder.node(children=[turn], matrix=matrix)
    to_world = builder.load().objects[0].to_world
    # x (1) -> scaled (3) -> turned to +y (3) -> doubled and shifted (11).
    np.testing.assert_allclose(to_world @ [0.0, 0.0, 0.0, 1.0], [0.0, 11.0, 0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(to_world[:3, 0], [0.0, 6.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(to_world[:3, 1], [-2.0, 0.0, 0.0], atol=1e-12)


def test_mirrored_nodes_keep_their_front(builder: GltfBuilder) -> None:
    normals = builder.accessor([[0.0, 0.0, 1.0]] * 3)
    builder.node(mesh=builder.mesh(attributes={"NORMAL": normals}), scale=[-2.0, 1.0, 1.0])
    item = builder.load().objects[0]
    mesh = item.meshes[0]
    assert np.linalg.det(item.to_world) > 0.0
    world = mesh.positions @ item.to_world[:3, :3].T
    assert sorted(world.tolist()) == [[-2.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    corner = world[mesh.faces[0]]
    assert np.cross(corner[1] - corner[0], corner[2] - corner[0])[2] > 0.0
    assert mesh.normals is not None and mesh.normals.tolist() == [[0.0, 0.0, 1.0]] * 3


def test_scale_of_zero_stays_invertible(builder: GltfBuilder) -> None:
    builder.node(mesh=builder.mesh(), scale=[0.0, 1.0, 1.0])
    to_world = builder.load().objects[0].to_world
    assert 0.0 < to_world[0, 0] <= 1e-6
    assert np.isfinite(np.linalg.inv(to_world)).all()


def test_only_the_default_scene_is_loaded(builder: GltfBuilder) -> None:
    builder.node(mesh=builder.mesh(), name="first")
    other = builder.node(root=False, mesh=builder.mesh(), name="second")
    builder.json["scenes"].append({"nodes": [other]})
    builder.json["scene"] = 1
    data = builder.load()
    assert [item.name for item in data.objects] == ["second"]
    assert any("2 scenes" in warning for warning in data.warnings)


def test_file_without_scenes_shows_all_nodes(builder: GltfBuilder) -> None:
    builder.node(mesh=builder.mesh())
    builder.node(mesh=builder.mesh())
    del builder.json["scenes"], builder.json["scene"]
    assert len(builder.load().objects) == 2


def test_deep_trees_do_not_recurse(builder: GltfBuilder) -> None:
    below = builder.node(root=False, mesh=builder.mesh())
    for _ in range(3000):
        below = builder.node(root=False, children=[below], translation=[0.0, 1.0, 0.0])
    builder.json["scenes"][0]["nodes"] = [below]
    assert builder.load().objects[0].to_world[1, 3] == 3000.0
