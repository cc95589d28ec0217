"""Changes to an uploaded scene while it is being rendered: lights, sky, materials, objects that are taken by hand.

Each makes the new data and the arrays that follow from it first and puts them in place last, so that what is refused
changes nothing. Values change without a compilation; the number of lights and the width of the light tree are part of
the kernels, so a scene that gets more of them records the frame anew.
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import fields as fields_of
from dataclasses import replace
from typing import Any, TypeVar

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.errors import LuxelError
from luxel.scene.accel import move_instance
from luxel.scene.arrays import copy_array, from_numpy, to_floats
from luxel.scene.builder import find_gloss, lets_rays_pass
from luxel.scene.check import check_light, check_material, check_motion, check_sky
from luxel.scene.device import Scene, set_time, upload
from luxel.scene.emission_maps import VertexLooks
from luxel.scene.emitters import Emitters, collect_emitters
from luxel.scene.gloss import with_gloss_row
from luxel.scene.held import hold_scene
from luxel.scene.host import Looks
from luxel.scene.lights import build_light_tables, refit_lights
from luxel.scene.local import local_light, local_object
from luxel.scene.model import Light, Material, Object, SceneData, Sky, Texture
from luxel.scene.records import Record, describe
from luxel.scene.rules import LARGEST, is_number
from luxel.scene.sky_suns import replace_sky
from luxel.scene.textures import MaterialTables, build_material_tables

SEE_THROUGH = frozenset({"alpha", "alpha_mode", "alpha_cutoff", "base_color_texture"})
"""Fields that say whether rays may pass."""
BAKED = SEE_THROUGH | {
    "base_color", "metallic", "metallic_roughness_texture", "reflect_back", "emission_texture", "transmission",
    "transmission_texture", "diffuse",
}  # fmt: skip
"""Fields that a baked state holds, or whose changes it would not notice."""

FLAT = 1e-9
"""Share of a matrix's longest axis under which its shortest counts as none."""
SHORTEST = 1e-30
"""Length of an axis whose inverse single precision still holds."""

AnyRecord = TypeVar("AnyRecord", bound=Record)


class Held:
    """The motion of an object that a hand has placed: the same matrix at any time."""

    def __init__(self, matrix: np.ndarray) -> None:
        self.matrix = np.array(matrix, np.float64)
        """(4, 4) object-to-world."""
        self.matrix.flags.writeable = False

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


def find_index(items: Sequence[Any], which: int | str, what: str) -> int:
    """Return the place of the item of that index or name. Raises LuxelError where there is none, or several."""
    if isinstance(which, str):
        places = [index for index, item in enumerate(items) if item.name == which]
        if len(places) == 1:
            return places[0]
        if places:
            numbers = ", ".join(map(str, places))
            raise LuxelError(f"{len(places)} {what}s are called '{which}': name one by its index ({numbers})")
        close = difflib.get_close_matches(which, [item.name for item in items], n=1)
        hint = f"; did you mean '{close[0]}'?" if close else f"; give its index, from 0 to {len(items) - 1}"
        raise LuxelError(f"there is no {what} '{which}'{hint if items else ''}")
    if isinstance(which, bool) or not isinstance(which, int | np.integer):
        raise LuxelError(f"a {what} is named by its index or its name, not by {which!r}")
    if not 0 <= which < len(items):
        known = f"they go from 0 to {len(items) - 1}" if items else "there are none"
        raise LuxelError(f"there is no {what} {which}: {known}")
    return int(which)


def change(record: AnyRecord, fields: dict[str, Any]) -> AnyRecord:
    """Return `record` with other values of some fields. Raises LuxelError for an unknown field or a bad value."""
    known = [item.name for item in fields_of(record)]  # type: ignore[arg-type]
    for name in fields:
        if name not in known:
            close = difflib.get_close_matches(name, known, n=1)
            hint = f"; did you mean '{close[0]}'?" if close else f": it has {', '.join(known)}"
            raise LuxelError(f"{describe(record)} has no field '{name}'{hint}")
    if isinstance(record, Material):
        # What the diffuse condition shows follows from the new fields.
        fields = {"diffuse": None, **fields}
    return replace(record, **fields)  # type: ignore[type-var]


def _put(scene: Scene, **changes: Any) -> None:
    """Make changed data the scene's own, and tell whoever looks at it."""
    host = scene.host
    host._data = hold_scene(replace(host.data, **changes))
    host.note_moving_lights()
    host.epoch += 1


# --- lights, sky ---------------------------------------------------------------------------------------------------


def set_lights(scene: Scene, lights: Sequence[Light]) -> None:
    """Replace all lights without a surface. Raises LuxelError for one that cannot be."""
    for light in lights:
        if not isinstance(light, Light):
            raise LuxelError(f"{light!r} is no light: give a luxel.Light")
        check_light(light)
        check_motion(light)
    changed = replace(scene.host.data, lights=list(lights))
    _relight(scene, changed, scene.host.sources.emitters)
    _put(scene, lights=list(lights))


def set_light(scene: Scene, which: int | str, **fields: Any) -> None:
    """Change fields of one light."""
    lights = list(scene.host.data.lights)
    index = find_index(lights, which, "light")
    lights[index] = change(lights[index], fields)
    set_lights(scene, lights)


def add_light(scene: Scene, light: Light) -> int:
    """Add a light without a surface; return its index."""
    set_lights(scene, [*scene.host.data.lights, light])
    return len(scene.host.data.lights) - 1


def remove_light(scene: Scene, which: int | str) -> None:
    """Remove a light."""
    lights = list(scene.host.data.lights)
    del lights[find_index(lights, which, "light")]
    set_lights(scene, lights)


def set_sky(scene: Scene, sky: Sky) -> None:
    """Replace the sky, and with it the suns of its image. Raises LuxelError for an image that is not finite."""
    if sky.image is not scene.host.data.sky.image:
        check_sky(sky)
    changed = replace_sky(scene.host.data, sky)
    _relight(scene, changed, scene.host.sources.emitters)
    _put(scene, sky=changed.sky, lights=changed.lights)


def set_light_scale(scene: Scene, factor: float) -> None:
    """Multiply every light, emission and sky by `factor`; compiles nothing. Raises LuxelError for a negative one."""
    if not (is_number(factor) and factor >= 0.0):
        raise LuxelError(f"light cannot be scaled by {factor}: use a finite number of 0 or more")
    scene.lights.scale = dr.opaque(mi.Float, float(factor))
    scene.host.light_scale = float(factor)
    scene.host.epoch += 1


def _relight(scene: Scene, data: SceneData, emitters: Emitters) -> None:
    """Make the light tables of changed `data`; the common scale stays, and so do widths that need not grow."""
    before, host = scene.lights, scene.host
    # A sky image may be large, and stays where it is unless another one comes.
    same_image = data.sky.image is host.data.sky.image
    slim = replace(data, sky=replace(data.sky, image=None)) if same_image else data
    # The device has them measured from the origin.
    slim = replace(slim, lights=[local_light(light, host.origin) for light in data.lights])
    tables, sources = build_light_tables(slim, emitters, host.matrices, host.time, (before, host.sources))
    if same_image:
        tables.sky_image, tables.sky_width, tables.sky_height = before.sky_image, before.sky_width, before.sky_height
        tables.sky_table = before.sky_table
    else:
        tables.sky_image = copy_array(tables.sky_image)
        tables.sky_table.cells = copy_array(tables.sky_table.cells)
    # A sky that has gone out is black, which needs no other kernel.
    tables.has_sky |= before.has_sky
    tables.scale = before.scale
    scene.lights, host.sources = tables, sources


def _emitters(scene: Scene, data: SceneData) -> Emitters:
    """Return what emits, made of the materials of `data`, at the present time."""
    host = scene.host
    before = list(host.show_materials(host.data.materials)), host.sources.emitters
    return collect_emitters(host.show(data), *_triangle_table(scene), _vertex_looks(scene), host.movable_ids(), before)


def _vertex_looks(scene: Scene) -> VertexLooks:
    geometry, features = scene.geometry, scene.features
    u, v = (np.array(rows).reshape(-1, 4)[:, 3] for rows in (geometry.vertices, geometry.normals))
    return VertexLooks(
        uv=np.stack([u, v], axis=1),
        uv2=np.array(geometry.uv2).reshape(-1, 2) if features.uv2 else None,
        colors=np.array(geometry.colors).reshape(-1, 4) if features.colors else None,
    )


def _triangle_table(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Return triangles (F, 4) and vertices (V, 3), in their objects' spaces at the present time."""
    host = scene.host
    if host.triangle_table is None or scene.features.deforming:
        triangles = np.array(scene.geometry.triangles).reshape(-1, 4)
        host.triangle_table = triangles, np.array(scene.geometry.vertices).reshape(-1, 4)[:, :3]
    return host.triangle_table


# --- materials -----------------------------------------------------------------------------------------------------


def set_material(scene: Scene, index: int, material: Material) -> None:
    """Replace material `index`; one that `needs_upload` says no to. Raises LuxelError for one that cannot be."""
    check_material(material)
    data = scene.host.data
    materials = [*data.materials[:index], material, *data.materials[index + 1 :]]
    changed = replace(data, materials=materials)
    host = scene.host
    row = _material_row(scene, host.show_material(data.materials[index]), host.show_material(material), index)
    tables = row if row is not None else _all_rows(scene, changed)
    _relight(scene, changed, _emitters(scene, changed))
    scene.materials = tables
    _put(scene, materials=materials)


def needs_upload(scene: Scene, index: int, material: Material) -> bool:
    """Return whether triangles that are traced as opaque would let rays pass, or the first gloss would appear."""
    data = scene.host.data
    gloss, glass = find_gloss([material], scene.host.looks)
    if gloss > scene.features.gloss or glass > scene.features.transmission:
        return True
    before, material = map(scene.host.show_material, (data.materials[index], material))
    if material.alpha_mode == "opaque" or all(
        _is_same(getattr(material, key), getattr(before, key)) for key in SEE_THROUGH
    ):
        return False
    if material.alpha_mode != before.alpha_mode:
        # Whether chance decides is part of the kernels.
        return True
    meshes = [mesh for item in scene.host.data.objects for mesh in item.meshes if mesh.material == index]
    if not any(lets_rays_pass(material, mesh) for mesh in meshes):
        return False
    uses = (_triangle_table(scene)[0][:, 3] & 0xFFFF) == index
    return any(
        not group.cutout and bool(uses[group.prim_offset : group.prim_offset + group.prim_count].any())
        for group in scene.groups
    )


def _is_same(value: Any, before: Any) -> bool:
    """Return whether a field keeps its value; another texture is another value, since arrays are not compared."""
    return value is before or (not isinstance(before, Texture) and value == before)


def is_baked(data: SceneData, index: int) -> bool:
    """Return whether a still object has material `index`."""
    return any(
        mesh.material == index
        for item in data.objects
        if item.motion is None and item.deform is None
        for mesh in item.meshes
    )


def _material_row(scene: Scene, before: Material, material: Material, index: int) -> MaterialTables | None:
    """Return the tables with another row of factors and flags; None where they must be made anew."""
    tables, gloss, rough = scene.materials, scene.features.gloss, material.metallic_roughness_texture
    slots = np.array(tables.slots).reshape(-1, 8)
    glows_anew = material.emission_texture is not None and max(material.emission) > 0.0 and not slots[index, 1]
    textures = [item.name for item in fields_of(Material) if item.name.endswith("_texture")]
    same = all(getattr(material, name) is getattr(before, name) for name in textures)
    combined = rough is not None and not gloss and material.metallic != before.metallic
    if not same or glows_anew or combined:
        return None
    kept = () if gloss else ("metallic_roughness_texture",)
    plain = replace(material, **{name: None for name in textures if name not in kept})
    single = build_material_tables(SceneData("", [], [plain]), gloss)
    factors = np.array(tables.factors).reshape(-1, 16)
    # Where the metallic texture lies apart from the colour's, which `plain` has not, its factor stays.
    factors[index] = np.array(single.factors) if gloss else [*np.array(single.factors)[:13], *factors[index, 13:]]
    flags = int(np.array(single.slots)[4])
    changed = replace(tables, factors=to_floats(factors), one_sided=tables.one_sided or single.one_sided)
    if flags != slots[index, 4]:
        slots[index, 4] = flags
        changed.slots = copy_array(from_numpy(mi.UInt32, slots))
    if gloss:
        changed.gloss = with_gloss_row(tables.gloss, single.gloss, index)
        changed.has_metallic = tables.has_metallic or single.has_metallic
    return changed


def _all_rows(scene: Scene, data: SceneData) -> MaterialTables:
    tables = build_material_tables(scene.host.show(data), scene.features.gloss)
    for name in ("factors", "slots", "textures", "transforms", "texels"):
        setattr(tables, name, copy_array(getattr(tables, name)))
    gloss = tables.gloss
    gloss.factors, gloss.slots = copy_array(gloss.factors), copy_array(gloss.slots)
    return tables


# --- objects -------------------------------------------------------------------------------------------------------


def is_movable(scene: Scene, index: int) -> bool:
    """Return whether object `index` has a space of its own in the uploaded scene, so that it can be placed."""
    item = scene.host.data.objects[index]
    return item.motion is not None and item.deform is None


def check_placement(scene: Scene, index: int, matrix: Any) -> np.ndarray:
    """Return `matrix` (4, 4) float64. Raises LuxelError where object `index` cannot be placed by it."""
    item = scene.host.data.objects[index]
    try:
        placed = np.array(matrix, np.float64)
    except (TypeError, ValueError, OverflowError):
        placed = np.zeros(0)
    if placed.shape != (4, 4) or not np.isfinite(placed).all():
        raise LuxelError(f"object '{item.name}' is placed by a finite 4x4 matrix (object to world), not by this one")
    if not (np.abs(placed[:3, 3]) <= LARGEST).all():
        raise LuxelError(f"object '{item.name}' cannot be placed beyond {LARGEST:.0e} m: move it to where the scene is")
    # By the ratio of its axes and not by its volume, which small objects lack.
    axes = np.linalg.svd(placed[:3, :3], compute_uv=False)
    flat = not axes[2] > max(FLAT * axes[0], SHORTEST)
    if flat or not np.array_equal(placed[3], (0.0, 0.0, 0.0, 1.0)):
        raise LuxelError(
            f"object '{item.name}' cannot be placed by a matrix without inverse, or with a last row other than 0 0 0 1"
        )
    if item.deform is not None:
        raise LuxelError(f"object '{item.name}' deforms; only rigid objects can be moved by hand")
    return placed


def with_held(data: SceneData, index: int, matrix: np.ndarray) -> SceneData:
    """Return `data` with object `index` as one that hands place, at `matrix` (4, 4)."""
    held = replace(data.objects[index], motion=Held(matrix))
    return replace(data, objects=[*data.objects[:index], held, *data.objects[index + 1 :]])


def place_object(scene: Scene, index: int, matrix: np.ndarray) -> None:
    """Place object `index` at `matrix` (4, 4), and keep it there at any time; compiles nothing.

    Raises LuxelError for an object without a space of its own (`is_movable`) and for a matrix that flattens it.
    """
    host, geometry = scene.host, scene.geometry
    matrix = check_placement(scene, index, matrix)
    if not is_movable(scene, index):
        raise LuxelError(f"object '{host.data.objects[index].name}' is part of the still scene: hold it first")
    object_id = int(host.object_ids[index])
    _put(scene, objects=with_held(host.data, index, matrix).objects)
    held: Object = local_object(host.data.objects[index], host.origin)
    assert held.motion is not None
    host.moving = [(key, held if key == object_id else item) for key, item in host.moving]
    host.matrices[object_id] = held.motion(host.time)
    if scene.one is not None:
        names = [group.name for group in scene.groups if group.object_id == object_id]
        move_instance(scene.one, names, host.matrices[object_id])
    if not host.is_placed:
        geometry.to_world_before = copy_array(geometry.to_world)
    geometry.to_world = to_floats(host.matrices[:, :3, :])
    geometry.to_object = to_floats(np.linalg.inv(host.matrices)[:, :3, :])
    host.is_placed = True
    if (host.sources.emitters.object_ids == object_id).any():
        refit_lights(scene.lights, host.sources, host.matrices)


# --- the scene anew ------------------------------------------------------------------------------------------------


def upload_like(scene: Scene, data: SceneData, looks: Looks | None = None) -> Scene:
    """Return `data` uploaded as `scene` was, at its time and under its scale of light; `looks` None: as it was, too."""
    fresh = upload(data, one_accel=scene.one is not None, materials=looks or scene.host.looks)
    set_time(fresh, scene.host.time)
    fresh.lights.scale, fresh.host.light_scale = scene.lights.scale, scene.host.light_scale
    fresh.host.epoch = scene.host.epoch + 1
    return fresh


def take_over(scene: Scene, fresh: Scene) -> None:
    """Let `scene` be `fresh` for all who have it; caches of the old one no longer fit."""
    for item in fields_of(Scene):
        setattr(scene, item.name, getattr(fresh, item.name))
