"""Two methods, or a method and the truth, in one picture; and how far apart they are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from luxel.image.layers import Layers
from luxel.image.tonemap import mean_exposure, to_display
from luxel.image.write import to_bytes
from luxel.inspect.looks.legend import Legend, Scale
from luxel.inspect.ramps import colorize
from luxel.methods.path_tracer import PathTracer
from luxel.metrics import error

TRUTH_METHOD = PathTracer.name
"""The method whose samples, gathered while the camera rests, are shown as the truth."""
SPLIT_COLOR = (255, 255, 255)
FIGURES = {
    "regional": error.regional,
    "bias": error.bias,
    "rmse_tonemapped": error.rmse_tonemapped,
    "abs_error_mean": error.abs_error_mean,
}
"""Live figures against the truth, by their names in the reports."""
ERROR_LEGEND = Legend("displayed difference, summed over the channels", "", Scale(0.0, 0.5), "heat")
"""What the colours of the error map mean."""


@dataclass(frozen=True)
class Comparison:
    """What a visitor compares the method in use with."""

    rival: str | None = None
    """Another method; `TRUTH_METHOD` is the truth, which gathers while the camera rests."""
    split: float = 0.5
    """Where the picture changes from the method in use to its rival, 0 left to 1 right."""
    shows_map: bool = False
    """The right side shows how far apart the two are, instead of the rival."""


def join_halves(left: np.ndarray, right: np.ndarray, split: float) -> np.ndarray:
    """Return `left` up to column `split` (0..1) and `right` from there, with a thin line between; (H, W, 3) uint8.

    Where one has fewer pixels it is enlarged to the other's size.
    """
    height, width = max(left.shape[0], right.shape[0]), max(left.shape[1], right.shape[1])
    left, right = enlarge(left, width, height), enlarge(right, width, height)
    column = int(round(np.clip(split, 0.0, 1.0) * width))
    joined = right.copy()
    joined[:, :column] = left[:, :column]
    if 0 < column < width:
        thick = max(1, width // 640)
        joined[:, max(column - thick, 0) : column + thick] = SPLIT_COLOR
    return joined


def enlarge(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return `image` at `width` x `height` by repeating its pixels."""
    if image.shape[:2] == (height, width):
        return image
    rows = np.arange(height) * image.shape[0] // height
    columns = np.arange(width) * image.shape[1] // width
    return image[rows[:, None], columns[None, :]]


def measure(test: Layers, truth: Layers) -> dict[str, float]:
    """Return the live figures of `test` against `truth`: the same camera and size."""
    return {name: figure(test, truth) for name, figure in FIGURES.items()}


def draw_error(test: Layers, truth: Layers) -> np.ndarray:
    """Return the displayed difference by the colours of `ERROR_LEGEND`, (H, W, 3) uint8."""
    exposure = mean_exposure(truth.image())
    first, second = to_display(test.image(), exposure), to_display(truth.image(), exposure)
    assert ERROR_LEGEND.scale is not None
    level = ERROR_LEGEND.scale.place(np.abs(first - second).sum(axis=-1))
    return to_bytes(colorize(level, ERROR_LEGEND.ramp))
