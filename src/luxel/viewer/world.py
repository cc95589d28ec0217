"""The world that all visitors share: the scene, the caches of its light, the clock. It knows no camera and no browser.

Every change is whole or not at all: what may fail is built first, and only then put in place.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from luxel.errors import LuxelError
from luxel.methods.own import list_names
from luxel.methods.params import find_method, make_params
from luxel.methods.table import METHODS
from luxel.render.live import LiveScene
from luxel.render.shared import Cache
from luxel.scene.device import Scene, set_time, upload
from luxel.scene.gloss import is_glossy
from luxel.scene.host import Looks
from luxel.scene.model import Light, SceneData

LIGHT_LIMIT = 64
"""Lights that visitors may add up to."""


@dataclass(frozen=True)
class Choice:
    """A method with the parameters that were asked for."""

    method: str
    preset: str | None = None
    settings: dict[str, Any] = field(default_factory=dict)
    """Only what differs from the preset."""

    def params(self) -> Any:
        """Return the `Params`. Raises LuxelError for an unknown name or a value of the wrong kind."""
        return make_params(self.method, self.preset, self.settings)

    def shown_materials(self, wanted: Looks) -> Looks:
        """Return what the method shows of materials where `wanted` is asked for."""
        return find_method(self.method).shown_materials(wanted)


@dataclass
class Clock:
    """The time of an animated scene, seconds."""

    duration: float
    now: float = 0.0
    playing: bool = False
    speed: float = 1.0

    def tick(self, seconds: float) -> None:
        """Let `seconds` of real time pass; the animation starts over at its end."""
        if self.playing and self.duration > 0.0:
            self.now = (self.now + self.speed * min(seconds, 0.25)) % self.duration

    def seek(self, seconds: float) -> None:
        """Go to a time within the animation. Raises LuxelError for what is no time."""
        if not np.isfinite(seconds):
            raise LuxelError(f"an animation has no time {seconds}")
        self.now = float(np.clip(seconds, 0.0, self.duration))


class World(LiveScene):
    """One scene under one or two methods, edited by the calls of `LiveScene`. Only the render thread may touch it."""

    def __init__(self, data: SceneData, choice: Choice, seed: int = 0, materials: Looks = "diffuse") -> None:
        """Upload the scene and build the method's cache. Raises LuxelError for bad input.

        `materials` "full" shows all that they do as long as all methods in view can; with another one, in use or beside
        the split, all show their diffuse part, so that both sides are one scene.
        """
        self.name = data.name
        self.seed = seed
        self.materials: Looks = materials
        self.scene: Scene = upload(data, recentre=True, materials=self._looks_of([choice.method]))
        self.clock = Clock(data.duration)
        self.frozen = False
        """The caches stay as they are: nothing is traced, placed or forgotten."""
        self.main = choice.method
        self.choices: dict[str, Choice] = {choice.method: choice}
        self.caches: dict[str, Cache] = {choice.method: Cache(self.scene, choice.method, choice.params(), seed)}
        self.version = 0
        """Counts what changes the picture: visitors start their means anew."""
        self.structure = 0
        """Counts what changes the controls: visitors draw them anew."""
        self.placed: set[int] = set()
        """Objects that hands have moved since the world was last published."""

    # ------------------------------------------------------------------ frames

    def tick(self, seconds: float, wanted: Iterable[str]) -> bool:
        """Let `seconds` pass, and keep the caches of the methods that somebody looks at; return whether objects moved.

        `wanted` names those methods; the one in use always stays.
        """
        names = {self.main, *wanted}
        for name in [name for name in self.caches if name not in names]:
            del self.caches[name]
        self._show_for(names)
        self.clock.tick(seconds)
        moved = set_time(self.scene, self.clock.now)
        self.version += moved
        return moved

    def advance(self, wanted: Iterable[str]) -> None:
        """Advance the caches by one frame."""
        for name in {self.main, *wanted}:
            cache = self.cache(name)
            if not self.frozen:
                cache.advance()

    def cache(self, name: str) -> Cache:
        """Return the cache of method `name`, made on first use. Raises LuxelError for an unknown one."""
        if name not in self.caches:
            self._show_for({name, *self.caches})
            choice = self.choices.setdefault(name, Choice(find_method(name).name))
            self.caches[name] = Cache(self.scene, name, choice.params(), self.seed)
        return self.caches[name]

    # ------------------------------------------------------------------ methods

    def switch_method(self, name: str, preset: str | None = None) -> None:
        """Light the scene by method `name`, with its last parameters or those of `preset`."""
        choice = Choice(name, preset) if preset is not None else self.choices.get(name, Choice(find_method(name).name))
        self._choose(choice)
        self.main = name

    def apply_preset(self, preset: str | None) -> None:
        """Give the method in use a preset's parameters; None: its defaults."""
        self._choose(Choice(self.main, preset))

    def set_param(self, key: str, value: Any) -> bool:
        """Set a parameter of the method in use; return whether the cache could go on."""
        choice = self.choices[self.main]
        return self._choose(replace(choice, settings={**choice.settings, key: value}))

    def _choose(self, choice: Choice) -> bool:
        params = choice.params()
        if choice.method in self.caches:
            kept = self.caches[choice.method].retune(params)
        else:
            self._show_for({choice.method, *self.caches})
            self.caches[choice.method], kept = Cache(self.scene, choice.method, params, self.seed), False
        self.choices[choice.method] = choice
        self._mark(structure=True)
        return kept

    def reset(self) -> None:
        """Forget all cached light."""
        for cache in self.caches.values():
            cache.rebuild(self.scene, cache.params)
        self._mark()

    def freeze(self, frozen: bool) -> None:
        """Hold the caches as they are, or let them go on."""
        self.frozen = bool(frozen)
        self._mark(structure=True)

    def _looks_of(self, names: Iterable[str]) -> Looks:
        """Return what these methods can show together of the materials."""
        alone = {find_method(name).shown_materials(self.materials) for name in names}
        return "diffuse" if "diffuse" in alone else "full"

    def _show_for(self, names: Iterable[str]) -> None:
        """Upload the scene anew where these methods show other materials than it has, and some are glossy."""
        looks = self._looks_of(names)
        if looks != self.scene.host.looks and any(map(is_glossy, self.data.materials)):
            self._upload(self.data, f"showing {looks} materials", looks)
            self._mark(structure=True)

    # ------------------------------------------------------------------ edits

    def _caches(self) -> Iterable[Cache]:
        return self.caches.values()

    def _note_edit(self, structure: bool = True) -> None:
        self._mark(structure)

    def add_light(self, light: Light) -> int:
        """Add a light without a surface, up to a number that visitors cannot pass."""
        if len(self.lights) >= LIGHT_LIMIT:
            raise LuxelError(f"a scene takes {LIGHT_LIMIT} lights here; remove one first")
        return super().add_light(light)

    @property
    def lights(self) -> list[Light]:
        """The lights without a surface."""
        return self.data.lights

    def place(self, index: int, matrix: np.ndarray) -> None:
        """Place object `index` at `matrix` (4, 4), as `move_object`, and tell the controls of it."""
        self.move_object(index, matrix)
        self.placed.add(index)

    # ------------------------------------------------------------------ time

    def seek(self, seconds: float) -> None:
        """Go to a time of the animation."""
        self.clock.seek(seconds)

    def play(self, playing: bool) -> None:
        """Run or stop the animation."""
        self.clock.playing = bool(playing) and self.clock.duration > 0.0
        self._mark(structure=True)

    def set_speed(self, speed: float) -> None:
        """Let the animation run at `speed` times its own."""
        if not 0.0 < speed <= 100.0:
            raise LuxelError(f"an animation cannot run at {speed} times its speed: use a number above 0, at most 100")
        self.clock.speed = float(speed)

    def _mark(self, structure: bool = False) -> None:
        self.version += 1
        self.structure += structure


def list_methods() -> list[str]:
    """Return the methods that light a scene: those with a cache, progressive ones, baselines; then installed ones.

    Installed ones are loaded when they are chosen.
    """
    known = sorted(METHODS, key=lambda name: (METHODS[name].baseline, METHODS[name].progressive))
    return [*known, *(name for name in list_names() if name not in METHODS)]
