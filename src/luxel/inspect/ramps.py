"""Colours for numbers: ramps whose steps look even, as they are drawn in OKLab (Ottosson 2020), and colours for ids.

A ramp goes through a few stops of lightness, chroma and hue; lightness rises evenly, so a ramp still reads in grey.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from luxel.image.tonemap import to_display

STEPS = 256
STOPS: dict[str, tuple[tuple[float, float, float], ...]] = {
    # Blue, green, yellow: for what is simply more or less.
    "field": ((0.24, 0.10, 300.0), (0.42, 0.11, 262.0), (0.59, 0.10, 205.0), (0.75, 0.15, 150.0), (0.93, 0.18, 105.0)),
    # Night, violet, ember, pale yellow: for what costs or errs.
    "heat": ((0.14, 0.05, 290.0), (0.36, 0.16, 310.0), (0.56, 0.20, 15.0), (0.76, 0.17, 60.0), (0.96, 0.09, 100.0)),
}
"""(lightness, chroma, hue in degrees) at even distances from the low end to the high one."""
BELOW = ((0.16, 0.0, 240.0), (0.48, 0.13, 255.0), (0.90, 0.10, 215.0))
ABOVE = ((0.16, 0.0, 40.0), (0.50, 0.17, 35.0), (0.92, 0.11, 85.0))
"""The two arms of the ramp `signed`, from nothing in the middle outwards: too little is blue, too much is orange."""
GOLDEN = 0.6180339887
"""Turns by which the hues of following ids are apart: no two near ones look alike."""


def colorize(values: np.ndarray, ramp: str = "field") -> np.ndarray:
    """Return displayed colours (..., 3) float32 for `values` (...), which are clipped to 0..1; NaN counts as 0.

    `ramp` is `field`, `heat`, or `signed`, whose middle, 0.5, is dark.
    """
    table = ramp_table(ramp)
    place = np.clip(np.nan_to_num(values), 0.0, 1.0) * (len(table) - 1)
    steps = np.arange(len(table))
    return np.stack([np.interp(place, steps, channel) for channel in table.T], axis=-1).astype(np.float32)


@cache
def ramp_table(ramp: str) -> np.ndarray:
    """Return the displayed colours of a ramp, (STEPS, 3) float32 from its low end to its high one."""
    if ramp == "signed":
        half = STEPS // 2
        return np.concatenate([_walk(BELOW, half)[::-1], _walk(ABOVE, half)])
    return _walk(STOPS[ramp], STEPS)


def _walk(stops: tuple[tuple[float, float, float], ...], steps: int) -> np.ndarray:
    """Return `steps` displayed colours through the stops, interpolated in OKLab."""
    lightness, chroma, hue = np.array(stops).T
    lab = np.stack([lightness, chroma * np.cos(np.deg2rad(hue)), chroma * np.sin(np.deg2rad(hue))])
    place = np.linspace(0.0, len(stops) - 1.0, steps)
    return from_oklab(np.stack([np.interp(place, np.arange(len(stops)), channel) for channel in lab], axis=-1))


def from_oklab(lab: np.ndarray) -> np.ndarray:
    """Return displayed colours (..., 3) float32 of OKLab ones; what a display cannot show is clipped."""
    lightness, a, b = np.moveaxis(np.asarray(lab, np.float64), -1, 0)
    l = (lightness + 0.3963377774 * a + 0.2158037573 * b) ** 3  # noqa: E741
    m = (lightness - 0.1055613458 * a - 0.0638541728 * b) ** 3
    s = (lightness - 0.0894841775 * a - 1.2914855480 * b) ** 3
    linear = np.stack(
        [
            4.0767416621 * l - 3.3077115913 * m + 0.2309699292 * s,
            -1.2684380046 * l + 2.6097574011 * m - 0.3413193965 * s,
            -0.0041960863 * l - 0.7034186147 * m + 1.7076147010 * s,
        ],
        axis=-1,
    )
    return to_display(linear)


def id_colors(ids: np.ndarray) -> np.ndarray:
    """Return a displayed colour for each id, (..., 3) float32: hues apart, lightness and chroma a little."""
    words = np.asarray(ids).astype(np.uint32)
    hue = 2.0 * np.pi * np.mod(words * GOLDEN, 1.0)
    lightness = 0.60 + 0.22 * (_scramble(words) * (1.0 / 4294967296.0))
    chroma = 0.10 + 0.06 * (_scramble(words + np.uint32(7)) * (1.0 / 4294967296.0))
    return from_oklab(np.stack([lightness, chroma * np.cos(hue), chroma * np.sin(hue)], axis=-1))


def _scramble(words: np.ndarray) -> np.ndarray:
    """Return well-mixed words (Wellons' lowbias32)."""
    with np.errstate(over="ignore"):
        words = words ^ (words >> np.uint32(16))
        words = words * np.uint32(0x7FEB352D)
        words = words ^ (words >> np.uint32(15))
        words = words * np.uint32(0x846CA68B)
        return words ^ (words >> np.uint32(16))
