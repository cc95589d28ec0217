"""Click a pixel: what lights it, in words, as a list, and drawn in the scene."""

from __future__ import annotations

from html import escape
from typing import Any

import numpy as np
from viser import Icon, SceneClickEvent

from luxel.methods.base import Contribution
from luxel.render.explain import Explanation, explain_pixel
from luxel.viewer.deep import shot_of
from luxel.viewer.desk import QUIET, Desk
from luxel.viewer.stats import Facts
from luxel.viewer.visitor import Visitor
from luxel.viewer.world import World

SHOWN = 12
"""Cache items in the list."""
DRAWN = 64
"""Cache items drawn in the scene."""
ANSWERED, SILENT, POINT = (240, 170, 60), (150, 90, 90), (90, 200, 250)
INVITATION = "*Click on the picture: what lights that point, and why the others do not.*"


class ExplainPanel:
    """The words, the surface, the items; markers in the scene."""

    def __init__(self, desk: Desk) -> None:
        self.desk = desk
        self._markers: list[Any] = []

    def build(self) -> None:
        gui, desk = self.desk.gui, self.desk
        with gui.add_folder("Why is it lit so?"):
            self._words = gui.add_markdown(INVITATION)
            self._table = gui.add_html("")
            clear = gui.add_button("Clear markers", icon=Icon.X, visible=False, color=QUIET)
            self._clear = clear
            desk.on_press(clear, self._wipe)

        @desk.client.scene.on_click()
        def _(event: SceneClickEvent) -> None:
            x, y = (float(part) for part in event.screen_pos)
            desk.post(lambda world, visitor: self._ask(world, visitor, x, y), "explain")

    def refresh(self, facts: Facts) -> None:
        pass

    def tick(self) -> None:
        pass

    def _ask(self, world: World, visitor: Visitor, x: float, y: float) -> None:
        """On the render thread: explain the point (x, y in 0..1) of the picture in use."""
        mosaic = visitor.mosaic(world.main)
        if mosaic is None:
            return
        shot = shot_of(mosaic, visitor.shown_exposure)
        column = min(int(x * shot.film.width), shot.film.width - 1)
        row = min(int(y * shot.film.height), shot.film.height - 1)
        found = explain_pixel(shot, column, row)
        self.desk.run(self._show, found)

    def _show(self, found: Explanation) -> None:
        first, *others = found.words or ("Nothing is known of this pixel.",)
        self._words.content = f"**{first}**" + (f"\n\n{' '.join(others)}" if others else "")
        self._table.content = draw_facts(found) + draw_items(found)
        self._clear.visible = True
        self._mark(found)

    # ------------------------------------------------------------------ in the scene

    def _mark(self, found: Explanation) -> None:
        self._wipe(words=False)
        if found.position is None:
            return
        scene, facts = self.desk.client.scene, self.desk.facts
        unit = 0.0015 * float(np.linalg.norm(facts.upper - facts.lower))
        point = np.asarray(found.position)
        self._markers.append(scene.add_icosphere("/explain/point", 2.0 * unit, color=POINT, position=tuple(point)))
        placed = [item for item in found.contributions if item.p is not None][:DRAWN]
        if not placed:
            return
        places = np.asarray([item.p for item in placed], np.float32)
        answered = np.asarray([item.weight > 0.0 for item in placed])
        colors = np.where(answered[:, None], np.asarray(ANSWERED), np.asarray(SILENT)).astype(np.uint8)
        self._markers.append(
            scene.add_point_cloud("/explain/items", places, colors, point_size=2.0 * unit, point_shape="circle")
        )
        if answered.any():
            ends = np.stack([np.broadcast_to(point, places.shape), places], axis=1).astype(np.float32)[answered]
            self._markers.append(
                scene.add_line_segments(
                    "/explain/lines", ends, np.asarray(ANSWERED, np.uint8), thickness=1.5, thickness_units="screen"
                )
            )

    def _wipe(self, words: bool = True) -> None:
        for marker in self._markers:
            marker.remove()
        self._markers = []
        if words:
            self._words.content, self._table.content = INVITATION, ""
            self._clear.visible = False


def draw_facts(found: Explanation) -> str:
    """Return an HTML table of what is known of the pixel."""
    rows = [("pixel", f"{found.pixel[0]}, {found.pixel[1]}")]
    if found.hit and found.position is not None and found.normal is not None:
        rows += [
            ("object", " / ".join(name for name in (found.object_name, found.material_name) if name)),
            ("place", _three(found.position, "m")),
            ("normal", _three(found.normal)),
            ("albedo", _three(found.albedo)),
            ("direct E", _three(found.direct, "W/m²")),
            ("indirect E", _three(found.indirect, "W/m²")),
        ]
        if found.paths is not None:
            rows.append(("paths find", _three(found.paths.indirect, "W/m²")))
        rows.append(("coverage", f"{found.weight:.3g}"))
    lines = "".join(
        f'<tr><td style="opacity: 0.65; padding-right: 0.8em">{name}</td>'
        f'<td style="text-align: right">{escape(text)}</td></tr>'
        for name, text in rows
    )
    return (
        '<div style="padding: 0 0.8em"><table style="width: 100%; font-size: 0.8em; '
        f'font-variant-numeric: tabular-nums">{lines}</table></div>'
    )


def draw_items(found: Explanation) -> str:
    """Return the cache items that were asked as an HTML list, heaviest first, with why others gave nothing."""
    if not found.contributions:
        return ""
    rows = "".join(_item_row(found.item, item) for item in found.contributions[:SHOWN])
    rest = len(found.contributions) - SHOWN
    more = f'<div style="opacity: 0.65">and {rest} more</div>' if rest > 0 else ""
    return f'<div style="font-size: 0.8em; padding: 0.5em 1em 0.3em">{rows}{more}</div>'


def _item_row(kind: str, item: Contribution) -> str:
    bar = (
        f'<span style="display: inline-block; vertical-align: middle; height: 0.55em; '
        f'width: {3.0 * item.weight:.2f}em; background: rgb{ANSWERED}; border-radius: 0.15em"></span>'
    )
    share = f"{100.0 * item.weight:.0f} %" if item.weight > 0.0 else "–"
    return (
        f'<div style="display: flex; gap: 0.5em"><span style="width: 7em">{escape(kind)} {item.item}</span>'
        f'<span style="width: 3em; text-align: right">{share}</span><span style="width: 3.2em">{bar}</span>'
        f'<span style="flex: 1; opacity: 0.65">{escape(item.reason)}</span></div>'
    )


def _three(values: tuple[float, float, float], unit: str = "") -> str:
    return "  ".join(f"{value:.3g}" for value in values) + (f" {unit}" if unit else "")
