"""Changes to an uploaded scene while it is being rendered: lights, emission, objects that are taken by hand.

Each edits `scene.host.data` and then the arrays that follow from it. Values change without a compilation; the number of
lights or of emissive triangles is part of the kernels, so changing it records the frame anew.
"""

from __future__ import annotations

import math
from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.errors import LuxelError
from luxel.scene.accel import move_instance
from luxel.scene.arrays import copy_floats, to_floats
from luxel.scene.device import Scene
from luxel.scene.edit import DEFAULT_SUN, apply_sun
from luxel.scene.lights import build_light_tables, refresh_delta_lights
from luxel.scene.model import Colour, Light, Object, SceneData

NIGHT = 1e-9
"""W/m^2 of a sun that is out."""


class Held:
    """The motion of an object that a hand has placed: the same matrix at any time."""

    def __init__(self, matrix: np.ndarray) -> None:
        self.matrix = np.array(matrix, np.float64)
        """(4, 4) object-to-world."""

    def __call__(self, time: float) -> np.ndarray:
        return self.matrix


def copy_scene_data(data: SceneData) -> SceneData:
    """Return a copy whose lists of objects, materials and lights may be edited without touching `data`."""
    return replace(
        data,
        objects=[replace(item) for item in data.objects],
        materials=[replace(material) for material in data.materials],
        lights=[replace(light) for light in data.lights],
        sky=replace(data.sky),
        warnings=list(data.warnings),
    )


# --- lights --------------------------------------------------------------------------------------------------------


def set_lights(scene: Scene, lights: list[Light]) -> None:
    """Replace all lights without a surface. Raises LuxelError for a colour, place or direction that cannot be."""
    for light in lights:
        check_light(light)
    scene.host.data.lights = list(lights)
    _relight(scene)


def check_light(light: Light) -> None:
    """Raise LuxelError for a light that cannot be rendered."""
    numbers = (*light.color, *light.position, *light.direction)
    if not all(math.isfinite(number) for number in numbers):
        raise LuxelError(f"light '{light.name}' holds a number that is not finite")
    if min(light.color) < 0.0:
        raise LuxelError(f"light '{light.name}' has a negative colour {light.color}; use 0 or more")
    if light.kind != "point" and not any(light.direction):
        raise LuxelError(f"light '{light.name}' needs a direction")


def set_emission(scene: Scene, material: int, emission: Colour) -> None:
    """Set the radiance of an emissive material, W/(m^2 sr). Raises LuxelError for a negative or endless one."""
    if not all(math.isfinite(channel) and channel >= 0.0 for channel in emission):
        raise LuxelError(f"an emission of {emission} cannot be: use finite numbers of 0 or more")
    data, tables = scene.host.data, scene.materials
    data.materials[material].emission = emission
    factors = np.array(tables.factors).reshape(-1, 16)
    factors[material, 4:7] = emission
    scene.materials = replace(tables, factors=to_floats(factors))
    _relight(scene)


def set_sun(scene: Scene, azimuth: float, elevation: float, strength: float) -> None:
    """Replace the directional lights by one sun; angles in degrees as in `edit.apply_sun`, strength in W/m^2."""
    # A sun that is out keeps a trace of light, and with it its tint for the next morning.
    strength = max(strength, NIGHT)
    suns = [light for light in scene.host.data.lights if light.kind == "directional"]
    changed = apply_sun(replace(scene.host.data), f"{azimuth},{elevation},{strength}").lights
    # The tint of the scene's own sun stays.
    if suns and max(suns[0].color) > 0.0:
        tint = np.asarray(suns[0].color) / max(suns[0].color)
        red, green, blue = (float(strength * channel) for channel in tint)
        changed[-1].color = (red, green, blue)
    set_lights(scene, changed)


def sun_angles(data: SceneData) -> tuple[float, float, float] | None:
    """Return azimuth and elevation in degrees, and the strength in W/m^2, of the first sun; None without one."""
    for light in data.lights:
        if light.kind == "directional":
            x, y, z = -np.asarray(light.direction) / np.linalg.norm(light.direction)
            azimuth = math.degrees(math.atan2(x, z)) % 360.0
            return azimuth, math.degrees(math.asin(float(np.clip(y, -1.0, 1.0)))), max(light.color)
    return None


def sun_at_hour(hour: float) -> tuple[float, float, float]:
    """Return azimuth, elevation (degrees) and strength (W/m^2) of a plain sun at `hour`, 0..24.

    It rises in the east (+X) at 6, stands 60 degrees high in the south (+Z) at 12 and sets at 18; a thicker air dims it
    near the horizon. No place on earth is meant.
    """
    turn = (hour - 12.0) / 12.0 * math.pi
    elevation = 60.0 * math.cos(turn)
    azimuth = (90.0 - 90.0 * (hour - 6.0) / 6.0) % 360.0
    height = max(math.sin(math.radians(elevation)), 0.0)
    strength = max(DEFAULT_SUN) * math.exp(-0.15 * (1.0 / max(height, 0.05) - 1.0)) if height > 0.0 else 0.0
    return azimuth, elevation, strength


def _relight(scene: Scene) -> None:
    """Make the light tables anew from the scene's data; the common scale stays."""
    triangles = np.array(scene.geometry.triangles).reshape(-1, 4)
    areas = _triangle_areas(scene, triangles)
    scale, data = scene.lights.scale, scene.host.data
    tables = build_light_tables(data, scene.materials, triangles, areas)
    tables.scale = scale
    # Arrays of their own, opaque: a frozen frame that saw other ones would be recorded anew.
    dr.make_opaque(tables.entries, tables.probabilities, tables.alias, tables.sky_image)
    refresh_delta_lights(tables, data.lights, scene.host.time)
    scene.lights = tables


def _triangle_areas(scene: Scene, triangles: np.ndarray) -> np.ndarray:
    """Return the area of each triangle (F,), m^2, at the scene's present time."""
    points = np.array(scene.geometry.vertices).reshape(-1, 4)[:, :3].astype(np.float64)
    corners = points[triangles[:, :3].astype(np.int64)]
    for group in scene.groups:
        if group.object_id:
            part = slice(group.prim_offset, group.prim_offset + group.prim_count)
            corners[part] = corners[part] @ scene.host.matrices[group.object_id][:3, :3].T
    return 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)


# --- objects -------------------------------------------------------------------------------------------------------


def hold_object(data: SceneData, index: int, matrix: np.ndarray) -> Object:
    """Make object `index` of `data` one that hands place, at `matrix` (4, 4); returns it."""
    held = replace(data.objects[index], motion=Held(matrix))
    data.objects[index] = held
    return held


def is_movable(scene: Scene, index: int) -> bool:
    """Return whether object `index` has a space of its own in the uploaded scene, so that it can be placed."""
    return any(object_id == index + 1 for object_id, _ in scene.host.moving)


def place_object(scene: Scene, index: int, matrix: np.ndarray) -> None:
    """Place object `index` at `matrix` (4, 4), and keep it there at any time; compiles nothing.

    Raises LuxelError for an object without a space of its own (`is_movable`) and for a matrix that flattens it.
    """
    host, geometry = scene.host, scene.geometry
    if not is_movable(scene, index):
        raise LuxelError(f"object '{host.data.objects[index].name}' is part of the still scene: hold it first")
    if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix[:3, :3])) < 1e-12:
        raise LuxelError(f"object '{host.data.objects[index].name}' cannot be placed by a matrix without inverse")
    held = hold_object(host.data, index, matrix)
    object_id = index + 1
    host.moving = [(key, held if key == object_id else item) for key, item in host.moving]
    host.matrices[object_id] = matrix
    if scene.one is not None:
        names = [group.name for group in scene.groups if group.object_id == object_id]
        move_instance(scene.one, names, host.matrices[object_id])
    geometry.to_world_before = copy_floats(geometry.to_world)
    geometry.to_world = to_floats(host.matrices[:, :3, :])
    geometry.to_object = to_floats(np.linalg.inv(host.matrices)[:, :3, :])


def set_light_scale(scene: Scene, factor: float) -> None:
    """Multiply every light, emission and sky by `factor`; compiles nothing. Raises LuxelError for a negative one."""
    if not (math.isfinite(factor) and factor >= 0.0):
        raise LuxelError(f"light cannot be scaled by {factor}: use a finite number of 0 or more")
    scene.lights.scale = dr.opaque(mi.Float, float(factor))
