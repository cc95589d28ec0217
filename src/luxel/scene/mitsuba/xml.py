"""Mitsuba 3 scene files (.xml): read by Mitsuba itself, then turned into the plain data of the model."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from luxel import runtime
from luxel.errors import LuxelError
from luxel.scene.local import measured_from
from luxel.scene.mitsuba.bsdf import Layer, find_relief, read_bsdf
from luxel.scene.mitsuba.cameras import convert_sensors
from luxel.scene.mitsuba.file import SceneFile, read_scene_file
from luxel.scene.mitsuba.lights import convert_emitters
from luxel.scene.mitsuba.materials import make_materials, paint_mesh
from luxel.scene.mitsuba.relief import Stretch, measure_stretch
from luxel.scene.mitsuba.shapes import convert_shape, make_back
from luxel.scene.model import Camera, Light, Material, Mesh, Object, SceneData
from luxel.scene.origin import find_origin, warn_of_rounding
from luxel.scene.warnings import Warnings

SKIPPED_SHAPES = "Shapes of these types are left out: {names}."


def load_mitsuba_xml(path: Path) -> SceneData:
    """Read a Mitsuba 3 scene. Picks a device if none is set. Raises `LuxelError` where the file cannot be used.

    Each shape becomes an object of one mesh, each instance an object that shares the meshes of its group.
    `mitsuba_full` returns the scene as Mitsuba loads it.
    """
    if mi.variant() is None:
        runtime.start("auto")
    data, _ = _read(path)
    origin, size, _ = find_origin(data)
    if origin.any():
        # Mitsuba's single precision has rounded everything: once more, from numbers that it leaves as they are.
        near, step = _read(path, origin)
        data = measured_from(near, origin)
        warn_of_rounding(data, step, size)
    return data


def _read(path: Path, origin: np.ndarray | None = None) -> tuple[SceneData, float]:
    """Return the scene, measured from `origin` (3,) if it is given, and the step that its meshes are rounded to."""
    file = read_scene_file(path, origin)
    warnings = file.warnings
    materials: list[Material] = []
    objects = _convert_objects(file, materials, warnings)
    if not any(len(mesh.faces) for item in objects for mesh in item.meshes):
        raise LuxelError(f"'{path}' holds no triangles; there is nothing to render.")
    _check_positions(objects, path)
    lights, sky = convert_emitters(file.scene, warnings)
    cameras = convert_sensors(file.scene, warnings) if file.has_sensor else []
    _check_numbers(lights, cameras, path)
    data = SceneData(
        path.stem,
        objects,
        materials,
        lights,
        cameras,
        sky,
        hide_emitters=file.hide_emitters,
        warnings=warnings.sentences(),
        diffuse_warnings=warnings.sentences(diffuse_only=True),
        mitsuba_full=file.full,
    )
    return data, file.step


def _convert_objects(file: SceneFile, materials: list[Material], warnings: Warnings) -> list[Object]:
    """Return an object for each shape and each instance, and append the materials that they need."""
    members = {name for names in file.groups.values() for name in names}
    # Where each member of a group stands.
    places: dict[str, list[np.ndarray]] = {}
    for instance in file.instances:
        for name in file.groups[instance.group]:
            places.setdefault(name, []).append(instance.to_world)
    converter = _Converter(materials, warnings)
    objects: list[Object] = []
    shared: dict[str, list[Mesh]] = {}
    for index, shape in enumerate(file.scene.shapes()):
        name = shape.id() or f"{shape.class_name().lower()}-{index}"
        meshes = converter.convert(shape, places.get(shape.id(), [np.eye(4)]))
        if shape.id() in members:
            shared[shape.id()] = meshes
        elif meshes:
            objects.append(Object(name, meshes))
    for instance in file.instances:
        meshes = [mesh for name in file.groups[instance.group] for mesh in shared.get(name, [])]
        if meshes:
            objects.append(Object(instance.name, meshes, instance.to_world))
    return objects


class _Converter:
    """Turns shapes into meshes, and their BSDFs into materials that they share."""

    def __init__(self, materials: list[Material], warnings: Warnings) -> None:
        self.materials = materials
        self.warnings = warnings
        self.trees: dict[int, Layer] = {}
        self.known: dict[tuple[Any, ...], list[int]] = {}

    def convert(self, shape: Any, places: list[np.ndarray]) -> list[Mesh]:
        """Return the shape's mesh, and a second one where its back has a material of its own; none if unknown.

        `places`: the matrices (4, 4) that put it into the world.
        """
        mesh = convert_shape(shape)
        if mesh is None:
            self.warnings.add(SKIPPED_SHAPES, shape.class_name())
            return []
        if shape.is_medium_transition():
            self.warnings.add("Participating media are left out.")
        bsdf = shape.bsdf()
        if bsdf.ptr not in self.trees:
            self.trees[bsdf.ptr] = read_bsdf(bsdf)
        tree = self.trees[bsdf.ptr]
        rows = self._find_materials(shape, tree, mesh)
        mesh.material = rows[0]
        materials = [self.materials[row] for row in rows]
        front = paint_mesh(shape, tree, mesh, materials, self.warnings)
        if len(rows) == 1:
            return [front]
        back = paint_mesh(shape, tree, mesh, materials, self.warnings, back=True)
        return [front, make_back(back, rows[1], places)]

    def _find_materials(self, shape: Any, tree: Layer, mesh: Mesh) -> list[int]:
        """Return the rows of the shape's materials. Shapes share them by their BSDF; those that emit have their own."""
        emitter = shape.emitter()
        relief = find_relief(tree)
        stretch = Stretch() if relief is None else measure_stretch(mesh)
        if relief is not None and relief.bsdf.class_name() == "NormalMap":
            # Only bumps depend on lengths.
            stretch = Stretch(mirrored=stretch.mirrored)
        key = (shape.bsdf().ptr, None if emitter is None else emitter.ptr, stretch.key())
        if key not in self.known:
            made = make_materials(shape, tree, stretch, self.warnings)
            self.known[key] = list(range(len(self.materials), len(self.materials) + len(made)))
            self.materials += made
        return self.known[key]


def _check_positions(objects: list[Object], path: Path) -> None:
    """Raise `LuxelError` for a shape that cannot be placed."""
    seen: set[int] = set()
    for item in objects:
        fresh = [mesh for mesh in item.meshes if id(mesh) not in seen]
        seen.update(id(mesh) for mesh in fresh)
        if not np.isfinite(item.to_world).all() or not all(np.isfinite(mesh.positions).all() for mesh in fresh):
            raise LuxelError(f"Shape '{item.name}' of '{path}' has NaN or infinite positions; repair the mesh.")


def _check_numbers(lights: list[Light], cameras: list[Camera], path: Path) -> None:
    """Raise `LuxelError` for a light or a camera that is nowhere."""
    for light in lights:
        if not np.isfinite([*light.color, *light.position, *light.direction]).all():
            raise LuxelError(f"A {light.kind} light of '{path}' has NaN or infinite values; give it numbers.")
    for camera in cameras:
        if not np.isfinite([*camera.eye, *camera.target, *camera.up, camera.fov]).all():
            raise LuxelError(f"Camera '{camera.name}' of '{path}' has NaN or infinite values; give it a place.")
