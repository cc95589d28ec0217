"""How many pixels to render now: an image must answer a drag in time, and sharpen when the camera rests.

A picture of full size is rendered in passes. A pass takes every `stride`-th pixel of every `stride`-th row, so it costs
1 / stride^2 of the picture, and a drag never waits for more than the pass that is running. While the camera turns,
each pass is shown at once, enlarged; at rest stride^2 passes with different offsets fill the picture up, exactly.
"""

from __future__ import annotations

import math
from functools import cache

STRIDES = (1, 2, 3, 4, 6, 8)
"""A pass takes one pixel in stride x stride."""
GRAIN = 24
"""Full sizes are multiples of it, so that every stride divides them."""
TARGET_MS = 150.0
"""A drag should be answered within this time."""
SAFETY = 0.8
"""Share of the target that a prediction may fill; the rest is for encoding and the way to the browser."""
WAIT = 2.0
"""Passes between a drag and its answer: the one that was running, and its own."""
MEMORY = 0.7
"""Share of the past that a measured time keeps."""
CALM = 0.6
"""A finer stride is taken only where it would fill no more than this share of what is allowed, so that it lasts."""


def fit_size(window: tuple[int, int], budget: tuple[int, int]) -> tuple[int, int]:
    """Return the full (width, height) for a window: its shape, no more pixels than it or `budget` has, whole grains."""
    width, height = max(window[0], 1), max(window[1], 1)
    scale = min(1.0, math.sqrt(budget[0] * budget[1] / (width * height)))
    columns = max(1, round(width * scale / GRAIN))
    rows = max(1, round(height * scale / GRAIN))
    # A window as thin as a grain must not grow beyond the budget along its other side.
    most = max(1, budget[0] * budget[1] // GRAIN**2)
    return min(columns, max(1, most // rows)) * GRAIN, min(rows, max(1, most // columns)) * GRAIN


@cache
def order_offsets(stride: int) -> tuple[tuple[int, int], ...]:
    """Return the (column, row) offsets of a picture's passes.

    The first d^2 of them are an even lattice for every d of `even_sides`; between, each next one is as far from the
    others as can be.
    """
    order = [(0, 0)]
    for side in even_sides(stride)[1:]:
        step = stride // side
        lattice = [(column, row) for row in range(0, stride, step) for column in range(0, stride, step)]
        rest = [offset for offset in lattice if offset not in order]
        while rest:
            best = max(rest, key=lambda offset: min(_apart(offset, other, stride) for other in order))
            rest.remove(best)
            order.append(best)
    return tuple(order)


@cache
def even_sides(stride: int) -> tuple[int, ...]:
    """Return the sides of the lattices that the passes complete on their way: 1, 2, 4 of stride 4; 1, 2, 6 of 6."""
    sides, rest = [1], stride
    for factor in (2, 3):
        while rest % factor == 0:
            rest //= factor
            sides.append(sides[-1] * factor)
    return tuple(sides)


def complete_side(stride: int, passes: int) -> int:
    """Return the side of the largest lattice that `passes` passes have completed; 0 before the first."""
    return max((side for side in even_sides(stride) if side * side <= passes), default=0)


def _apart(a: tuple[int, int], b: tuple[int, int], stride: int) -> float:
    """Return the squared distance of two offsets in a pattern that repeats every `stride` pixels."""
    return sum(min(abs(p - q), stride - abs(p - q)) ** 2 for p, q in zip(a, b, strict=True))


class StrideController:
    """Chooses the stride from the times that passes took."""

    def __init__(self, target_ms: float = TARGET_MS) -> None:
        self.target_ms = target_ms
        self.stride = STRIDES[2]
        self._pass_ms: float | None = None

    @property
    def allowed_ms(self) -> float:
        """What one pass may take."""
        return SAFETY * self.target_ms / WAIT

    def observe(self, ms: float) -> None:
        """Note what a pass at the present stride took, other visitors' passes of the same frame included."""
        self._pass_ms = ms if self._pass_ms is None else MEMORY * self._pass_ms + (1.0 - MEMORY) * ms

    def choose(self) -> int:
        """Return the stride to go on with: the finest one that answers in time, the coarsest where none does."""
        if self._pass_ms is None:
            return self.stride
        place = STRIDES.index(self.stride)
        finer = STRIDES[max(place - 1, 0)]
        # A finer pass takes at most what its pixels ask for, as part of a frame knows no pixels.
        finer_ms = self._pass_ms * (self.stride / finer) ** 2
        if self._pass_ms > self.allowed_ms:
            self._take(STRIDES[min(place + 1, len(STRIDES) - 1)])
        elif finer_ms <= CALM * self.allowed_ms:
            self._take(finer)
        return self.stride

    def _take(self, stride: int) -> None:
        if stride != self.stride:
            self.stride, self._pass_ms = stride, None
