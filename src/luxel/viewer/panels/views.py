"""What is shown: the image, its parts, the surfaces, the cache; and how bright."""

from __future__ import annotations

from luxel.viewer.connection import Connection, put
from luxel.viewer.host_looks import LEGEND_WIDTH, legend_strip, looks_of, uninspected
from luxel.viewer.stats import Facts

IMAGE_DOC = "the image"
"""What needs no words."""
STOPS = 5.0
"""Exposure goes so many stops up and down."""


class ViewsPanel:
    """The look, its legend, exposure."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection
        self._legend: object | None = None

    def build(self) -> None:
        """Add the controls to the page."""
        gui, connection = self.connection.gui, self.connection
        with gui.add_folder("Picture"):
            docs = looks_of(connection.facts.choice.method)
            self._look = gui.add_dropdown(
                "Show", tuple(docs), initial_value="image", hint="The image, its parts, or what the method keeps."
            )
            connection.on_change(self._look, self._choose)
            self._doc = gui.add_markdown("", visible=False)
            self._strip = gui.add_image(legend_strip_or_blank(None), format="png", visible=False)
            self._auto = gui.add_checkbox(
                "Auto exposure", True, hint="Shows lit surfaces at middle grey, as `luxel render` does."
            )
            connection.on_change(self._auto, lambda value: connection.show(auto_exposure=bool(value)))
            self._bias = gui.add_slider(
                "Exposure",
                -STOPS,
                STOPS,
                0.1,
                0.0,
                hint="Stops: each one doubles or halves what is shown, not the light.",
            )
            connection.on_change(self._bias, lambda value: connection.show(bias_stops=float(value)))

    def refresh(self, facts: Facts) -> None:
        """Show `facts`, which may have changed elsewhere."""
        docs = looks_of(facts.choice.method)
        if tuple(docs) != tuple(self._look.options):
            kept = self._look.value if self._look.value in docs else "image"
            self._look.options = tuple(docs)
            put(self._look, kept)
            self._choose(kept)

    def tick(self) -> None:
        host_look = self.connection.visitor.host_look
        legend = None if host_look is None else host_look.legend
        if legend is not None and legend.scale is None and not legend.entries:
            legend = None  # only a title, which stands above already
        if legend != self._legend:
            self._legend = legend
            if legend is not None:
                self._strip.image = legend_strip_or_blank(legend)
            self._strip.visible = legend is not None

    def _choose(self, look: str) -> None:
        method = self.connection.facts.choice.method
        words = _in_words(looks_of(method).get(look, "")) or _in_words(uninspected(method))
        self._doc.content, self._doc.visible = words, bool(words)
        self.connection.show(look=look)


def legend_strip_or_blank(legend):  # noqa: ANN001, ANN201
    """Return a legend as a picture, or one dark pixel."""
    import numpy as np

    return np.zeros((1, 1, 3), np.uint8) if legend is None else legend_strip(legend, LEGEND_WIDTH)


def _in_words(doc: str) -> str:
    return f"*{doc[:1].upper()}{doc[1:]}.*" if doc and doc != IMAGE_DOC else ""
