"""What every reproduction does: a view with its truth, and a method run on it once for all figures that are asked."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from luxel.errors import LuxelError
from luxel.metrics.error import absolute_error, bias, display_pair, regional, truth_noise
from luxel.metrics.flip import flip
from luxel.metrics.temporal import flicker
from luxel.render.tonemap import auto_exposure, to_display

if TYPE_CHECKING:
    from luxel.render.layers import Layers
    from luxel.render.renderer import Renderer
    from luxel.render.truth import Truth
    from luxel.scene.device import Scene
    from luxel.scene.model import Camera

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Budget:
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


QUICK = Budget(size=(64, 36), frames=8, spp=16, still_frames=4, staged_frames=2, quick=True)
"""For tests: every figure exists, none of them counts."""


def check_budget(budget: Budget) -> None:
    """Raise LuxelError for a budget that measures nothing."""
    if budget.frames < 1 or budget.spp < 2 or budget.still_frames < 1:
        raise LuxelError("reproduce needs 1 frame, 2 samples a pixel and 1 still frame at least")


@dataclass
class Figures:
    """One run's figures; errors are those of displayed images where the name does not say `regional` or `bias`."""

    abs_mean: float
    """Mean over pixels of the summed absolute channel difference, 0..3."""
    abs_max: float
    abs_min: float
    regional: float
    bias: float
    flip: float
    change_mean: float
    """Mean over pixels and still frames of the summed absolute channel change, direct light held fixed."""
    change_max: float
    """The largest pixel's mean change over the still frames."""
    stages: dict[str, float]
    """Milliseconds of device time by stage."""
    rays: int
    """Rays a frame that the method's cache casts at most."""
    cache: dict[str, int | float]


@dataclass
class View:
    """A camera on an uploaded scene, with the truth of what it sees."""

    name: str
    scene: Scene
    camera: Camera
    budget: Budget
    truth: Truth
    done: dict[Any, Figures] = field(default_factory=dict)
    """Runs by method, preset and settings: tables share them."""

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

    def measure(self, method: str, preset: str | None, params: dict[str, Any], *, fly: bool = False) -> Figures:
        """Return the figures of a run, from memory where the same run was asked before; `fly` flies first."""
        key = (method, preset, tuple(sorted(params.items())), fly)
        if key not in self.done:
            self.done[key] = self._run(method, preset, params, fly)
        return self.done[key]

    def _run(self, method: str, preset: str | None, params: dict[str, Any], fly: bool) -> Figures:
        renderer = self.renderer(method, preset, params)
        if fly:
            renderer.fly()
        renderer.run(self.budget.frames)
        layers, truth = renderer.layers(), self.truth.layers
        shown, wanted = display_pair(layers.image(), truth.image())
        errors = absolute_error(shown, wanted, truth.hit)[truth.hit]
        changes = Changes()
        still = changes.watch(self._still_images(renderer, layers))
        mean = flicker(still).absolute
        rays = renderer.method.ray_counts(renderer.state)
        return Figures(
            abs_mean=float(errors.mean()) if errors.size else float("nan"),
            abs_max=float(errors.max(initial=0.0)),
            abs_min=float(errors.min(initial=3.0)),
            regional=regional(layers, truth),
            bias=bias(layers, truth),
            flip=flip(shown, wanted),
            change_mean=mean,
            change_max=changes.largest(),
            stages=renderer.staged(self.budget.staged_frames),
            rays=int(sum(rays.values())),
            cache=renderer.cache(),
        )

    def _still_images(self, renderer: Renderer, first: Layers) -> Iterator[np.ndarray]:
        """Yield the displayed images of a still view, the first frame's direct light in all of them."""
        exposure = auto_exposure(self.truth.layers.image())
        yield to_display(first.image(), exposure)
        for _ in range(self.budget.still_frames):
            renderer.step()
            yield to_display(replace(renderer.layers(), direct=first.direct).image(), exposure)


class Changes:
    """Sums each pixel's change from frame to frame while somebody else reads the images."""

    def __init__(self) -> None:
        self.total: np.ndarray | None = None
        self.count = 0

    def watch(self, images: Iterator[np.ndarray]) -> Iterator[np.ndarray]:
        """Pass the images (H, W, 3) on, noting how they change."""
        before: np.ndarray | None = None
        for image in images:
            if before is not None:
                change = np.abs(image.astype(np.float64) - before).sum(axis=-1)
                self.total = change if self.total is None else self.total + change
                self.count += 1
            before = image
            yield image

    def largest(self) -> float:
        """Return the largest pixel's mean change a frame; NaN before two images."""
        return float("nan") if self.total is None else float(self.total.max()) / self.count


def make_view(name: str, scene: Scene, camera: Camera, budget: Budget, progress: Progress | None = None) -> View:
    """Render (or find) the truth of `camera` and return the view."""
    from luxel.render.truth import render_truth

    told = (lambda share: progress(f"{name}: truth", share)) if progress is not None else None
    truth = render_truth(scene, camera=camera, size=budget.size, spp=budget.spp, progress=told)
    return View(name, scene, camera, budget, truth)


def noise_note(view: View) -> str:
    """Return one sentence on the noise of the view's truth."""
    noise = truth_noise(view.truth.layers, view.truth.halves)
    return f"Truth of the view '{view.name}': {view.truth.spp} samples a pixel, noise {noise:.2g} of its mean."
