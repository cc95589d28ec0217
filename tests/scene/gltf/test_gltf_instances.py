"""EXT_mesh_gpu_instancing and KHR_node_visibility, by their own specifications."""

from __future__ import annotations

from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from luxel.errors import LuxelError
from luxel.scene.gltf import load_gltf
from luxel.scene.model import Mesh, Object

if TYPE_CHECKING:
    from conftest import GltfBuilder

INSTANCING = "EXT_mesh_gpu_instancing"
TURNS = Rotation.from_euler("xyz", [[10, 20, 30], [-50, 0, 80], [0, 170, 0]], degrees=True)
PLACES = np.array([[1.0, 2.0, 3.0], [-4.0, 0.5, 0.0], [0.0, 0.0, 7.0]])
SIZES = np.array([[1.0, 1.0, 1.0], [2.0, 0.5, 3.0], [0.1, 0.2, 0.3]])


def instances(**accessors: int) -> dict[str, Any]:
    return {INSTANCING: {"attributes": accessors}}


def world(item: Object, mesh: Mesh, time: float = 0.0) -> np.ndarray:
    """(F, 3, 3) corners in world space."""
    matrix = item.to_world if item.motion is None else item.motion(time)
    positions = mesh.positions if item.deform is None else item.deform(time)[0][0]
    return positions[mesh.faces] @ matrix[:3, :3].T + matrix[:3, 3]


def expected(node: np.ndarray, corners: np.ndarray, k: int) -> np.ndarray:
    """The specification: node's global matrix, times translation, rotation and scale of the instance."""
    local = TURNS[k].apply(corners * SIZES[k]) + PLACES[k]
    return local @ node[:3, :3].T + node[:3, 3]


CORNERS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
MATRIX = np.array([[0.0, -2.0, 0.0, 1.0], [2.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, -5.0], [0.0, 0.0, 0.0, 1.0]])


@pytest.mark.parametrize(("dtype", "scale"), [("float32", 1.0), ("int16", 32767.0), ("int8", 127.0)])
@pytest.mark.parametrize("required", [False, True])
def test_instances_stand_about_their_node(builder: GltfBuilder, dtype: str, scale: float, required: bool) -> None:
    turns = np.rint(TURNS.as_quat() * scale) if scale > 1.0 else TURNS.as_quat()
    parts = instances(
        TRANSLATION=builder.accessor(PLACES),
        ROTATION=builder.accessor(turns, dtype, normalized=scale > 1.0),
        SCALE=builder.accessor(SIZES),
    )
    builder.node(mesh=builder.mesh(name="tree"), matrix=MATRIX.T.ravel().tolist(), extensions=parts)
    builder.json["extensionsUsed"] = [INSTANCING]
    if required:
        builder.json["extensionsRequired"] = [INSTANCING]
    data = builder.load()
    assert [item.name for item in data.objects] == ["tree", "tree-2", "tree-3"]
    assert not any("not supported" in warning for warning in data.warnings)
    for k, item in enumerate(data.objects):
        assert item.meshes[0] is data.objects[0].meshes[0], "one mesh, shared"
        error = np.abs(world(item, item.meshes[0])[0] - expected(MATRIX, CORNERS, k)).max()
        assert error < (1e-5 if dtype == "float32" else 3.0 / scale)


def test_places_alone_are_enough(builder: GltfBuilder) -> None:
    builder.node(mesh=builder.mesh(), extensions=instances(TRANSLATION=builder.accessor(PLACES)))
    data = builder.load()
    np.testing.assert_allclose([item.to_world[:3, 3] for item in data.objects], PLACES)


def test_mirrored_instances_keep_their_front(builder: GltfBuilder) -> None:
    normals = builder.accessor([[0.0, 0.0, 1.0]] * 3)
    sizes = builder.accessor([[1.0, 1.0, 1.0], [-1.0, 1.0, 1.0], [-2.0, 2.0, 2.0]])
    builder.node(mesh=builder.mesh(attributes={"NORMAL": normals}), extensions=instances(SCALE=sizes))
    objects = builder.load().objects
    assert objects[1].meshes[0] is objects[2].meshes[0] and objects[0].meshes[0] is not objects[1].meshes[0]
    for item, sign in zip(objects, (1.0, -1.0, -2.0), strict=True):
        assert np.linalg.det(item.to_world[:3, :3]) > 0.0
        corner = world(item, item.meshes[0])[0]
        assert np.cross(corner[1] - corner[0], corner[2] - corner[0])[2] > 0.0
        assert sorted(corner[:, 0].tolist()) == sorted([0.0, 0.0, sign])


def test_instances_of_a_moving_node(builder: GltfBuilder) -> None:
    parts = instances(TRANSLATION=builder.accessor(PLACES))
    node = builder.node(mesh=builder.mesh(), extensions=parts)
    half = np.sqrt(0.5)
    builder.animate(node, "rotation", [0.0, 1.0], [[0.0, 0.0, 0.0, 1.0], [0.0, half, 0.0, half]])
    data = builder.load()
    turn = Rotation.from_euler("y", 90, degrees=True)
    for k, item in enumerate(data.objects):
        assert item.motion is not None
        np.testing.assert_allclose(item.motion(0.0)[:3, 3], PLACES[k], atol=1e-6)
        np.testing.assert_allclose(item.motion(1.0)[:3, 3], turn.apply(PLACES[k]), atol=1e-6)


@pytest.mark.parametrize("size", [1.0, -1.0])
def test_instances_of_a_skinned_mesh(builder: GltfBuilder, size: float) -> None:
    """The skin places the vertices whatever its node does; each instance then moves them by its own matrix."""
    joint = builder.node(translation=[0.0, 10.0, 0.0])
    attributes = {
        "JOINTS_0": builder.accessor([[0, 0, 0, 0]] * 3, "uint8"),
        "WEIGHTS_0": builder.accessor([[1.0, 0.0, 0.0, 0.0]] * 3),
    }
    builder.add("skins", {"joints": [joint]})
    sizes = builder.accessor([[size, 1.0, 1.0]] * 2)
    parts = instances(TRANSLATION=builder.accessor([[5.0, 0.0, 0.0], [0.0, 0.0, 6.0]]), SCALE=sizes)
    builder.node(mesh=builder.mesh(attributes=attributes), skin=0, translation=[99.0, 0.0, 0.0], extensions=parts)
    builder.animate(joint, "translation", [0.0, 1.0], [[0.0, 10.0, 0.0], [0.0, 20.0, 0.0]])
    objects = builder.load().objects
    assert len(objects) == 2
    for item, place in zip(objects, ([5.0, 0.0, 0.0], [0.0, 0.0, 6.0]), strict=True):
        assert np.linalg.det(item.to_world[:3, :3]) > 0.0
        for time, height in ((0.0, 10.0), (1.0, 20.0)):
            corners = world(item, item.meshes[0], time)[0]
            wanted = (CORNERS + [0.0, height, 0.0]) * [size, 1.0, 1.0] + place
            np.testing.assert_allclose(sorted(corners.tolist()), sorted(wanted.tolist()), atol=1e-5)
            assert np.cross(corners[1] - corners[0], corners[2] - corners[0])[2] > 0.0


def test_broken_instances_are_one_sentence(builder: GltfBuilder) -> None:
    places = builder.accessor(PLACES)
    cases = [
        (instances(TRANSLATION=places, SCALE=builder.accessor(SIZES[:2])), "unequal length (TRANSLATION 3, SCALE 2)"),
        (instances(TRANSLATION=builder.accessor([[0.0, np.nan, 0.0]])), "TRANSLATION of node 0 holds NaN"),
        (instances(ROTATION=places), "type VEC3 where VEC4"),
        (instances(TRANSLATION=77), "accessor 77"),
    ]
    node = builder.node(mesh=builder.mesh())
    for extension, words in cases:
        builder.json["nodes"][node]["extensions"] = extension
        builder.json.pop("buffers", None)
        with pytest.raises(LuxelError) as caught:
            builder.load()
        assert words in str(caught.value) and "\n" not in str(caught.value)


def test_other_instance_attributes_are_named(builder: GltfBuilder) -> None:
    places = builder.accessor(PLACES)
    parts = instances(TRANSLATION=places, COLOR_0=places, _ID=places)
    builder.node(mesh=builder.mesh(), extensions=parts)
    warnings = builder.load().warnings
    assert any("COLOR_0" in warning for warning in warnings) and not any("_ID" in warning for warning in warnings)


# --- visibility ----------------------------------------------------------------------------------------------------


def visible(value: Any) -> dict[str, Any]:
    return {"KHR_node_visibility": {"visible": value}}


@pytest.mark.parametrize("required", [False, True])
def test_hidden_nodes_hide_what_is_below(builder: GltfBuilder, required: bool) -> None:
    mesh = builder.mesh()
    lens = builder.add("cameras", {"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.1}})
    lamp = builder.light(type="point")
    leaf = builder.node(root=False, mesh=mesh, name="leaf", extensions=visible(True))
    bulb = builder.node(root=False, name="bulb", extensions=lamp)
    eye = builder.node(root=False, name="eye", camera=lens)
    builder.node(mesh=mesh, name="hidden", children=[leaf, bulb, eye], extensions=visible(False))
    builder.node(mesh=mesh, name="shown", extensions=visible(True))
    builder.node(mesh=mesh, name="plain", extensions={"KHR_node_visibility": {}})
    builder.json["extensionsUsed"] = ["KHR_node_visibility"]
    if required:
        builder.json["extensionsRequired"] = ["KHR_node_visibility"]
    data = builder.load()
    assert [item.name for item in data.objects] == ["shown", "plain"]
    assert data.lights == []
    # "Visibility affects neither cameras, nor node's interactivity features."
    assert [camera.name for camera in data.cameras] == ["eye"]
    assert not any("KHR_node_visibility" in warning for warning in data.warnings)


def test_a_scene_that_is_all_hidden_says_so(builder: GltfBuilder) -> None:
    builder.node(mesh=builder.mesh(), extensions=visible(False))
    with pytest.raises(LuxelError, match="no triangles, as KHR_node_visibility hides its nodes"):
        builder.load()


def test_visibility_must_be_true_or_false(builder: GltfBuilder) -> None:
    builder.node(mesh=builder.mesh(), extensions=visible("no"))
    with pytest.raises(LuxelError, match="visibility of node 0 must be true or false"):
        builder.load()


def test_animated_visibility_is_named(builder: GltfBuilder) -> None:
    node = builder.node(mesh=builder.mesh(), extensions=visible(True))
    builder.animate(node, "translation", [0.0, 1.0], [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    pointer = "/nodes/0/extensions/KHR_node_visibility/visible"
    target = {"path": "pointer", "extensions": {"KHR_animation_pointer": {"pointer": pointer}}}
    builder.json["animations"][0]["channels"].append({"sampler": 0, "target": target})
    builder.json["extensionsUsed"] = builder.json["extensionsRequired"] = ["KHR_animation_pointer"]
    data = builder.load()
    assert len(data.objects) == 1 and data.objects[0].motion is not None
    assert any("Animation of visibility is not supported" in one and pointer in one for one in data.warnings)


def test_pointers_to_places_play(builder: GltfBuilder) -> None:
    node = builder.node(mesh=builder.mesh())
    builder.animate(node, "translation", [0.0, 1.0], [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0]])
    target = {"path": "pointer", "extensions": {"KHR_animation_pointer": {"pointer": "/nodes/0/translation"}}}
    builder.json["animations"][0]["channels"][0]["target"] = target
    (item,) = builder.load().objects
    assert item.motion is not None and item.motion(0.5)[0, 3] == 2.0


# --- many ----------------------------------------------------------------------------------------------------------


def seconds_to_load(builder: GltfBuilder, count: int) -> float:
    builder.json["nodes"] = [{"mesh": 0, "name": "box", "translation": [float(i), 0.0, 0.0]} for i in range(count)]
    builder.json["scenes"][0]["nodes"] = list(range(count))
    path = builder.write()
    start = perf_counter()
    data = load_gltf(path)
    spent = perf_counter() - start
    assert len({item.name for item in data.objects}) == count
    assert len({id(item.meshes[0]) for item in data.objects}) == 1
    return spent


def test_time_grows_with_the_nodes_and_not_with_their_square(builder: GltfBuilder) -> None:
    """All of one name, which must be told apart."""
    builder.mesh()
    few = min(seconds_to_load(builder, 1000) for _ in range(3))
    many = min(seconds_to_load(builder, 16_000) for _ in range(2))
    assert many < 4.0 * 16.0 * few
