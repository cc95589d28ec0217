"""What every reproduction does: a view with its truth, and a method run on it once for all figures that are asked."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from luxel.bench.reproduce.regions import chroma_distance, chroma_spread, mean_error, mean_light, noise_on
from luxel.bench.reproduce.study import StudyRunner, Tick
from luxel.errors import LuxelError
from luxel.image.tonemap import mean_exposure, to_display
from luxel.methods.params import make_params
from luxel.metrics.error import absolute_error, bias, display_pair, regional, truth_noise
from luxel.metrics.flip import flip

if TYPE_CHECKING:
    from luxel.render.renderer import Renderer
    from luxel.render.truth import Truth
    from luxel.scene.device import Scene
    from luxel.scene.model import Camera

SETUP_FRAMES = 64
"""What building a method and recording its kernels counts for in the share done, frames."""


@dataclass(frozen=True)
class StudyBudget:
    """How much work a reproduction does."""

    size: tuple[int, int] = (512, 288)
    """(width, height)."""
    frames: int = 128
    """Frames before a figure is taken."""
    spp: int = 512
    """Samples a pixel of the truth."""
    still_frames: int = 50
    """Frames that stability is measured on."""
    staged_frames: int = 9
    flight_frames: int = 64
    """Frames from each stop of a flight: surfels come slowly, one tile of twelve a frame with preset ekberg."""
    seed: int = 0
    quick: bool = False
    """Tables keep their first and last rows only: for tests."""

    def thin(self, rows: list[Any]) -> list[Any]:
        """Return `rows`, or the first and the last of them."""
        return rows if not self.quick or len(rows) < 3 else [rows[0], rows[-1]]

    def describe(self) -> dict[str, Any]:
        """Return what decides the figures, for the head of the report."""
        width, height = self.size
        return {
            "size": f"{width}x{height}",
            "frames": self.frames,
            "truth": f"{self.spp} samples a pixel",
            "still frames": self.still_frames,
            "seed": self.seed,
        }


QUICK = StudyBudget(size=(64, 36), frames=8, spp=16, still_frames=4, staged_frames=2, flight_frames=1, quick=True)
"""For tests: every figure exists, none of them counts."""


def check_budget(budget: StudyBudget) -> None:
    """Raise LuxelError for a budget that measures nothing."""
    if budget.frames < 1 or budget.spp < 2 or budget.still_frames < 1:
        raise LuxelError("reproduce needs 1 frame, 2 samples a pixel and 1 still frame at least")


@dataclass
class Figures:
    """One run's figures, None where they were not asked for or do not exist.

    Errors are those of displayed images where the name does not say `regional` or `bias`.
    """

    abs_mean: float | None = None
    """Mean over pixels of the summed absolute channel difference, 0..3."""
    abs_max: float | None = None
    abs_min: float | None = None
    regional: float | None = None
    bias: float | None = None
    flip: float | None = None
    change_mean: float | None = None
    """Mean over pixels and still frames of the summed absolute channel change, direct light held fixed."""
    change_max: float | None = None
    """The largest pixel's mean change over the still frames."""
    stages: dict[str, float] = field(default_factory=dict)
    """Milliseconds of device time by stage."""
    rays: int | None = None
    """Rays a frame that the method's cache casts at most."""
    cache: dict[str, int | float] = field(default_factory=dict)
    places: dict[str, dict[str, Any]] = field(default_factory=dict)
    """Light on parts of the picture by their names: see `describe_light`."""

    @classmethod
    def of_parts(cls, parts: dict[str, Any]) -> Figures:
        """Return the figures of a run's measured parts."""
        figures, known = cls(), {each.name for each in fields(cls)}
        for name, part in parts.items():
            if name == "stages":
                figures.stages = part
            elif name.startswith(AT):
                figures.places[name.removeprefix(AT)] = part
            else:
                for key in known & part.keys():
                    setattr(figures, key, part[key])
        return figures


ERRORS, FLIP, CHANGES, STAGES, CACHE, NOISE = "errors", "flip", "changes", "stages", "cache", "noise"
"""Parts of a run that a table can ask for; each costs time, so that nobody gets what he did not ask for."""
AT = "at "
"""Begins the part of a run that looks at one place of the picture."""


@dataclass
class StudyView:
    """A camera on a scene, which is uploaded, and its truth rendered, when the first run needs them."""

    name: str
    budget: StudyBudget
    runner: StudyRunner
    prepare: Callable[[], tuple[Scene, Camera]]
    places: Mapping[str, Callable[[StudyView], np.ndarray]] = field(default_factory=dict)
    """Parts of the picture by name -> the function that gives the pixels, (H, W) bool."""
    stops: int = 0
    """Stops of the scene's flight."""

    @cached_property
    def _prepared(self) -> tuple[Scene, Camera]:
        return self.prepare()

    @property
    def scene(self) -> Scene:
        """The uploaded scene."""
        return self._prepared[0]

    @property
    def camera(self) -> Camera:
        """The view's camera."""
        return self._prepared[1]

    @cached_property
    def truth(self) -> Truth:
        """What the camera should see."""
        from luxel.render.truth import render_truth

        budget = self.budget

        def tell(share: float) -> None:
            self.runner.tell(round(share * budget.spp), f"{self.name}: truth of {budget.spp} samples")

        return render_truth(self.scene, camera=self.camera, size=budget.size, spp=budget.spp, progress=tell)

    def mask(self, place: str) -> np.ndarray:
        """Return (H, W) bool: the pixels of a place."""
        if place not in self._masks:
            self._masks[place] = self.places[place](self)
        return self._masks[place]

    @cached_property
    def _masks(self) -> dict[str, np.ndarray]:
        return {}

    def renderer(self, method: str, preset: str | None, params: dict[str, Any]) -> Renderer:
        """Return a fresh renderer of this view. Raises LuxelError for an unknown method, preset or parameter."""
        from luxel.render.renderer import Renderer

        return Renderer(
            self.scene,
            method=method,
            params=dict(params),
            preset=preset,
            size=self.budget.size,
            seed=self.budget.seed,
            camera=self.camera,
        )

    def measure(
        self, method: str, preset: str | None, params: dict[str, Any], *parts: str, fly: bool = False
    ) -> Figures:
        """Return `parts` of a run, and its cache's size; the same run is done once for all tables; `fly` flies first.

        Blank figures while the runner is counting.
        """

        def make(wanted: frozenset[str], tick: Tick) -> dict[str, Any]:
            return self._run(self.renderer(method, preset, params), wanted, fly, tick)

        # The truth comes first: it is shared, and a run's progress should be its own.
        if set(parts) - {STAGES}:
            self._ask_truth(NOISE)
        # A setting that only repeats the preset's makes no other run.
        base = make_params(method, preset, {})
        settings = ", ".join(f"{key}={value}" for key, value in sorted(params.items()) if getattr(base, key) != value)
        name = f"{self.name} {label(method, preset)} {settings}{' after a flight' if fly else ''}"
        return Figures.of_parts(self.runner.ask(name, [CACHE, *parts], lambda wanted: self._cost(wanted, fly), make))

    def truth_at(self, place: str) -> dict[str, Any]:
        """Return the truth's light on a place as `describe_light` gives it, with its noise; empty while counting."""
        return self._ask_truth(AT + place)

    def noise_note(self) -> str:
        """Return one sentence on the noise of the truth."""
        about = self._ask_truth(NOISE)
        spp, noise = about.get("spp"), about.get("noise")
        return f"Truth of the view '{self.name}': {spp} samples a pixel, noise {short(noise)} of its mean."

    def _ask_truth(self, part: str) -> dict[str, Any]:
        def make(wanted: frozenset[str], tick: Tick) -> dict[str, Any]:
            made: dict[str, Any] = {}
            for each in wanted:
                if each == NOISE:
                    noise = truth_noise(self.truth.layers, self.truth.halves)
                    made[each] = {"noise": noise, "spp": self.truth.spp}
                else:
                    mask = self.mask(each.removeprefix(AT))
                    light = describe_light(self.truth.layers.indirect, self.truth, mask)
                    made[each] = {**light, "noise": noise_on(self.truth.halves, mask), "spp": self.truth.spp}
            return made

        # A sample of the truth takes about as long as a frame.
        return self.runner.ask(f"{self.name} truth", [part], lambda wanted: self.budget.spp, make).get(part, {})

    def _cost(self, parts: frozenset[str], fly: bool) -> int:
        budget = self.budget
        extra = budget.still_frames * (CHANGES in parts) + budget.staged_frames * (STAGES in parts)
        return SETUP_FRAMES + budget.frames + extra + fly * self.stops * (budget.flight_frames + 1)

    def _run(self, renderer: Renderer, parts: frozenset[str], fly: bool, tick: Tick) -> dict[str, Any]:
        """Return the wanted parts of a run; frames before them are the same whatever is wanted."""
        budget = self.budget
        if fly:
            from luxel.render.flight import fly_through

            fly_through(renderer, budget.flight_frames)
        renderer.run(budget.frames, progress=lambda frame: tick(SETUP_FRAMES + frame))
        workload = renderer.method.workload
        rays = {} if workload is None else workload.ray_counts(renderer.state)
        cache = renderer.cache()
        made: dict[str, Any] = {CACHE: {"rays": int(sum(rays.values())), "cache": cache}}
        layers = renderer.layers()
        if STAGES in parts:
            made[STAGES] = renderer.staged(budget.staged_frames)
        if CHANGES in parts:
            changes = PixelChanges()
            changes.watch(self._still_images(renderer, tick))
            made[CHANGES] = {"change_mean": changes.mean(), "change_max": changes.largest()}
        if ERRORS in parts or FLIP in parts:
            truth = self.truth.layers
            shown, wanted = display_pair(layers.image(), truth.image())
            if FLIP in parts:
                made[FLIP] = {"flip": flip(shown, wanted)}
            if ERRORS in parts:
                errors = absolute_error(shown, wanted, truth.hit)[truth.hit]
                made[ERRORS] = {
                    "abs_mean": float(errors.mean()) if errors.size else None,
                    "abs_max": float(errors.max(initial=0.0)),
                    "abs_min": float(errors.min(initial=3.0)),
                    "regional": regional(layers, truth),
                    "bias": bias(layers, truth),
                }
        for part in parts:
            if part.startswith(AT):
                made[part] = describe_light(layers.indirect, self.truth, self.mask(part.removeprefix(AT)))
        return made

    def _still_images(self, renderer: Renderer, tick: Tick) -> Iterator[np.ndarray]:
        """Yield the displayed images of a still view, the first frame's direct light in all of them."""
        budget = self.budget
        exposure = mean_exposure(self.truth.layers.image())
        first = renderer.layers()
        yield to_display(first.image(), exposure)
        for frame in range(budget.still_frames):
            renderer.step()
            yield to_display(replace(renderer.layers(), direct=first.direct).image(), exposure)
            tick(SETUP_FRAMES + budget.frames + frame + 1)


def describe_light(light: np.ndarray, truth: Truth, mask: np.ndarray) -> dict[str, Any]:
    """Return pixels, mean (3), chroma's spread and distance, error and bias of `light` (H, W, 3) on `mask` (H, W)."""
    wanted = truth.layers.indirect
    error, off = mean_error(light, wanted, mask)
    return {
        "pixels": int(mask.sum()),
        "mean": mean_light(light, mask),
        "spread": chroma_spread(light, mask),
        "distance": chroma_distance(light, wanted, mask),
        "error": error,
        "bias": off,
    }


class PixelChanges:
    """Each pixel's change from frame to frame: `luxel.metrics.temporal.flicker`, which has no largest pixel."""

    def __init__(self) -> None:
        self.total: np.ndarray | None = None
        self.count = 0

    def watch(self, images: Iterable[np.ndarray]) -> None:
        """Sum the changes between consecutive images (H, W, 3)."""
        before: np.ndarray | None = None
        for image in images:
            if before is not None:
                change = np.abs(image.astype(np.float64) - before).sum(axis=-1)
                self.total = change if self.total is None else self.total + change
                self.count += 1
            before = image

    def mean(self) -> float:
        """Return the summed absolute channel change, mean over pixels and frames; NaN before two images."""
        return float("nan") if self.total is None else float(self.total.mean()) / self.count

    def largest(self) -> float:
        """Return the largest pixel's mean change a frame; NaN before two images."""
        return float("nan") if self.total is None else float(self.total.max()) / self.count


def label(method: str, preset: str | None) -> str:
    """Return `gibs:ekberg`, or the bare name for a method's defaults."""
    return f"{method}:{preset}" if preset else method


def short(value: float | None) -> str:
    """Return a figure for a note: two digits, `-` where there is none."""
    return "-" if value is None else f"{value:.2g}"
