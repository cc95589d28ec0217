"""Key frames, against SciPy's splines and rotations."""

from __future__ import annotations

import pickle
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation, Slerp

from luxel.scene.gltf.animation import Track
from luxel.scene.gltf.nodes import compose, decompose, rigid
from luxel.scene.model import Object

if TYPE_CHECKING:
    from conftest import GltfBuilder

TIMES = [1.0, 2.0, 4.0]
PLACES = [[0.0, 0.0, 0.0], [2.0, 4.0, 0.0], [2.0, 4.0, 8.0]]


def animated(builder: GltfBuilder, path: str, values: Any, interpolation: str | None, **node: Any) -> Object:
    index = builder.node(mesh=builder.mesh(), **node)
    builder.animate(index, path, TIMES, values, interpolation)
    data = builder.load()
    assert data.duration == 4.0
    return data.objects[0]


def place(item: Object, time: float) -> list[float]:
    assert item.motion is not None
    return item.motion(time)[:3, 3].tolist()


@pytest.mark.parametrize("interpolation", ["LINEAR", None])
def test_linear_places(builder: GltfBuilder, interpolation: str | None) -> None:
    item = animated(builder, "translation", PLACES, interpolation)
    assert place(item, 1.5) == [1.0, 2.0, 0.0]
    assert place(item, 2.5) == [2.0, 4.0, 2.0]
    assert place(item, 2.0) == [2.0, 4.0, 0.0]


def test_times_outside_the_keys_hold_the_ends(builder: GltfBuilder) -> None:
    item = animated(builder, "translation", [[5.0, 0.0, 0.0], *PLACES[1:]], "LINEAR", translation=[9.0, 9.0, 9.0])
    assert place(item, 0.0) == place(item, -3.0) == [5.0, 0.0, 0.0]
    assert place(item, 4.0) == place(item, 100.0) == PLACES[2]
    assert item.to_world[:3, 3].tolist() == [5.0, 0.0, 0.0], "to_world is the pose at time 0, not the one at rest"


def test_steps_hold_until_the_next_key(builder: GltfBuilder) -> None:
    item = animated(builder, "translation", PLACES, "STEP")
    assert place(item, 1.999) == PLACES[0]
    assert place(item, 2.0) == PLACES[1]
    assert place(item, 3.999) == PLACES[1]


def test_cubic_spline_is_hermites(builder: GltfBuilder) -> None:
    rng = np.random.default_rng(1)
    keys = rng.normal(size=(3, 3, 3)).astype(np.float32)  # key, (in-tangent, value, out-tangent), axis
    item = animated(builder, "translation", keys.reshape(9, 3), "CUBICSPLINE")
    for left, time in ((0, 1.3), (1, 2.2), (1, 3.7)):
        tangents = [keys[left, 2], keys[left + 1, 0]]
        spline = CubicHermiteSpline(TIMES[left : left + 2], keys[left : left + 2, 1], tangents)
        np.testing.assert_allclose(place(item, time), spline(time), atol=1e-6)
    np.testing.assert_allclose(place(item, 9.0), keys[2, 1], atol=1e-6)


def test_rotations_are_slerped(builder: GltfBuilder) -> None:
    turns = Rotation.from_euler("xyz", [[0, 0, 0], [80, 20, 0], [-60, 10, 120]], degrees=True)
    values = turns.as_quat() * np.array([[1.0], [-1.0], [1.0]])  # a flipped sign is the same turn
    item = animated(builder, "rotation", values, "LINEAR")
    assert item.motion is not None
    slerp = Slerp(TIMES, turns)
    for time in (1.0, 1.25, 1.9, 2.5, 3.9):
        np.testing.assert_allclose(item.motion(time)[:3, :3], slerp(time).as_matrix(), atol=1e-6)


def test_slerp_of_almost_equal_and_of_opposite_turns() -> None:
    keys = Rotation.from_euler("y", [[0.0], [1e-4], [180.0]], degrees=True).as_quat()
    track = Track(np.array(TIMES), keys, "LINEAR", is_rotation=True)
    np.testing.assert_allclose(track.sample(1.5), Rotation.from_euler("y", 5e-5, degrees=True).as_quat(), atol=1e-9)
    np.testing.assert_allclose(track.sample(3.0), Rotation.from_euler("y", 90.00005, degrees=True).as_quat(), atol=1e-9)


def test_cubic_rotations_stay_unit(builder: GltfBuilder) -> None:
    still = [0.0, 0.0, 0.0, 0.0]
    first, last = [0.0, 0.0, 0.0, 1.0], [0.0, 0.0, float(np.sqrt(0.5)), float(np.sqrt(0.5))]
    item = animated(builder, "rotation", [still, first, still, still, last, still, still, last, still], "CUBICSPLINE")
    assert item.motion is not None
    # Without tangents, halfway is the mean of the two, made a unit quaternion: an eighth of a turn.
    np.testing.assert_allclose(
        item.motion(1.5)[:3, :3], Rotation.from_euler("z", 45, degrees=True).as_matrix(), atol=1e-6
    )


def test_animated_scale_under_a_still_turn(builder: GltfBuilder) -> None:
    half = float(np.sqrt(0.5))
    scales = [[1.0, 1.0, 1.0], [3.0, 1.0, 1.0], [3.0, 1.0, 1.0]]
    item = animated(builder, "scale", scales, "LINEAR", rotation=[0.0, 0.0, half, half], translation=[0.0, 0.0, 7.0])
    assert item.motion is not None
    np.testing.assert_allclose(item.motion(1.5) @ [1.0, 0.0, 0.0, 1.0], [0.0, 2.0, 7.0, 1.0], atol=1e-6)


def test_children_follow_and_strangers_stand(builder: GltfBuilder) -> None:
    child = builder.node(root=False, mesh=builder.mesh(), translation=[0.0, 1.0, 0.0], name="child")
    parent = builder.node(children=[child])
    builder.node(mesh=builder.mesh(), name="stranger")
    builder.animate(parent, "translation", TIMES, PLACES)
    data = builder.load()
    found = {item.name: item for item in data.objects}
    assert place(found["child"], 4.0) == [2.0, 5.0, 8.0]
    assert found["stranger"].motion is None and found["stranger"].deform is None


def test_animated_node_with_a_matrix(builder: GltfBuilder) -> None:
    matrix = compose(np.array([1.0, 2.0, 3.0]), Rotation.from_euler("x", 30, degrees=True).as_quat(), np.full(3, 2.0))
    item = animated(builder, "translation", PLACES, "LINEAR", matrix=matrix.T.reshape(-1).tolist())
    assert item.motion is not None
    expected = matrix.copy()
    expected[:3, 3] = [1.0, 2.0, 0.0]
    np.testing.assert_allclose(item.motion(1.5), expected, atol=1e-6)


def test_decompose_undoes_compose() -> None:
    rng = np.random.default_rng(3)
    for sign in (1.0, -1.0):
        turn = Rotation.random(rng=rng)
        scale = np.array([sign * 2.0, 0.5, 3.0])
        matrix = compose(np.array([1.0, 2.0, 3.0]), turn.as_quat(), scale)
        np.testing.assert_allclose(matrix[:3, :3], turn.as_matrix() * scale, atol=1e-12)
        np.testing.assert_allclose(compose(*decompose(matrix)), matrix, atol=1e-12)


def test_rigid_keeps_place_and_direction_of_any_matrix() -> None:
    sheared = np.eye(4)
    sheared[:3, :3] = [[-2.0, 0.5, 0.0], [0.0, 3.0, 0.0], [0.0, 1.0, 4.0]]  # mirrored, too
    sheared[:3, 3] = [1.0, 2.0, 3.0]
    flat = np.diag([1.0, 1.0, 0.0, 1.0])
    upless = np.eye(4)
    upless[:3, 1] = upless[:3, 2]
    for matrix, backward in ((sheared, [0, 0, 1]), (flat, [0, 0, 1]), (upless, [0, 0, 1])):
        pose = rigid(matrix)
        np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(pose) == pytest.approx(1.0)
        np.testing.assert_allclose(pose[:3, 2], backward, atol=1e-12)
        np.testing.assert_array_equal(pose[:3, 3], matrix[:3, 3])


def test_first_animation_plays_and_the_others_are_named(builder: GltfBuilder) -> None:
    index = builder.node(mesh=builder.mesh())
    builder.animate(index, "translation", TIMES, PLACES)
    sampler = {"input": builder.accessor([0.0, 50.0]), "output": builder.accessor(PLACES[:2])}
    channel = {"sampler": 0, "target": {"node": index, "path": "translation"}}
    builder.add("animations", {"name": "walk", "samplers": [sampler], "channels": [channel]})
    builder.add("animations", {"samplers": [sampler], "channels": [channel]})
    data = builder.load()
    assert data.duration == 4.0
    assert place(data.objects[0], 2.0) == PLACES[1]
    assert "Only the first animation (first) is played; not played: walk, animation 2." in data.warnings


def test_channels_without_a_node_are_ignored(builder: GltfBuilder) -> None:
    index = builder.node(mesh=builder.mesh())
    builder.animate(index, "translation", TIMES, PLACES)
    del builder.json["animations"][0]["channels"][0]["target"]["node"]
    data = builder.load()
    assert data.objects[0].motion is None and data.duration == 0.0


def test_byte_rotations_are_normalised(builder: GltfBuilder) -> None:
    index = builder.node(mesh=builder.mesh())
    builder.animate(index, "rotation", TIMES, [[0.0, 0.0, 0.0, 1.0]] * 3)
    values = builder.accessor([[0, 0, 0, 127], [0, 127, 0, 0], [0, 127, 0, 0]], "int8", normalized=True)
    builder.json["animations"][0]["samplers"][0]["output"] = values
    item = builder.load().objects[0]
    assert item.motion is not None
    np.testing.assert_allclose(item.motion(4.0)[:3, :3], np.diag([-1.0, 1.0, -1.0]), atol=1e-9)


def test_motions_can_be_sent_to_another_process(builder: GltfBuilder) -> None:
    item = pickle.loads(pickle.dumps(animated(builder, "translation", PLACES, "LINEAR")))
    assert place(item, 1.5) == [1.0, 2.0, 0.0]
