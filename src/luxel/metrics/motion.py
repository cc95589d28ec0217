"""Figures of a flight: how far each judged frame is from the truth of its moment, and how much it flickers on the way.

Errors are those of `error.py`, frame by frame. A truth may be there as layers, or, where those would be too much to
keep, as sums over its blocks alone. Flicker needs no truth: a pixel is compared with the same place of the surface in
the frame before.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from luxel.image.layers import Layers
from luxel.image.tonemap import to_display
from luxel.metrics.error import ALBEDO_FLOOR, REGION, bias, block_sums, display_pair, regional
from luxel.metrics.flip import flip

MOTION_FIGURES = (
    "motion_regional", "motion_regional_worst", "motion_flip", "motion_bias", "motion_flicker", "cut_regional",
)  # fmt: skip
"""Names of what `motion_figures` returns."""


# ---------- A truth in sums ----------


@dataclass
class TruthSums:
    """What `regional` and `bias` need of a truth, float64."""

    light: np.ndarray
    """(R, C, 3): indirect radiance summed over blocks of 16x16 pixels, channels of albedo above 0.02 alone."""
    albedo: np.ndarray
    """(R, C, 3): the albedo summed over the same."""
    total: np.ndarray
    """(3,): indirect radiance summed over all pixels that hit something."""
    reflected: np.ndarray
    """(3,): albedo summed over all pixels that hit something."""


def sum_truth(truth: Layers) -> TruthSums:
    """Return the sums of a frame."""
    radiance, hit = truth.indirect_radiance(), truth.hit[..., None]
    counted = hit & (truth.albedo > ALBEDO_FLOOR)
    return TruthSums(
        block_sums(np.where(counted, radiance, 0.0), REGION),
        block_sums(np.where(counted, truth.albedo, 0.0), REGION),
        np.where(hit, radiance, 0.0).sum(axis=(0, 1), dtype=np.float64),
        np.where(hit, truth.albedo, 0.0).sum(axis=(0, 1), dtype=np.float64),
    )


def judge_by_sums(test: Layers, truth: TruthSums) -> dict[str, float]:
    """Return `regional` and `bias` of a frame against the sums of its truth; NaN where the truth leaves one undefined.

    The two see the same surfaces; where none is blended that is so for any two frames of one camera.
    """
    given, filled = sum_truth(test), truth.albedo > 0.0
    wanted = truth.light[filled] / truth.albedo[filled]
    error = given.light[filled] / truth.albedo[filled] - wanted
    mean = float(wanted.mean()) if wanted.size else 0.0
    total = float(truth.total.sum())
    return {
        "regional": float(np.sqrt(np.mean(error**2))) / mean if mean > 0.0 else float("nan"),
        "bias": float(given.total.sum()) / total - 1.0 if total > 0.0 else float("nan"),
    }


def sums_irradiance(frames: Iterable[TruthSums]) -> tuple[float, float, float]:
    """Return the one irradiance (W/m^2, per channel) that gives the total of all frames; 0 without albedo."""
    total, reflected = np.zeros(3), np.zeros(3)
    for sums in frames:
        total, reflected = total + sums.total, reflected + sums.reflected
    red, green, blue = np.where(reflected > 0.0, np.pi * total / np.where(reflected > 0.0, reflected, 1.0), 0.0)
    return float(red), float(green), float(blue)


# ---------- A frame ----------


def judge_frame(test: Layers, truth: Layers, split: bool = True) -> dict[str, float]:
    """Return `regional`, `bias` and `flip` of a frame against the truth of its moment.

    What is displayed has the truth's direct light on either side, so that only indirect light tells them apart: a
    frame in motion has but one sample of direct light, whose noise would decide. `split` False leaves out the two
    figures of indirect light, which cannot be compared where one side reflects what the other does not.
    """
    shown = display_pair(replace(test, direct=truth.direct).image(), truth.image())
    light = {"regional": regional(test, truth), "bias": bias(test, truth)} if split else {}
    return {**light, "flip": flip(*shown)}


# ---------- From frame to frame ----------


@dataclass
class PixelTaps:
    """Where the surface behind each pixel was seen in the frame before: four pixels with weights."""

    pixel: np.ndarray
    """(H, W, 4): numbers of the pixels, row by row."""
    weight: np.ndarray
    """(H, W, 4): bilinear weights that add up to one; all zero where none of the four shows the same surface."""

    @property
    def valid(self) -> np.ndarray:
        """Return where the surface was seen before, (H, W) bool."""
        return self.weight.sum(axis=-1) > 0.0

    def fetch(self, values: np.ndarray) -> np.ndarray:
        """Return `values` (H, W, C) of the frame before, brought to the pixels of this one."""
        return np.einsum("hwt,hwtc->hwc", self.weight, values.reshape(-1, values.shape[-1])[self.pixel])


def flicker_between(now: Layers, before: Layers, taps: PixelTaps, exposure: float) -> float:
    """Return the mean absolute displayed change of albedo / pi times E from a frame to the next, 0..3.

    Summed over the channels, mean over the pixels with validated taps; NaN without any. E of the frame before is
    brought here along the motion; both have this frame's albedo, so that a texture's own detail is no flicker.
    """
    valid = taps.valid
    if not valid.any():
        return float("nan")
    shown = [
        to_display(now.albedo / np.pi * irradiance, exposure).astype(np.float64)
        for irradiance in (now.indirect, taps.fetch(before.indirect))
    ]
    return float(np.abs(shown[0] - shown[1]).sum(axis=-1)[valid].mean())


# ---------- The whole flight ----------


def motion_figures(
    frames: Sequence[Mapping[str, float]], flickers: Sequence[float], cuts: Sequence[Mapping[str, float]]
) -> dict[str, float | None]:
    """Return every figure of a flight by name; None where no frame has what it is made of.

    `frames` are the judged frames as `judge_frame` or `judge_by_sums` return them, `flickers` those of the judged
    frames, `cuts` the judged frames after the jump. A frame in which a figure is undefined has no say in it.
    """
    errors, flips, biases = (_known(frame.get(name) for frame in frames) for name in ("regional", "flip", "bias"))
    return {
        "motion_regional": _mean(errors),
        "motion_regional_worst": max(errors, default=None),
        "motion_flip": _mean(flips),
        "motion_bias": _mean([abs(value) for value in biases]),
        "motion_flicker": _mean(_known(flickers)),
        "cut_regional": _mean(_known(frame.get("regional") for frame in cuts)),
    }


def _known(values: Iterable[float | None]) -> list[float]:
    return [float(value) for value in values if value is not None and np.isfinite(value)]


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if values else None
