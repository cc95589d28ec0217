"""What a frame costs: stage bars, rays, cache, memory, recordings."""

from __future__ import annotations

from html import escape
from typing import Any

from luxel.viewer.connection import Connection
from luxel.viewer.stats import Facts

BAR_COLOR = "#f0aa3c"


class StatsPanel:
    """Bars in milliseconds of device time, and a table of figures."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection
        self._texts: dict[str, str] = {}

    def build(self) -> None:
        """Add the controls to the page."""
        gui, connection = self.connection.gui, self.connection
        with gui.add_folder("Cost of a frame"):
            watch = gui.add_checkbox(
                "Time the stages", False, hint="Every few seconds at rest one frame runs stage by stage."
            )
            connection.on_change(watch, self._watch)
            self._bars = gui.add_html("")
            self._table = gui.add_html("")

    def refresh(self, facts: Facts) -> None:
        """Show `facts`, which may have changed elsewhere."""
        pass

    def tick(self) -> None:
        stats = self.connection.session.stats
        self._write(self._bars, "bars", draw_bars(stats.stages) if self.connection.visitor.watches_stages else "")
        self._write(self._table, "table", draw_table(self._rows()))

    def _rows(self) -> list[tuple[str, str]]:
        stats, visitor = self.connection.session.stats, self.connection.visitor
        answers = sorted(visitor.answers_ms)
        drag = f"{answers[len(answers) // 2]:.0f} ms" if answers else "–"
        rows = [
            ("frame", f"{stats.frame_ms:.1f} ms · {stats.frames_a_second:.0f} a second"),
            ("answer to a drag", f"{drag} · 1 pixel in {visitor.stride_controller.stride**2}"),
            *((f"rays, {kind}", f"{count:,} a frame") for kind, count in stats.rays.items()),
            *((name.replace("_", " "), _number(value)) for name, value in stats.cache.items()),
            ("memory", f"{stats.memory_mb:,.0f} MB"),
            ("recordings", f"{stats.recordings}"),
            ("visitors", f"{stats.visitors}"),
        ]
        return [*rows, *(("note", warning) for warning in stats.warnings)]

    def _watch(self, value: bool) -> None:
        self.connection.visitor.watches_stages = bool(value)

    def _write(self, handle: Any, name: str, text: str) -> None:
        if self._texts.get(name) != text:
            self._texts[name] = text
            handle.content = text


def draw_bars(stages: dict[str, float]) -> str:
    """Return HTML bars of stage -> milliseconds, the widest for the dearest."""
    if not stages:
        return '<div style="padding: 0.2em 0.8em; font-size: 0.8em; opacity: 0.65">At rest, in a moment.</div>'
    most, total = max(max(stages.values()), 1e-9), sum(stages.values())
    rows = "".join(
        '<div style="display: flex; align-items: center; gap: 0.5em; height: 1.35em">'
        f'<span style="width: 8em; overflow: hidden; text-overflow: ellipsis">{escape(name)}</span>'
        '<span style="flex: 1"><span style="display: block; height: 0.6em; border-radius: 0.2em; '
        f'background: {BAR_COLOR}; width: {max(100.0 * ms / most, 0.5):.1f}%"></span></span>'
        f'<span style="width: 5.2em; text-align: right; white-space: nowrap">{ms:.2f} ms</span></div>'
        for name, ms in stages.items()
    )
    sum_row = f'<div style="text-align: right; opacity: 0.65">together {total:.2f} ms</div>'
    return f'<div style="padding: 0 0.8em; font-size: 0.8em; font-variant-numeric: tabular-nums">{rows}{sum_row}</div>'


def draw_table(rows: list[tuple[str, str]]) -> str:
    """Return an HTML table of two columns."""
    lines = "".join(
        f'<tr><td style="opacity: 0.65; padding-right: 0.8em; vertical-align: top">{escape(name)}</td>'
        f'<td style="text-align: right">{escape(text)}</td></tr>'
        for name, text in rows
    )
    return (
        '<div style="padding: 0.2em 0.8em"><table style="width: 100%; font-size: 0.8em; '
        f'font-variant-numeric: tabular-nums">{lines}</table></div>'
    )


def _number(value: int | float) -> str:
    return f"{value:,}" if isinstance(value, int) else f"{value:,.4g}"
