"""The controls beside the picture, one file a panel: what is seen, the method, the light, the scene, the inside."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from contextlib import contextmanager

from viser import Icon, IconName

from luxel.viewer.connection import Connection, Panel
from luxel.viewer.panels.camera import CameraPanel
from luxel.viewer.panels.compare import ComparePanel
from luxel.viewer.panels.explain import ExplainPanel
from luxel.viewer.panels.header import HeaderPanel
from luxel.viewer.panels.light import LightPanel
from luxel.viewer.panels.method import MethodPanel
from luxel.viewer.panels.objects import ObjectsPanel
from luxel.viewer.panels.share import SharePanel
from luxel.viewer.panels.stats import StatsPanel
from luxel.viewer.panels.time import TimePanel
from luxel.viewer.panels.views import ViewsPanel
from luxel.viewer.stats import Facts

TABS: tuple[tuple[str, IconName, tuple[type, ...]], ...] = (
    ("See", Icon.EYE, (ViewsPanel, ComparePanel, CameraPanel, SharePanel)),
    ("Method", Icon.ADJUSTMENTS_HORIZONTAL, (MethodPanel,)),
    ("Light", Icon.SUN, (LightPanel,)),
    ("Scene", Icon.CUBE, (ObjectsPanel, TimePanel)),
    ("Inside", Icon.SEARCH, (ExplainPanel, StatsPanel)),
)
"""Label, icon, panels."""


class Panels:
    """All panels of one visitor."""

    def __init__(self, panels: list[Panel]) -> None:
        self._panels = panels

    def refresh(self, facts: Facts) -> None:
        """Let every panel show the world's values."""
        for panel in self._panels:
            with _gone_is_fine():
                panel.refresh(facts)

    def tick(self) -> None:
        """Let every panel renew its figures."""
        for panel in self._panels:
            with _gone_is_fine():
                panel.tick()


def build_panels(connection: Connection) -> Panels:
    """Add all panels to a visitor's window."""
    header = HeaderPanel(connection)
    header.build()
    panels: list[Panel] = [header]
    group = connection.gui.add_tab_group()
    for label, icon, kinds in TABS:
        with group.add_tab(label, icon):
            for kind in kinds:
                panel = kind(connection)
                panel.build()
                panels.append(panel)
    return Panels(panels)


@contextmanager
def _gone_is_fine() -> Iterator[None]:
    """A visitor may leave while a control is being written."""
    with contextlib.suppress(KeyError, RuntimeError):
        yield
