"""A scene measured from its origin: what the device and everything that runs on it sees.

Whoever uses luxel speaks the file's coordinates, in double precision. The device has single precision, which at 100 km
tells places 8 mm apart. So `upload` takes the scene as `localise` returns it, `Host.local`, and what comes back from
the device (places of hits, probes, surfels) has the origin added where it is handed out. docs/conventions.md, "Far from
the origin", says where that is. A scene whose origin is (0, 0, 0) is its own local one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from luxel.scene.model import Camera, Colour, Light, Mesh, Object, SceneData
from luxel.scene.origin import far_centre

Shifted = dict[int, tuple[list[Mesh], np.ndarray, list[Mesh]]]
"""By identity of a list of meshes: the list itself, the middle of its vertices, and its meshes about that."""


@dataclass
class Between:
    """A motion seen from elsewhere: outer @ motion(time) @ inner, all (4, 4) float64."""

    motion: Callable[[float], np.ndarray]
    outer: np.ndarray
    inner: np.ndarray

    def __call__(self, time: float) -> np.ndarray:
        return self.outer @ np.asarray(self.motion(time), np.float64) @ self.inner


def localise(data: SceneData) -> SceneData:
    """Return `data` measured from `data.origin`, which is then (0, 0, 0); `data` itself where nothing changes."""
    origin = np.asarray(data.origin, np.float64)
    known: Shifted = {}
    objects = [local_object(item, origin, known) for item in data.objects]
    if not origin.any():
        moved = any(new is not old for new, old in zip(objects, data.objects, strict=True))
        return replace(data, objects=objects) if moved else data
    return replace(
        data,
        origin=(0.0, 0.0, 0.0),
        objects=objects,
        lights=[local_light(light, origin) for light in data.lights],
        cameras=[local_camera(camera, origin) for camera in data.cameras],
        flight=[local_camera(camera, origin) for camera in data.flight],
    )


def measured_from(data: SceneData, origin: np.ndarray) -> SceneData:
    """Return `data`, which is measured from `origin` (3,), in the file's coordinates: the opposite of `localise`."""
    x, y, z = origin.tolist()
    back = translation(origin)
    return replace(
        data,
        origin=(x, y, z),
        objects=[replace(item, to_world=back @ item.to_world) for item in data.objects],
        lights=[local_light(light, -origin) for light in data.lights],
        cameras=[local_camera(camera, -origin) for camera in data.cameras],
    )


def local_object(item: Object, origin: np.ndarray, known: Shifted | None = None) -> Object:
    """Return `item` measured from `origin` (3,); a moving one with its vertices about the middle of its own space.

    What stands still is brought to the scene's space in double precision, wherever its vertices are. The space of what
    moves is on the device too.
    """
    centre, meshes = np.zeros(3), item.meshes
    if item.motion is not None and item.deform is None:
        centre, meshes = _about_middle(item.meshes, {} if known is None else known)
    if not origin.any() and not centre.any():
        return item
    outer, inner = translation(-origin), translation(centre)
    motion = None if item.motion is None else Between(item.motion, outer, inner)
    return replace(item, meshes=meshes, to_world=outer @ item.to_world @ inner, motion=motion)


def local_light(light: Light, origin: np.ndarray) -> Light:
    """Return `light` measured from `origin` (3,)."""
    if not origin.any():
        return light
    motion = None if light.motion is None else Between(light.motion, translation(-origin), translation(origin))
    place = light.position if light.kind == "directional" else _minus(light.position, origin)
    return replace(light, position=place, motion=motion)


def local_camera(camera: Camera, origin: Sequence[float] | np.ndarray) -> Camera:
    """Return `camera` measured from `origin` (3,); the opposite with -origin."""
    origin = np.asarray(origin, np.float64)
    if not origin.any():
        return camera
    motion = None if camera.motion is None else Between(camera.motion, translation(-origin), np.eye(4))
    return replace(camera, eye=_minus(camera.eye, origin), target=_minus(camera.target, origin), motion=motion)


def translation(offset: np.ndarray) -> np.ndarray:
    """Return the (4, 4) float64 matrix that moves by `offset` (3,)."""
    matrix = np.eye(4)
    matrix[:3, 3] = offset
    return matrix


def _minus(place: Colour, origin: np.ndarray) -> Colour:
    x, y, z = (np.asarray(place, np.float64) - origin).tolist()
    return x, y, z


def _about_middle(meshes: list[Mesh], known: Shifted) -> tuple[np.ndarray, list[Mesh]]:
    """Return the middle (3,) of vertices that are far from zero, and the meshes about it; else zero and `meshes`."""
    if id(meshes) not in known:
        filled = [mesh.positions for mesh in meshes if len(mesh.faces)]
        centre = far_centre(np.concatenate(filled) if filled else np.zeros((0, 3)))
        shifted = meshes
        if centre.any():
            shifted = [replace(mesh, positions=(mesh.positions - centre).astype(np.float32)) for mesh in meshes]
        known[id(meshes)] = meshes, centre, shifted
    _, centre, shifted = known[id(meshes)]
    return centre, shifted
