"""From `SceneData` to the device: meshes are collected, grouped and written into buffers, tables are built.

Triangles are grouped: still and opaque, still cut-outs (alpha-tested), and each moving object by itself, in its own
space (`accel.py` says how groups are traced). All groups share one vertex and one triangle buffer, so a hit is just a
triangle and two weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.scene.accel import Group, OneAccel, build_one_accel, find_hits, make_accel
from luxel.scene.arrays import copy_array, from_numpy, matrix_rows, to_floats
from luxel.scene.bounds import find_bounds
from luxel.scene.buffers import Features, Geometry, Scene
from luxel.scene.check import check_geometry
from luxel.scene.emission_maps import VertexLooks
from luxel.scene.emitters import collect_emitters
from luxel.scene.gloss import is_glass, is_glossy
from luxel.scene.host import DeformingPart, Host, Looks
from luxel.scene.lights import build_light_tables
from luxel.scene.model import Material, Mesh, Object, SceneData
from luxel.scene.textures import build_material_tables
from luxel.scene.triangles import Triangles, triangle_areas


@dataclass
class _Part:
    """One mesh on its way into the buffers."""

    mesh: Mesh
    positions: np.ndarray
    normals: np.ndarray | None
    faces: np.ndarray
    object_index: int
    object_id: int
    space: int
    cutout: bool
    deform: tuple[Object, int] | None


class SceneBuilder:
    """Collects meshes, then writes them group by group."""

    def __init__(self, data: SceneData, one_accel: bool, looks: Looks) -> None:
        self.one_accel = one_accel
        self.parts: list[_Part] = []
        self.host = Host(data, np.zeros(3), np.zeros(3), 0.0, looks)
        self.data = self.host.local
        self.host.matrices = np.tile(np.eye(4), (int(self.host.object_ids.max(initial=0)) + 1, 1, 1))

    def add_object(self, index: int) -> None:
        """Take in the meshes of object `index`: what stands still in world space, what moves in a space of its own."""
        obj, object_id = self.data.objects[index], int(self.host.object_ids[index])
        moving = obj.motion is not None or obj.deform is not None
        if obj.motion is not None:
            self.host.moving.append((object_id, obj))
            self.host.matrices[object_id] = obj.motion(0.0)
        elif obj.deform is not None:
            self.host.matrices[object_id] = obj.to_world
        deformed = obj.deform(0.0) if obj.deform is not None else None
        for mesh_index, mesh in enumerate(obj.meshes):
            if len(mesh.faces) == 0:
                continue
            positions, normals = (mesh.positions, mesh.normals) if deformed is None else deformed[mesh_index]
            faces = np.asarray(mesh.faces, np.uint32)
            if not moving:
                positions, normals, faces = _bake(obj.to_world, positions, normals, faces)
            cutout = lets_rays_pass(self.data.materials[mesh.material], mesh)
            space = object_id if moving else 0
            deform = (obj, mesh_index) if deformed is not None else None
            self.parts.append(_Part(mesh, positions, normals, faces, index, object_id, space, cutout, deform))

    def finish(self) -> Scene:
        """Return the scene of all objects taken in."""
        # Parts of one group stand together; a deforming mesh is a group of its own.
        keyed: dict[tuple[int, bool, int], list[_Part]] = {}
        for index, part in enumerate(self.parts):
            keyed.setdefault((part.space, part.cutout, index if part.deform else -1), []).append(part)
        ordered = [keyed[key] for key in sorted(keyed, key=lambda key: (key[0], key[1], key[2]))]

        groups: list[Group] = []
        meshes: list[tuple[Group, np.ndarray, np.ndarray, bool]] = []
        vertex_offset, prim_offset = 0, 0
        triangle_rows: list[np.ndarray] = []
        for members in ordered:
            faces, start = [], vertex_offset
            for part in members:
                faces.append(part.faces.astype(np.int64) + vertex_offset)
                vertex_offset += len(part.positions)
                tag = np.full((len(part.faces), 1), part.mesh.material | part.object_id << 16, np.int64)
                triangle_rows.append(np.hstack([faces[-1], tag]))
            all_faces = np.concatenate(faces)
            positions = np.concatenate([part.positions for part in members])
            first = members[0]
            group = Group(
                name=f"group{len(groups)}",
                accel=None if self.one_accel else make_accel(positions, all_faces - start),
                prim_offset=prim_offset,
                object_id=first.space,
                cutout=first.cutout,
                prim_count=len(all_faces),
            )
            meshes.append((group, positions, all_faces - start, first.deform is not None))
            if first.deform is not None:
                self.host.deforming.append(DeformingPart(*first.deform, start, group))
            prim_offset += len(all_faces)
            groups.append(group)
        flat = [part for members in ordered for part in members]
        self.host.part_starts = np.cumsum([0, *(len(part.faces) for part in flat)])[:-1]
        self.host.part_objects = np.array([part.object_index for part in flat])
        one = build_one_accel(meshes, self.host.matrices) if self.one_accel else None
        return self._scene(groups, one, flat, np.concatenate(triangle_rows).astype(np.uint32))

    def _scene(self, groups: list[Group], one: OneAccel | None, parts: list[_Part], triangles: np.ndarray) -> Scene:
        host, data = self.host, self.data
        rows = _collect_rows(parts)
        geometry = _make_geometry(rows, triangles, host)
        world = _world_positions(rows.positions, parts, host.matrices)
        corners = world[triangles[:, :3].astype(np.int64)]
        areas = triangle_areas(corners)
        moved = _moved_boxes(data, parts)
        check_geometry(data.name, corners, areas, moved, bool(host.deforming))
        bounds = find_bounds(
            data, Triangles(corners, areas), lambda o, d: find_hits(groups, one, host.matrices, o, d), moved
        )
        host.lower, host.upper, host.area = bounds.lower, bounds.upper, bounds.area
        features = _find_features(data, host, parts, surrounded=not bounds.complete)
        materials = build_material_tables(data, features.gloss)
        looks = VertexLooks(rows.uv, rows.uv2, rows.colors)
        emitters = collect_emitters(data, triangles, rows.positions, looks, host.movable_ids())
        lights, host.sources = build_light_tables(data, emitters, host.matrices)
        host.note_moving_lights()
        scene = Scene(
            groups=groups,
            one=one,
            geometry=geometry,
            materials=materials,
            lights=lights,
            features=features,
            lower=_opaque_point(host.lower),
            upper=_opaque_point(host.upper),
            coordinate=dr.opaque(mi.Float, float(np.median(np.abs(corners).max(axis=(1, 2))))),
            layer_seed=dr.opaque(mi.UInt32, 0),
            host=host,
        )
        dr.eval(geometry)
        return scene


@dataclass
class _Rows:
    """What vertices have, in the order of the buffers; None where no mesh of the scene has it."""

    positions: np.ndarray
    normals: np.ndarray
    uv: np.ndarray
    colors: np.ndarray | None
    uv2: np.ndarray | None


def _collect_rows(parts: list[_Part]) -> _Rows:
    has_colors = any(part.mesh.colors is not None for part in parts)
    has_uv2 = any(part.mesh.uv2 is not None for part in parts)
    return _Rows(
        positions=np.concatenate([part.positions for part in parts]).astype(np.float32),
        normals=np.concatenate([_or_zeros(part.normals, len(part.positions), 3) for part in parts]),
        uv=np.concatenate([_or_zeros(part.mesh.uv, len(part.positions), 2) for part in parts]),
        colors=np.concatenate([_colors(part.mesh) for part in parts]) if has_colors else None,
        uv2=np.concatenate([_or_zeros(part.mesh.uv2, len(part.positions), 2) for part in parts]) if has_uv2 else None,
    )


def _make_geometry(rows: _Rows, triangles: np.ndarray, host: Host) -> Geometry:
    to_world, to_object = matrix_rows(host.matrices)
    vertices = to_floats(np.hstack([rows.positions, rows.uv[:, :1]]))
    return Geometry(
        vertices=vertices,
        normals=to_floats(np.hstack([rows.normals, rows.uv[:, 1:]])),
        triangles=from_numpy(mi.UInt32, triangles),
        colors=to_floats(np.ones((1, 4)) if rows.colors is None else rows.colors),
        uv2=to_floats(np.zeros((1, 2)) if rows.uv2 is None else rows.uv2),
        to_world=to_world,
        to_object=to_object,
        to_world_before=copy_array(to_world),
        vertices_before=copy_array(vertices) if host.deforming else to_floats(np.zeros((1, 4))),
    )


def _find_features(data: SceneData, host: Host, parts: list[_Part], surrounded: bool) -> Features:
    gloss, transmission = find_gloss(data.materials, host.looks)
    modes = {data.materials[part.mesh.material].alpha_mode for part in parts if part.cutout}
    return Features(
        moving=bool(host.moving or host.deforming),
        deforming=bool(host.deforming),
        colors=any(part.mesh.colors is not None for part in parts),
        uv2=any(part.mesh.uv2 is not None for part in parts),
        cutout=bool(modes),
        blended="blend" in modes,
        gloss=gloss,
        transmission=transmission,
        hide_emitters=data.hide_emitters,
        surrounded=surrounded,
    )


def find_gloss(materials: Sequence[Material], looks: Looks) -> tuple[bool, bool]:
    """Return whether some of `materials` reflect or refract, and whether some are glass, under that condition."""
    full = looks == "full"
    return full and any(map(is_glossy, materials)), full and any(map(is_glass, materials))


def lets_rays_pass(material: Material, mesh: Mesh) -> bool:
    """Return whether `mesh`, made of `material`, does not stop every ray: it has holes or passes light by chance."""
    if material.alpha_mode == "opaque":
        return False
    texture, colors = material.base_color_texture, mesh.colors
    varies = (texture is not None and texture.image.shape[-1] == 4) or (colors is not None and colors.shape[1] == 4)
    limit = 1.0 if material.alpha_mode == "blend" else material.alpha_cutoff
    return varies or material.alpha < limit


def _bake(
    to_world: np.ndarray, positions: np.ndarray, normals: np.ndarray | None, faces: np.ndarray
) -> tuple[np.ndarray, np.ndarray | None, np.ndarray]:
    """Move a still mesh into world space; a mirroring matrix turns its triangles round to keep their front."""
    linear = to_world[:3, :3]
    positions = positions @ linear.T + to_world[:3, 3]
    if normals is not None and abs(np.linalg.det(linear)) > 0.0:
        normals = normals @ np.linalg.inv(linear)
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = normals / np.where(length > 0.0, length, 1.0)
    if np.linalg.det(linear) < 0.0:
        faces = faces[:, ::-1]
    return positions.astype(np.float32), normals, faces


def _world_positions(positions: np.ndarray, parts: list[_Part], matrices: np.ndarray) -> np.ndarray:
    world, start = np.empty_like(positions), 0
    for part in parts:
        stop = start + len(part.positions)
        matrix = matrices[part.space]
        world[start:stop] = positions[start:stop] @ matrix[:3, :3].T + matrix[:3, 3]
        start = stop
    return world


def _moved_boxes(data: SceneData, parts: list[_Part]) -> np.ndarray:
    """Return the boxes (K, 2, 3) that moving parts take up at 33 times of the animation, world space."""
    boxes = []
    moving = [part for part in parts if part.space] if data.duration > 0.0 else []
    for part in moving:
        obj = data.objects[part.object_index]
        low, high = part.positions.min(axis=0), part.positions.max(axis=0)
        ends = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
        still = part.positions if len(part.positions) <= len(ends) else ends
        for time in np.linspace(0.0, data.duration, 33):
            points = still if obj.deform is None else obj.deform(float(time))[part.deform[1]][0]  # type: ignore[index]
            matrix = obj.to_world if obj.motion is None else obj.motion(float(time))
            points = points @ matrix[:3, :3].T + matrix[:3, 3]
            boxes.append([points.min(axis=0), points.max(axis=0)])
    return np.array(boxes).reshape(-1, 2, 3)


def _or_zeros(array: np.ndarray | None, rows: int, columns: int) -> np.ndarray:
    return np.zeros((rows, columns), np.float32) if array is None else np.asarray(array, np.float32)[:, :columns]


def _colors(mesh: Mesh) -> np.ndarray:
    rows = np.ones((len(mesh.positions), 4), np.float32)
    if mesh.colors is not None:
        rows[:, : mesh.colors.shape[1]] = mesh.colors
    return rows


def _opaque_point(values: np.ndarray) -> mi.Point3f:
    return mi.Point3f(*(dr.opaque(mi.Float, float(value)) for value in values))
