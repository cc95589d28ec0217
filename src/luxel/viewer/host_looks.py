"""Looks that are drawn on the host from a whole view: the cache laid bare, depth, errors, with their legends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from luxel.image.write import to_bytes
from luxel.inspect.looks import Legend, Shot, draw_legend, draw_look, list_looks
from luxel.kernels.film import Film
from luxel.kernels.records import Surface
from luxel.methods.inspect import say_uninspected
from luxel.methods.params import find_method
from luxel.viewer.display import FAST_LOOKS
from luxel.viewer.interleaved import InterleavedView

LEGEND_WIDTH = 330
"""Pixels of a legend in the panel."""


@dataclass(frozen=True)
class HostLook:
    """A look, drawn."""

    pixels: np.ndarray
    """(h, w, 3) uint8."""
    legend: Legend | None


def is_host_look(look: str) -> bool:
    """Return whether `look` is drawn here rather than in the encoder."""
    return look not in FAST_LOOKS


def looks_of(method: str) -> dict[str, str]:
    """Return the looks that can be shown of `method`, each with what it shows; those against a truth left out."""
    return {look.name: look.doc for look in list_looks(find_method(method), truth=False)}


def uninspected(method: str) -> str:
    """Return the sentence on a method whose cache cannot be looked into; empty for one that has an inspector."""
    return "" if find_method(method).inspector is not None else say_uninspected(method)


def has_look(method: str, look: str) -> bool:
    """Return whether `method` has that look."""
    return look in looks_of(method)


def shows_a_point(method: str, look: str) -> bool:
    """Return whether `look` shows what lights one point, the one that was clicked last."""
    return any(each.name == look and each.kind == "source" for each in list_looks(find_method(method)))


def draw_interleaved(
    interleaved: InterleavedView, look: str, exposure: float, point: Surface | None = None
) -> HostLook:
    """Draw `look` of a picture: small while it is not full. `point` is the one that was clicked, None: the middle."""
    drawing = draw_look(look, shot_of(interleaved, exposure, point))
    return HostLook(to_bytes(drawing.image), drawing.legend)


def shot_of(interleaved: InterleavedView, exposure: float, point: Surface | None = None) -> Shot:
    """Return what was seen last: the full picture, or while there is none the small one."""
    view, cache = interleaved.middle_view, interleaved.cache
    film, layers = (
        (Film(*interleaved.size), interleaved.layers()) if interleaved.is_full else (view.film, view.layers())
    )
    return Shot(cache.scene, cache.method, cache.state, film, view.pinhole, layers, exposure, point=point)


def legend_strip(legend: Legend, width: int) -> np.ndarray:
    """Return a legend as a picture, (h, width, 3) uint8."""
    return to_bytes(draw_legend(legend, width))
