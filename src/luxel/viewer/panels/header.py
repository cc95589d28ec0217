"""The head of the panel: scene, method, and how it runs, in two lines."""

from __future__ import annotations

from html import escape

from luxel.viewer.connection import Connection
from luxel.viewer.stats import Facts

KEYS = """
if (!document.body.dataset.luxelKeys) {
  document.body.dataset.luxelKeys = 'kept';
  const moves = /^(Key[WASDQE]|Arrow(Up|Down|Left|Right))$/;
  document.body.addEventListener('keydown', event => {
    if (moves.test(event.code) && event.target.closest('button, a, [role], [tabindex]')) event.stopPropagation();
  });
}
"""
"""Run once by the browser. viser moves the camera by keys that reach the document, unless text is being typed; a
slider, list or tab that has the focus needs them for itself. Controls listen below the body, so they have had the key
by then."""
PIXEL = "data:image/gif;base64,R0lGODlhAQABAAAAACwAAAAAAQABAAA="
MUTED = "color: var(--mantine-color-dimmed, #8a9099)"


class HeaderPanel:
    """Scene and method in large letters, then size, speed and device."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection
        self._text = ""

    def build(self) -> None:
        """Add the controls to the page."""
        self._text = self._write()
        self._html = self.connection.gui.add_html(self._text)
        # Scripts in such HTML do not run, but what follows the loading of an image does.
        self.connection.gui.add_html(f'<img src="{PIXEL}" style="display: none" onload="{escape(KEYS)}">')

    def refresh(self, facts: Facts) -> None:
        """Show `facts`, which may have changed elsewhere."""
        self.tick()

    def tick(self) -> None:
        text = self._write()
        if text != self._text:
            self._text = text
            self._html.content = text

    def _write(self) -> str:
        facts, stats, visitor = self.connection.facts, self.connection.session.stats, self.connection.visitor
        width, height = visitor.size
        state = "turning" if visitor.is_moving else "sharp" if visitor.is_sharp else "sharpening"
        line = " · ".join(
            [
                f"{width}×{height}",
                state,
                f"{stats.frames_a_second:.0f} frames/s",
                "GPU" if stats.device == "cuda" else "CPU",
            ]
        )
        frozen = ' <span style="color:#6cc5e8">frozen</span>' if facts.frozen else ""
        return (
            '<div style="padding: 0.5em 0.9em 0.7em; line-height: 1.35">'
            f'<div style="font-size: 1.15em; font-weight: 650">{escape(facts.name)}'
            f'<span style="{MUTED}; font-weight: 400"> lit by </span>{escape(facts.choice.method)}{frozen}</div>'
            f'<div style="font-size: 0.82em; {MUTED}; font-variant-numeric: tabular-nums">{line}</div></div>'
        )
