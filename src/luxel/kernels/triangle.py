"""Triangles of the shared buffers: fetch one, interpolate what its corners hold, or read all of them to the host.

How rows of `Geometry` are packed stands here and where they are made, in `scene/builder.py`.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.scene.device import Scene


@dataclass
class Triangle:
    """A triangle's rows of the shared buffers. Kernels pay only for the fields that they go on to use."""

    corners: list[mi.UInt32]
    """Three vertex numbers."""
    positions: list[mi.Point3f]
    """Of each corner, object space."""
    normals: list[mi.Normal3f]
    """Of each corner: object-space vertex normal (zero: use the triangle's)."""
    uv: list[mi.Point2f]
    """Of each corner: the first texture coordinates."""
    material: mi.UInt32
    object_id: mi.UInt32


@dataclass
class TrianglePoint:
    """What a triangle's corners hold, interpolated at one point of it."""

    position: mi.Point3f
    """Object space."""
    normal: mi.Normal3f
    """Object space, as interpolated: not of unit length, zero where the mesh has no vertex normals."""
    uv: mi.Point2f
    uv2: mi.Point2f
    color: mi.Vector4f
    """Vertex colour and its alpha; ones where the scene has none."""
    material: mi.UInt32


@dataclass
class TriangleRows:
    """All triangles of a scene on the host, in the order of their numbers."""

    vertices: np.ndarray
    """(F, 3) int64: vertex numbers."""
    material: np.ndarray
    """(F,) int64."""
    object_id: np.ndarray
    """(F,) int64, from 1."""


def fetch_triangle(scene: Scene, prim_id: mi.UInt32, active: mi.Bool, *, before: bool = False) -> Triangle:
    """Return triangle `prim_id`, counted over the whole scene; `before`: its positions of one frame ago."""
    geometry = scene.geometry
    row = dr.gather(mi.Vector4u, geometry.triangles, prim_id, active)
    corners = [row.x, row.y, row.z]
    buffer = geometry.vertices_before if before and scene.features.deforming else geometry.vertices
    vertices = [dr.gather(mi.Vector4f, buffer, corner, active) for corner in corners]
    normals = [dr.gather(mi.Vector4f, geometry.normals, corner, active) for corner in corners]
    return Triangle(
        corners=corners,
        positions=[mi.Point3f(v.x, v.y, v.z) for v in vertices],
        normals=[mi.Normal3f(n.x, n.y, n.z) for n in normals],
        uv=[mi.Point2f(v.w, n.w) for v, n in zip(vertices, normals, strict=True)],
        material=row.w & 0xFFFF,
        object_id=row.w >> 16,
    )


def face_vector(corners: list[mi.Point3f]) -> mi.Vector3f:
    """Return the normal of the side on which `corners` go round counter-clockwise, as long as twice the area."""
    return mi.Vector3f(dr.cross(corners[1] - corners[0], corners[2] - corners[0]))


def interpolate(scene: Scene, triangle: Triangle, barycentric: mi.Point2f, active: mi.Bool) -> TrianglePoint:
    """Return the point of `triangle` at the weights `barycentric` of its second and third corner."""
    geometry, features = scene.geometry, scene.features
    weights = (1.0 - barycentric.x - barycentric.y, barycentric.x, barycentric.y)

    def mix(rows: list) -> mi.Vector4f:
        return rows[0] * weights[0] + rows[1] * weights[1] + rows[2] * weights[2]

    uv = mi.Point2f(mix(triangle.uv))
    uv2 = mi.Point2f(uv)
    if features.uv2:
        uv2 = mi.Point2f(mix([dr.gather(mi.Point2f, geometry.uv2, i, active) for i in triangle.corners]))
    color = mi.Vector4f(1.0)
    if features.colors:
        color = mix([dr.gather(mi.Vector4f, geometry.colors, i, active) for i in triangle.corners])
    return TrianglePoint(
        position=mi.Point3f(mix(triangle.positions)),
        normal=mi.Normal3f(mix(triangle.normals)),
        uv=uv,
        uv2=uv2,
        color=color,
        material=triangle.material,
    )


def triangle_count(scene: Scene) -> int:
    """Return how many triangles the scene has."""
    return dr.width(scene.geometry.triangles) // 4


def read_triangles(scene: Scene) -> TriangleRows:
    """Return the rows of all triangles."""
    rows = np.array(scene.geometry.triangles).reshape(-1, 4).astype(np.int64)
    return TriangleRows(vertices=rows[:, :3], material=rows[:, 3] & 0xFFFF, object_id=rows[:, 3] >> 16)


def read_positions(scene: Scene) -> np.ndarray:
    """Return the positions (V, 3) float32 of all vertices, object space; measured from the scene's origin."""
    return np.array(scene.geometry.vertices).reshape(-1, 4)[:, :3]


def read_normals(scene: Scene) -> np.ndarray:
    """Return the normals (V, 3) float32 of all vertices, object space; zero: use the triangle's."""
    return np.array(scene.geometry.normals).reshape(-1, 4)[:, :3]


def read_uv(scene: Scene) -> np.ndarray:
    """Return the first texture coordinates (V, 2) float32 of all vertices."""
    geometry = scene.geometry
    return np.stack([np.array(rows).reshape(-1, 4)[:, 3] for rows in (geometry.vertices, geometry.normals)], axis=1)


def read_uv2(scene: Scene) -> np.ndarray:
    """Return the light map coordinates (V, 2) float32 of all vertices; one row where the scene has none."""
    return np.array(scene.geometry.uv2).reshape(-1, 2)
