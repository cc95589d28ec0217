"""Triangles as kernels and the host read them, against the meshes that they were made of."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.kernels.transform import carry_normal, determinant, transform_normal, transform_point, transform_vector
from luxel.kernels.triangle import (
    face_vector,
    fetch_triangle,
    interpolate,
    read_normals,
    read_positions,
    read_triangles,
    read_uv,
    read_uv2,
    triangle_count,
)
from luxel.scene.device import Scene, set_time, upload
from luxel.scene.library.shapes import rotation, translation
from luxel.scene.model import Material, Mesh, Object, SceneData

RNG = np.random.default_rng(2)


def patch(count: int, material: int) -> Mesh:
    """Return `count` random triangles that share no vertex, with everything that a vertex may hold."""
    size = 3 * count
    n = RNG.normal(size=(size, 3)).astype(np.float32)
    return Mesh(
        RNG.normal(size=(size, 3)).astype(np.float32),
        np.arange(size, dtype=np.uint32).reshape(-1, 3),
        material,
        normals=n / np.linalg.norm(n, axis=1, keepdims=True),
        uv=RNG.random((size, 2)).astype(np.float32),
        uv2=RNG.random((size, 2)).astype(np.float32),
        colors=RNG.random((size, 4)).astype(np.float32),
    )


PATCHES = [patch(5, 1), patch(7, 0)]


@pytest.fixture(scope="module")
def scene() -> Scene:
    objects = [Object(str(index), [mesh]) for index, mesh in enumerate(PATCHES)]
    return upload(SceneData("patches", objects, [Material(), Material()]))


def whole(name: str) -> np.ndarray:
    """Return what all vertices hold, patch by patch."""
    return np.concatenate([getattr(mesh, name) for mesh in PATCHES])


def test_the_host_reads_what_the_meshes_hold(scene: Scene) -> None:
    rows = read_triangles(scene)
    assert triangle_count(scene) == len(rows.vertices) == 12
    np.testing.assert_array_equal(rows.material, [1] * 5 + [0] * 7)
    np.testing.assert_array_equal(rows.object_id, [1] * 5 + [2] * 7)
    corners = rows.vertices.ravel()
    np.testing.assert_allclose(read_positions(scene)[corners], whole("positions"), rtol=1e-6)
    np.testing.assert_allclose(read_normals(scene)[corners], whole("normals"), atol=1e-6)
    np.testing.assert_array_equal(read_uv(scene)[corners], whole("uv"))
    np.testing.assert_array_equal(read_uv2(scene)[corners], whole("uv2"))


def test_points_are_means_of_their_corners(scene: Scene) -> None:
    """Weights that add up to one, in float64."""
    prim = np.arange(12, dtype=np.uint32)
    weights = RNG.dirichlet((1.0, 1.0, 1.0), 12)
    active = dr.full(mi.Bool, True, 12)
    triangle = fetch_triangle(scene, mi.UInt32(prim), active)
    point = interpolate(scene, triangle, mi.Point2f(*weights[:, 1:].T.astype(np.float32)), active)
    for found, name in (
        (point.position, "positions"), (point.normal, "normals"), (point.uv, "uv"), (point.uv2, "uv2"),
        (point.color, "colors"),
    ):  # fmt: skip
        expected = np.einsum("fk,fkc->fc", weights, whole(name).reshape(12, 3, -1).astype(float))
        np.testing.assert_allclose(np.array(found).T, expected, atol=2e-6, err_msg=name)
    corners = whole("positions").reshape(12, 3, 3).astype(float)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    np.testing.assert_allclose(np.array(face_vector(triangle.positions)).T, normal, atol=1e-5)


def test_matrices_move_points_vectors_and_normals() -> None:
    """Of a moving object that is stretched, turned and mirrored: matrices in float64 say where things go."""
    matrix = translation(1.0, -2.0, 3.0) @ rotation("y", 40.0) @ np.diag([2.0, -0.5, 1.5, 1.0])
    mover = Object("mover", [PATCHES[0]], motion=lambda _: matrix)
    scene = upload(SceneData("moves", [Object("still", [PATCHES[1]]), mover], [Material(), Material()]))
    set_time(scene, 1.0)
    to_world, to_object, index = scene.geometry.to_world, scene.geometry.to_object, mi.UInt32(2)
    v = RNG.normal(size=3)
    unit = v / np.linalg.norm(v)
    np.testing.assert_allclose(
        np.array(transform_point(to_world, index, mi.Point3f(*v.tolist()))).ravel(),
        matrix[:3, :3] @ v + matrix[:3, 3],
        atol=1e-5,
    )
    np.testing.assert_allclose(
        np.array(transform_vector(to_world, index, mi.Vector3f(*v.tolist()))).ravel(), matrix[:3, :3] @ v, atol=1e-5
    )
    there = np.linalg.inv(matrix[:3, :3]).T @ unit
    found = transform_normal(to_object, index, mi.Normal3f(*unit.tolist()))
    np.testing.assert_allclose(np.array(found).ravel(), there / np.linalg.norm(there), atol=1e-5)
    np.testing.assert_allclose(np.array(transform_normal(to_world, index, found)).ravel(), unit, atol=1e-5)
    assert float(np.array(determinant(to_world, index)).item()) == pytest.approx(-1.5, rel=1e-5)
    # And from where it is now to where it was, which was no mirror image.
    before = translation(0.3, 0.0, 2.0) @ rotation("x", -70.0) @ np.diag([1.0, 3.0, 0.7, 1.0])
    tables = mi.Float(np.stack([np.eye(4)[:3], np.eye(4)[:3], before[:3]]).astype(np.float32).ravel())
    for now, was, inverse in ((to_world, before, tables), (tables, matrix, to_world)):
        mine = np.linalg.inv((matrix if now is to_world else before)[:3, :3]).T @ unit
        mine /= np.linalg.norm(mine)
        carried = carry_normal(now, inverse, index, mi.Normal3f(*mine.tolist()))
        there = np.linalg.inv(was[:3, :3]).T @ unit
        np.testing.assert_allclose(np.array(carried).ravel(), there / np.linalg.norm(there), atol=1e-5)
