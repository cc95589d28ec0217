"""Automatic exposure: one rule for image, sequence, viewer, bake and inspection.

A picture is metered in 32 x 32 cells, so that the noise of single pixels has no say. What counts is the light that
surfaces reflect: not the background, not lamps. Of the cells, the brightest tenth (a patch of sun, the wall beside a
lamp) counts as no brighter than its border, and what is darker than 1/50 of that (a facade in the dark, seen with a
lit room) counts the less the darker it is. The mean of all this is shown as middle grey. Measurements have a rule of
their own: `tonemap.mean_exposure`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from luxel.image.layers import Layers
from luxel.image.tonemap import MIDDLE_GREY
from luxel.scene.colours import luminance

CELLS = 32
"""Cells along each side of a picture."""
BRIGHT = 0.9
"""Share of the metered area that lies below the highlights."""
DARK = 0.02
"""Of the highlights: what is darker counts by the square of how much darker it is, so that no brightness is a step."""
STOPS_MAX = 32.0
"""From the automatic exposure, either way: more is a slip of the pen."""
FACTOR_MAX = 1e12
"""A factor that is given, and one over the least: darker or brighter is no picture."""
KINDS = 3
"""Light reflected by surfaces; all light of surfaces (where everything shines, as in a bake); all light."""


@dataclass(frozen=True)
class Exposure:
    """What a user asks for: a factor, or stops from the automatic exposure."""

    factor: float | None = None
    """None: automatic."""
    stops: float = 0.0
    """Above (or below) the automatic exposure, powers of two."""

    def of(self, picture: Layers | np.ndarray) -> float:
        """Return the factor for `picture`: layers, or linear light (..., 3) that counts as a whole."""
        return auto_exposure(picture) * 2.0**self.stops if self.factor is None else self.factor


def resolve_exposure(wanted: Exposure | float | None, picture: Layers | np.ndarray) -> float:
    """Return the factor that `wanted` means for `picture`; None is automatic."""
    return (wanted if isinstance(wanted, Exposure) else Exposure(wanted)).of(picture)


@dataclass(frozen=True)
class Meter:
    """Light by cell; meters of pictures of one view add up."""

    light: np.ndarray
    """(KINDS, C) sums of luminance over the pixels of each cell that count."""
    count: np.ndarray
    """(KINDS, C) how many those are."""

    def __add__(self, other: Meter) -> Meter:
        return Meter(self.light + other.light, self.count + other.count)

    @property
    def mean(self) -> float:
        """The mean luminance of the picture."""
        return float(self.light[-1].sum() / max(self.count[-1].sum(), 1.0))

    def exposure(self) -> float:
        """Return the automatic exposure; 1 for a black picture."""
        for light, count in zip(self.light, self.count, strict=True):
            if light.sum() > 0.0:
                used = count > 0.0
                return MIDDLE_GREY / _typical(light[used] / count[used], count[used])
        return 1.0


def auto_exposure(picture: Layers | np.ndarray) -> float:
    """Return the factor that shows a picture well: the mean of its lit surfaces at 0.18 (see the head of this file).

    `picture`: layers, or linear light (H, W, 3) or (N, 3) of which all counts. Pixels that are not finite are left
    out; a black picture gives 1.
    """
    return (_meter_layers(picture) if isinstance(picture, Layers) else _meter_light(picture)).exposure()


def cells_of(width: int, height: int) -> np.ndarray:
    """Return the cell of each pixel of a picture, (H, W) int64 below CELLS^2."""
    rows, columns = (np.arange(size) * CELLS // size for size in (height, width))
    return rows[:, None] * CELLS + columns


def _meter_layers(layers: Layers) -> Meter:
    cells = cells_of(*layers.hit.shape[::-1]).ravel()
    reflected = luminance(layers.albedo / np.pi * (layers.direct + layers.indirect) + layers.glossy)
    whole = luminance(layers.image())
    surface = layers.hit & ((luminance(layers.albedo) > 0.0) | (luminance(layers.glossy) > 0.0))
    counted = (reflected, surface), (whole, layers.hit), (whole, np.ones_like(layers.hit))
    return _sum(cells, [(light.ravel(), mask.ravel()) for light, mask in counted], CELLS * CELLS)


def _meter_light(light: np.ndarray) -> Meter:
    values = luminance(light).ravel()
    # A list of points has no places: each is a cell.
    cells = cells_of(light.shape[1], light.shape[0]).ravel() if light.ndim == 3 else np.arange(values.size)
    none, every = np.zeros(values.shape, bool), np.ones(values.shape, bool)
    return _sum(cells, [(values, none), (values, none), (values, every)], int(cells.max(initial=0)) + 1)


def _sum(cells: np.ndarray, counted: list[tuple[np.ndarray, np.ndarray]], cell_count: int) -> Meter:
    sums: list[np.ndarray] = []
    counts: list[np.ndarray] = []
    for light, mask in counted:
        used = mask & np.isfinite(light)
        sums.append(np.bincount(cells[used], np.maximum(light[used], 0.0), cell_count))
        counts.append(np.bincount(cells[used], minlength=cell_count))
    return Meter(np.stack(sums), np.stack(counts).astype(np.float64))


def _typical(light: np.ndarray, count: np.ndarray) -> float:
    """Return the mean of what is lit, highlights cut, of cells with `light` and `count` pixels each."""
    lit = light > 0.0
    light, count = light[lit], count[lit]
    order = np.argsort(light)
    below = np.cumsum(count[order])
    bright = light[order][np.searchsorted(below, BRIGHT * below[-1])]
    share = np.minimum(light / (DARK * bright), 1.0) ** 2
    return float(np.average(np.minimum(light, bright), weights=count * share))
