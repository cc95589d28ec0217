"""Looks into the cache of `gibs`: why a point is lit so, what can be drawn of it, what it holds."""

from __future__ import annotations

from typing import ClassVar

from luxel.kernels.records import Surface
from luxel.methods.gibs.explain import explain_point
from luxel.methods.gibs.looks import GIBS_LOOKS, read_surfels
from luxel.methods.gibs.surfels import GibsState
from luxel.methods.gibs.views import surfel_views
from luxel.methods.inspect import CacheView, Contribution, Inspector, Look, Reading
from luxel.scene.device import Scene


class GibsInspector(Inspector):
    """Shows what `gibs` keeps."""

    item: ClassVar[str] = "surfel"
    looks: ClassVar[tuple[Look, ...]] = GIBS_LOOKS

    def explain(self, scene: Scene, state: GibsState, surface: Surface) -> list[Contribution]:
        return explain_point(state, surface)

    def read(self, scene: Scene, state: GibsState, surface: Surface, look: str) -> Reading:
        return read_surfels(state, surface, look)

    def views(self, scene: Scene, state: GibsState) -> dict[str, CacheView]:
        return surfel_views(state)
