"""Figures of a running session: frame rate, stages, rays, cache, memory, recordings; and what the controls show."""

from __future__ import annotations

import statistics
import threading
import time as clock
from collections import deque
from dataclasses import dataclass, field, replace
from typing import Any

import drjit as dr
import numpy as np

from luxel import runtime
from luxel.scene.gloss import is_glossy
from luxel.scene.host import Looks
from luxel.scene.live import Held
from luxel.scene.model import Light
from luxel.scene.sun import sun_angles
from luxel.stages import recording
from luxel.viewer.visitor import Visitor
from luxel.viewer.world import Choice, World

MEMORY_EVERY = 5.0
"""Seconds between two readings of the memory in use; on a GPU each asks the driver's own program."""


@dataclass(frozen=True)
class ObjectFacts:
    """An object of the scene as the controls show it."""

    name: str
    matrix: np.ndarray
    middle: np.ndarray
    """World, metres."""
    size: float
    """Diagonal of its box, metres."""
    held: bool = False
    """A hand has placed it."""


@dataclass(frozen=True)
class Facts:
    """The world as the controls show it; a copy that any thread may read."""

    structure: int
    name: str
    choice: Choice
    params: Any
    frozen: bool
    light_scale: float
    sun: tuple[float, float, float, float] | None
    """Azimuth, elevation in degrees, strength in W/m^2, diameter in degrees."""
    lights: tuple[Light, ...]
    glowing: tuple[tuple[int, str, tuple[float, float, float]], ...]
    """Emissive materials: index, name, radiance."""
    objects: tuple[ObjectFacts, ...]
    duration: float
    playing: bool
    speed: float
    lower: np.ndarray
    """(3,) as the browser measures, from `origin`; `upper` too. All else is in the file's coordinates."""
    upper: np.ndarray
    materials: Looks | None = None
    """What is shown of them; None where none of them is glossy, so that it makes no difference."""
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """(3,) where the browser's (0, 0, 0) lies in the file's coordinates: a browser draws in single precision."""


@dataclass
class Stats:
    """Written by the render thread, read by the controls."""

    device: str
    facts: Facts | None = None
    now: float = 0.0
    """Time of the animation, seconds."""
    visitors: int = 0
    recordings: int = 0
    rays: dict[str, int] = field(default_factory=dict)
    cache: dict[str, int | float] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    memory_mb: float = 0.0
    stages: dict[str, float] = field(default_factory=dict)
    """Milliseconds of device time, by stage."""
    read_at: float = -1e9
    staged_at: float = -1e9
    memory_at: float = -1e9
    _frames: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=64))

    def note_frame(self, ms: float, now: float, visitors: int, recordings: int) -> None:
        """Note a frame that took `ms` and ended at `now`."""
        self._frames.append((now, ms))
        self.visitors, self.recordings = visitors, recordings

    @property
    def frame_ms(self) -> float:
        """Median of the last frames."""
        return statistics.median(ms for _, ms in self._frames) if self._frames else 0.0

    @property
    def frames_a_second(self) -> float:
        """Frames that ended within the last two seconds, a second."""
        now = clock.perf_counter()
        recent = [at for at, _ in list(self._frames) if now - at < 2.0]
        return (len(recent) - 1) / (recent[-1] - recent[0]) if len(recent) > 1 else 0.0

    def publish(self, world: World) -> None:
        """Renew the copy of the world where it has changed."""
        self.now = world.clock.now
        if self.facts is None or self.facts.structure != world.structure:
            self.facts = describe(world)
        elif world.placed:
            objects = list(self.facts.objects)
            for index in world.placed:
                objects[index] = describe_object(world, index)
            self.facts = replace(self.facts, objects=tuple(objects))
        world.placed.clear()


def describe(world: World) -> Facts:
    """Return the world as the controls show it."""
    data, host = world.data, world.scene.host
    used = {mesh.material for item in data.objects for mesh in item.meshes}
    glowing = tuple(
        (index, material.name or f"material {index}", material.emission)
        for index, material in enumerate(data.materials)
        if index in used and max(material.emission) > 0.0
    )
    return Facts(
        structure=world.structure,
        name=world.name,
        choice=world.choices[world.main],
        params=world.cache(world.main).params,
        frozen=world.frozen,
        light_scale=world.light_scale,
        sun=sun_angles(data),
        lights=tuple(replace(light) for light in data.lights),
        glowing=glowing,
        objects=tuple(describe_object(world, index) for index in range(len(data.objects))),
        duration=world.clock.duration,
        playing=world.clock.playing,
        speed=world.clock.speed,
        materials=host.looks if any(map(is_glossy, data.materials)) else None,
        origin=host.origin,
        lower=host.lower,
        upper=host.upper,
    )


def describe_object(world: World, index: int) -> ObjectFacts:
    """Return object `index` as it stands now."""
    item = world.data.objects[index]
    matrix = np.asarray(item.to_world if item.motion is None else item.motion(world.clock.now), np.float64)
    points = [np.asarray(mesh.positions) for mesh in item.meshes if len(mesh.positions)]
    if not points:
        return ObjectFacts(item.name, matrix, matrix[:3, 3].copy(), 0.0)
    held = isinstance(item.motion, Held)
    low, high = np.min([p.min(axis=0) for p in points], axis=0), np.max([p.max(axis=0) for p in points], axis=0)
    middle = matrix[:3, :3] @ (0.5 * (low + high)) + matrix[:3, 3]
    size = float(np.linalg.norm(matrix[:3, :3] @ (high - low)))
    return ObjectFacts(item.name or f"object {index + 1}", matrix, middle, size, held)


def read_cache(stats: Stats, world: World) -> None:
    """Read the sizes of the cache in use, its rays, its warnings and the memory."""
    cache = world.cache(world.main)
    stats.cache = cache.method.cache(cache.state)
    workload = cache.method.workload
    stats.rays = {} if workload is None else workload.ray_counts(cache.state)
    stats.warnings = cache.method.warnings(cache.state)
    if clock.perf_counter() - stats.memory_at > MEMORY_EVERY:
        stats.memory_at = clock.perf_counter()
        # The driver's program takes a tenth of a second: no frame should wait for it.
        threading.Thread(target=read_memory, args=(stats,), name="luxel-memory", daemon=True).start()


def read_memory(stats: Stats) -> None:
    """Read how much memory is in use."""
    stats.memory_mb = runtime.memory_mb()


def measure_stages(world: World, visitor: Visitor) -> dict[str, float]:
    """Run one frame of the method in use stage by stage; return stage -> milliseconds of device time.

    The frame counts: the world goes on from it.
    """
    interleaved = visitor.interleaved(world.main)
    if interleaved is None:
        return {}
    view = interleaved.view_at(0.5, 0.5)
    with recording() as recorder:
        if not view.repeat_staged(advance=not world.frozen):
            return {}
        dr.sync_thread()
    return recorder.medians()
