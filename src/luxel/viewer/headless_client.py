"""A visitor without a browser: speaks viser's protocol over a WebSocket. For the soak, the rate and the tests.

Layout of a message from the server, after viser's `infra`: 8 bytes size and 8 bytes compressed size, little-endian;
zstd-compressed msgpack; binary buffers. Messages to the server are plain msgpack.
"""

from __future__ import annotations

import math
import random
import time as clock
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any

import msgspec.msgpack
import numpy as np
import viser
import zstandard
from websockets.sync.client import connect
from websockets.sync.connection import Connection
from websockets.typing import Subprotocol

from luxel.scene.model import Camera
from luxel.viewer import cameras


@dataclass
class Control:
    """A control that the server has added."""

    uuid: str
    kind: str
    label: str
    props: dict[str, Any]
    value: Any


@dataclass
class HeadlessClient:
    """One connection: counts pictures, keeps the controls, answers like a browser."""

    url: str
    window: tuple[int, int] = (640, 480)
    controls: dict[str, Control] = field(default_factory=dict)
    notices: list[str] = field(default_factory=list)
    pictures: int = 0
    picture_bytes: int = 0
    picture: bytes = b""
    """The last JPEG."""

    def __enter__(self) -> HeadlessClient:
        protocol = Subprotocol(f"viser-v{viser.__version__}")
        address = self.url.replace("http", "ws", 1)
        self._held = ExitStack()
        self._socket: Connection = self._held.enter_context(
            connect(address, subprotocols=[protocol], max_size=None, compression=None)
        )
        return self

    def __exit__(self, *_: object) -> None:
        self._held.close()

    # ------------------------------------------------------------------ to the server

    def look(self, camera: Camera) -> None:
        """Say where the browser's camera is."""
        eye, right, up, forward = (np.asarray(axis) for axis in cameras.camera_axes(camera))
        wxyz = cameras.quaternion(np.stack([right, -up, forward], axis=1))
        width, height = self.window
        self._send(
            "ViewerCameraMessage",
            wxyz=wxyz,
            position=tuple(float(axis) for axis in eye),
            fov=cameras.vertical_fov(camera.fov, width / height),
            near=0.01,
            far=1000.0,
            image_height=height,
            image_width=width,
            look_at=tuple(float(axis) for axis in camera.target),
            up_direction=tuple(float(axis) for axis in up),
        )

    def set(self, control: Control, value: Any) -> None:
        """Turn a control."""
        control.value = value
        self._send("GuiUpdateMessage", uuid=control.uuid, updates={"value": value})

    def click(self, x: float, y: float) -> None:
        """Click the picture at (x, y), 0..1 from the top left."""
        self._send(
            "ScenePointerMessage",
            event_type="click",
            ray_origin=(0.0, 0.0, 0.0),
            ray_direction=(0.0, 0.0, 1.0),
            screen_pos=((x, y),),
            modifier=None,
        )

    def _send(self, kind: str, **fields: Any) -> None:
        self._socket.send(msgspec.msgpack.encode({"type": kind, **fields}))

    # ------------------------------------------------------------------ from the server

    def listen(self, seconds: float, until_picture: bool = False) -> int:
        """Take what comes for `seconds`, or until a picture comes; return how many pictures did."""
        before, end = self.pictures, clock.perf_counter() + seconds
        while (left := end - clock.perf_counter()) > 0.0:
            try:
                raw = self._socket.recv(timeout=left)
            except TimeoutError:
                break
            for message in decode(raw if isinstance(raw, bytes) else raw.encode()):
                self._take(message)
            if until_picture and self.pictures > before:
                break
        return self.pictures - before

    def _take(self, message: dict[str, Any]) -> None:
        kind = message["type"]
        if kind == "BackgroundImageMessage" and message["rgb_data"]:
            self.pictures += 1
            self.picture = bytes(message["rgb_data"])
            self.picture_bytes += len(self.picture)
        elif kind == "NotificationShowMessage" or kind == "NotificationMessage":
            self.notices.append(str(message.get("props", {}).get("body", "")))
        elif kind == "GuiRemoveMessage":
            self.controls.pop(message["uuid"], None)
        elif kind == "GuiUpdateMessage" and message["uuid"] in self.controls:
            self.controls[message["uuid"]].props |= message["updates"]
        elif kind.startswith("Gui") and "props" in message and "uuid" in message:
            props = message["props"]
            control = Control(message["uuid"], kind, str(props.get("label", "")), props, message.get("value"))
            self.controls[message["uuid"]] = control

    def find(self, label: str, kind: str = "") -> Control:
        """Return the control of that label. Raises KeyError where there is none."""
        for control in self.controls.values():
            if control.label == label and kind in control.kind:
                return control
        raise KeyError(f"no control '{label}' among {sorted(each.label for each in self.controls.values())}")

    # ------------------------------------------------------------------ chance

    def fiddle(self, chance: random.Random, home: Camera) -> None:
        """Turn the camera, or some slider, check box or list, at random."""
        if chance.random() < 0.6:
            self.look(turned(home, chance.uniform(-0.6, 0.6), chance.uniform(-0.2, 0.2)))
            return
        kinds = ("GuiSliderMessage", "GuiCheckboxMessage", "GuiDropdownMessage")
        control = chance.choice([each for each in self.controls.values() if each.kind in kinds] or [None])
        if control is None:
            return
        if control.kind == "GuiSliderMessage":
            low, high, step = (control.props[name] for name in ("min", "max", "step"))
            value = low + step * chance.randrange(max(int((high - low) / step), 1))
            self.set(control, type(step)(value))
        elif control.kind == "GuiCheckboxMessage":
            self.set(control, not control.value)
        else:
            self.set(control, chance.choice(control.props["options"]))


def decode(raw: bytes) -> Iterator[dict[str, Any]]:
    """Yield the messages of one frame from the server."""
    size, packed = int.from_bytes(raw[:8], "little"), int.from_bytes(raw[8:16], "little")
    body = zstandard.ZstdDecompressor().decompress(raw[16 : 16 + packed], max_output_size=size)
    yield from msgspec.msgpack.decode(body)["messages"]


def turned(home: Camera, azimuth: float, elevation: float) -> Camera:
    """Return `home` turned about its target by two angles, radians."""
    target, offset = np.asarray(home.target, np.float64), np.asarray(home.eye, np.float64) - np.asarray(home.target)
    distance = float(np.linalg.norm(offset))
    around = math.atan2(offset[0], offset[2]) + azimuth
    above = float(np.clip(math.asin(offset[1] / distance) + elevation, -1.4, 1.4))
    x, y, z = target + distance * np.array(
        [math.cos(above) * math.sin(around), math.sin(above), math.cos(above) * math.cos(around)]
    )
    return Camera((float(x), float(y), float(z)), home.target, fov=home.fov)
