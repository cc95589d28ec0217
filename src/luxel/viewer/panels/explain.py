"""Click a pixel: what lights it, in words, as a list, and drawn in the scene."""

from __future__ import annotations

from html import escape

import numpy as np
from viser import Icon, SceneClickEvent

from luxel.inspect.diagnosis import ANSWERS
from luxel.inspect.explain import explain_pixel
from luxel.inspect.explanation import Explanation, show_place
from luxel.inspect.looks.shot import surface_at_pixel
from luxel.methods.inspect import Contribution, Discs
from luxel.viewer.connection import QUIET, Connection
from luxel.viewer.host_looks import shot_of, shows_a_point
from luxel.viewer.markers import ANSWERED, SILENT, Markers, find_visible, item_color
from luxel.viewer.stats import Facts
from luxel.viewer.visitor import Visitor
from luxel.viewer.world import World

SHOWN = 12
"""Cache items in the list."""
SWATCH = 0.6
"""Width of a bar at least, em, where its colour is that of discs in the scene."""
INVITATION = "*Click on the picture: what lights that point, and why the others do not.*"


class ExplainPanel:
    """The words, the surface, the items; markers in the scene."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection
        facts = connection.facts
        self._markers = Markers(connection.client.scene, float(np.linalg.norm(facts.upper - facts.lower)))
        self._seen_from = (0.0, 0.0, 0.0)
        """Where the eye was when the discs that it sees were found."""

    def build(self) -> None:
        """Add the controls to the page."""
        gui, connection = self.connection.gui, self.connection
        with gui.add_folder("Why is it lit so?"):
            self._words = gui.add_markdown(INVITATION)
            self._table = gui.add_html("")
            clear = gui.add_button("Clear markers", icon=Icon.X, visible=False, color=QUIET)
            self._clear = clear
            connection.on_press(clear, self._wipe)

        @connection.client.scene.on_click()
        def _(event: SceneClickEvent) -> None:
            x, y = (float(part) for part in event.screen_pos)
            connection.post(lambda world, visitor: self._ask(world, visitor, x, y), "explain")

    def refresh(self, facts: Facts) -> None:
        """Show `facts`, which may have changed elsewhere."""
        pass

    def tick(self) -> None:
        # A look of one point draws in the picture what the markers would cover.
        visitor = self.connection.visitor
        self._markers.show(not shows_a_point(self.connection.facts.choice.method, visitor.look))
        eye, discs = visitor.camera.eye, self._markers.discs
        if discs is not None and eye != self._seen_from and not visitor.is_moving:
            self._seen_from = eye
            self.connection.post(lambda world, _: self._look_again(world, eye, discs), "discs")

    def _look_again(self, world: World, eye: tuple[float, float, float], discs: Discs) -> None:
        """On the render thread: show the discs that another place of the eye sees."""
        self.connection.run(self._markers.show_discs, discs, find_visible(world.scene, eye, discs))

    def _ask(self, world: World, visitor: Visitor, x: float, y: float) -> None:
        """On the render thread: explain the point (x, y in 0..1) of the picture in use."""
        interleaved = visitor.interleaved(world.main)
        if interleaved is None:
            return
        shot = shot_of(interleaved, visitor.shown_exposure)
        column = min(int(x * shot.film.width), shot.film.width - 1)
        row = min(int(y * shot.film.height), shot.film.height - 1)
        found, (point, _) = explain_pixel(shot, column, row), surface_at_pixel(shot, column, row)
        visitor.choose_point(world.scene, point)
        inspector = shot.method.inspector if found.hit else None
        discs = None if inspector is None else inspector.discs(shot.scene, shot.state, point)
        self._seen_from = visitor.camera.eye
        visible = None if discs is None else find_visible(shot.scene, self._seen_from, discs)
        self.connection.run(self._show, found, discs, visible)

    def _show(self, found: Explanation, discs: Discs | None, visible: np.ndarray | None) -> None:
        first, *others = found.words or ("Nothing is known of this pixel.",)
        self._words.content = f"**{first}**" + (f"\n\n{' '.join(others)}" if others else "")
        self._table.content = draw_facts(found) + draw_items(found, discs is not None)
        self._clear.visible = True
        self._markers.draw(found, discs, visible, self.connection.facts.origin)

    def _wipe(self) -> None:
        self._markers.clear()
        self._words.content, self._table.content = INVITATION, ""
        self._clear.visible = False


def draw_facts(found: Explanation) -> str:
    """Return an HTML table of what is known of the pixel."""
    rows = [("pixel", f"{found.pixel[0]}, {found.pixel[1]}")]
    if found.hit and found.position is not None and found.normal is not None:
        rows += [
            ("object", " / ".join(name for name in (found.object_name, found.material_name) if name)),
            ("place", f"{show_place(found.position, found.distance)} m"),
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


def draw_items(found: Explanation, colored: bool = False) -> str:
    """Return the cache items that were asked as an HTML list, heaviest first, with why others gave nothing.

    `colored` gives each the colour that it has in the scene.
    """
    if not found.contributions:
        return ""
    rows = "".join(_item_row(found.item, item, colored) for item in found.contributions[:SHOWN])
    rest = len(found.contributions) - SHOWN
    more = f'<div style="opacity: 0.65">and {rest} more</div>' if rest > 0 else ""
    return f'<div style="font-size: 0.8em; padding: 0.5em 1em 0.3em">{rows}{more}</div>'


def _item_row(kind: str, item: Contribution, colored: bool) -> str:
    has_color = colored and item.p is not None
    color = tuple(int(channel) for channel in item_color(item)) if has_color else ANSWERED if item.answers else SILENT
    width = max(3.0 * item.weight, SWATCH if has_color else 0.0)
    bar = (
        f'<span style="display: inline-block; vertical-align: middle; height: 0.55em; '
        f'width: {width:.2f}em; background: rgb{color}; border-radius: 0.15em"></span>'
    )
    share = f"{100.0 * item.weight:.0f} %" if item.answers or item.weight > ANSWERS else "–"
    return (
        f'<div style="display: flex; gap: 0.5em"><span style="width: 7em">{escape(kind)} {item.item}</span>'
        f'<span style="width: 3em; text-align: right">{share}</span><span style="width: 3.2em">{bar}</span>'
        f'<span style="flex: 1; opacity: 0.65">{escape(item.reason)}</span></div>'
    )


def _three(values: tuple[float, float, float], unit: str = "") -> str:
    return "  ".join(f"{value:.3g}" for value in values) + (f" {unit}" if unit else "")
