"""Figures of a run over time: how calm it is, how soon it follows, whether it drifts."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

STEP_SHARE = 0.9
"""Share of a step in the light after which a method counts as having followed it."""
DRIFT_SAMPLES = 1500
"""Longer runs are thinned to this many values: the slope looks at every pair."""


class Flicker(NamedTuple):
    """What a still view does that it should not do."""

    relative: float
    """`absolute` over the mean of the displayed images (over pixels and channels)."""
    absolute: float
    """Summed absolute channel change from frame to frame, mean over pixels and frames, 0..3."""


def flicker(images: Iterable[np.ndarray]) -> Flicker:
    """Measure the change between consecutive displayed images of a still view, (H, W, 3) in 0..1 each.

    The direct light should be held fixed, so that only the method under test can change them. Reads the images
    one by one: a generator keeps two in memory. Fewer than two images, or black ones, give NaN.
    """
    changes: list[float] = []
    means: list[float] = []
    before: np.ndarray | None = None
    for image in images:
        now = image.astype(np.float64)
        if before is not None:
            changes.append(float(np.abs(now - before).sum(axis=-1).mean()))
        means.append(float(now.mean()))
        before = now
    if not changes:
        return Flicker(float("nan"), float("nan"))
    absolute, mean = float(np.mean(changes)), float(np.mean(means))
    return Flicker(absolute / mean if mean > 0.0 else float("nan"), absolute)


def lag_frames(before: float, series: Sequence[float], scale: float = 0.5) -> int | None:
    """Return the first frame after which the mean indirect light stays past 90 % of a step in all lights.

    `before` is the mean indirect light just before the step; `series` that of frame 1, 2, … after all lights were
    multiplied by `scale`, which in the end multiplies `before` too. A method without memory has 1. None: it does
    not get there within the series, or there was no light to follow.
    """
    step = before * (scale - 1.0)
    if not np.isfinite(step) or step == 0.0:
        return None
    followed = 0
    for value in reversed(series):
        if not (value - before) / step >= STEP_SHARE:
            break
        followed += 1
    return len(series) - followed + 1 if followed else None


def drift(values: Sequence[float]) -> float:
    """Return the trend of a run, as a share of its median: Theil-Sen slope times the run's length over the median.

    The slope is the median over all pairs, so spikes do not count. Fewer than two values give NaN.
    """
    if len(values) < 2:
        return float("nan")
    places = np.unique(np.linspace(0, len(values) - 1, min(len(values), DRIFT_SAMPLES)).round().astype(int))
    samples = np.asarray(values, np.float64)[places]
    first, second = np.triu_indices(len(places), 1)
    slope = float(np.median((samples[second] - samples[first]) / (places[second] - places[first])))
    median = float(np.median(samples))
    return slope * (len(values) - 1) / median if median != 0.0 else float("nan")
