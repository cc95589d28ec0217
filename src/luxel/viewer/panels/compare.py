"""Side by side: the method in use and another one, or the truth."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from luxel.viewer.compare import ERROR_LEGEND, TRUTH_METHOD
from luxel.viewer.connection import Connection, put, put_visible
from luxel.viewer.host_looks import LEGEND_WIDTH, legend_strip
from luxel.viewer.stats import Facts
from luxel.viewer.visitor import Visitor
from luxel.viewer.world import list_methods

NOTHING = "nothing"
TRUTH = "truth (path traced)"
NAMES = {
    "regional": ("regional error", "RMSE of indirect light over blocks of 16 × 16 pixels, over the truth's mean"),
    "bias": ("bias", "mean indirect light over the truth's, minus one"),
    "rmse_tonemapped": ("RMSE, tone-mapped", "of indirect light after c / (1 + max c)"),
    "abs_error_mean": ("displayed difference", "summed over the channels, 0 to 3"),
}


class ComparePanel:
    """Rival, split, error map, figures."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection
        self._text = ""

    def build(self) -> None:
        """Add the controls to the page."""
        gui, connection = self.connection.gui, self.connection
        with gui.add_folder("Compare", expand_by_default=False):
            self._rival = gui.add_dropdown(
                "With", self._options(), hint="Shown on the right. The truth gathers samples while the camera rests."
            )
            connection.on_change(self._rival, self._choose)
            self._split = gui.add_slider("Split", 0.0, 1.0, 0.005, 0.5, hint="Where left gives way to right.")
            connection.on_change(self._split, lambda value: self._change("split", split=float(value)))
            self._map = gui.add_checkbox("Error map", False, hint="The right side shows how far apart the two are.")
            connection.on_change(self._map, lambda value: self._change(None, shows_map=bool(value)))
            self._strip = gui.add_image(legend_strip(ERROR_LEGEND, LEGEND_WIDTH), format="png", visible=False)
            self._figures = gui.add_html("")

    def refresh(self, facts: Facts) -> None:
        """Show `facts`, which may have changed elsewhere."""
        options = self._options()
        if options != tuple(self._rival.options):
            kept = self._rival.value if self._rival.value in options else NOTHING
            self._rival.options = options
            put(self._rival, kept)
            self._choose(kept)

    def tick(self) -> None:
        comparison = self.connection.visitor.comparison
        put_visible(self._strip, comparison.shows_map and comparison.rival is not None)
        text = self._write()
        if text != self._text:
            self._text = text
            self._figures.content = text

    def _options(self) -> tuple[str, ...]:
        used = self.connection.facts.choice.method
        others = [name for name in list_methods() if name not in (TRUTH_METHOD, used)]
        return (NOTHING, *(() if used == TRUTH_METHOD else (TRUTH,)), *others)

    def _choose(self, name: str) -> None:
        rival = {NOTHING: None, TRUTH: TRUTH_METHOD}.get(name, name)
        self._change(None, rival=rival)

    def _change(self, key: str | None, **changes: Any) -> None:
        def apply(world: Any, visitor: Visitor) -> None:
            visitor.comparison = replace(visitor.comparison, **changes)

        self.connection.post(apply, key)

    def _write(self) -> str:
        visitor = self.connection.visitor
        if visitor.comparison.rival is None:
            return ""
        figures = dict(visitor.figures)
        if not figures:
            return _note("The figures come once the camera rests and both pictures are whole.")
        samples = int(figures.pop("samples", 0))
        rows = "".join(
            f'<tr title="{NAMES[name][1]}"><td>{NAMES[name][0]}</td>'
            f'<td style="text-align: right; font-variant-numeric: tabular-nums">{_figure(name, value)}</td></tr>'
            for name, value in figures.items()
        )
        against = "the truth" if visitor.comparison.rival == TRUTH_METHOD else visitor.comparison.rival
        table = f'<table style="width: 100%; font-size: 0.85em">{rows}</table>'
        more = f"Against {against}, {samples} sample{'s' if samples != 1 else ''} a pixel so far."
        return f'<div style="padding: 0 0.6em">{table}</div>' + _note(more)


def _note(text: str) -> str:
    return f'<div style="padding: 0.2em 0.8em; font-size: 0.8em; opacity: 0.65">{text}</div>'


def _figure(name: str, value: float) -> str:
    """Return a figure as shown; a dash where it has no value, as beside a picture without indirect light."""
    if not math.isfinite(value):
        return "–"
    return f"{value:+.3f}" if name == "bias" else f"{value:.4f}"
