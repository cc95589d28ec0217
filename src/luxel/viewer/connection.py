"""What every panel works with: one visitor's browser on one side, the session on the other."""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from viser import ClientHandle, GuiApi, GuiDropdownHandle

from luxel.scene.model import Camera
from luxel.viewer import cameras
from luxel.viewer.session import Request, Session
from luxel.viewer.stats import Facts
from luxel.viewer.visitor import Visitor

NUDGE = 1e-4
QUIET = (68, 72, 78)
"""Colour of buttons that are not the first thing to press."""


class Connection:
    """One visitor's place: browser, session, and the way from one to the other."""

    def __init__(self, client: ClientHandle, session: Session, visitor: Visitor) -> None:
        self.client = client
        self.session = session
        self.visitor = visitor
        # viser has no public way to ask what a connection still has to send.
        self._line: Any = client._websock_connection.get_message_buffer()

    @property
    def gui(self) -> GuiApi:
        """The controls of this visitor's browser."""
        return self.client.gui

    @property
    def facts(self) -> Facts:
        """The world as it was published last."""
        return self.session.facts

    @property
    def is_gone(self) -> bool:
        """Whether the browser has left; viser tells so only later, and warns of what is sent meanwhile."""
        return bool(self._line.done)

    def waits_for_line(self) -> bool:
        """Return whether a picture is still waiting to be sent."""
        with self._line.buffer_lock:
            waiting = list(self._line.message_from_id.values())
        return any(type(message).__name__ == "BackgroundImageMessage" for message in waiting)

    def post(self, request: Request, key: str | None = None) -> None:
        """Leave a request; one with the same key that still waits is dropped."""
        self.session.post(self.visitor, request, key)

    def show(self, **changes: Any) -> None:
        """Change what this visitor is shown; leaves the world alone."""
        self.post(lambda world, visitor: visitor.show(**changes))

    @property
    def aspect(self) -> float:
        """Width over height of the visitor's window."""
        browser = self.client.camera
        return browser.image_width / max(browser.image_height, 1)

    def go_to(self, camera: Camera) -> None:
        """Move the browser's camera to one of ours; the picture follows as it does a drag."""
        facts, browser = self.facts, self.client.camera
        reach = 0.5 * float(np.linalg.norm(facts.upper - facts.lower))
        position, look_at, up = cameras.look_of_camera(camera, self.session.stats.now, reach)
        with self.client.atomic():
            browser.up_direction = up
            browser.position = position - facts.origin
            browser.look_at = look_at - facts.origin
            browser.fov = cameras.vertical_fov_in_window(camera.fov, self.aspect)

    def ask_for_camera(self) -> None:
        """Have the browser tell its camera and the size of its canvas again.

        While its panels dock, it reports the canvas as it was, and then says nothing until the camera moves. Only a new
        angle makes it speak: this one differs by far less than a pixel.
        """
        browser = self.client.camera
        browser.fov = browser.fov * (1.0 + NUDGE)

    def run(self, work: Callable[..., None], *values: Any) -> None:
        """Do something slow for the browser on a thread of its own; a fault is told, not lost."""

        def do() -> None:
            try:
                work(*values)
            except Exception as error:
                if not self.is_gone:
                    self.session.faults.append(traceback.format_exc())
                    self.visitor.notify("error", f"{type(error).__name__}: {error}")

        threading.Thread(target=do, name="luxel-connection", daemon=True).start()

    def add_list(self, label: str, options: tuple[str, ...], hint: str) -> GuiDropdownHandle[str]:
        """Add a list to choose from; its options may change later."""
        return self.gui.add_dropdown(label, options, hint=hint)

    def on_change(self, handle: Any, act: Callable[[Any], None]) -> None:
        """Call `act` with the new value where the visitor, not the program, has changed a control."""

        # Asynchronous callbacks run one after another; viser would run plain ones on several threads at once.
        @handle.on_update
        async def _(event: Any) -> None:
            if event.client is not None:
                act(handle.value)

    def on_press(self, handle: Any, act: Callable[[], None]) -> None:
        """Call `act` where a button is pressed."""

        @handle.on_click
        async def _(event: Any) -> None:
            act()

    def notify(self, kind: str, sentence: str) -> None:
        """Show a sentence in the corner of the visitor's window."""
        title, color = ("That did not work", "red") if kind == "error" else ("luxel", "teal")
        self.client.add_notification(title, sentence, auto_close_seconds=8.0 if kind == "error" else 5.0, color=color)


class Panel(Protocol):
    """A group of controls. `build` once; `refresh` where the world's controls have changed; `tick` now and then."""

    def build(self) -> None:
        """Add the controls at the present place of the visitor's panel."""

    def refresh(self, facts: Facts) -> None:
        """Show the world's values: another visitor may have changed them, or a change was refused."""

    def tick(self) -> None:
        """Renew figures."""


def put(handle: Any, value: Any) -> None:
    """Set a control without minding that it is already there or gone."""
    if handle is not None and handle.value != value:
        handle.value = value


def put_visible(handle: Any, visible: bool) -> None:
    """Show or hide a control or a node; what is so already is not sent again."""
    if handle.visible != visible:
        handle.visible = visible
