"""`SceneData` as the kernels read it: flat buffers, acceleration structures, light tables.

Triangles are grouped: still and opaque, still cut-outs (alpha-tested), and each moving object by itself, in its own
space (`accel.py` says how groups are traced). All groups share one vertex and one triangle buffer, so a hit is just a
triangle and two weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.errors import LuxelError
from luxel.scene.accel import (
    Group,
    OneAccel,
    build_one_accel,
    find_hits,
    make_accel,
    move_instance,
    place,
    write_mesh_positions,
)
from luxel.scene.arrays import copy_array, from_numpy, to_floats
from luxel.scene.bounds import find_bounds
from luxel.scene.check import check_geometry, check_inverse, check_scene
from luxel.scene.emission_maps import VertexLooks
from luxel.scene.emitters import collect_emitters, deform_emitters
from luxel.scene.gloss import is_glass, is_glossy
from luxel.scene.held import hold_scene
from luxel.scene.host import OBJECT_LIMIT, DeformingPart, Host, Looks
from luxel.scene.lights import LightTables, build_light_tables, move_delta_lights, refit_lights
from luxel.scene.model import Material, Mesh, Object, SceneData
from luxel.scene.origin import find_origin
from luxel.scene.sky_suns import with_suns
from luxel.scene.textures import MaterialTables, build_material_tables
from luxel.scene.triangles import Triangles, triangle_areas


@dataclass
class Geometry:
    """The shared buffers. Rows of four floats let the kernels read one packet instead of four words."""

    vertices: mi.Float
    """(V, 4): object-space position, u."""
    normals: mi.Float
    """(V, 4): object-space vertex normal (zero: use the triangle's), v."""
    triangles: mi.UInt32
    """(F, 4): three vertices, material | object id << 16."""
    colors: mi.Float
    """(V, 4) vertex colours, or one row where the scene has none."""
    uv2: mi.Float
    """(V, 2) light map coordinates, or one row."""
    to_world: mi.Float
    """(objects + 1, 12): rows of the object-to-world matrices; row 0 is the identity."""
    to_object: mi.Float
    """(objects + 1, 12): their inverses."""
    to_world_before: mi.Float
    """(objects + 1, 12): `to_world` one frame earlier, for motion vectors."""
    vertices_before: mi.Float
    """Deforming scenes: `vertices` one frame earlier; else one row."""


@dataclass
class Features:
    """What the scene has, as constants: kernels are compiled without what it lacks."""

    moving: bool
    deforming: bool
    colors: bool
    uv2: bool
    cutout: bool
    """Some surfaces do not stop every ray."""
    blended: bool
    """Some surfaces let rays by by chance: a frame sees one stochastic layer of them."""
    gloss: bool
    """Some materials reflect or refract, and are to be seen so: `MaterialTables.gloss` has a row for each."""
    transmission: bool
    """Some of them are glass."""
    hide_emitters: bool
    """Camera rays pass through surfaces that emit, and see no sky."""
    surrounded: bool
    """Some triangles lie beyond the robust bounds: a dome, a wide ground, a stray."""


@dataclass
class Scene:
    """What every kernel takes. A Dr.Jit pytree: frozen functions read it as an input."""

    groups: list[Group]
    one: OneAccel | None
    """All groups in one structure, as OptiX needs it; else each group has its own."""
    geometry: Geometry
    materials: MaterialTables
    lights: LightTables
    features: Features
    lower: mi.Point3f
    """Robust bounds over the animation (`scene/bounds.py`), world space, measured from the origin (`local.py`)."""
    upper: mi.Point3f
    coordinate: mi.Float
    """Median over the triangles of their largest |coordinate|, metres: how coarsely places are rounded here."""
    layer_seed: mi.UInt32
    """Chooses the stochastic layer of blended surfaces; whoever averages layers changes it (`choose_layer`)."""
    host: Host = field(repr=False)


def upload(
    data: SceneData, one_accel: bool | None = None, *, recentre: bool = False, materials: Looks = "diffuse"
) -> Scene:
    """Build the device scene of `data`; `one_accel` None decides by the device (OptiX needs it).

    `materials`: "full" for all that they do, "diffuse" for what `scene/diffuse.py` leaves of them.
    `recentre`: where no origin is set and the scene lies far away, one is chosen, as the loaders do for files.
    Raises LuxelError where there is nothing to trace or a limit is passed.
    """
    if len(data.materials) > OBJECT_LIMIT:
        raise LuxelError(f"{data.name}: more than {OBJECT_LIMIT} materials; merge some of them")
    check_scene(data)
    if recentre and not any(data.origin):
        x, y, z = find_origin(data)[0].tolist()
        data = replace(data, origin=(x, y, z))
    data = hold_scene(with_suns(data))
    on_optix = dr.backend_v(mi.Float) == dr.JitBackend.CUDA
    builder = _Builder(data, bool(on_optix) if one_accel is None else one_accel, materials)
    for index in range(len(data.objects)):
        builder.add_object(index)
    if not builder.parts:
        raise LuxelError(f"{data.name}: the scene holds no triangles, so there is nothing to render")
    return _settle(builder.finish())


def _settle(scene: Scene) -> Scene:
    """Give tables that live edits replace memory of their own, so that a frame does not record anew at the first."""
    lights, materials = scene.lights, scene.materials
    lights.sky_image, lights.sky_table.cells = copy_array(lights.sky_image), copy_array(lights.sky_table.cells)
    materials.factors, materials.slots = copy_array(materials.factors), copy_array(materials.slots)
    gloss = materials.gloss
    gloss.factors, gloss.slots = copy_array(gloss.factors), copy_array(gloss.slots)
    return scene


def choose_layer(scene: Scene, seed: mi.UInt32) -> Scene:
    """Return the scene as rays of layer `seed` see it: another layer of its blended surfaces, if it has any."""
    return replace(scene, layer_seed=seed) if scene.features.blended else scene


def set_time(scene: Scene, time: float) -> bool:
    """Move objects and lights to `time` seconds; return whether anything moved.

    Motion vectors refer to the time of the call before.
    """
    host, geometry = scene.host, scene.geometry
    still = time == host.time
    if still and host.is_placed:
        host.is_placed = False
        return False
    # Before anything moves, so that a matrix that cannot be leaves the scene as it was.
    matrices = {} if still else {key: check_inverse(obj, _placed(obj, time), time) for key, obj in host.moving}
    host.time, host.is_placed = time, False
    has_motion = bool(host.moving or host.deforming or host.lights_move)
    if not has_motion:
        return False
    # Copies: an alias today and another array tomorrow would make the frozen frame record anew.
    geometry.to_world_before = copy_array(geometry.to_world)
    if host.deforming:
        geometry.vertices_before = copy_array(geometry.vertices)
    if still:
        return False
    if host.moving:
        for object_id, matrix in matrices.items():
            host.matrices[object_id] = matrix
            if scene.one is not None:
                names = [group.name for group in scene.groups if group.object_id == object_id]
                move_instance(scene.one, names, host.matrices[object_id])
        geometry.to_world, geometry.to_object = _matrix_rows(host.matrices)
    for part in host.deforming:
        _deform(scene, part, time)
    _follow_with_lights(scene, time)
    host.epoch += 1
    return True


def _placed(obj: Object, time: float) -> np.ndarray:
    assert obj.motion is not None
    return obj.motion(time)


def _follow_with_lights(scene: Scene, time: float) -> None:
    """Bring the light tables to `time` seconds, once the objects are there."""
    host = scene.host
    if host.lights_move:
        move_delta_lights(scene.lights, host.sources, host.local.lights, time)
    if host.lights_move or host.glows_in_motion:
        refit_lights(scene.lights, host.sources, host.matrices)


def _deform(scene: Scene, part: DeformingPart, time: float) -> None:
    """Write the deformed vertices of one mesh and rebuild its own small acceleration structure."""
    assert part.obj.deform is not None
    geometry = scene.geometry
    positions, normals = part.obj.deform(time)[part.mesh_index]
    deform_emitters(scene.host.sources.emitters, part.vertex_offset, positions)
    count = len(positions)
    index = dr.arange(mi.UInt32, count) + part.vertex_offset
    for axis in range(3):
        dr.scatter(geometry.vertices, from_numpy(mi.Float, positions[:, axis]), 4 * index + axis)
        if normals is not None:
            dr.scatter(geometry.normals, from_numpy(mi.Float, normals[:, axis]), 4 * index + axis)
    if scene.one is not None:
        matrix = scene.host.matrices[part.group.object_id]
        write_mesh_positions(scene.one.accel, place(positions, matrix), part.group.name)
    elif part.group.accel is not None:
        write_mesh_positions(part.group.accel, positions, part.group.name)
    dr.eval(geometry.vertices, geometry.normals)


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


class _Builder:
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
        host = self.host
        positions = np.concatenate([part.positions for part in parts]).astype(np.float32)
        normals = np.concatenate([_or_zeros(part.normals, len(part.positions), 3) for part in parts])
        uv = np.concatenate([_or_zeros(part.mesh.uv, len(part.positions), 2) for part in parts])
        to_world, to_object = _matrix_rows(host.matrices)
        has_colors = any(part.mesh.colors is not None for part in parts)
        has_uv2 = any(part.mesh.uv2 is not None for part in parts)
        colors = np.concatenate([_colors(part.mesh) for part in parts]) if has_colors else np.ones((1, 4))
        uv2 = np.concatenate([_or_zeros(part.mesh.uv2, len(part.positions), 2) for part in parts])
        vertices = to_floats(np.hstack([positions, uv[:, :1]]))
        geometry = Geometry(
            vertices=vertices,
            normals=to_floats(np.hstack([normals, uv[:, 1:]])),
            triangles=from_numpy(mi.UInt32, triangles),
            colors=to_floats(colors),
            uv2=to_floats(uv2 if has_uv2 else np.zeros((1, 2))),
            to_world=to_world,
            to_object=to_object,
            to_world_before=copy_array(to_world),
            vertices_before=copy_array(vertices) if host.deforming else to_floats(np.zeros((1, 4))),
        )
        world = _world_positions(positions, parts, host.matrices)
        corners = world[triangles[:, :3].astype(np.int64)]
        areas = triangle_areas(corners)
        moved = _moved_boxes(self.data, parts)
        check_geometry(self.data.name, corners, areas, moved, bool(host.deforming))
        bounds = find_bounds(
            self.data, Triangles(corners, areas), lambda o, d: find_hits(groups, one, host.matrices, o, d), moved
        )
        host.lower, host.upper, host.area = bounds.lower, bounds.upper, bounds.area
        gloss, transmission = find_gloss(self.data.materials, host.looks)
        materials = build_material_tables(self.data, gloss)
        looks = VertexLooks(uv, uv2 if has_uv2 else None, colors if has_colors else None)
        emitters = collect_emitters(self.data, triangles, positions, looks, host.movable_ids())
        lights, host.sources = build_light_tables(self.data, emitters, host.matrices)
        host.note_moving_lights()
        scene = Scene(
            groups=groups,
            one=one,
            geometry=geometry,
            materials=materials,
            lights=lights,
            features=Features(
                moving=bool(host.moving or host.deforming),
                deforming=bool(host.deforming),
                colors=has_colors,
                uv2=has_uv2,
                cutout=any(part.cutout for part in parts),
                blended=any(
                    part.cutout and self.data.materials[part.mesh.material].alpha_mode == "blend" for part in parts
                ),
                gloss=gloss,
                transmission=transmission,
                hide_emitters=self.data.hide_emitters,
                surrounded=not bounds.complete,
            ),
            lower=_opaque_point(host.lower),
            upper=_opaque_point(host.upper),
            coordinate=dr.opaque(mi.Float, float(np.median(np.abs(corners).max(axis=(1, 2))))),
            layer_seed=dr.opaque(mi.UInt32, 0),
            host=host,
        )
        dr.eval(geometry)
        return scene


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


def _matrix_rows(matrices: np.ndarray) -> tuple[mi.Float, mi.Float]:
    return to_floats(matrices[:, :3, :]), to_floats(np.linalg.inv(matrices)[:, :3, :])


def _or_zeros(array: np.ndarray | None, rows: int, columns: int) -> np.ndarray:
    return np.zeros((rows, columns), np.float32) if array is None else np.asarray(array, np.float32)[:, :columns]


def _colors(mesh: Mesh) -> np.ndarray:
    rows = np.ones((len(mesh.positions), 4), np.float32)
    if mesh.colors is not None:
        rows[:, : mesh.colors.shape[1]] = mesh.colors
    return rows


def _opaque_point(values: np.ndarray) -> mi.Point3f:
    return mi.Point3f(*(dr.opaque(mi.Float, float(value)) for value in values))
