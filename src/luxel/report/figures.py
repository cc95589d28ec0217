"""What the report calls each figure: words, unit, which way is better, how it is written."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

MISSING = "–"
"""Written where a figure does not apply."""


@dataclass(frozen=True)
class Figure:
    """One column of the tables."""

    name: str
    """Its key in results.json."""
    title: str
    unit: str
    better: str
    """`down` (less is better), `zero` (nearer to 0 is better), or empty for a plain fact."""
    scale: float
    """What the stored number is multiplied by to be in `unit`."""
    words: str

    @property
    def arrow(self) -> str:
        return {"down": "↓", "zero": "→ 0"}.get(self.better, "")

    def sort_key(self, value: float | None) -> float | None:
        """Return what tables sort by: the distance from the best value, or None where there is no figure."""
        if value is None or not math.isfinite(value):
            return None
        return abs(value) if self.better == "zero" else value


FIGURES: dict[str, Figure] = {
    figure.name: figure
    for figure in (
        Figure("regional", "Error", "", "down", 1.0,
               "`regional`, the main figure: indirect light on 16×16-pixel blocks, the root mean square of the blocks’ "
               "errors over the truth’s mean. 0.02 means that the light on a patch of wall is typically off by 2 % of "
               "the scene’s mean."),
        Figure("bias", "Bias", "%", "zero", 100.0,
               "`bias`: mean indirect light over the truth’s, minus one. Errors of both signs cancel in it."),
        Figure("flip", "FLIP", "", "down", 1.0,
               "`flip`: how much a viewer sees who flips between the displayed image and the truth, 0 to 1."),
        Figure("flicker", "Flicker", "%", "down", 100.0,
               "`flicker`: mean change between still frames over the image’s mean, direct light held fixed."),
        Figure("lag_frames", "Lag", "frames", "down", 1.0,
               "`lag_frames`: all lights are halved at once; the frames until the indirect light has followed."),
        Figure("leak", "Leak", "%", "down", 100.0,
               "`leak`: light on the walls of a sealed room over light in the lit view, after a flight through the "
               "lit side. Empty where a scene has no sealed room."),
        Figure("frame_ms", "Frame", "ms", "down", 1.0,
               "`frame_ms`: median time of a whole frame after the warm-up, compilation apart."),
        Figure("floor_ms", "Floor", "ms", "", 1.0,
               "`floor_ms`: bare ray casts of the same count and kind in the same run, and the bytes that the frame "
               "must move. The ratio of frame to floor travels between machines; bare times do not."),
        Figure("relmse", "relMSE", "", "down", 1.0,
               "`relmse`: squared error over squared truth, linear values. Strict in dark corners."),
        Figure("rmse_tonemapped", "RMSE, indirect", "", "down", 1.0,
               "`rmse_tonemapped`: RMSE after c / (1 + max c) on indirect light, the truth’s mean scaled to 1."),
        Figure("rmse_gi_tonemapped", "RMSE, all light", "", "down", 1.0,
               "`rmse_gi_tonemapped`: the same on direct and indirect light together over the albedo."),
        Figure("abs_error_mean", "Abs. error", "", "down", 1.0,
               "`abs_error_mean`: summed absolute channel difference of the displayed image, 0 to 3."),
        Figure("abs_error_max", "Abs. error, max.", "", "down", 1.0, "`abs_error_max`: its largest pixel."),
        Figure("block_error_max", "Worst block", "", "down", 1.0,
               "`block_error_max`: the largest mean of it over a block of 64×64 pixels: the worst place."),
        Figure("flicker_absolute", "Flicker, abs.", "", "down", 1.0,
               "`flicker_absolute`: mean over pixels of the summed absolute channel change between still frames."),
        Figure("motion_regional", "Error in motion", "", "down", 1.0,
               "`motion_regional`: `regional` of every sixth frame of a flight, each against the truth of its moment, "
               "on average."),
        Figure("motion_regional_worst", "Worst frame", "", "down", 1.0,
               "`motion_regional_worst`: the largest of these."),
        Figure("motion_bias", "Bias, absolute", "%", "down", 100.0,
               "`motion_bias`: mean of the absolute `bias` of these frames: too bright here does not make up for too "
               "dark there."),
        Figure("motion_flip", "FLIP in motion", "", "down", 1.0,
               "`motion_flip`: mean `flip` of these frames, with the truth’s direct light on either side."),
        Figure("motion_flicker", "Flicker in motion", "", "down", 1.0,
               "`motion_flicker`: how much the displayed indirect light of a place changes from one frame to the next, "
               "0 to 3. Places are followed by their motion; it needs no truth."),
        Figure("cut_regional", "After a jump", "", "down", 1.0,
               "`cut_regional`: mean `regional` of frames 1, 4 and 16 after a jump to a view at the other end of the "
               "flight."),
        Figure("motion_ms", "Frame in motion", "ms", "down", 1.0,
               "`motion_ms`: median time of a flown frame, in the same run."),
    )
}  # fmt: skip
"""By name, in the order of the tables."""

MOTION = (
    "motion_regional", "motion_regional_worst", "motion_bias", "motion_flip", "motion_flicker", "cut_regional",
    "motion_ms",
)  # fmt: skip
"""Columns of a flight's table."""
MAIN = ("regional", "bias", "flip", "flicker", "lag_frames", "leak", "frame_ms", "floor_ms")
"""Columns of the first table; the others follow in a second one."""


def round_figure(value: float | None, digits: int = 3) -> str:
    """Return a number for people: `digits` significant ones, thousands by commas, a real minus sign."""
    if value is None or not math.isfinite(value):
        return MISSING
    size = abs(value)
    if size >= 999.5 or value == int(value):
        text = f"{value:,.0f}"
    elif size < 1e-4:
        text = f"{value:.{max(digits - 2, 0)}e}"
    else:
        text = f"{value:.{max(digits - 1 - math.floor(math.log10(size)), 0)}f}"
    return text.replace("-", "−")


def write_figure(name: str, value: float | None, with_unit: bool = False) -> str:
    """Return a figure in its unit, such as `0.0235`, or with the unit behind it, such as `47.3 ms`."""
    figure = FIGURES[name]
    if value is None or not math.isfinite(value):
        return MISSING
    scaled = value * figure.scale
    # A millionth of a percent is rounding, not light.
    text = "<0.001" if figure.unit == "%" and 0.0 < abs(scaled) < 0.001 else round_figure(scaled)
    return f"{text} {figure.unit}" if with_unit and figure.unit else text


def write_spread(name: str, spread: Any) -> str:
    """Return `± 0.002` in the figure's unit, two digits, or nothing where there is no spread."""
    if not isinstance(spread, int | float) or not math.isfinite(spread):
        return ""
    figure = FIGURES[name]
    text = round_figure(spread * figure.scale, 2)
    return f"± {'<0.001' if figure.unit == '%' and 0.0 < spread * figure.scale < 0.001 else text}"


def write_time(ms: float | None) -> str:
    """Return a duration in ms, or in seconds or minutes where those read better."""
    if ms is None or not math.isfinite(ms):
        return MISSING
    if ms >= 120_000.0:
        return f"{round_figure(ms / 60_000.0)} min"
    return f"{round_figure(ms / 1000.0)} s" if ms >= 1000.0 else f"{round_figure(ms)} ms"
