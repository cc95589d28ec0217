"""Pixels in tile order: 16 x 16 tiles, Morton order inside.

Neighbouring lanes are neighbouring pixels in both directions, so rays and cache reads stay coherent, and every aligned
run of 256, 64 or 16 lanes is a tile of 16, 8 or 4 pixels: a per-tile minimum is one block reduction.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

TILE = 16


class Film(NamedTuple):
    """Image size, the padded lanes that cover it, and what its pixels show.

    A tuple, as frozen dataclasses fail inside Dr.Jit's loops, and g-buffers carry it into them.
    """

    width: int
    height: int
    filter: str = "none"
    """One of `scene.choice.FILTERS`: what a still view's pixels show once its frames are averaged."""
    spread: float = 1.0
    """The filter's pixel, in pixels of the film: 1/n of a film that takes every n-th pixel of a picture."""

    @property
    def is_filtered(self) -> bool:
        """Whether pixels show more than the light through their centres."""
        return self.filter != "none"

    @property
    def lane_count(self) -> int:
        """Pixels padded to whole tiles."""
        return self.tiles_x * self.tiles_y * TILE * TILE

    @property
    def tiles_x(self) -> int:
        return -(-self.width // TILE)

    @property
    def tiles_y(self) -> int:
        return -(-self.height // TILE)

    def pixel_of_lane(self, lane: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32, mi.Bool]:
        """Return column, row and whether the lane is inside the image."""
        tile, inner = lane >> 8, lane & 255
        x = (tile % self.tiles_x) * TILE + _every_second_bit(inner)
        y = (tile // self.tiles_x) * TILE + _every_second_bit(inner >> 1)
        return x, y, (x < self.width) & (y < self.height)

    def lane_of_pixel(self, x: mi.Int32, y: mi.Int32) -> tuple[mi.UInt32, mi.Bool]:
        """Return the lane of column `x` and row `y`, and whether they are inside the image; 0 where they are not."""
        inside = (x >= 0) & (x < self.width) & (y >= 0) & (y < self.height)
        column, row = mi.UInt32(dr.select(inside, x, 0)), mi.UInt32(dr.select(inside, y, 0))
        inner = _spread(column & (TILE - 1)) | (_spread(row & (TILE - 1)) << 1)
        return ((row // TILE) * self.tiles_x + column // TILE) * (TILE * TILE) + inner, inside

    def image_coordinates(self, pixel: mi.Point2f) -> tuple[mi.Float, mi.Float]:
        """Return a camera's x, y in -1..1 (y up) of places in pixels right and down from the upper left corner."""
        return pixel.x * (2.0 / self.width) - 1.0, 1.0 - pixel.y * (2.0 / self.height)

    def lanes_of_image(self) -> np.ndarray:
        """Return (H, W) int64: the lane of each pixel; read-only, since it is kept."""
        return _lanes_of_image(self)

    def to_image(self, value: Any) -> np.ndarray:
        """Return a Dr.Jit array or colour of all lanes as (H, W) or (H, W, 3).

        A value that is the same everywhere (such as no glossy light) comes as one row.
        """
        array = np.array(value)
        array = array.T if array.ndim == 2 else array
        return np.broadcast_to(array, (self.lane_count, *array.shape[1:]))[self.lanes_of_image()]


@lru_cache(maxsize=8)
def _lanes_of_image(film: Film) -> np.ndarray:
    """Every layer of every frame that leaves the device asks for it, and it takes longer to make than to use."""
    y, x = np.mgrid[: film.height, : film.width].astype(np.int64)
    inner = _spread(x % TILE) | _spread(y % TILE) << 1
    lanes = ((y // TILE) * film.tiles_x + x // TILE) * 256 + inner
    lanes.flags.writeable = False
    return lanes


def _every_second_bit(word: mi.UInt32) -> mi.UInt32:
    """Gather bits 0, 2, 4, 6 of `word` into bits 0 to 3."""
    return (word & 1) | ((word >> 1) & 2) | ((word >> 2) & 4) | ((word >> 3) & 8)


def _spread(value: Any) -> Any:
    """Put bits 0 to 3 of `value` at places 0, 2, 4, 6: whole numbers of NumPy or of the device."""
    return (value & 1) | (value & 2) << 1 | (value & 4) << 2 | (value & 8) << 3
