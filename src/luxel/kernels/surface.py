"""From a triangle and barycentric weights to everything shading needs there.

The work is lazy: a kernel pays only for the fields of `Surface` that it goes on to use.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.kernels.material import diffuse_albedo, emitted_radiance, fetch_factors, fetch_flags, fetch_slots
from luxel.kernels.ray_origin import clear_of_corners, clear_when_placed, find_way_clear
from luxel.kernels.records import Surface
from luxel.kernels.surface_bsdf import bsdf_at
from luxel.kernels.texture import fetch_texture
from luxel.kernels.trace import Hit
from luxel.kernels.transform import carry_normal, transform_normal, transform_point, transform_vector
from luxel.kernels.triangle import Triangle, TrianglePoint, face_vector, fetch_triangle, interpolate
from luxel.scene.arrays import vectors_from_numpy
from luxel.scene.device import Scene
from luxel.scene.textures import FLAG_REFLECT_BACK


def surface_at_hit(scene: Scene, hit: Hit, direction: mi.Vector3f) -> Surface:
    """Return the surface where a ray along `direction` (unit, world) hit."""
    return surface_at(scene, hit.prim_id, hit.barycentric, hit.valid, wo=-direction)


def surface_at(
    scene: Scene, prim_id: mi.UInt32, barycentric: mi.Point2f, active: mi.Bool, wo: mi.Vector3f | None = None,
    *, back: mi.Bool | bool = False,
) -> Surface:  # fmt: skip
    """Return the surface at given points of triangles, seen along `wo`; where `wo` is None, from straight in front.

    `back`: there, from straight behind instead.
    """
    triangle = fetch_triangle(scene, prim_id, active)
    point = interpolate(scene, triangle, barycentric, active)
    placed = _place(scene, triangle, *_normals_at(scene, triangle, point, active), active)

    # Turn both normals to the viewer's side, and move the point clear of its triangle there.
    front = ~mi.Bool(back) if wo is None else dr.dot(placed.n_face, wo) >= 0.0
    n_geometric = dr.select(front, placed.n_face, -placed.n_face)
    p, p_object = _clear_point(scene, triangle, point, placed, barycentric, n_geometric, active)
    wo = mi.Vector3f(n_geometric) if wo is None else wo
    # Vertex normals that oppose their own triangle (a common modelling fault) follow the triangle.
    agrees = dr.dot(placed.n_smooth, n_geometric) >= 0.0

    albedo = diffuse_albedo(scene, point, front, active)
    return Surface(
        p=p,
        p_object=p_object,
        n_geometric=n_geometric,
        n_shading=dr.select(agrees, placed.n_smooth, -placed.n_smooth),
        wo=wo,
        object_id=dr.select(active, triangle.object_id, 0),
        prim_id=prim_id,
        barycentric=barycentric,
        uv=point.uv,
        uv2=point.uv2,
        albedo=albedo,
        emission=emitted_radiance(scene, point, front, active),
        bsdf=bsdf_at(scene, point, albedo, active),
        front=front,
        active=active,
    )


@dataclass
class _Placed:
    """A triangle and its normals at a point, in the world."""

    corners: list[mi.Point3f]
    n_face: mi.Normal3f
    n_smooth: mi.Normal3f
    double_area: mi.Float
    clear: mi.Float
    """Metres that keep a point clear of it."""


def _normals_at(
    scene: Scene, triangle: Triangle, point: TrianglePoint, active: mi.Bool
) -> tuple[mi.Normal3f, mi.Normal3f, mi.Float]:
    """Return unit normals of triangle and surface, the latter turned by the normal map, and twice the area.

    In the space of the object.
    """
    face = mi.Normal3f(face_vector(triangle.positions))
    area = dr.norm(face)
    n_face = face / dr.fmax(area, 1e-30)
    length = dr.squared_norm(point.normal)
    n_smooth = dr.select(length > 1e-12, point.normal * dr.rsqrt(dr.fmax(length, 1e-12)), n_face)
    if scene.materials.has_normal:
        row = fetch_slots(scene, triangle.material, active).z
        scale = fetch_factors(scene, triangle.material, 3, active).x
        turned = _normal_map(scene, row, scale, point, triangle, n_smooth, active)
        n_smooth = dr.select(active & (row != 0), turned, n_smooth)
    return n_face, n_smooth, area


def _place(
    scene: Scene, triangle: Triangle, n_face: mi.Normal3f, n_smooth: mi.Normal3f, area: mi.Float, active: mi.Bool
) -> _Placed:
    """Bring triangle and normals to world space: moving objects only, the others were baked."""
    corners, owner, geometry = triangle.positions, triangle.object_id, scene.geometry
    if not scene.features.moving:
        return _Placed(corners, n_face, n_smooth, area, clear_of_corners(corners))
    placed = [transform_point(geometry.to_world, owner, corner, active) for corner in corners]
    return _Placed(
        placed,
        transform_normal(geometry.to_object, owner, n_face, active),
        transform_normal(geometry.to_object, owner, n_smooth, active),
        dr.norm(face_vector(placed)),
        clear_when_placed(geometry.to_world, owner, corners, active),
    )


def _clear_point(
    scene: Scene,
    triangle: Triangle,
    point: TrianglePoint,
    placed: _Placed,
    barycentric: mi.Point2f,
    n: mi.Normal3f,
    active: mi.Bool,
) -> tuple[mi.Point3f, mi.Point3f]:
    """Return the point moved clear of its triangle on the side of `n`, in the world and in its object's space.

    Where objects move, their space keeps it.
    """
    way = find_way_clear(placed.corners, barycentric, n, placed.double_area, placed.clear)
    if not scene.features.moving:
        p = mi.Point3f(point.position + way)
        return p, p
    way = transform_vector(scene.geometry.to_object, triangle.object_id, way, active)
    p_object = mi.Point3f(point.position + way)
    return transform_point(scene.geometry.to_world, triangle.object_id, p_object, active), p_object


def _normal_map(scene, row, scale, point, triangle, n_smooth, active):  # noqa: ANN001, ANN202
    """Return the object-space normal that the map gives, in the tangent frame of the texture coordinates."""
    texel = fetch_texture(scene.materials, row, point.uv, point.uv2, active)
    a, b, c = triangle.positions
    edge_1, edge_2 = mi.Vector3f(b - a), mi.Vector3f(c - a)
    local = mi.Vector3f((2.0 * texel.x - 1.0) * scale, (2.0 * texel.y - 1.0) * scale, 2.0 * texel.z - 1.0)
    du1, dv1 = triangle.uv[1] - triangle.uv[0]
    du2, dv2 = triangle.uv[2] - triangle.uv[0]
    determinant = du1 * dv2 - du2 * dv1
    usable = dr.abs(determinant) > 1e-20
    tangent = (edge_1 * dv2 - edge_2 * dv1) * dr.mulsign(mi.Float(1.0), determinant)
    bitangent_side = (edge_2 * du1 - edge_1 * du2) * dr.mulsign(mi.Float(1.0), determinant)
    tangent -= n_smooth * dr.dot(n_smooth, tangent)
    tangent *= dr.rsqrt(dr.fmax(dr.squared_norm(tangent), 1e-36))
    bitangent = dr.cross(mi.Vector3f(n_smooth), tangent)
    # glTF: +v of the image points down, +green of the map points up.
    bitangent = dr.select(dr.dot(bitangent, bitangent_side) > 0.0, -bitangent, bitangent)
    turned = mi.Normal3f(tangent * local.x + bitangent * local.y + mi.Vector3f(n_smooth) * local.z)
    length = dr.squared_norm(turned)
    return dr.select(usable & (length > 1e-12), turned * dr.rsqrt(dr.fmax(length, 1e-12)), n_smooth)


def previous_position(scene: Scene, surface: Surface) -> mi.Point3f:
    """Return where the points of `surface` were one frame ago, world space (for motion vectors)."""
    if not scene.features.moving:
        return surface.p
    before = surface.p_object
    if scene.features.deforming:
        triangle = fetch_triangle(scene, surface.prim_id, surface.active, before=True)
        before = interpolate(scene, triangle, surface.barycentric, surface.active).position
    return transform_point(scene.geometry.to_world_before, surface.object_id, before, surface.active)


def previous_normal(scene: Scene, surface: Surface, n: mi.Normal3f) -> mi.Normal3f:
    """Return what unit normals `n` of `surface` were one frame ago, world space.

    Objects turn and stretch them; what an object's own deforming does to them in a frame is left out.
    """
    if not scene.features.moving:
        return n
    geometry = scene.geometry
    return carry_normal(geometry.to_world, geometry.to_world_before, surface.object_id, n, surface.active)


def reflects_back(scene: Scene, prim_id: mi.UInt32, active: mi.Bool) -> mi.Bool:
    """Return whether the triangles' backs reflect, whatever their colour."""
    material = fetch_triangle(scene, prim_id, active).material
    return (fetch_flags(scene, material, active) & FLAG_REFLECT_BACK) != 0


def free_surface(points: np.ndarray, normals: np.ndarray) -> Surface:
    """Return free points as surfaces: (N, 3) world positions and unit normals, no object, albedo one."""
    p = vectors_from_numpy(mi.Point3f, points)
    n = vectors_from_numpy(mi.Normal3f, normals)
    return Surface.at(p, n, active=dr.full(mi.Bool, True, len(points)))
