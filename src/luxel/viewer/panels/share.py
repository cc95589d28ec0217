"""Take the view along: a picture as PNG or EXR, the command line, the Python lines."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from viser import Icon

from luxel.image.layers import Layers
from luxel.image.tonemap import write_image
from luxel.render.exposure import Exposure
from luxel.viewer import share
from luxel.viewer.connection import QUIET, Connection
from luxel.viewer.panels.snippets import draw_snippet
from luxel.viewer.snapshot import Snapshot
from luxel.viewer.stats import Facts
from luxel.viewer.visitor import Visitor
from luxel.viewer.world import World

WINDOW = "as shown"
SIZES = (WINDOW, "512x512", "1280x720", "1920x1080", "3840x2160")


def wrap_command(command: str) -> str:
    """Return a command over several lines, an option a line."""
    for mark in (" --", " '--", " -o "):
        command = command.replace(mark, f" \\\n {mark}")
    return command


class SharePanel:
    """Screenshot, and the view as text."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection

    def build(self) -> None:
        """Add the controls to the page."""
        gui, connection = self.connection.gui, self.connection
        with gui.add_folder("Take along", expand_by_default=False):
            self._size = gui.add_dropdown("Size", SIZES, hint="Of the picture, pixels.")
            save = gui.add_button_group("Save", ("PNG", "EXR"), hint="PNG as shown; EXR linear, W/(m² sr).")
            connection.on_press(save, lambda: self._save(f".{save.value.lower()}"))
            tell = gui.add_button(
                "Copy as command", icon=Icon.COPY, hint="The lines that make this view again.", color=QUIET
            )
            connection.on_press(tell, self._tell)

    def refresh(self, facts: Facts) -> None:
        """Show `facts`, which may have changed elsewhere."""
        pass

    def tick(self) -> None:
        pass

    def _shared_view(self, visitor: Visitor) -> share.SharedView:
        width, height = visitor.size
        if self._size.value != WINDOW:
            width, height = (int(part) for part in self._size.value.split("x"))
        fixed = Exposure(visitor.exposure * 2.0**visitor.bias_stops)
        exposure = Exposure(stops=visitor.bias_stops) if visitor.auto_exposure else fixed
        return share.SharedView(visitor.camera, (width, height), self.connection.session.stats.now, exposure)

    # ------------------------------------------------------------------ pictures

    def _save(self, suffix: str) -> None:
        name = share.picture_name(self.connection.facts) + suffix
        self.connection.notify("info", f"{name}: rendering; the download starts when it is done.")

        def start(world: World, visitor: Visitor) -> None:
            view = self._shared_view(visitor)

            def keep(layers: Layers) -> None:
                self.connection.run(self._send, name, layers.image(), view.exposure.of(layers))

            shape = view.camera, view.size, visitor.stride_controller.stride
            visitor.snapshots.append(Snapshot(world, *shape, keep, self.connection.session.pixel_filter))

        self.connection.post(start)

    def _send(self, name: str, image: np.ndarray, exposure: float) -> None:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / name
            write_image(path, image, exposure)
            self.connection.client.send_file_download(name, path.read_bytes(), save_immediately=True)

    # ------------------------------------------------------------------ text

    def _tell(self) -> None:
        def tell(world: World, visitor: Visitor) -> None:
            self.connection.run(self._open, self._shared_view(visitor))

        self.connection.post(tell)

    def _open(self, view: share.SharedView) -> None:
        gui, facts, launch = self.connection.gui, self.connection.facts, self.connection.session.launch
        command, lines = share.write_command(launch, facts, view), share.write_python(launch, facts, view)
        missing = share.missing_in_command(launch, facts)
        with gui.add_modal("This view again") as modal:
            gui.add_html(draw_snippet("In a shell", wrap_command(command)))
            if missing:
                gui.add_markdown(f"*The command knows nothing of {' and '.join(missing)}; the Python lines do.*")
            gui.add_html(draw_snippet("In Python", lines))
            close = gui.add_button("Close", color=QUIET)
        self.connection.on_press(close, modal.close)
