"""Looks into the cache of `lightmap`: why a point is lit so, what can be drawn of it, what it holds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from luxel.kernels.records import Surface
from luxel.methods.inspect import CacheView, Contribution, Discs, Inspector, Look, Reading, Sources
from luxel.methods.lightmap.inspect.clusters import read_discs, read_sources
from luxel.methods.lightmap.inspect.explain import explain_point
from luxel.methods.lightmap.inspect.looks import LIGHTMAP_LOOKS, read_look
from luxel.methods.lightmap.inspect.views import lightmap_views
from luxel.methods.lightmap.run.state import LightmapState
from luxel.scene.device import Scene


class LightmapInspector(Inspector):
    """Shows what `lightmap` keeps."""

    item: ClassVar[str] = "cluster"
    looks: ClassVar[tuple[Look, ...]] = LIGHTMAP_LOOKS

    def explain(self, scene: Scene, state: LightmapState, surface: Surface) -> list[Contribution]:
        return explain_point(scene, state, surface)

    def read(self, scene: Scene, state: LightmapState, surface: Surface, look: str) -> Reading:
        return read_look(state, surface, look)

    def sources(self, scene: Scene, state: LightmapState, point: Surface, surface: Surface) -> Sources:
        return read_sources(state, point, surface)

    def discs(self, scene: Scene, state: LightmapState, point: Surface) -> Discs | None:
        return read_discs(scene, state, point)

    def views(self, scene: Scene, state: LightmapState) -> Mapping[str, CacheView]:
        return lightmap_views(state)
