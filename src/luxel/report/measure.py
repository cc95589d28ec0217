"""One method on one scene with one seed: run it, and take every figure of the design's section 7."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from luxel.image.layers import Layers
from luxel.image.tonemap import to_display
from luxel.metrics.error import all_errors, image_errors, image_noise, regional
from luxel.metrics.leak import box_points, leak_ratio
from luxel.metrics.temporal import STEP_SHARE, flicker, lag_frames
from luxel.scene.model import SceneData

if TYPE_CHECKING:
    from luxel.render.renderer import Renderer
    from luxel.render.truth import Truth

WARMUP_FRAMES = 8
"""Frames whose times are not counted: kernels are compiled in them."""
FLICKER_FRAMES = 50
"""Still frames that `flicker` looks at."""
LAG_LIMIT = 200
"""Frames after which a method that has not followed the light never will."""
LAG_SETTLED = 50
"""Frames that the light has to stay past 90 % of the step before the run is cut short."""
LEAK_POINTS = 128
"""Points along each side of the sealed room: the outer ones lie where light creeps in along shared floors."""
LEAK_FRAMES = 64
"""Frames at the scene's own view between the flight and the look into the sealed room."""

MakeRenderer = Callable[[], "Renderer"]
ShareProgress = Callable[[float], None]


@dataclass
class Run:
    """What a run gave."""

    figures: dict[str, Any]
    """By name; None where a figure does not apply."""
    layers: Layers
    """The last frame."""


def measure_run(
    make: MakeRenderer,
    truth: Truth,
    *,
    frames: int,
    exposure: float,
    flight: bool = False,
    split: bool = True,
    progress: ShareProgress | None = None,
) -> Run:
    """Render `frames` frames with a fresh renderer and measure the run against `truth`.

    `exposure` is the factor at which images are displayed; `progress` gets the share done, 0..1. After the frames
    come those for flicker, timing and lag, which change nothing in the image that is judged; `flight` flies first.
    `split` False: the truth has full materials, which most methods do not show, so that their indirect light cannot be
    held against its own: the figures of indirect light are None, and those of displayed images judge.
    """
    from luxel.render.flight import fly_through
    from luxel.render.floor import count_rays, measure_floor

    report = progress or (lambda share: None)
    renderer = make()
    if flight:
        fly_through(renderer)
    layers, frame_ms, series = _run_frames(renderer, truth, frames, split, lambda share: report(0.7 * share))
    figures = judge(layers, truth, split)
    figures["frame_ms"] = frame_ms
    figures["warnings"] = renderer.method.warnings(renderer.state)

    means: list[float] = []
    figures["flicker"], figures["flicker_absolute"] = flicker(_still_images(renderer, layers.direct, exposure, means))
    report(0.8)
    figures["stages"] = renderer.staged()
    figures["floor_ms"] = measure_floor(renderer)
    figures["rays_per_frame"] = count_rays(renderer)
    figures["cache"] = renderer.cache()
    figures["lag_frames"] = measure_lag(renderer, statistics.fmean(means))
    report(0.9)
    figures["leak"] = _measure_leak(make, renderer.scene.host.data)
    figures["series"] = series
    report(1.0)
    return Run(figures, layers)


def judge(layers: Layers, truth: Truth, split: bool = True) -> dict[str, Any]:
    """Return every figure of one frame against the truth, by name; `split` as `measure_run` says."""
    figures: dict[str, Any] = all_errors(layers, truth.layers, truth.halves)
    if split:
        return figures
    noise = None if truth.image_halves is None else image_noise(truth.image_halves)
    shown = image_errors(layers.image(), truth.layers.image(), truth.layers.hit)
    return dict.fromkeys(figures) | shown | {"truth_noise": noise}


def series_frames(frames: int) -> list[int]:
    """Return the frame numbers at which the series looks: powers of two, and the last frame."""
    return sorted({2**power for power in range(frames.bit_length()) if 2**power < frames} | {frames})


def _run_frames(
    renderer: Renderer, truth: Truth, frames: int, split: bool, report: ShareProgress
) -> tuple[Layers, float, dict[str, Any]]:
    """Return the last frame's layers, the median frame time in ms and the series along the run."""
    times: list[float] = []
    marks = series_frames(frames)
    errors: list[float | None] = []
    layers: Layers | None = None
    for mark in marks:
        times += renderer.run(mark - len(times))
        layers = renderer.layers()
        errors.append(regional(layers, truth.layers) if split else None)
        report(mark / frames)
    assert layers is not None
    median = statistics.median(times[WARMUP_FRAMES:] or times)
    # The first frames count at the median: what they took beyond it is compilation.
    steady = [median] * min(WARMUP_FRAMES, frames) + times[WARMUP_FRAMES:]
    spent = np.cumsum(steady)
    return layers, median, {"frame": marks, "ms": [float(spent[mark - 1]) for mark in marks], "regional": errors}


def _still_images(renderer: Renderer, direct: np.ndarray, exposure: float, means: list[float]) -> Iterator[np.ndarray]:
    """Yield the last frame and 50 more as displayed, all with the same direct light.

    Appends the mean indirect light of each to `means`: together they are what the lag is counted from.
    """
    for frame in range(FLICKER_FRAMES + 1):
        if frame > 0:
            renderer.step()
        layers = replace(renderer.layers(), direct=direct)
        means.append(mean_indirect(layers))
        yield to_display(layers.image(), exposure)


def measure_lag(renderer: Renderer, before: float) -> int | None:
    """Halve all lights of a converged run and count the frames until the indirect light has followed.

    The run ends early once the light has stayed past 90 % of the step for 50 frames.
    """
    if not before > 0.0:
        return None
    passed = before * (1.0 - 0.5 * STEP_SHARE)
    renderer.set_light_scale(0.5)
    series: list[float] = []
    settled = 0
    while len(series) < LAG_LIMIT and settled < LAG_SETTLED:
        renderer.step()
        series.append(mean_indirect(renderer.layers()))
        settled = settled + 1 if series[-1] <= passed else 0
    renderer.set_light_scale(1.0)
    return lag_frames(before, series, 0.5)


def _measure_leak(make: MakeRenderer, data: SceneData) -> float | None:
    """Fly through the lit side with a fresh cache and compare a sealed room's walls with the lit view.

    None where the scene has no sealed room: its facts name one by `sealed_lo_x` .. `sealed_hi_z`.
    """
    if "sealed_lo_x" not in data.facts:
        return None
    from luxel.render.flight import fly_through

    lower, upper = (np.array([data.facts[f"sealed_{end}_{axis}"] for axis in "xyz"]) for end in ("lo", "hi"))
    renderer = make()
    if data.flight:
        fly_through(renderer)
    renderer.run(LEAK_FRAMES)
    sealed = np.asarray(renderer.irradiance_at(*box_points(lower, upper, LEAK_POINTS)))
    layers = renderer.layers()
    return leak_ratio(sealed, layers.indirect[layers.hit])


def mean_indirect(layers: Layers) -> float:
    """Return the mean indirect radiance over the pixels that hit something."""
    return float(layers.indirect_radiance()[layers.hit].mean(dtype=np.float64)) if layers.hit.any() else 0.0
