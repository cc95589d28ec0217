"""Contenders in motion: each flies the same frames, and is held against the truth of every sixth of them.

the flight and its truth, once a scene (`run_motion_truth`) -> each method with each seed (`run_flight`)
"""

from __future__ import annotations

import statistics
import time as clock
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from luxel.image.layers import Layers
from luxel.image.tonemap import to_display
from luxel.image.write import to_bytes
from luxel.metrics.motion import PixelTaps, flicker_between, judge_by_sums, judge_frame, motion_figures
from luxel.report.jobs import MethodSetup, Progress, SceneCache, ViewJob, this_machine

if TYPE_CHECKING:
    from luxel.render.motion_path import MotionPath
    from luxel.render.motion_truth import FrameTruth, MotionTruth
    from luxel.render.renderer import Renderer
    from luxel.scene.model import Camera

STRIP_FRAMES, STRIP_WIDTH = 6, 320
"""Frames of a strip of pictures, and the pixels that each is wide at most."""
SERIES = ("regional", "bias", "flip")
"""Figures of which each judged frame's own is kept."""

Treat = Callable[[Layers, "Camera", float], Layers]
"""Takes a frame's layers, its camera and its time; returns what is judged, such as denoised ones."""


@dataclass(frozen=True)
class MotionChoice:
    """What is flown."""

    frames: int
    line: str | None
    """EYE;EYE;TARGET;TARGET[;FOV]; None: a curve through the scene's key views."""
    spp: int | None
    """Paths a pixel of the truth; None: as `render_motion_truth` says."""


@dataclass(frozen=True)
class MotionJob:
    """The truth of one scene's flight."""

    view: ViewJob
    choice: MotionChoice

    @property
    def title(self) -> str:
        return f"{self.view.label}: truth in motion"


@dataclass
class MotionView:
    """What every contender flies, and is measured against."""

    path: MotionPath
    truth: MotionTruth
    taps: list[PixelTaps]
    """Of each judged frame."""
    strip: np.ndarray | None
    """(H, W, 3) uint8: pictures of the truth side by side; None where only its sums are known."""

    def choose_pictured(self) -> list[int]:
        """Return the numbers of the judged frames that strips show."""
        judged = self.path.judged
        places = np.linspace(0, len(judged) - 1, min(STRIP_FRAMES, len(judged))).round().astype(int)
        return [judged[place] for place in places]


@dataclass(frozen=True)
class FlightJob:
    """One method's flight with one seed."""

    view: ViewJob
    setup: MethodSetup
    seed: int
    pictured: bool
    """Whether its strip is wanted, and not its figures alone."""

    @property
    def title(self) -> str:
        return f"{self.view.label}: {self.setup.label} in motion, seed {self.seed}"


@dataclass
class FlightOutcome:
    """What a flight gave."""

    figures: dict[str, Any]
    """Those of `motion_figures`, and `motion_ms`, the median time of a flown frame."""
    series: dict[str, Any]
    """`frame`, and by frame `regional`, `bias`, `flip`, `flicker`; `cut` with the frames after the jump."""
    strip: np.ndarray | None
    """(H, W, 3) uint8, as `MotionView.strip`."""
    machine: dict[str, Any]


def run_motion_truth(job: MotionJob, *, scenes: SceneCache, report: Progress) -> MotionView:
    """Return the flight of a scene with its truth. Raises LuxelError where there is nothing to fly through."""
    from luxel.render.motion_path import find_motion
    from luxel.render.motion_taps import trace_taps
    from luxel.render.motion_truth import render_motion_truth

    def tell(share: float) -> None:
        report(job.title, share)

    scene = scenes.scene(job.view, job.view.materials)
    path = find_motion(scene, job.choice.frames, job.choice.line)
    truth = render_motion_truth(scene, path, job.view.size, job.choice.spp, progress=lambda share: tell(0.9 * share))
    # Committed sums bring the jump that they are of.
    path = replace(path, cut=truth.cut)
    taps = trace_taps(scene, path, job.view.size, progress=lambda share: tell(0.9 + 0.1 * share))
    view = MotionView(path, truth, taps, None)
    wanted = view.choose_pictured()
    shown = [_shrink(one.layers, truth) for one in truth.frames if one.layers is not None and one.frame in wanted]
    view.strip = np.concatenate(shown, axis=1) if shown else None
    return view


def run_flight(job: FlightJob, view: MotionView, *, scenes: SceneCache, report: Progress) -> FlightOutcome:
    """Fly a method along the path of `view` and measure it."""
    from luxel.render.renderer import Renderer

    scene = scenes.scene(job.view, job.setup.shown_materials(job.view.materials))
    params = job.setup.params(view.truth.irradiance)
    renderer = Renderer(
        scene, job.setup.method, params, size=job.view.size, seed=job.seed, camera=view.path.views[0]
    )  # fmt: skip
    return fly(
        renderer,
        view,
        split=job.view.materials == "diffuse",
        pictured=job.pictured,
        progress=lambda share: report(job.title, share),
    )


def fly(
    renderer: Renderer,
    view: MotionView,
    *,
    split: bool,
    pictured: bool,
    treat: Treat | None = None,
    progress: Callable[[float], None] | None = None,
) -> FlightOutcome:
    """Fly `renderer` along the path of `view`, with its still frames before and the jump behind; return what it gave.

    `split` False: the truth has full materials, and displayed images alone are judged. `treat` is done to what is
    looked at, and is not timed. Leaves the scene at time 0.
    """
    from luxel.render.motion_path import CUT_FRAMES, STILL_FRAMES, frame_time
    from luxel.scene.device import set_time

    path, truth, tell = view.path, view.truth, progress or (lambda share: None)
    total = STILL_FRAMES + len(path.views) + CUT_FRAMES[-1]
    judged = {one.frame: (one, taps) for one, taps in zip(truth.frames, view.taps, strict=True)}
    cuts = {one.frame: one for one in truth.cuts}
    wanted = view.choose_pictured() if pictured else []
    record = _Record(split, truth.exposure)
    shown: list[np.ndarray] = []
    before: Layers | None = None
    stills, jumps = [path.views[0]] * STILL_FRAMES, [path.cut] * CUT_FRAMES[-1]
    try:
        for frame, camera in enumerate([*stills, *path.views, *jumps], 1 - STILL_FRAMES):
            ms = _step(renderer, camera, frame_time(frame))
            if 1 <= frame <= len(path.views):
                record.spent.append(ms)
            if frame in judged or frame + 1 in judged or frame in cuts:
                layers = renderer.layers()
                layers = layers if treat is None else treat(layers, camera, frame_time(frame))
                if frame in judged and before is not None:
                    record.judge(layers, before, *judged[frame])
                if frame in cuts:
                    record.judge_cut(layers, cuts[frame], frame - len(path.views))
                if frame in wanted:
                    shown.append(_shrink(layers, truth, judged[frame][0].layers))
                before = layers
            tell((frame + STILL_FRAMES) / total)
    finally:
        set_time(renderer.scene, 0.0)
    return record.finish(np.concatenate(shown, axis=1) if shown else None)


def _step(renderer: Renderer, camera: Camera, time: float) -> float:
    """Render one frame and wait for it; return its milliseconds."""
    import drjit as dr

    start = clock.perf_counter()
    renderer.step(time=time, camera=camera)
    dr.sync_thread()
    return 1e3 * (clock.perf_counter() - start)


class _Record:
    """What is noted down on the way."""

    def __init__(self, split: bool, exposure: float) -> None:
        self._split, self._exposure = split, exposure
        self._frames: list[dict[str, float]] = []
        self._numbers: list[int] = []
        self._flickers: list[float] = []
        self._cuts: list[dict[str, float]] = []
        self._after: list[int] = []
        self.spent: list[float] = []
        """Milliseconds of each flown frame."""

    def judge(self, layers: Layers, before: Layers, truth: FrameTruth, taps: PixelTaps) -> None:
        """Note a judged frame; `before` is the one before it."""
        self._numbers.append(truth.frame)
        self._frames.append(self._measure(layers, truth))
        self._flickers.append(flicker_between(layers, before, taps, self._exposure))

    def judge_cut(self, layers: Layers, truth: FrameTruth, after: int) -> None:
        """Note the frame `after` so many others since the jump."""
        self._after.append(after)
        self._cuts.append(self._measure(layers, truth))

    def _measure(self, layers: Layers, truth: FrameTruth) -> dict[str, float]:
        if truth.layers is not None:
            return judge_frame(layers, truth.layers, self._split)
        return judge_by_sums(layers, truth.sums) if self._split else {}

    def finish(self, strip: np.ndarray | None) -> FlightOutcome:
        figures: dict[str, Any] = dict(motion_figures(self._frames, self._flickers, self._cuts))
        figures["motion_ms"] = statistics.median(self.spent)
        series = {
            "frame": self._numbers,
            **{name: [one.get(name) for one in self._frames] for name in SERIES},
            "flicker": self._flickers,
            "cut": {"frame": self._after, "regional": [one.get("regional") for one in self._cuts]},
        }
        return FlightOutcome(figures, series, strip, this_machine())


def _shrink(layers: Layers, truth: MotionTruth, wanted: Layers | None = None) -> np.ndarray:
    """Return a frame as displayed in a strip, (H, W, 3) uint8, with the direct light of `wanted` where there is any."""
    from PIL import Image

    lit = layers if wanted is None else replace(layers, direct=wanted.direct)
    picture = Image.fromarray(to_bytes(to_display(lit.image(), truth.exposure)))
    if picture.width > STRIP_WIDTH:
        size = (STRIP_WIDTH, max(1, round(picture.height * STRIP_WIDTH / picture.width)))
        picture = picture.resize(size, Image.Resampling.LANCZOS)
    return np.asarray(picture)


def average_series(every: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the mean over the seeds of what `FlightOutcome.series` holds, entry by entry."""
    from luxel.report.collect import mean_of

    def means(parts: list[dict[str, Any]]) -> dict[str, Any]:
        lists = [name for name in parts[0] if name not in ("frame", "cut")]
        return {"frame": parts[0]["frame"]} | {
            name: [mean_of(values) for values in zip(*(part[name] for part in parts), strict=True)] for name in lists
        }

    return means(every) | {"cut": means([one["cut"] for one in every])}
