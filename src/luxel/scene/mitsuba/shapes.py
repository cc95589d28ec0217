"""Mitsuba's shapes as triangles whose fronts are Mitsuba's, with its uv and its colours per vertex or face."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.errors import LuxelError
from luxel.scene.arrays import from_numpy, vectors_from_numpy
from luxel.scene.library.shapes import cylinder, make_mesh, rotation, transformed
from luxel.scene.model import Mesh
from luxel.scene.rounding import twin_gaps_in_places


def convert_shape(shape: Any) -> Mesh | None:
    """Return the shape's triangles in world space, none where it has no extent; None for an unknown type."""
    if shape.is_mesh():
        return read_mesh(shape)
    maker = ANALYTIC_SHAPES.get(shape.class_name())
    if maker is None:
        return None
    matrix = np.array(mi.traverse(shape)["to_world"].matrix, float).reshape(4, 4)
    if shape.class_name() == "Sphere":
        # It stays round, with the length of the first axis for its radius.
        lengths = np.linalg.norm(matrix[:3, :3], axis=0)
        matrix[:3, :3] *= lengths[0] / np.maximum(lengths, 1e-30)
    if not abs(np.linalg.det(matrix[:3, :3])) > 0.0:
        return Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32))
    mesh = transformed(maker(), matrix)
    # Mirrors and `flip_normals` mean another thing to each type, so the shape itself is asked.
    return mesh if _fronts_agree(shape, mesh) else turn_inside_out(mesh)


def read_mesh(shape: Any) -> Mesh:
    """Return a Mitsuba mesh's arrays as a `Mesh` in world space. The one place that knows their names.

    Mitsuba takes the front from the vertex normals where there are any, so triangles wound against them are turned.
    """
    positions = np.array(shape.vertex_positions_buffer(), np.float32).reshape(-1, 3)
    faces = np.array(shape.faces_buffer(), np.uint32).reshape(-1, 3)
    if faces.max(initial=0) >= max(len(positions), 1):
        raise LuxelError(f"Mesh '{shape.id()}' names vertex {faces.max()} of {len(positions)}; export it again.")
    smooth = shape.has_vertex_normals() and not shape.has_face_normals()
    normals = np.array(shape.vertex_normals_buffer(), np.float32) if smooth else None
    uv = np.array(shape.vertex_texcoords_buffer(), np.float32) if shape.has_vertex_texcoords() else None
    mesh = make_mesh(positions, faces, 0, normals=normals, uv=uv)
    if shape.has_flipped_normals():
        mesh = turn_inside_out(mesh)
    if mesh.normals is not None:
        mesh.faces = _wind_by_normals(mesh.positions, mesh.faces, mesh.normals)
    return mesh


def turn_inside_out(mesh: Mesh) -> Mesh:
    """Turn the front of `mesh` to its other side, in place; return it."""
    mesh.faces = np.ascontiguousarray(mesh.faces[:, ::-1])
    mesh.normals = None if mesh.normals is None else -mesh.normals
    return mesh


def make_back(mesh: Mesh, material: int, places: list[np.ndarray]) -> Mesh:
    """Return a copy that faces the other way and stands a hair behind, for a back of another material.

    The hair is as wide as rounding makes it where the matrices (4, 4) `places` put the mesh.
    """
    faces = mesh.faces.astype(np.int64)
    corners = mesh.positions[faces].astype(float)
    face_normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.zeros((len(mesh.positions), 3))
    for corner in range(3):
        np.add.at(inward, faces[:, corner], -face_normals)
    inward /= np.maximum(np.linalg.norm(inward, axis=1, keepdims=True), 1e-30)
    gaps = twin_gaps_in_places(mesh.positions, mesh.faces, inward, places)
    moved = (mesh.positions + inward * gaps[:, None]).astype(np.float32)
    return turn_inside_out(replace(mesh, positions=moved, material=material))


def corner_interactions(shape: Any, faces: np.ndarray) -> Any:
    """Return Mitsuba surface interactions at the three corners of all faces (3 F), seen from straight in front."""
    index = np.repeat(np.arange(len(faces), dtype=np.uint32), 3)
    b = np.tile(np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)], np.float32), (len(faces), 1))
    hit = dr.zeros(mi.PreliminaryIntersection3f, len(index))
    hit.t = mi.Float(1.0)
    hit.prim_index = from_numpy(mi.UInt32, index)
    hit.prim_uv = vectors_from_numpy(mi.Point2f, b)
    hit.shape = mi.ShapePtr(shape)
    si = shape.compute_surface_interaction(dr.zeros(mi.Ray3f, len(index)), hit, mi.RayFlags.All)
    si.t, si.prim_index, si.shape = mi.Float(1.0), hit.prim_index, mi.ShapePtr(shape)
    si.wi = mi.Vector3f(0.0, 0.0, 1.0)
    return si


def split_corners(mesh: Mesh) -> Mesh:
    """Return the mesh with three vertices of its own for each triangle."""
    order = mesh.faces.ravel().astype(np.int64)
    return replace(
        mesh,
        positions=mesh.positions[order],
        faces=np.arange(len(order), dtype=np.uint32).reshape(-1, 3),
        normals=None if mesh.normals is None else mesh.normals[order],
        uv=None if mesh.uv is None else mesh.uv[order],
    )


def _wind_by_normals(positions: np.ndarray, faces: np.ndarray, normals: np.ndarray) -> np.ndarray:
    corners = positions[faces].astype(float)
    wound = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    against = (wound * normals[faces].astype(float).sum(axis=1)).sum(axis=1) < 0.0
    return np.ascontiguousarray(np.where(against[:, None], faces[:, ::-1], faces))


def _fronts_agree(shape: Any, mesh: Mesh) -> bool:
    """Return whether the middle of the first triangles face to where Mitsuba's shading normals point."""
    corners = mesh.positions[mesh.faces[:16]].astype(float)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1)
    corners, normal = corners[length > 0.0], normal[length > 0.0] / length[length > 0.0, None]
    if not len(normal):
        return True
    reach = 0.2 * math.sqrt(float(length.max()))
    start = (corners.mean(axis=1) + normal * reach).astype(np.float32)
    origin = vectors_from_numpy(mi.Point3f, start)
    way = vectors_from_numpy(mi.Vector3f, -normal)
    si = shape.ray_intersect(mi.Ray3f(origin, way))
    agreement = np.einsum("ij,ij->i", np.array(si.sh_frame.n).T.astype(float), normal)
    return float(np.where(np.isfinite(np.array(si.t)), agreement, 0.0).sum()) >= 0.0


# --- shapes that Mitsuba intersects without triangles --------------------------------------------------------------


def _unit_sphere() -> Mesh:
    """Return Mitsuba's unit sphere with its uv: u about +Z from +X, v from +Z down."""
    rows, columns = 32, 64
    v, u = np.meshgrid(np.linspace(0, 1, rows + 1), np.linspace(0, 1, columns + 1), indexing="ij")
    polar, azimuth = v.ravel() * math.pi, u.ravel() * 2 * math.pi
    points = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=1)
    first = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)[None, :]).ravel()
    below = first + columns + 1
    lower = np.stack([first, below, below + 1], axis=1)[:-columns]
    upper = np.stack([first, below + 1, first + 1], axis=1)[columns:]
    faces = np.concatenate([lower, upper])
    return make_mesh(points, faces, 0, normals=points, uv=np.stack([u.ravel(), v.ravel()], axis=1))


def _unit_disk() -> Mesh:
    """Return Mitsuba's unit disk in the XY plane, facing +Z, with its uv: u is the radius, v the angle."""
    sides = 64
    angle = np.linspace(0, 2 * math.pi, sides + 1)
    rim = np.stack([np.cos(angle), np.sin(angle), np.zeros(sides + 1)], axis=1)
    points = np.concatenate([np.zeros((sides, 3)), rim])
    turn = angle / (2 * math.pi)
    centre_uv = np.stack([np.zeros(sides), (turn[:-1] + turn[1:]) / 2], axis=1)
    uv = np.concatenate([centre_uv, np.stack([np.ones(sides + 1), turn], axis=1)])
    here = np.arange(sides)
    return make_mesh(points, np.stack([here, sides + here, sides + here + 1], axis=1), 0, uv=uv)


def _unit_cylinder() -> Mesh:
    """Return Mitsuba's unit cylinder along +Z, open at both ends, with its uv: u about +Z from +X, v from 0 to 1."""
    mesh = transformed(cylinder((0, 0, 0), 1.0, 1.0, 0, sides=64), rotation("x", 90.0))
    corners = mesh.positions[mesh.faces]
    turn = np.arctan2(corners[..., 1], corners[..., 0]) / (2 * math.pi) % 1.0
    # A triangle over the seam goes on beyond 1.
    turn = np.where((turn < 0.25) & (turn.max(axis=1, keepdims=True) > 0.75), turn + 1.0, turn)
    mesh = split_corners(mesh)
    mesh.uv = np.stack([turn.ravel(), corners[..., 2].ravel()], axis=1).astype(np.float32)
    return mesh


ANALYTIC_SHAPES: dict[str, Callable[[], Mesh]] = {
    "Sphere": _unit_sphere,
    "Disk": _unit_disk,
    "Cylinder": _unit_cylinder,
}
"""Rectangles and cubes are meshes to Mitsuba."""
