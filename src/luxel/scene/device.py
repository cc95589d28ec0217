"""`SceneData` goes to the device, and moves there.

`builder.py` makes the buffers, structures and tables that `buffers.py` lists.
"""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.errors import LuxelError
from luxel.scene.accel import move_instance, place, write_mesh_positions
from luxel.scene.arrays import copy_array, from_numpy, matrix_rows
from luxel.scene.buffers import Scene
from luxel.scene.builder import SceneBuilder
from luxel.scene.check import check_inverse, check_scene
from luxel.scene.emitters import deform_emitters
from luxel.scene.held import hold_scene
from luxel.scene.host import OBJECT_LIMIT, DeformingPart, Looks
from luxel.scene.lights import move_delta_lights, refit_lights
from luxel.scene.model import Object, SceneData
from luxel.scene.origin import find_origin
from luxel.scene.sky_suns import with_suns

__all__ = ["Scene", "choose_layer", "set_time", "upload"]


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
    builder = SceneBuilder(data, bool(on_optix) if one_accel is None else one_accel, materials)
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
        geometry.to_world, geometry.to_object = matrix_rows(host.matrices)
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
