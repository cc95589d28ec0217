"""The copy of a scene that an uploaded one keeps: whoever edits it is told what to call instead.

Records and matrices are copied, larger arrays are shared as read-only views. What was shared in the original (a mesh of
many objects, an image of many textures) is shared in the copy.
"""

from __future__ import annotations

from typing import Any, NoReturn

import numpy as np

from luxel.errors import LuxelError
from luxel.scene.records import HELD, Record

ADVICE = {
    "Light": "call set_light",
    "Material": "call set_material",
    "Texture": "call set_material with a new texture",
    "Sky": "call set_sky",
    "Camera": "call set_camera",
    "Object": "call move_object, or change your own scene and make a new renderer",
    "Mesh": "change your own scene and make a new renderer",
    "Node": "change your own scene and make a new renderer",
    "SceneData": "call set_light, add_light, remove_light, set_material, set_sky or move_object",
}


MATRIX_SIZE = 16
"""Numbers of an array up to which it is copied and not shared."""


class HeldList(list[Any]):
    """A list that cannot be changed."""

    def _refuse(self, *_: Any, **__: Any) -> NoReturn:
        raise LuxelError(f"this list belongs to a renderer and cannot be changed: {ADVICE['SceneData']}")

    __setitem__ = __delitem__ = __iadd__ = __imul__ = _refuse  # type: ignore[assignment]
    append = extend = insert = pop = remove = clear = sort = reverse = _refuse  # type: ignore[assignment]

    def __reduce__(self) -> tuple[type[list[Any]], tuple[list[Any]]]:  # type: ignore[override]
        # A copy is a plain list.
        return list, (list(self),)


class HeldDict(dict[Any, Any]):
    """A dictionary that cannot be changed."""

    def _refuse(self, *_: Any, **__: Any) -> NoReturn:
        raise LuxelError(f"this dictionary belongs to a renderer and cannot be changed: {ADVICE['Mesh']}")

    __setitem__ = __delitem__ = __ior__ = _refuse  # type: ignore[assignment]
    clear = pop = popitem = setdefault = update = _refuse  # type: ignore[assignment]

    def __reduce__(self) -> tuple[type[dict[Any, Any]], tuple[dict[Any, Any]]]:  # type: ignore[override]
        # A copy is a plain dictionary.
        return dict, (dict(self),)


def hold_scene(record: Any, known: dict[int, Any] | None = None) -> Any:
    """Return a copy of `record` (a `SceneData` or any part of one) that cannot be changed; held parts stay the same."""
    known = {} if known is None else known
    if isinstance(record, Record):
        return record if HELD in vars(record) else known.get(id(record)) or _hold_record(record, known)
    if type(record) is list:
        return HeldList([hold_scene(item, known) for item in record])
    if type(record) is dict:
        return HeldDict({key: hold_scene(value, known) for key, value in record.items()})
    if isinstance(record, tuple):
        return HeldList(hold_scene(list(record), known)) if record and isinstance(record[0], Record) else record
    if isinstance(record, np.ndarray):
        if id(record) not in known and record.flags.writeable:
            # The owner may well write into a matrix, and it is small; vertices and images are shared.
            view = record.copy() if record.size <= MATRIX_SIZE else record.view()
            view.flags.writeable = False
            known[id(record)] = view
        return known.get(id(record), record)
    return record


def _hold_record(record: Record, known: dict[int, Any]) -> Record:
    copy = object.__new__(type(record))
    fields = copy.__dict__
    for name, value in vars(record).items():
        plain = value is None or isinstance(value, str | float | int)
        fields[name] = value if plain else hold_scene(value, known)
    fields[HELD] = ADVICE[type(record).__name__]
    known[id(record)] = copy
    return copy
