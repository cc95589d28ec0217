"""Looks into the cache of `ddgi`: why a point is lit so, what can be drawn of it, what it holds."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar

from luxel.kernels.records import Surface
from luxel.methods.ddgi.explain import explain_point
from luxel.methods.ddgi.export import write_atlases
from luxel.methods.ddgi.looks import DDGI_LOOKS, read_probes_at
from luxel.methods.ddgi.state import DdgiState
from luxel.methods.ddgi.views import probe_views
from luxel.methods.inspect import CacheView, Contribution, Inspector, Look, Reading
from luxel.scene.device import Scene


class DdgiInspector(Inspector):
    """Shows what `ddgi` keeps."""

    item: ClassVar[str] = "probe"
    atlases: ClassVar[bool] = True
    looks: ClassVar[tuple[Look, ...]] = DDGI_LOOKS

    def explain(self, scene: Scene, state: DdgiState, surface: Surface) -> list[Contribution]:
        return explain_point(state, surface)

    def read(self, scene: Scene, state: DdgiState, surface: Surface, look: str) -> Reading:
        return read_probes_at(state, surface, look)

    def views(self, scene: Scene, state: DdgiState) -> Mapping[str, CacheView]:
        return probe_views(state)

    def write_atlases(self, state: DdgiState, folder: str | Path) -> list[Path]:
        return write_atlases(state, folder)
