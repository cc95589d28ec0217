"""What an image, a run and a sealed room are worth: the figures of the reports, on plain NumPy arrays."""

from __future__ import annotations

from luxel.metrics.error import all_errors, ambient_irradiance, regional
from luxel.metrics.flip import flip, flip_map
from luxel.metrics.leak import leak_ratio
from luxel.metrics.temporal import drift, flicker, lag_frames

__all__ = [
    "all_errors",
    "ambient_irradiance",
    "drift",
    "flicker",
    "flip",
    "flip_map",
    "lag_frames",
    "leak_ratio",
    "regional",
]
