"""Skins and morph targets, against their definition vertex by vertex."""

from __future__ import annotations

import pickle
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from luxel.scene.model import Object

if TYPE_CHECKING:
    from conftest import GltfBuilder

POSITIONS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
HALF = float(np.sqrt(0.5))


def vertices(item: Object, time: float) -> np.ndarray:
    assert item.deform is not None
    positions, _ = item.deform(time)[0]
    assert positions.dtype == np.float32
    return positions


def influences(builder: GltfBuilder, joints: Any, weights: Any, number: int = 0) -> dict[str, int]:
    return {
        f"JOINTS_{number}": builder.accessor(joints, "uint8"),
        f"WEIGHTS_{number}": builder.accessor(weights),
    }


def test_skin_blends_its_joints(builder: GltfBuilder) -> None:
    """Vertex 0 follows joint 0, vertex 1 joint 1, vertex 2 half of each; the node's own transform is ignored."""
    rng = np.random.default_rng(5)
    bind = np.tile(np.eye(4), (2, 1, 1))
    bind[:, :3, :3] = Rotation.random(2, rng=rng).as_matrix()
    bind[:, :3, 3] = rng.normal(size=(2, 3))
    attributes = influences(
        builder, [[0, 9, 9, 9], [1, 0, 0, 0], [0, 1, 0, 0]], [[1, 0, 0, 0], [1, 0, 0, 0], [0.5, 0.5, 0, 0]]
    )
    mesh = builder.mesh(POSITIONS, attributes=attributes)
    tip = builder.node(root=False, translation=[0.0, 2.0, 0.0])
    base = builder.node(children=[tip], rotation=[0.0, 0.0, HALF, HALF], translation=[3.0, 0.0, 0.0])
    builder.add("skins", {"joints": [base, tip], "inverseBindMatrices": builder.accessor(bind)})
    builder.node(mesh=mesh, skin=0, translation=[100.0, 100.0, 100.0])
    builder.animate(tip, "translation", [0.0, 2.0], [[0.0, 2.0, 0.0], [0.0, 6.0, 0.0]])
    data = builder.load()
    item = data.objects[0]
    assert data.duration == 2.0
    assert item.motion is None and item.to_world.tolist() == np.eye(4).tolist()
    world_base = np.eye(4)
    world_base[:3, :3] = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    world_base[:3, 3] = [3.0, 0.0, 0.0]
    for time, height in ((0.0, 2.0), (1.0, 4.0), (2.0, 6.0)):
        local_tip = np.eye(4)
        local_tip[1, 3] = height
        joints = np.array([world_base, world_base @ local_tip]) @ bind.astype(np.float32)
        blends = np.array([joints[0], joints[1], 0.5 * (joints[0] + joints[1])])
        expected = np.einsum("vij,vj->vi", blends[:, :3], np.c_[POSITIONS, np.ones(3)])
        np.testing.assert_allclose(vertices(item, time), expected, atol=1e-5)
    np.testing.assert_allclose(item.meshes[0].positions, vertices(item, 0.0))
    np.testing.assert_allclose(vertices(pickle.loads(pickle.dumps(item)), 1.0), vertices(item, 1.0))


def test_skin_with_eight_influences(builder: GltfBuilder) -> None:
    count = 6
    joints = [builder.node(translation=[float(10**k), 0.0, 0.0]) for k in range(count)]
    weights = np.array([0.1, 0.1, 0.1, 0.2, 0.2, 0.3])
    attributes = {
        **influences(builder, [[0, 1, 2, 3]] * 3, [weights[:4].tolist()] * 3),
        **influences(builder, [[4, 5, 0, 0]] * 3, [[*weights[4:].tolist(), 0.0, 0.0]] * 3, number=1),
    }
    builder.add("skins", {"joints": joints})
    builder.node(mesh=builder.mesh(POSITIONS, attributes=attributes), skin=0)
    item = builder.load().objects[0]
    assert item.deform is None, "nothing moves: the pose is baked"
    shift = float((weights * 10.0 ** np.arange(count)).sum())
    np.testing.assert_allclose(item.meshes[0].positions, POSITIONS + [shift, 0.0, 0.0], rtol=1e-6)


def test_weights_are_made_to_sum_to_one(builder: GltfBuilder) -> None:
    joints = [builder.node(translation=[4.0, 0.0, 0.0]), builder.node()]
    weights = [[0.2, 0.2, 0, 0], [0, 0, 0, 0], [1.0, 0, 0, 0]]
    attributes = influences(builder, [[0, 1, 0, 0], [0, 1, 0, 0], [1, 0, 0, 0]], weights)
    builder.add("skins", {"joints": joints})
    builder.node(mesh=builder.mesh(POSITIONS, attributes=attributes), skin=0)
    moved = builder.load().objects[0].meshes[0].positions - POSITIONS
    np.testing.assert_allclose(moved[:, 0], [2.0, 4.0, 0.0], atol=1e-6)


def test_skin_weights_of_normalised_bytes(builder: GltfBuilder) -> None:
    joints = [builder.node(translation=[5.0, 0.0, 0.0]), builder.node()]
    attributes = {
        "JOINTS_0": builder.accessor([[0, 1, 0, 0]] * 3, "uint16"),
        "WEIGHTS_0": builder.accessor([[51, 204, 0, 0]] * 3, "uint8", normalized=True),
    }
    builder.add("skins", {"joints": joints})
    builder.node(mesh=builder.mesh(POSITIONS, attributes=attributes), skin=0)
    np.testing.assert_allclose(builder.load().objects[0].meshes[0].positions[0], [1.0, 0.0, 0.0], atol=1e-6)


def test_skinned_normals_stay_at_right_angles(builder: GltfBuilder) -> None:
    """A plane x + z = 0 stretched by 3 in x has the normal (1, 0, 3), not (3, 0, 1)."""
    plane = [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, -1.0]]
    attributes = influences(builder, [[0, 0, 0, 0]] * 3, [[1, 0, 0, 0]] * 3)
    attributes["NORMAL"] = builder.accessor([[HALF, 0.0, HALF]] * 3)
    builder.add("skins", {"joints": [builder.node(scale=[3.0, 1.0, 1.0])]})
    builder.node(mesh=builder.mesh(plane, attributes=attributes), skin=0)
    mesh = builder.load().objects[0].meshes[0]
    assert mesh.normals is not None
    np.testing.assert_allclose(mesh.normals, [np.array([1.0, 0.0, 3.0]) / np.sqrt(10.0)] * 3, atol=1e-6)


def test_mirroring_joints_turn_the_triangles(builder: GltfBuilder) -> None:
    attributes = influences(builder, [[0, 0, 0, 0]] * 3, [[1, 0, 0, 0]] * 3)
    attributes["NORMAL"] = builder.accessor([[0.0, 0.0, 1.0]] * 3)
    builder.add("skins", {"joints": [builder.node(scale=[-1.0, 1.0, 1.0])]})
    builder.node(mesh=builder.mesh(POSITIONS, attributes=attributes), skin=0)
    mesh = builder.load().objects[0].meshes[0]
    corner = mesh.positions[mesh.faces[0]]
    assert np.cross(corner[1] - corner[0], corner[2] - corner[0])[2] > 0.0
    assert mesh.normals is not None and mesh.normals[:, 2].tolist() == [1.0, 1.0, 1.0]


def test_primitive_without_joints_follows_its_node(builder: GltfBuilder) -> None:
    builder.add("skins", {"joints": [builder.node(translation=[50.0, 0.0, 0.0])]})
    builder.node(mesh=builder.mesh(POSITIONS), skin=0, translation=[0.0, 7.0, 0.0])
    np.testing.assert_allclose(builder.load().objects[0].meshes[0].positions, POSITIONS + [0.0, 7.0, 0.0])


def morphing(builder: GltfBuilder, **mesh: Any) -> int:
    """A mesh with two targets: one lifts vertex 2 by 1 in y, one moves all by 2 in z and leans the normals."""
    lift = builder.accessor([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    push, lean = builder.accessor([[0.0, 0.0, 2.0]] * 3), builder.accessor([[1.0, 0.0, 0.0]] * 3)
    normal = builder.accessor([[0.0, 0.0, 1.0]] * 3)
    targets = [{"POSITION": lift}, {"POSITION": push, "NORMAL": lean}]
    index = builder.mesh(POSITIONS, attributes={"NORMAL": normal}, targets=targets)
    builder.json["meshes"][index].update(mesh)
    return index


@pytest.mark.parametrize("place", ["mesh", "node", "both"])
def test_still_weights_are_applied(builder: GltfBuilder, place: str) -> None:
    weights = {"weights": [0.5, 1.0]}
    in_mesh = {} if place == "node" else weights if place == "mesh" else {"weights": [9.0, 9.0]}
    node = builder.node(mesh=morphing(builder, **in_mesh))
    builder.json["nodes"][node].update({} if place == "mesh" else weights)
    item = builder.load().objects[0]
    assert item.deform is None
    np.testing.assert_allclose(item.meshes[0].positions, [[0, 0, 2], [1, 0, 2], [0, 1.5, 2]])
    assert item.meshes[0].normals is not None
    np.testing.assert_allclose(item.meshes[0].normals, [[HALF, 0.0, HALF]] * 3, atol=1e-6)


def test_morphs_without_weights_leave_the_base(builder: GltfBuilder) -> None:
    builder.node(mesh=morphing(builder))
    np.testing.assert_allclose(builder.load().objects[0].meshes[0].positions, POSITIONS)


def test_animated_weights_stay_in_object_space(builder: GltfBuilder) -> None:
    node = builder.node(mesh=morphing(builder), translation=[10.0, 0.0, 0.0])
    builder.animate(node, "weights", [0.0, 1.0, 3.0], [0.0, 0.0, 1.0, 0.0, 1.0, 1.0])
    item = builder.load().objects[0]
    assert item.motion is None and item.to_world[0, 3] == 10.0
    np.testing.assert_allclose(vertices(item, 0.25)[2], [0.0, 1.25, 0.0])
    np.testing.assert_allclose(vertices(item, 2.0), [[0, 0, 1], [1, 0, 1], [0, 2, 1]])
    np.testing.assert_allclose(vertices(item, 30.0)[1], [1.0, 0.0, 2.0])


def test_cubic_weights(builder: GltfBuilder) -> None:
    node = builder.node(mesh=morphing(builder))
    # Two keys, each with in-tangents, values and out-tangents of both targets.
    keys = [[0, 0], [0, 0], [1, 0], [0, 0], [1, 2], [0, 0]]
    builder.animate(node, "weights", [0.0, 2.0], np.reshape(keys, -1), "CUBICSPLINE")
    item = builder.load().objects[0]
    # Halfway: (start + end) / 2 + span / 8 * (out-tangent - in-tangent) = 0.5 + 0.25, and 1.
    np.testing.assert_allclose(vertices(item, 1.0)[2], [0.0, 1.75, 2.0], atol=1e-6)


def test_skinned_mesh_is_morphed_first(builder: GltfBuilder) -> None:
    mesh = morphing(builder, weights=[0.0, 1.0])
    attributes = influences(builder, [[0, 0, 0, 0]] * 3, [[1, 0, 0, 0]] * 3)
    builder.json["meshes"][mesh]["primitives"][0]["attributes"].update(attributes)
    builder.add("skins", {"joints": [builder.node(rotation=[0.0, HALF, 0.0, HALF])]})
    builder.node(mesh=mesh, skin=0)
    # The push by 2 in z turns to 2 in x, and x to -z.
    np.testing.assert_allclose(
        builder.load().objects[0].meshes[0].positions, [[2, 0, 0], [2, 0, -1], [2, 1, 0]], atol=1e-6
    )


def test_mirrored_morph_moves_in_the_mirror(builder: GltfBuilder) -> None:
    push = builder.accessor([[1.0, 0.0, 0.0]] * 3)
    node = builder.node(mesh=builder.mesh(POSITIONS, targets=[{"POSITION": push}]), scale=[-1.0, 1.0, 1.0])
    builder.animate(node, "weights", [0.0, 1.0], [0.0, 1.0])
    item = builder.load().objects[0]
    world = vertices(item, 1.0) @ item.to_world[:3, :3].T
    np.testing.assert_allclose(world, [[-1, 0, 0], [-2, 0, 0], [-1, 1, 0]])


def test_morphs_of_coordinates_are_named(builder: GltfBuilder) -> None:
    target = {"POSITION": builder.accessor(POSITIONS), "TEXCOORD_0": builder.accessor([[0.0, 0.0]] * 3)}
    builder.node(mesh=builder.mesh(POSITIONS, targets=[target]))
    assert any("TEXCOORD_0" in warning for warning in builder.load().warnings)
