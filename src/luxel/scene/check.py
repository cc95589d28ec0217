"""What cannot be in a whole scene: indices out of range, arrays of unequal length, lights without a direction."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from luxel.errors import LuxelError
from luxel.scene.model import Camera, Light, Material, Mesh, Object, SceneData, Sky
from luxel.scene.records import describe
from luxel.scene.rules import RULES

FARTHEST = 1e15
"""Metres from the origin at most: farther off, squared distances leave the range of single precision."""
NEEDLE = 1e-7
"""Area over squared length under which a triangle is a line but for round-off."""


def check_scene(data: SceneData) -> None:
    """Raise LuxelError for the first thing in `data` that cannot be rendered, with its place and what to do."""
    # Lists may have been filled after they were set.
    for record in (data, *data.objects):
        check_lists(record)
    for light in data.lights:
        check_light(light)
    check_sky(data.sky)
    for material in data.materials:
        check_material(material)
    for camera in data.cameras:
        check_camera(camera)
    for moving in (*data.objects, *data.lights):
        check_motion(moving)
    for item, mesh, number in _each_mesh(data):
        reason = _find_fault(mesh, len(data.materials))
        if reason:
            raise LuxelError(f"{data.name}: object '{item.name}', mesh {number}: {reason}")
    if data.objects:
        finite = np.isfinite(np.stack([item.to_world for item in data.objects])).all(axis=(1, 2))
        if not finite.all():
            name = data.objects[int(np.argmin(finite))].name
            raise LuxelError(f"{data.name}: object '{name}' has a matrix that is not finite: repair its to_world")


def check_geometry(name: str, corners: np.ndarray, areas: np.ndarray, moved: np.ndarray, deforms: bool) -> None:
    """Raise LuxelError where scene `name` cannot be traced as a whole.

    `corners` (F, 3, 3) and `areas` (F,) are its triangles, `moved` (K, 2, 3) what moving parts reach. Where something
    `deforms`, what has no area now may have one later.
    """
    if not np.isfinite(corners).all() or not np.isfinite(moved).all():
        raise LuxelError(f"{name}: vertex positions are NaN or infinite; repair the file")
    reach = max(float(np.abs(corners).max()), float(np.abs(moved).max(initial=0.0)))
    if reach > FARTHEST:
        raise LuxelError(
            f"{name}: vertex positions reach {reach:.0e} m, beyond the {FARTHEST:.0e} m that can be traced; "
            "repair or scale the file"
        )
    edges = corners - np.roll(corners, 1, axis=1)
    longest = np.abs(edges).max(axis=(1, 2)).astype(np.float64)
    if not deforms and not (areas > NEEDLE * longest**2).any():
        raise LuxelError(
            f"{name}: none of its triangles has an area, as each lies on a line or in a point, so nothing can be seen; "
            "repair the file"
        )


def check_lists(record: SceneData | Object) -> None:
    """Raise LuxelError for a list that holds something else than the records that it is for."""
    for name, rule in RULES[type(record).__name__].items():
        value = getattr(record, name)
        if isinstance(value, list) and not rule.accepts(value):
            raise LuxelError(f"{describe(record)}: {name} holds something else: give {rule.words}")


def check_motion(record: Object | Light | Camera) -> None:
    """Raise LuxelError for a motion that does not answer with a finite matrix, or flattens an object."""
    if record.motion is None:
        return
    try:
        matrix = np.asarray(record.motion(0.0), np.float64)
    except (TypeError, ValueError) as error:
        raise LuxelError(f"{describe(record)}: its motion fails at 0 seconds ({error}): repair it") from None
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise LuxelError(f"{describe(record)}: its motion must give a finite 4x4 matrix for a time in seconds")
    if isinstance(record, Object):
        check_inverse(record, matrix, 0.0)


def check_inverse(item: Object, matrix: np.ndarray, time: float) -> np.ndarray:
    """Return `matrix` (4, 4), which places `item` at `time` seconds. Raises LuxelError where it flattens it."""
    try:
        np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        raise LuxelError(
            f"object '{item.name}': its motion flattens it at {time:g} seconds to what no matrix takes back; "
            "scale it by 1e-6 in place of 0"
        ) from None
    return matrix


def check_light(light: Light) -> None:
    """Raise LuxelError for a sun or spot that shines nowhere."""
    if light.kind != "point" and not any(light.direction):
        raise LuxelError(f"light '{light.name}' needs a direction: give one that is not (0, 0, 0)")


def check_sky(sky: Sky) -> None:
    """Raise LuxelError for an image that holds what is no light."""
    if sky.image is not None and not (np.isfinite(sky.image).all() and sky.image.min() >= 0):
        raise LuxelError("the sky's image holds values that are negative, NaN or infinite: repair it and try again")


def check_material(material: Material) -> None:
    """Raise LuxelError for a complex index without its real part; a missing `k` is zero."""
    if material.k is not None and material.eta is None:
        raise LuxelError(f"{describe(material)} has k without eta, which together are a metal's index: give both")


def check_camera(camera: Camera) -> None:
    """Raise LuxelError for a camera that looks nowhere."""
    check_motion(camera)
    if camera.motion is None and np.allclose(camera.eye, camera.target, rtol=0.0, atol=1e-12):
        raise LuxelError(f"camera '{camera.name}' looks nowhere: its eye and its target are the same point")


def _each_mesh(data: SceneData) -> Iterator[tuple[Object, Mesh, int]]:
    """Yield every mesh once with its number, however many objects share it."""
    seen: set[int] = set()
    for item in data.objects:
        for number, mesh in enumerate(item.meshes):
            if id(mesh) not in seen:
                seen.add(id(mesh))
                yield item, mesh, number


def _find_fault(mesh: Mesh, material_count: int) -> str:
    """Return what is wrong with a mesh; empty where nothing is."""
    if mesh.material >= material_count:
        count = "no material" if material_count == 0 else f"materials 0 to {material_count - 1}"
        return f"material {mesh.material} is out of range: the scene has {count}"
    vertex_count = len(mesh.positions)
    if len(mesh.faces):
        low, high = mesh.faces.min(), mesh.faces.max()
        if low < 0 or high >= vertex_count:
            index = low if low < 0 else high
            return f"a face names vertex {index}, which is out of range: the mesh has {vertex_count} vertices"
    for name in ("normals", "uv", "uv2", "colors"):
        rows = getattr(mesh, name)
        if rows is not None and len(rows) != vertex_count:
            return f"{name} has {len(rows)} rows for {vertex_count} vertices: give one a vertex"
    return ""
