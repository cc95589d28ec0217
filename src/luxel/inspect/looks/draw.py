"""Looks by name: which there are for a method, and the drawing of one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from luxel.errors import LuxelError
from luxel.inspect.looks.cache import CACHE_KINDS
from luxel.inspect.looks.frame import FRAME_LOOKS, NEEDS_TRUTH
from luxel.inspect.looks.legend import Legend, draw_legend
from luxel.inspect.looks.shot import Shot
from luxel.methods.base import Method
from luxel.methods.inspect import Look, say_uninspected


@dataclass(frozen=True)
class Drawing:
    """A look of a frame."""

    look: Look
    image: np.ndarray
    """(H, W, 3) float32 in 0..1, ready to be shown."""
    legend: Legend | None
    """What its colours mean; None where they mean themselves."""

    def with_legend(self) -> np.ndarray:
        """Return the image with its legend as a strip below it, (H + strip, W, 3)."""
        if self.legend is None:
            return self.image
        return np.concatenate([self.image, draw_legend(self.legend, self.image.shape[1])])


def list_looks(method: Method, *, truth: bool = True) -> tuple[Look, ...]:
    """Return what can be drawn of a frame of `method`; without a `truth`, not what is measured against one."""
    frame = tuple(look for look in (entry.look for entry in FRAME_LOOKS) if truth or look.name not in NEEDS_TRUTH)
    return frame if method.inspector is None else (*frame, *method.inspector.looks)


def find_look(name: str, method: Method) -> Look:
    """Return the look of that name. Raises LuxelError where `method` has none."""
    for look in list_looks(method):
        if look.name == name:
            return look
    known = ", ".join(look.name for look in list_looks(method))
    more = f"; {say_uninspected(method.name)}" if method.inspector is None else ""
    raise LuxelError(f"method '{method.name}' has no look '{name}' (it has: {known}){more}")


def draw_look(name: str, shot: Shot, *, span: Sequence[float] | None = None) -> Drawing:
    """Return look `name` of a frame; `span` sets the ends of a number's scale, which else fits the picture.

    Raises LuxelError for a name that the method does not have, and for an error where the shot has no truth.
    """
    look = find_look(name, shot.method)
    ends = None if span is None else (float(span[0]), float(span[1]))
    if ends is not None and not (np.isfinite(ends).all() and ends[0] < ends[1]):
        raise LuxelError(f"look '{name}': a scale from {ends[0]} to {ends[1]} cannot be drawn")
    for entry in FRAME_LOOKS:
        if entry.look.name == name:
            if name in NEEDS_TRUTH and shot.truth is None:
                raise LuxelError(f"look '{name}' compares with the truth: give one (--truth)")
            return Drawing(look, *entry.draw(shot, look, ends))
    return Drawing(look, *CACHE_KINDS[look.kind](shot, look, ends))
