"""The part of an uploaded scene that stays in Python."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal
from weakref import WeakSet

import numpy as np

from luxel.errors import LuxelError
from luxel.scene.accel import Group
from luxel.scene.diffuse import as_diffuse
from luxel.scene.lights import LightSources
from luxel.scene.local import localise
from luxel.scene.model import Material, Object, SceneData

OBJECT_LIMIT = 65535
Looks = Literal["diffuse", "full"]
"""What of the materials the device has."""


class Host:
    """The part of a scene that stays in Python: its data, its moving parts, its size. Opaque to Dr.Jit."""

    def __init__(
        self, data: SceneData, lower: np.ndarray, upper: np.ndarray, area: float, looks: Looks = "diffuse"
    ) -> None:
        self._data = data
        self._local: tuple[SceneData, SceneData] | None = None
        self.looks: Looks = looks
        self._shown: dict[int, tuple[Material, Material]] = {}
        """By identity of a material: it, and what the device has of it."""
        self.lower = lower
        """(3,) float64: the robust bounds over the animation (`scene/bounds.py`), measured from the origin; strays may
        lie beyond them."""
        self.upper = upper
        self.area = area
        """Surface area in these bounds at time 0, m^2."""
        self.time = 0.0
        self.epoch = 0
        """Counts what changes the picture: motion, and edits of the live scene."""
        self.caches: WeakSet[Any] = WeakSet()
        """Those who light this scene, and are asked before an edit (`render/shared.Cache`)."""
        self.light_scale = 1.0
        """The factor in `LightTables.scale`."""
        self.is_placed = False
        """An object was placed by hand since `set_time` was last called."""
        self.triangle_table: tuple[np.ndarray, np.ndarray] | None = None
        """Triangles and their vertices' places, once an edit has asked for them."""
        self.facts: tuple[Sequence[Material], Any] | None = None
        """Materials, and the tables of all that they are: for looks at them under the diffuse condition."""
        self.sources: LightSources
        """What the light tables were made of."""
        self.lights_move = False
        """Some light without a surface has a motion."""
        self.glows_in_motion = False
        """Some triangle that emits belongs to what moves or deforms."""
        self.moving: list[tuple[int, Object]] = []
        self.deforming: list[DeformingPart] = []
        self.matrices = np.zeros((1, 4, 4))
        self.object_ids = number_objects(data)
        """(objects,): the id in `Geometry.triangles` of each object of `data`."""
        self.part_starts = np.zeros(0, np.int64)
        """First triangle of each mesh, ascending, and below the object that it belongs to."""
        self.part_objects = np.zeros(0, np.int64)

    @property
    def origin(self) -> np.ndarray:
        """(3,) float64: where the device's (0, 0, 0) lies in the file's coordinates."""
        return np.asarray(self._data.origin, np.float64)

    @property
    def local(self) -> SceneData:
        """`data` as the device has it: measured from the origin, its materials by `looks`."""
        if self._local is None or self._local[0] is not self._data:
            self._local = self._data, self.show(localise(self._data))
        return self._local[1]

    def show(self, data: SceneData) -> SceneData:
        """Return `data` with what the device has of its materials."""
        materials = self.show_materials(data.materials)
        changed = any(new is not old for new, old in zip(materials, data.materials, strict=True))
        return replace(data, materials=materials) if changed else data

    def show_materials(self, materials: Sequence[Material]) -> Sequence[Material]:
        """Return what the device has of `materials`: the same records for the same ones as long as they are asked."""
        if self.looks == "full":
            return materials
        before = self._shown
        self._shown = {id(item): before.get(id(item)) or (item, as_diffuse(item)) for item in materials}
        return [self._shown[id(item)][1] for item in materials]

    def show_material(self, material: Material) -> Material:
        """Return what the device has, or would have, of one material."""
        known = self._shown.get(id(material))
        return material if self.looks == "full" else known[1] if known else as_diffuse(material)

    def object_of_triangle(self, prim_id: int) -> int:
        """Return the index in `data.objects` of the object that triangle `prim_id` belongs to."""
        return int(self.part_objects[np.searchsorted(self.part_starts, prim_id, side="right") - 1])

    def object_name(self, object_id: int) -> str:
        """Return what the object of this id is called; where still objects share one, that they do."""
        owners = np.flatnonzero(self.object_ids == object_id)
        if len(owners) == 1:
            return self.data.objects[owners[0]].name or f"object {owners[0] + 1}"
        return f"{len(owners)} still objects"

    def movable_ids(self) -> np.ndarray:
        """Return which object ids have a space of their own, (ids,) bool."""
        movable = np.zeros(len(self.matrices), bool)
        movable[[key for key, _ in self.moving]] = True
        movable[[part.group.object_id for part in self.deforming]] = True
        return movable

    def note_moving_lights(self) -> None:
        """Find out which light moves, once `sources` or `data` are others."""
        self.lights_move = any(light.motion is not None for light in self.data.lights)
        self.glows_in_motion = bool(self.movable_ids()[self.sources.emitters.object_ids].any())

    @property
    def data(self) -> SceneData:
        """The scene as it is now, in the file's coordinates, held: `scene/live` changes it."""
        return self._data

    @data.setter
    def data(self, data: SceneData) -> None:
        raise LuxelError("an uploaded scene keeps its data: edit it by the calls of a renderer, or upload another one")


@dataclass
class DeformingPart:
    """One mesh of a deforming object: where its vertices are, and how to move them."""

    obj: Object
    mesh_index: int
    vertex_offset: int
    group: Group


def number_objects(data: SceneData) -> np.ndarray:
    """Return an id from 1 for each object, (objects,) int64; what stands still shares one where there are too many.

    Raises LuxelError where even what moves is too much.
    """
    count = len(data.objects)
    if count <= OBJECT_LIMIT:
        return np.arange(1, count + 1)
    moving = np.array([obj.motion is not None or obj.deform is not None for obj in data.objects])
    if moving.sum() >= OBJECT_LIMIT:
        raise LuxelError(f"{data.name}: more than {OBJECT_LIMIT - 1} objects move; merge some of them")
    return np.where(moving, np.cumsum(moving), moving.sum() + 1)
