"""`luxel view`: the scene in a browser, live."""

from __future__ import annotations

import os
import signal
import sys
import time as clock
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from luxel.cli import console, options
from luxel.errors import LuxelError
from luxel.scene.choice import PICTURE_FILTER, check_filter, check_materials

if TYPE_CHECKING:
    from luxel.scene.host import Looks
    from luxel.viewer.app import App
    from luxel.viewer.session import Session

LOCAL_HOSTS = ("127.0.0.1", "localhost", "::1")
STOP_SECONDS = 0.8
"""After Ctrl-C everything ends within this time, a running frame included."""


def view(
    scene: options.SceneName,
    method: options.Method = "gibs",
    preset: options.Preset = None,
    settings: options.Settings = None,
    size: Annotated[
        str, typer.Option("--size", metavar="WxH", help="Most pixels of a picture; its shape follows the window.")
    ] = "1280x720",
    port: Annotated[
        int | None,
        typer.Option("--port", min=0, max=65535, help="Port to listen on; else the first free from 8080."),
    ] = None,
    host: Annotated[
        str, typer.Option("--host", help="Address to listen on. Anything but this machine's own lets others in.")
    ] = "127.0.0.1",
    seed: options.Seed = 0,
    pixel_filter: options.Filter = PICTURE_FILTER,
    device: options.DeviceName = "auto",
    sun: options.Sun = None,
    sky: options.Sky = None,
    envmap: options.EnvMap = None,
    camera: options.CameraText = None,
    animation: options.Animation = None,
    materials: options.Materials = "full",
    debug: options.Debug = False,
) -> None:
    """Look at a scene in a browser: turn the camera, switch methods, turn the dials, look inside the cache."""
    wanted, given = options.parse_size(size), options.parse_settings(settings)
    check_filter(pixel_filter)
    check_materials(materials)
    looks = cast("Looks", materials)
    stated = {"sun": sun, "sky": sky, "envmap": envmap, "animation": animation}
    changes = {name: text for name, text in stated.items() if text is not None}
    require_viser()
    method, preset = options.choose_method(method, preset, device)
    with console.logs_on_stderr():
        from luxel import runtime

        reason = runtime.start(device).reason
        from luxel.viewer.app import App, find_port
        from luxel.viewer.session import Session
        from luxel.viewer.world import Choice

        choice = Choice(method, preset, given)
        choice.params()
        data = options.load_scene(scene, sun=sun, sky=sky, envmap=envmap, camera=camera, animation=animation)
        place = find_port(host, port)
        session = Session(
            data, choice, size=wanted, device=device, seed=seed, pixel_filter=pixel_filter, text=scene,
            options=changes, materials=looks,
        ).start()  # fmt: skip
        app = App(session, host=host, port=place)
    left_out = data.diffuse_warnings if choice.shown_materials(looks) == "full" else []
    console.warn([sentence for sentence in data.warnings if sentence not in left_out])
    print(f"luxel: {data.name} lit by {method} on {session.device.name} ({reason})")
    if host not in LOCAL_HOSTS:
        print(
            f"luxel: warning: listening on {host}: whoever reaches this machine's port {app.port} can look, and can "
            "change method, lights and objects; there is no password and no encryption",
            file=sys.stderr,
        )
    wait_for_the_end(app, session, debug)


def require_viser() -> None:
    """Raise LuxelError where viser is missing."""
    from importlib.util import find_spec

    if find_spec("viser") is None:
        raise LuxelError("the viewer needs an extra: run `pip install 'luxel[view]'`")


def wait_for_the_end(app: App, session: Session, debug: bool) -> None:
    """Serve until Ctrl-C or a polite kill, then end within a second, whatever the render thread is at."""

    def interrupt(number: int, frame: FrameType | None) -> Any:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    # A shell starts what a script puts in the background with SIGINT ignored; it stops the server all the same.
    signal.signal(signal.SIGINT, interrupt)
    told = 0
    try:
        print(f"luxel: open {app.url} in a browser; Ctrl-C stops", flush=True)
        while session.running:
            clock.sleep(0.1)
            if debug and len(session.faults) > told:
                print(*session.faults[told:], sep="\n", file=sys.stderr)
                told = len(session.faults)
    except KeyboardInterrupt:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    finally:
        signal.signal(signal.SIGTERM, before)
    end_quickly(app, session)


def end_quickly(app: App, session: Session) -> None:
    """Stop rendering, then serving, and end the process: threads of libraries may still be at work."""
    session.stop(STOP_SECONDS)
    print("luxel: stopped")
    sys.stdout.flush()
    sys.stderr.flush()
    # Browsers see the connection close; a frame that is being compiled cannot be waited for.
    os._exit(0)
