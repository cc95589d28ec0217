"""The path tracer in motion, in the time that each method takes for a frame: bare, with history, and that denoised.

A path tracer without memory gets as many paths a frame as the method's time allows. One that keeps a history along the
motion (the preset `reproject`, where luxel has it) would follow a change of the light later the longer that is: so it
keeps the longest one with which it is no later than the method (`lag_frames`).
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from luxel.metrics.temporal import STEP_SHARE
from luxel.report.jobs import Progress, SceneCache, ViewJob, nested, this_machine
from luxel.report.measure import mean_indirect, measure_lag
from luxel.report.motion import FlightOutcome, MotionView, Treat, fly
from luxel.report.peers import DENOISE_TRIALS, PEER, denoise_layers

if TYPE_CHECKING:
    from luxel.image.layers import Layers
    from luxel.methods.base import Method
    from luxel.render.denoise import Denoiser
    from luxel.render.renderer import Renderer
    from luxel.scene.device import Scene
    from luxel.scene.model import Camera

PRESET, DIAL = "reproject", "history"
"""The preset of the path tracer that keeps a history, and its dial: frames of it at most."""
LAG_SIZE = (64, 36)
"""Pixels of the picture by which the lag of a history is measured: it is a matter of time, not of pixels."""
SETTLED = 3
"""Histories long that a view stands still before its lag is measured."""


@dataclass(frozen=True)
class MotionBudget:
    """What a method took and how soon it follows the light."""

    of: str
    """The method's label."""
    file_name: str
    """The stem of its files."""
    ms: float
    """Milliseconds of a frame in motion."""
    lag: float | None
    """Its `lag_frames`; None where it never follows, or there is nothing to follow."""


@dataclass(frozen=True)
class MotionPeerJob:
    """The peers in motion of one scene's methods with one seed."""

    view: ViewJob
    seed: int
    none_ms: float
    """Milliseconds of a frame in motion without any indirect light."""
    budgets: tuple[MotionBudget, ...]
    pictured: bool
    """Whether strips are wanted, and not the figures alone."""

    @property
    def title(self) -> str:
        return f"{self.view.label}: {PEER} in motion, seed {self.seed}"


@dataclass
class MotionPeer:
    """The path tracer in a method's time."""

    of: MotionBudget
    preset: str | None
    history: int | None
    """Frames that its history is capped at; None without history."""
    lag: float | None
    """Its own `lag_frames` with that history, as measured."""
    denoised: str | None
    """`optix` or `oidn`; None: bare."""
    samples: int
    """Paths a pixel and frame."""
    ms: float
    """Milliseconds of a frame, denoising included."""
    outcome: FlightOutcome

    @property
    def label(self) -> str:
        return f"{PEER}:{self.preset}" if self.preset else PEER

    @property
    def file_name(self) -> str:
        """The stem of its files."""
        parts = [f"{PEER}_at_{self.of.file_name}", self.preset, "denoised" if self.denoised else None]
        return "_".join(part for part in parts if part)


@dataclass
class MotionPeerOutcome:
    """What a `MotionPeerJob` gave."""

    peers: list[MotionPeer]
    machine: dict[str, Any]


def run_motion_peers(
    job: MotionPeerJob, view: MotionView, *, scenes: SceneCache, report: Progress
) -> MotionPeerOutcome:
    """Fly the path tracer along the path of `view` in the time of each method."""
    from luxel import runtime
    from luxel.methods import find_method
    from luxel.render.denoise import find_denoiser

    method = find_method(PEER)
    scene = scenes.scene(job.view, method.shown_materials(job.view.materials))
    denoiser, _ = find_denoiser(runtime.start(job.view.device).name)
    peers = _Peers(job, view, scene, nested(report, 0.0, 1.0))
    found = [peers.bare(budget) for budget in job.budgets]
    if keeps_history(method):
        for budget in job.budgets:
            history, lag = longest_history(budget.lag, _longest(method), lambda frames: _lag_of(scene, job, frames))
            found += peers.with_history(budget, history, lag, denoiser)
    order = {budget.of: number for number, budget in enumerate(job.budgets)}
    found.sort(key=lambda peer: order[peer.of.of])
    return MotionPeerOutcome(found, this_machine())


def paths_within(ms: float, none_ms: float, one_ms: float) -> int:
    """Return how many paths a pixel fit into `ms`, at least one; a frame takes `none_ms` without, `one_ms` with one.

    Where one path takes no time that can be told, nothing says how many fit: one.
    """
    from luxel.methods.path_tracer import SAMPLE_LIMIT

    each = one_ms - none_ms
    return min(max(1, math.floor((ms - none_ms) / each)), SAMPLE_LIMIT) if each > 0.0 else 1


class _Peers:
    """Flights of the path tracer; those that are asked for twice are flown once."""

    def __init__(self, job: MotionPeerJob, view: MotionView, scene: Scene, report: Progress) -> None:
        self._job, self._view, self._scene, self._report = job, view, scene, report
        self._flown: dict[Any, FlightOutcome] = {}

    def bare(self, budget: MotionBudget) -> MotionPeer:
        """Return the path tracer without memory."""
        samples = paths_within(budget.ms, self._job.none_ms, self._ms({"samples": 1}))
        outcome = self._fly({"samples": samples})
        return MotionPeer(budget, None, None, None, None, samples, outcome.figures["motion_ms"], outcome)

    def with_history(
        self, budget: MotionBudget, history: int, lag: float | None, denoiser: Denoiser | None
    ) -> list[MotionPeer]:
        """Return the path tracer with a history of so many frames, and denoised where there is a denoiser."""
        one = self._ms({"samples": 1, DIAL: history}, PRESET)
        # Its history costs the same with any number of paths.
        without = one - (self._ms({"samples": 1}) - self._job.none_ms)
        found = []
        for used in [None, denoiser] if denoiser is not None else [None]:
            spent = 0.0 if used is None else self._denoise_ms(used)
            samples = paths_within(budget.ms - spent, without, one)
            outcome = self._fly({"samples": samples, DIAL: history}, PRESET, used)
            ms = outcome.figures["motion_ms"] + spent
            # A flight does not time what is done to what is looked at.
            outcome = replace(outcome, figures=outcome.figures | {"motion_ms": ms})
            name = used.used if used is not None else None
            found.append(MotionPeer(budget, PRESET, history, lag, name, samples, ms, outcome))
        return found

    def _ms(self, settings: dict[str, int], preset: str | None = None) -> float:
        return self._fly(settings, preset).figures["motion_ms"]

    def _fly(
        self, settings: dict[str, int], preset: str | None = None, denoiser: Denoiser | None = None
    ) -> FlightOutcome:
        key = (tuple(settings.items()), preset, denoiser is not None)
        if key not in self._flown:
            job = self._job
            renderer = make_peer(self._scene, settings, preset, job.view.size, job.seed, self._view.path.views[0])
            self._flown[key] = fly(
                renderer,
                self._view,
                split=job.view.materials == "diffuse",
                pictured=job.pictured,
                treat=None if denoiser is None else self._denoising(denoiser),
                progress=lambda share: self._report(job.title, share),
            )
        return self._flown[key]

    def _denoising(self, denoiser: Denoiser) -> Treat:
        from luxel.render.denoise import trace_guides

        def treat(layers: Layers, camera: Camera, time: float) -> Layers:
            guides = trace_guides(self._scene, camera, self._job.view.size, time)
            return denoise_layers(layers, denoiser, guides)[0]

        return treat

    def _denoise_ms(self, denoiser: Denoiser) -> float:
        """Return the milliseconds of denoising the first view, the median of some trials."""
        from luxel.render.denoise import trace_guides

        camera = self._view.path.views[0]
        renderer = make_peer(self._scene, {"samples": 1}, None, self._job.view.size, self._job.seed, camera)
        renderer.step()
        layers, guides = renderer.layers(), trace_guides(self._scene, camera, self._job.view.size, renderer.time)
        return statistics.median(denoise_layers(layers, denoiser, guides)[1] for _ in range(DENOISE_TRIALS))


def make_peer(
    scene: Scene, settings: dict[str, int], preset: str | None, size: tuple[int, int], seed: int, camera: Camera | None
) -> Renderer:
    """Return a renderer of the path tracer."""
    from luxel.methods import make_params
    from luxel.render.renderer import Renderer

    return Renderer(scene, PEER, make_params(PEER, preset, settings), size=size, seed=seed, camera=camera)


# ---------- How long a history may be ----------


def keeps_history(method: Method) -> bool:
    """Return whether the path tracer of this luxel has a preset that keeps a history, and the dial for its length."""
    return PRESET in method.presets and DIAL in {item.name for item in fields(method.Params)}


def _longest(method: Method) -> int:
    """Return the history of the preset as it is, which is the longest."""
    from luxel.methods import make_params

    return int(getattr(make_params(method.name, PRESET), DIAL))


def lag_by_arithmetic(history: int) -> int:
    """Return the first frame after which a still view with a history of so many frames is past 90 % of a step in light.

    After n frames the past counts as (history - 1) (1 - (n - 1) / (2 history)) frames beside those n, and fades out
    (`methods/path_history.py`): what is missing of the step is its share.
    """
    from luxel.methods.path_history import FADES_WITHIN

    frame = 1
    while True:
        past = (history - 1) * max(1.0 - (frame - 1) / (FADES_WITHIN * history), 0.0)
        if past <= (1.0 - STEP_SHARE + 1e-9) * (past + frame):
            return frame
        frame += 1


def longest_history(lag: float | None, most: int, measure: Callable[[int], float | None]) -> tuple[int, float | None]:
    """Return the longest history up to `most` that lags by no more than `lag` frames, and its own lag by `measure`.

    Arithmetic says where to begin, and the measurement decides, up and down. A method that never follows sets no limit;
    the shortest history is one frame, which is none.
    """
    if lag is None:
        return most, measure(most)
    history = 1
    while history < most and lag_by_arithmetic(history + 1) <= lag:
        history += 1
    found = measure(history)
    too_long = most + 1
    while history > 1 and (found is None or found > lag):
        # Lag grows with the history: as much shorter as it is too late, and at least by one.
        too_long = history
        history = max(1, min(history - 1, history // 2 if found is None else math.floor(history * lag / found)))
        found = measure(history)
    while history + 1 < too_long and found is not None and found <= lag:
        # As much longer as it may be later, at least by one; never again one that was too late.
        longer = max(history + 1, min(too_long - 1, math.floor(history * lag / max(found, 1))))
        later = measure(longer)
        if later is None or later > lag:
            too_long = longer
        else:
            history, found = longer, later
    return history, found


def _lag_of(scene: Scene, job: MotionPeerJob, history: int) -> float | None:
    """Return the `lag_frames` of a history of so many frames, at rest in the scene's own view."""
    size = LAG_SIZE if np.prod(LAG_SIZE) < np.prod(job.view.size) else job.view.size
    renderer = make_peer(scene, {"samples": 1, DIAL: history}, PRESET, size, job.seed, None)
    renderer.run(SETTLED * history)
    means = []
    for _ in range(min(history, 8)):
        renderer.step()
        means.append(mean_indirect(renderer.layers()))
    return measure_lag(renderer, statistics.fmean(means))
