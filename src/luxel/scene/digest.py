"""What tells scenes apart: a hash of a `SceneData` at one time, the same on every machine and device.

Each dataclass is hashed field by field, by name. A field at its default is left out, so that a field which luxel
learns later changes no hash of a scene that does not use it. What moves is hashed as it stands at the time in question.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import MISSING, fields, is_dataclass, replace
from functools import cache
from numbers import Number
from typing import Any, Literal

import numpy as np

from luxel.errors import LuxelError
from luxel.scene.diffuse import as_diffuse_scene
from luxel.scene.local import localise
from luxel.scene.model import Camera, Light, Mesh, Object, SceneData, Texture

LEFT_OUT = frozenset(
    ("name", "cameras", "flight", "duration", "warnings", "facts", "mitsuba_full", "default_sun", "origin")
    + ("node", "nodes", "uv2_set", "uv_more", "suns", "diffuse", "diffuse_warnings")
)
"""Fields that change no light: what things are called, views of the scene, how long it lasts, what is said of it,
what only serves to write the file again, a sky's suns, which are among the lights, and what the diffuse condition
shows in a material's place, which is hashed instead of it there."""
NOTHING = 1e-12
"""Share of an array's largest number under which one is rounding, and counts as zero."""


def hash_scene(data: SceneData, time: float = 0.0, materials: Literal["diffuse", "full"] = "diffuse") -> str:
    """Return 64 hexadecimal digits that tell how `data` looks at `time` seconds, whatever it is called.

    `materials`: "diffuse" leaves gloss out, which the diffuse condition does not show, as `scene/diffuse.py` says.

    Numbers count as 32-bit floats, so the precision that they are given in makes no difference, and as the device has
    them: a scene measured from amid it, and one that stands there, are the same.
    Raises LuxelError for a field of a kind that has no canonical form.
    """
    if materials == "diffuse":
        data = as_diffuse_scene(data)
    return _Walk(time).digest(localise(data)).hex()


def hash_camera(camera: Camera, axes: Sequence[np.ndarray]) -> str:
    """Return 64 hexadecimal digits that tell how `camera` looks; `axes` (each (3,)) are where it stands at the time."""
    still = replace(camera, eye=Camera.eye, target=Camera.target, up=Camera.up, motion=None)
    walk = _Walk(0.0)
    return hashlib.sha256(b"".join(walk.digest(part) for part in (still, *axes))).hexdigest()


def hash_numbers(*numbers: float) -> str:
    """Return 64 hexadecimal digits of numbers, as 32-bit floats."""
    return _Walk(0.0).digest(np.array(numbers, np.float64)).hex()


class _Walk:
    """One walk over a scene; what several parts share is hashed once."""

    def __init__(self, time: float) -> None:
        self.time = time
        self._known: dict[int, tuple[Any, bytes]] = {}
        """By identity, each with the object itself, which keeps the identity from being given away."""

    def digest(self, value: Any) -> bytes:
        """Return 32 bytes that tell `value` from all others."""
        kind: Any = type(value)
        if isinstance(value, Mesh | Texture):
            if id(value) not in self._known:
                self._known[id(value)] = value, self._digest_fields(value)
            return self._known[id(value)][1]
        if is_dataclass(kind):
            return self._digest_fields(self._freeze(value))
        if value is None or isinstance(value, str):
            return _hash(b"text" if isinstance(value, str) else b"none", (value or "").encode())
        if isinstance(value, np.ndarray | Number | np.generic):
            return _digest_array(np.asarray(value))
        if isinstance(value, list | tuple):
            if value and all(isinstance(item, Number | np.generic) for item in value):
                return _digest_array(np.array(value, np.float64))
            return _hash(b"list", *(self.digest(item) for item in value))
        if isinstance(value, dict):
            return _hash(b"dict", *(self.digest(item) for pair in sorted(value.items()) for item in pair))
        if callable(value):
            return self.digest(value(self.time))
        raise LuxelError(
            f"a scene that holds a {type(value).__name__} cannot be told from others; use NumPy and numbers"
        )

    def _digest_fields(self, value: Any) -> bytes:
        """Return the hash of a dataclass: of its fields by name, those at their default left out."""
        defaults, parts = _defaults(type(value)), []
        for name in sorted({item.name for item in fields(value)} - LEFT_OUT):
            held = self.digest(getattr(value, name))
            if held != defaults.get(name):
                parts += [name.encode(), held]
        return _hash(type(value).__name__.encode(), *parts)

    def _freeze(self, value: Any) -> Any:
        """Return an object or a light as it stands at the time, without its motion; anything else as it is."""
        if isinstance(value, Object) and (value.motion is not None or value.deform is not None):
            matrix = value.to_world if value.motion is None else value.motion(self.time)
            meshes = value.meshes
            if value.deform is not None:
                shapes = zip(meshes, value.deform(self.time), strict=True)
                meshes = [replace(mesh, positions=p, normals=n) for mesh, (p, n) in shapes]
            return replace(value, to_world=matrix, meshes=meshes, motion=None, deform=None)
        if isinstance(value, Light) and value.motion is not None:
            matrix = np.asarray(value.motion(self.time), np.float64)
            x, y, z = (matrix[:3, :3] @ np.asarray(value.position, np.float64) + matrix[:3, 3]).tolist()
            u, v, w = (matrix[:3, :3] @ np.asarray(value.direction, np.float64)).tolist()
            return replace(value, position=(x, y, z), direction=(u, v, w), motion=None)
        return value


@cache
def _defaults(kind: type) -> dict[str, bytes]:
    """Return the hash of each field's default, by name."""
    walk, found = _Walk(0.0), {}
    for item in fields(kind):
        if item.default is not MISSING:
            found[item.name] = walk.digest(item.default)
        elif item.default_factory is not MISSING:
            found[item.name] = walk.digest(item.default_factory())
    return found


def _digest_array(array: np.ndarray) -> bytes:
    """Return the hash of numbers: kind, shape and bytes, as 32-bit floats, bytes of an image, or 64-bit integers."""
    if array.ndim == 0 or array.dtype.kind == "f":
        array = np.asarray(array, np.float64 if array.ndim == 0 else None)
        size = np.abs(array)
        largest = np.max(size, where=np.isfinite(size), initial=0.0)
        # Adding zero turns -0 into 0.
        array = np.where(size < NOTHING * largest, 0.0, array).astype(np.float32) + np.float32(0.0)
    elif array.dtype != np.uint8:
        array = array.astype(np.int64)
    kind = f"{array.dtype.kind}{array.dtype.itemsize} {array.shape}"
    return _hash(b"array", kind.encode(), np.ascontiguousarray(array).data.cast("B") if array.size else b"")


def _hash(*parts: bytes | memoryview) -> bytes:
    """Return the SHA-256 of parts, each with its length before it, so that no two lists of parts run into one."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(len(part).to_bytes(8, "little"))
        digest.update(part)
    return digest.digest()
