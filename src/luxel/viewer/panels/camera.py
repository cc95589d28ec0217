"""Where the visitor looks from: the scene's cameras, orbit or fly, the angle."""

from __future__ import annotations

from typing import Any

import numpy as np
from viser import Icon

from luxel.viewer import cameras
from luxel.viewer.connection import QUIET, Connection, put
from luxel.viewer.stats import Facts

NEAR_POINT = 0.01
"""While flying, the point that the mouse turns about is so far ahead, over the scene's size: it turns the head."""


class CameraPanel:
    """Cameras of the file, the way to move, field of view."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection
        self._flies = False

    def build(self) -> None:
        """Add the controls to the page."""
        gui, connection = self.connection.gui, self.connection
        self._by_name = {
            f"{number + 1}  {camera.name}": camera for number, camera in enumerate(connection.session.cameras)
        }
        with gui.add_folder("Camera"):
            names = tuple(self._by_name)
            go = gui.add_dropdown("Go to", names, hint="The scene's own cameras.")
            connection.on_change(go, self._go)
            again = gui.add_button("Back to this view", icon=Icon.FOCUS_2, color=QUIET)
            connection.on_press(again, lambda: self._go(go.value))
            fly = gui.add_checkbox(
                "Fly", False, hint="The mouse turns the head, not the view about its middle. W A S D Q E move in both."
            )
            connection.on_change(fly, lambda value: self._set_flying(bool(value)))
            self._angle = gui.add_slider(
                "View angle °", 10, 130, 1, self._read_angle(), hint="Horizontal field of view, degrees."
            )
            connection.on_change(self._angle, self._set_angle)

        @connection.client.camera.on_update
        async def _(_: Any) -> None:
            if self._flies:
                self._turn_the_head()

    def refresh(self, facts: Facts) -> None:
        """Show `facts`, which may have changed elsewhere."""
        pass

    def tick(self) -> None:
        put(self._angle, self._read_angle())

    def _read_angle(self) -> int:
        angle = cameras.horizontal_fov(self.connection.client.camera.fov, self.connection.aspect)
        return int(np.clip(round(angle), 10, 130))

    def _set_angle(self, degrees: int) -> None:
        self.connection.client.camera.fov = cameras.vertical_fov(float(degrees), self.connection.aspect)

    def _go(self, name: str) -> None:
        self.connection.go_to(self._by_name[name])

    def _set_flying(self, flies: bool) -> None:
        self._flies = flies
        facts, browser = self.connection.facts, self.connection.client.camera
        if self._flies:
            self._turn_the_head()
            return
        # Orbit about what is ahead, at the distance of the scene's middle.
        middle = 0.5 * (facts.lower + facts.upper)
        ahead = browser.look_at - browser.position
        ahead = ahead / max(float(np.linalg.norm(ahead)), 1e-9)
        reach = max(float(np.dot(middle - browser.position, ahead)), 0.1 * float(np.linalg.norm(facts.upper - middle)))
        browser.look_at = browser.position + reach * ahead

    def _turn_the_head(self) -> None:
        facts, browser = self.connection.facts, self.connection.client.camera
        near = NEAR_POINT * float(np.linalg.norm(facts.upper - facts.lower))
        ahead = browser.look_at - browser.position
        distance = float(np.linalg.norm(ahead))
        if distance > 1.5 * near:
            browser.look_at = browser.position + ahead * (near / distance)
