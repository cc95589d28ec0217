"""The viewer's face: a viser server that gives each visitor a picture and a panel of controls.

For each visitor one thread takes the newest picture from the mailbox, encodes and sends it, and keeps the controls
fresh.
"""

from __future__ import annotations

import contextlib
import io
import math
import socket
import threading
import time as clock
import traceback
import warnings
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import viser

from luxel.errors import LuxelError
from luxel.scene.model import Camera
from luxel.viewer import cameras
from luxel.viewer.connection import Connection
from luxel.viewer.panels import Panels, build_panels
from luxel.viewer.session import Session
from luxel.viewer.visitor import DisplayFrame, Visitor

DEFAULT_PORT = 8080
PORT_TRIES = 20
"""Ports tried from the default one upwards where none was asked for."""
JPEG_QUALITY = {True: 75, False: 90}
"""While the camera turns, and at rest."""
TICK_SECONDS = 0.25
"""Between two renewals of the controls."""
LINE_SECONDS = 1.0
"""A picture waits so long at most for the one before to be sent; then it takes its place."""
REST_SECONDS = 0.1
"""Between two pictures at rest, where little changes from one to the next."""
NUDGE_SECONDS = (0.5, 1.5, 4.0)
"""After a visitor has come, the browser is asked again for the size of its canvas, which docks its panels meanwhile."""
BRAND = (240, 170, 60)
PANEL_WIDTH = 380


@dataclass
class _ServingState:
    """What a visitor's thread keeps from round to round."""

    start: float
    structure: int
    ticked: float = 0.0
    calm: float = 0.0
    nudges: list[float] = field(default_factory=lambda: list(NUDGE_SECONDS))


class App:
    """A session served to browsers."""

    def __init__(self, session: Session, *, host: str = "127.0.0.1", port: int | None = None) -> None:
        """Serve `session`, which runs, at `host`; `port` None takes the first free one from 8080.

        Raises LuxelError where the place is taken.
        """
        self.session = session
        self.host = host
        place = find_port(host, port)
        # A browser may leave between two messages of a panel; viser would warn of the second on standard error.
        warnings.filterwarnings("ignore", message="Queued a .* on a closed connection")
        # viser greets and takes leave on standard output, which is for results.
        with contextlib.redirect_stdout(io.StringIO()):
            self.server = viser.ViserServer(host=host, port=place, label="luxel", verbose=False)
        self.port = self.server.get_port()
        self._connections: dict[int, tuple[Connection, threading.Event]] = {}
        self._dress()
        self.server.on_client_connect(self._welcome)
        self.server.on_client_disconnect(self._part)

    @property
    def url(self) -> str:
        """Where a browser on this machine finds it."""
        name = "localhost" if self.host in ("127.0.0.1", "0.0.0.0", "::") else self.host
        return f"http://[{name}]:{self.port}" if ":" in name else f"http://{name}:{self.port}"

    def stop(self) -> None:
        """Stop serving; returns within about a second."""
        for _, gone in list(self._connections.values()):
            gone.set()
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()

    # ------------------------------------------------------------------ visitors

    def _dress(self) -> None:
        """Set the theme, the up direction and the first view."""
        server, camera = self.server, self.session.camera
        server.gui.configure_theme(
            dark_mode=True, show_logo=False, show_share_button=False, brand_color=BRAND, control_width="large"
        )
        server.gui.main_panel.dock_right()
        server.gui.main_panel.set_width(PANEL_WIDTH)
        server.scene.set_up_direction("+y")
        server.scene.world_axes.visible = False
        # Markers keep the colours that looks have: light from everywhere, of the strength that three.js calls pi.
        server.scene.configure_default_lights(enabled=False)
        server.scene.configure_environment_map(hdri=None)
        server.scene.add_light_ambient("/light", intensity=math.pi)
        position, look_at, up = cameras.look_of_camera(camera, 0.0, self._reach())
        start = server.initial_camera
        origin = self.session.facts.origin
        start.position, start.look_at, start.up = tuple(position - origin), tuple(look_at - origin), tuple(up)
        start.fov = cameras.vertical_fov_in_window(camera.fov, self.session.size[0] / self.session.size[1])
        start.near = 1e-3 * self._reach()
        start.far = 1e3 * self._reach()

    def _reach(self) -> float:
        """Return the distance at which a camera without a target is taken to look: half the scene's size."""
        facts = self.session.facts
        return max(0.5 * float(((facts.upper - facts.lower) ** 2).sum() ** 0.5), 1e-3)

    def _welcome(self, client: viser.ClientHandle) -> None:
        visitor = self.session.join()
        connection, gone = Connection(client, self.session, visitor), threading.Event()
        self._connections[client.client_id] = connection, gone
        connection.go_to(self.session.camera)
        follow_camera(connection)
        panels = build_panels(connection)
        threading.Thread(target=self._serve, args=(connection, gone, panels), name="luxel-serve", daemon=True).start()

        @client.camera.on_update
        async def _(_: Any) -> None:
            follow_camera(connection)

    def _part(self, client: viser.ClientHandle) -> None:
        connection, gone = self._connections.pop(client.client_id, (None, None))
        if connection is not None and gone is not None:
            gone.set()
            self.session.leave(connection.visitor)

    # ------------------------------------------------------------------ one visitor's thread

    def _serve(self, connection: Connection, gone: threading.Event, panels: Panels) -> None:
        """Send pictures and keep the controls fresh until the visitor leaves; a fault is told and costs one round."""
        turn = _ServingState(clock.perf_counter(), connection.facts.structure)
        while not gone.wait(0.0 if not connection.is_gone else TICK_SECONDS) and self.session.running:
            try:
                self._serve_once(connection, gone, panels, turn)
            except Exception:
                if not connection.is_gone and not gone.wait(TICK_SECONDS):
                    self.session.faults.append(traceback.format_exc())

    def _serve_once(self, connection: Connection, gone: threading.Event, panels: Panels, turn: _ServingState) -> None:
        frame = connection.visitor.mailbox.take(TICK_SECONDS, turn.calm)
        if frame is not None and not gone.is_set():
            send_frame(connection, frame)
            turn.calm = 0.0 if frame.moving else REST_SECONDS
        if connection.is_gone:
            return
        refused, facts = self._pass_notices(connection), connection.facts
        if refused or facts.structure != turn.structure:
            turn.structure = facts.structure
            panels.refresh(facts)
        now = clock.perf_counter()
        if now - turn.ticked > TICK_SECONDS:
            turn.ticked = now
            panels.tick()
        if turn.nudges and now - turn.start > turn.nudges[0]:
            turn.nudges.pop(0)
            connection.ask_for_camera()

    def _pass_notices(self, connection: Connection) -> bool:
        """Show what the session has to say; return whether something was refused."""
        refused, notices = False, connection.visitor.notices
        while notices:
            kind, sentence = notices.popleft()
            refused |= kind == "error"
            connection.notify(kind, sentence)
        return refused


def send_frame(connection: Connection, frame: DisplayFrame) -> None:
    """Encode a picture and hand it to the browser's connection, once that has sent the one before."""
    end = clock.perf_counter() + LINE_SECONDS
    while connection.waits_for_line() and clock.perf_counter() < end:
        clock.sleep(0.002)
    if connection.is_gone:
        return
    connection.client.scene.set_background_image(frame.pixels, format="jpeg", jpeg_quality=JPEG_QUALITY[frame.moving])
    connection.client.flush()
    if frame.asked is not None:
        connection.visitor.answers_ms.append(1e3 * (clock.perf_counter() - frame.asked))


def follow_camera(connection: Connection) -> None:
    """Tell the session where the browser's camera is and how large its window is."""
    browser, asked = connection.client.camera, clock.perf_counter()
    width, height = int(browser.image_width), int(browser.image_height)
    if width < 1 or height < 1:
        return
    reach = float(((browser.look_at - browser.position) ** 2).sum() ** 0.5)
    position = np.asarray(browser.position, np.float64) + connection.facts.origin
    camera: Camera = cameras.camera_from_pose(browser.wxyz, position, browser.fov, width / height, reach)

    def move(world: Any, visitor: Visitor) -> None:
        visitor.resize((width, height))
        visitor.turn(camera, asked)

    connection.post(move, key="camera")


def find_port(host: str, port: int | None) -> int:
    """Return a free port: `port`, or from 8080 upwards. Raises LuxelError where it is taken, or `host` is not ours."""
    wanted = [port] if port is not None else list(range(DEFAULT_PORT, DEFAULT_PORT + PORT_TRIES))
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    reason = ""
    for number in wanted:
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((host, number))
                return probe.getsockname()[1]
            except (OSError, OverflowError) as error:
                reason = getattr(error, "strerror", None) or str(error)
    place = f"{wanted[0]}" if len(wanted) == 1 else f"{wanted[0]} to {wanted[-1]}"
    raise LuxelError(f"cannot listen on {host}, port {place}: {reason.lower()}; choose others with --host and --port")
