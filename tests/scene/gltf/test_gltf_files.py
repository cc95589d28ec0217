"""Real files: counts, bounds and attributes against trimesh, an independent reader."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from luxel.scene.gltf import load_gltf
from luxel.scene.gltf.materials import mean_metallic
from luxel.scene.model import Object, SceneData

FILES = [
    "sponza-crytek/Sponza.gltf",
    "fox/Fox.glb",
    "own-test-scenes/cornell.glb",
    "own-test-scenes/furnace.glb",
    "own-test-scenes/lights.glb",
    "own-test-scenes/two_rooms.glb",
]


def find(folder: Path, name: str) -> Path:
    path = folder / name
    if not path.is_file():
        pytest.skip(f"{name} is not among the real scenes at {folder}")
    return path


def read_independently(path: Path) -> trimesh.Scene:
    scene = trimesh.load_scene(path, process=False, merge_primitives=False, skip_materials=True)
    assert isinstance(scene, trimesh.Scene)
    return scene


def world_triangles(item: Object) -> np.ndarray:
    """(F, 3, 3) corners of an object's triangles in world space at time 0."""
    matrix = item.to_world if item.motion is None else item.motion(0.0)
    corners = [mesh.positions[mesh.faces] for mesh in item.meshes]
    return np.concatenate(corners) @ matrix[:3, :3].T + matrix[:3, 3]


def triangle_count(data: SceneData) -> int:
    return sum(len(mesh.faces) for item in data.objects for mesh in item.meshes)


@pytest.mark.parametrize("name", FILES)
def test_counts_and_bounds(scenes_folder: Path, name: str) -> None:
    path = find(scenes_folder, name)
    data, other = load_gltf(path), read_independently(path)
    geometries = [other.geometry[other.graph[node][1]] for node in other.graph.nodes_geometry]
    meshes = [mesh for item in data.objects for mesh in item.meshes]
    assert len(meshes) == len(geometries)
    assert sorted(len(mesh.faces) for mesh in meshes) == sorted(len(found.faces) for found in geometries)
    assert sum(len(mesh.positions) for mesh in meshes) == sum(len(found.vertices) for found in geometries)
    if any(item.deform for item in data.objects):
        return  # the other reader shows skinned meshes unposed: see the fox below
    found = np.concatenate([world_triangles(item) for item in data.objects])
    expected = other.to_mesh().triangles
    np.testing.assert_allclose(found.min(axis=(0, 1)), other.bounds[0], atol=1e-4)
    np.testing.assert_allclose(found.max(axis=(0, 1)), other.bounds[1], atol=1e-4)

    def area(triangles: np.ndarray) -> float:
        normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        return 0.5 * float(np.linalg.norm(normals, axis=1).sum())

    assert area(found) == pytest.approx(area(expected), rel=1e-5)


def test_sponza(scenes_folder: Path) -> None:
    data = load_gltf(find(scenes_folder, "sponza-crytek/Sponza.gltf"))
    assert triangle_count(data) == 262_267
    assert len(data.materials) == 25
    metals = [material.name for material in data.materials if mean_metallic(material) > 0.5]
    assert len(metals) == 3 and len(data.warnings) == 1 and all(name in data.warnings[0] for name in metals)
    assert data.cameras == [] and data.lights == [] and data.duration == 0.0
    assert sum(material.base_color_texture is None for material in data.materials) == 1
    masked = [material for material in data.materials if material.alpha_mode == "mask"]
    assert len(masked) == 3
    for material in masked:
        assert material.base_color_texture is not None and material.base_color_texture.image.shape[2] == 4
    for mesh in data.objects[0].meshes:
        assert mesh.normals is not None and mesh.uv is not None
        np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=0.02)


def test_fox_runs(scenes_folder: Path) -> None:
    data = load_gltf(find(scenes_folder, "fox/Fox.glb"))
    fox = data.objects[0]
    assert triangle_count(data) == 576
    assert data.duration == pytest.approx(3.4166667)
    assert data.warnings == ["Only the first animation (Survey) is played; not played: Walk, Run."]
    assert fox.deform is not None and fox.motion is None
    poses = [fox.deform(time)[0][0] for time in (0.0, 1.0, 2.0)]
    assert np.abs(poses[0] - poses[1]).max() > 5.0
    np.testing.assert_array_equal(poses[0], fox.meshes[0].positions)
    # A skin bends a body but hardly stretches it: edges keep their length to a tenth in the mean.
    rest = read_independently(find(scenes_folder, "fox/Fox.glb"))
    corners = next(iter(rest.geometry.values())).triangles
    length = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)
    for pose in poses:
        moved = pose[fox.meshes[0].faces]
        ratio = np.linalg.norm(moved[:, 1] - moved[:, 0], axis=1) / length
        assert abs(float(ratio.mean()) - 1.0) < 0.1


def test_lights_and_cameras(scenes_folder: Path) -> None:
    data = load_gltf(find(scenes_folder, "own-test-scenes/lights.glb"))
    point, spot, sun = data.lights
    assert (point.kind, point.color, point.range) == ("point", (40.0, 24.0, 12.0), 12.0)
    assert point.position == (-1.5, 2.5, -2.5)
    np.testing.assert_allclose(spot.direction, [0.0, -1.0, 0.0], atol=1e-9)
    # Turned 50 degrees down, then 120 degrees clockwise about +Y.
    down, turn = np.radians(50.0), np.radians(120.0)
    expected = [np.cos(down) * np.sin(turn), -np.sin(down), -np.cos(down) * np.cos(turn)]
    np.testing.assert_allclose(sun.direction, expected, atol=1e-9)
    assert data.duration == 4.0
    (camera,) = data.cameras
    toward = np.subtract((-0.3, 0.9, -0.6), (5.5, 3.2, 6.0))
    np.testing.assert_allclose(np.subtract(camera.target, camera.eye), toward / np.linalg.norm(toward), atol=1e-6)
    assert [item.name for item in data.objects if item.motion] == ["metal_box"]
    box = next(item for item in data.objects if item.motion)
    assert box.motion is not None
    np.testing.assert_allclose(box.motion(0.5)[:3, 0], [np.sqrt(0.5), 0.0, -np.sqrt(0.5)], atol=1e-6)
