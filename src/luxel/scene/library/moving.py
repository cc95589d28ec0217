"""Rigid objects and a light on key frames: what caches must follow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from luxel.scene.library.shapes import box, cylinder, rotation, sphere, translation
from luxel.scene.model import Camera, Light, Material, Object, SceneData

DURATION = 4.0


@dataclass(frozen=True)
class KeyFrames:
    """Linear motion between keys (seconds, (x, y, z), degrees about +Y); it repeats after the last key."""

    keys: tuple[tuple[float, tuple[float, float, float], float], ...]

    def __call__(self, time: float) -> np.ndarray:
        """Return the (4, 4) matrix at `time` seconds."""
        times = np.array([key[0] for key in self.keys])
        now = time if time == times[-1] else time % times[-1]
        x, y, z = (float(np.interp(now, times, [key[1][axis] for key in self.keys])) for axis in range(3))
        return translation(x, y, z) @ rotation("y", float(np.interp(now, times, [key[2] for key in self.keys])))


def moving() -> SceneData:
    """A room in which a slab turns, a ball crosses, a lift goes up and down and a light circles: 4 s, repeating."""
    white, red, teal, ochre, slate = range(5)
    materials = [
        Material("white", (0.80, 0.79, 0.77)),
        Material("red", (0.72, 0.12, 0.10)),
        Material("teal", (0.10, 0.46, 0.46)),
        Material("ochre", (0.78, 0.55, 0.16)),
        Material("slate", (0.34, 0.36, 0.40)),
    ]
    lo, hi = (-2.5, 0.0, -2.5), (2.5, 3.0, 2.5)
    room = [
        box(lo, hi, white, inward=True, sides=("-x", "+x", "+y", "-z", "+z")),
        box(lo, hi, slate, inward=True, sides=("-y",)),
    ]
    turn = KeyFrames(((0.0, (-1.1, 0.0, -0.6), 0.0), (DURATION, (-1.1, 0.0, -0.6), 360.0)))
    cross = KeyFrames(
        ((0.0, (-1.6, 0.45, 0.75), 0.0), (2.0, (1.6, 0.45, 0.75), 180.0), (DURATION, (-1.6, 0.45, 0.75), 360.0))
    )
    lift = KeyFrames(((0.0, (1.2, 0.05, -1.0), 0.0), (2.0, (1.2, 1.3, -1.0), 0.0), (DURATION, (1.2, 0.05, -1.0), 0.0)))
    circle = KeyFrames(tuple((second, (0.0, 0.0, 0.0), 90.0 * second) for second in range(5)))
    objects = [
        Object("room", room),
        Object("slab", [box((-0.7, 0.0, -0.12), (0.7, 1.9, 0.12), red)], turn(0.0), turn),
        Object("ball", [sphere((0, 0, 0), 0.45, ochre, rings=20, sectors=40)], cross(0.0), cross),
        Object("lift", [cylinder((0, 0, 0), 0.55, 0.25, teal, sides=32, capped=True)], lift(0.0), lift),
    ]
    lamp = Light("point", (6.0, 5.6, 5.0), position=(1.2, 2.4, 0.4), name="lamp", motion=circle)
    view = Camera(eye=(0.3, 1.7, 2.42), target=(0.0, 0.9, -0.8), fov=85.0)
    flight = [
        view,
        Camera((-2.3, 2.2, 2.3), (0.6, 0.5, -0.8), fov=90.0),
        Camera((-2.3, 1.6, -2.3), (0.8, 0.7, 0.6), fov=95.0),
        Camera((0.0, 1.6, -2.3), (0.0, 0.9, 1.5), fov=95.0),
        Camera((2.3, 2.3, -2.2), (-0.6, 0.4, 0.4), fov=95.0),
        Camera((2.3, 1.2, 2.2), (-1.0, 0.8, -0.8), fov=90.0),
        Camera((0.2, 0.3, 0.2), (0.0, 3.0, 0.0), fov=120.0),
    ]
    return SceneData("moving", objects, materials, [lamp], cameras=[view], flight=flight, duration=DURATION)
