"""The animation: play, pause, step, scrub, speed."""

from __future__ import annotations

from typing import Any

from luxel.viewer.connection import Connection, put
from luxel.viewer.stats import Facts

FRAME_SECONDS = 1.0 / 30.0
"""What one step goes forward or back."""


class TimePanel:
    """Only there where something moves."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection
        self._scrub: Any = None

    def build(self) -> None:
        """Add the controls to the page."""
        gui, connection, facts = self.connection.gui, self.connection, self.connection.facts
        if facts.duration <= 0.0:
            return
        with gui.add_folder("Animation"):
            self._play = gui.add_checkbox("Play", facts.playing, hint="The animation starts over at its end.")
            connection.on_change(self._play, lambda value: connection.post(lambda world, _: world.play(value), "play"))
            self._scrub = gui.add_slider("Time s", 0.0, facts.duration, 0.01, 0.0)
            connection.on_change(self._scrub, lambda value: connection.post(lambda world, _: world.seek(value), "seek"))
            step = gui.add_button_group("Step", ("−1 frame", "+1 frame"), hint="A thirtieth of a second.")
            connection.on_press(step, lambda: self._step(1 if step.value.startswith("+") else -1))
            self._speed = gui.add_slider("Speed ×", 0.1, 4.0, 0.1, 1.0)
            connection.on_change(
                self._speed, lambda value: connection.post(lambda world, _: world.set_speed(value), "speed")
            )

    def refresh(self, facts: Facts) -> None:
        """Show `facts`, which may have changed elsewhere."""
        if self._scrub is not None:
            put(self._play, facts.playing)
            put(self._speed, facts.speed)

    def tick(self) -> None:
        if self._scrub is not None:
            put(self._scrub, round(self.connection.session.stats.now, 2))

    def _step(self, frames: int) -> None:
        def step(world: Any, _: Any) -> None:
            world.play(False)
            world.seek(world.clock.now + frames * FRAME_SECONDS)

        self.connection.post(step)
