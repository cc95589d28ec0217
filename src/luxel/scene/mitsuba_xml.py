"""Mitsuba 3 scene files (.xml): read by Mitsuba itself, then turned into the plain data of the model."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from luxel import runtime
from luxel.errors import LuxelError
from luxel.scene.library.shapes import cylinder, make_mesh, rotation, transformed
from luxel.scene.mitsuba_lights import convert_emitters
from luxel.scene.mitsuba_materials import Warnings, as_triple, make_material
from luxel.scene.model import Camera, Material, Mesh, Object, SceneData

SKIPPED_SHAPES = "Shapes of these types are left out: {names}."


def load_mitsuba_xml(path: Path) -> SceneData:
    """Read a Mitsuba 3 scene. Picks a device if none is set. Raises `LuxelError` where the file cannot be used.

    Each shape becomes an object of one mesh. `mitsuba_full` returns the scene as Mitsuba loaded it.
    """
    root = _parse(path)
    if mi.variant() is None:
        runtime.start("auto")
    scene = _load_scene(path)
    warnings = Warnings()
    materials: list[Material] = []
    objects = _convert_shapes(scene, materials, warnings)
    for copy in _expand_instances(path, root, warnings):
        objects += _convert_shapes(copy, materials, warnings)
    if not any(len(mesh.faces) for item in objects for mesh in item.meshes):
        raise LuxelError(f"'{path}' holds no triangles; there is nothing to render.")
    for item in objects:
        if not all(np.isfinite(mesh.positions).all() for mesh in item.meshes):
            raise LuxelError(f"Shape '{item.name}' of '{path}' has NaN or infinite positions; repair the mesh.")
    lights, sky = convert_emitters(scene, warnings)
    has_sensor = root.find(".//sensor") is not None or root.find(".//include") is not None
    cameras = [_convert_sensor(sensor, warnings) for sensor in scene.sensors()] if has_sensor else []
    for index, camera in enumerate(cameras[1:], 2):
        camera.name = camera.name if camera.name != "default" else f"camera-{index}"
    return SceneData(
        path.stem,
        objects,
        materials,
        lights,
        cameras,
        sky,
        warnings=warnings.sentences(),
        mitsuba_full=lambda: scene,
    )


# --- the file ------------------------------------------------------------------------------------------------------


def _parse(path: Path) -> ElementTree.Element:
    """Return the root element. Raises `LuxelError` where the file is no XML or no scene."""
    try:
        root = ElementTree.parse(path).getroot()
    except ElementTree.ParseError as error:
        raise LuxelError(f"'{path}' is not well-formed XML ({error}); export it again.") from error
    except OSError as error:
        raise LuxelError(f"'{path}' cannot be read ({error.strerror}).") from error
    if root.tag != "scene":
        raise LuxelError(f"'{path}' is XML but no Mitsuba scene: its root is <{root.tag}>, not <scene>.")
    return root


def _load_scene(path: Path) -> Any:
    """Return the `mi.Scene`. Raises `LuxelError` with the heart of Mitsuba's message."""
    try:
        scene: Any = mi.load_file(str(path), optimize=False)
    except Exception as error:
        raise LuxelError(f"Mitsuba cannot load '{path}': {_condense(str(error))}.") from error
    if not isinstance(scene, mi.Scene):
        raise LuxelError(f"'{path}' is not a whole Mitsuba scene; give the file whose root is <scene>.")
    return scene


def _condense(message: str) -> str:
    """Return the cause that ends a nested message, with its place behind it and no full stop."""
    lines = [line.strip() for line in message.splitlines() if line.strip()]
    # What a heading such as "unused properties:" introduces stands in the lines below it.
    start = max((index for index, line in enumerate(lines) if not line.startswith("-")), default=0)
    cause = " ".join(line.lstrip("- ") for line in lines[start:]) or "no reason given"
    cause = re.sub(r"\[[\w.]+(:\d+)?\] ", "", cause)
    placed = re.match(r"(?:Error while loading|While loading|At) .*? \(([^()]*line \d+[^()]*)\): (.+)", cause)
    if placed:
        return f"{placed[2].rstrip('.! ')} ({placed[1]})"
    return cause.rstrip(".! ")


def _expand_instances(path: Path, root: ElementTree.Element, warnings: Warnings) -> list[Any]:
    """Return one `mi.Scene` per instanced shape of the file itself, the instance's transform applied to it."""
    groups = {shape.get("id"): shape for shape in root.iter("shape") if shape.get("type") == "shapegroup"}
    instances = [shape for shape in root.iter("shape") if shape.get("type") == "instance"]
    shared = [item for item in root if item.tag in ("default", "bsdf", "texture", "path", "alias")]
    for entry in root.iter("string"):
        beside = path.resolve().parent / entry.get("value", "")
        if entry.get("name") == "filename" and beside.is_file():
            entry.set("value", str(beside))
    scenes = []
    for instance in instances:
        references = [reference.get("id") for reference in instance.iter("ref")]
        group = next((groups[name] for name in references if name in groups), None)
        if group is None:
            warnings.add("Instances of shapes that are defined in another file are left out.")
            continue
        small = ElementTree.Element("scene", root.attrib)
        small.extend(shared)
        small.extend(_moved(shape, instance) for shape in group.iter("shape") if shape is not group)
        try:
            scenes.append(mi.load_string(ElementTree.tostring(small, encoding="unicode"), optimize=False))
        except Exception as error:
            warnings.add(f"An instance is left out, as Mitsuba could not load it alone: {_condense(str(error))}.")
    return scenes


def _moved(shape: ElementTree.Element, instance: ElementTree.Element) -> ElementTree.Element:
    """Return a copy of a shape whose transform is followed by the instance's."""
    moved = ElementTree.Element("shape", {key: value for key, value in shape.attrib.items() if key != "id"})
    transform = ElementTree.SubElement(moved, "transform", {"name": "to_world"})
    for owner in (shape, instance):
        for child in owner:
            if child.tag == "transform":
                transform.extend(child)
    moved.extend(child for child in shape if child.tag != "transform")
    return moved


# --- shapes --------------------------------------------------------------------------------------------------------


def _convert_shapes(scene: Any, materials: list[Material], warnings: Warnings) -> list[Object]:
    """Return an object for each shape, and append the materials that they need."""
    known: dict[tuple[Any, ...], int] = {}
    objects = []
    for index, shape in enumerate(scene.shapes()):
        name = shape.id() or f"{shape.class_name().lower()}-{index}"
        if shape.class_name() == "Instance":
            continue
        mesh = _convert_shape(shape)
        if mesh is None:
            warnings.add(SKIPPED_SHAPES, shape.class_name())
            continue
        if shape.is_medium_transition():
            warnings.add("Participating media are left out.")
        emitter = shape.emitter()
        # Shapes share a material by their BSDF; those that emit have one each.
        key = (shape.bsdf().ptr,) if emitter is None else (shape.bsdf().ptr, emitter.ptr)
        if key not in known:
            known[key] = len(materials)
            materials.append(make_material(shape, warnings))
        mesh.material = known[key]
        objects.append(Object(name, [mesh]))
    return objects


def _convert_shape(shape: Any) -> Mesh | None:
    """Return the shape's triangles in world space; None for a type that luxel does not know."""
    if shape.is_mesh():
        return read_mesh(shape)
    maker = ANALYTIC_SHAPES.get(shape.class_name())
    if maker is None:
        return None
    mesh = transformed(maker(), _matrix(mi.traverse(shape)["to_world"]))
    return _turned_inside_out(mesh) if shape.has_flipped_normals() else mesh


def read_mesh(shape: Any) -> Mesh:
    """Return a Mitsuba mesh's arrays as a `Mesh` in world space. The one place that knows their names."""
    positions = np.array(shape.vertex_positions_buffer(), np.float32).reshape(-1, 3)
    faces = np.array(shape.faces_buffer(), np.uint32).reshape(-1, 3)
    smooth = shape.has_vertex_normals() and not shape.has_face_normals()
    normals = np.array(shape.vertex_normals_buffer(), np.float32) if smooth else None
    uv = np.array(shape.vertex_texcoords_buffer(), np.float32) if shape.has_vertex_texcoords() else None
    mesh = make_mesh(positions, faces, 0, normals=normals, uv=uv)
    return _turned_inside_out(mesh) if shape.has_flipped_normals() else mesh


def _turned_inside_out(mesh: Mesh) -> Mesh:
    mesh.faces = np.ascontiguousarray(mesh.faces[:, ::-1])
    mesh.normals = None if mesh.normals is None else -mesh.normals
    return mesh


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
    """Return Mitsuba's unit cylinder along +Z, open at both ends, without uv."""
    return transformed(cylinder((0, 0, 0), 1.0, 1.0, 0, sides=64), rotation("x", 90.0))


ANALYTIC_SHAPES: dict[str, Callable[[], Mesh]] = {
    "Sphere": _unit_sphere,
    "Disk": _unit_disk,
    "Cylinder": _unit_cylinder,
}
"""Shapes that Mitsuba intersects without triangles; rectangles and cubes are meshes there."""


# --- cameras -------------------------------------------------------------------------------------------------------


def _convert_sensor(sensor: Any, warnings: Warnings) -> Camera:
    """Return a pinhole. Mitsuba cameras look along +Z of their matrix; `x_fov` is what any fov axis came to."""
    matrix = _matrix(sensor.world_transform())
    parameters = mi.traverse(sensor)
    kind = sensor.class_name()
    fov = 60.0
    if "x_fov" in parameters:
        fov = float(np.array(parameters["x_fov"]).ravel()[0])
    if kind != "PerspectiveCamera":
        warnings.add("Cameras of these types become pinholes: {names}.", kind)
    offsets = [parameters[f"principal_point_offset_{axis}"] for axis in "xy" if "x_fov" in parameters]
    if any(abs(float(np.array(offset).ravel()[0])) > 1e-6 for offset in offsets):
        warnings.add("A camera's shifted principal point is centred.")
    if np.linalg.det(matrix[:3, :3]) < 0:
        warnings.add("A camera mirrors its image; luxel shows it unmirrored.")
    eye, forward, up = matrix[:3, 3], matrix[:3, 2], matrix[:3, 1]
    target = eye + forward / np.linalg.norm(forward)
    return Camera(as_triple(eye), as_triple(target), as_triple(up), fov, name=_camera_name(sensor))


def _camera_name(sensor: Any) -> str:
    """Return the sensor's id; Mitsuba makes up one with an underscore where the file gives none."""
    name = sensor.id()
    return name if name and not name.startswith("_") else "default"


def _matrix(transform: Any) -> np.ndarray:
    return np.array(transform.matrix, float).reshape(4, 4)
