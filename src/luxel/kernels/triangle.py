"""Triangles of the shared buffers: fetch one, and interpolate what its corners hold."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from luxel.scene.device import Scene


@dataclass
class Triangle:
    """A triangle's rows of the shared buffers. Kernels pay only for the fields that they go on to use."""

    corners: list[mi.UInt32]
    """Three vertex numbers."""
    vertices: list[mi.Vector4f]
    """Of each corner: object-space position, u."""
    normals: list[mi.Vector4f]
    """Of each corner: object-space vertex normal (zero: use the triangle's), v."""
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


def fetch_triangle(scene: Scene, prim_id: mi.UInt32, active: mi.Bool) -> Triangle:
    """Return triangle `prim_id`, counted over the whole scene."""
    geometry = scene.geometry
    row = dr.gather(mi.Vector4u, geometry.triangles, prim_id, active)
    corners = [row.x, row.y, row.z]
    return Triangle(
        corners=corners,
        vertices=[dr.gather(mi.Vector4f, geometry.vertices, corner, active) for corner in corners],
        normals=[dr.gather(mi.Vector4f, geometry.normals, corner, active) for corner in corners],
        material=row.w & 0xFFFF,
        object_id=row.w >> 16,
    )


def interpolate(scene: Scene, triangle: Triangle, barycentric: mi.Point2f, active: mi.Bool) -> TrianglePoint:
    """Return the point of `triangle` at the weights `barycentric` of its second and third corner."""
    geometry, features = scene.geometry, scene.features
    weights = (1.0 - barycentric.x - barycentric.y, barycentric.x, barycentric.y)

    def mix(rows: list) -> mi.Vector4f:
        return rows[0] * weights[0] + rows[1] * weights[1] + rows[2] * weights[2]

    vertex, normal = mix(triangle.vertices), mix(triangle.normals)
    uv = mi.Point2f(vertex.w, normal.w)
    uv2 = mi.Point2f(uv)
    if features.uv2:
        uv2 = mi.Point2f(mix([dr.gather(mi.Point2f, geometry.uv2, i, active) for i in triangle.corners]))
    color = mi.Vector4f(1.0)
    if features.colors:
        color = mix([dr.gather(mi.Vector4f, geometry.colors, i, active) for i in triangle.corners])
    return TrianglePoint(
        position=mi.Point3f(vertex.x, vertex.y, vertex.z),
        normal=mi.Normal3f(normal.x, normal.y, normal.z),
        uv=uv,
        uv2=uv2,
        color=color,
        material=triangle.material,
    )
