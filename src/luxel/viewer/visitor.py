"""One visitor: a camera, a window, what is shown, and the newest picture on its way to the browser."""

from __future__ import annotations

import threading
import time as clock
from collections import deque
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import numpy as np

from luxel.errors import LuxelError
from luxel.kernels.records import Surface
from luxel.methods.params import find_method
from luxel.scene.device import Scene
from luxel.scene.host import Host
from luxel.scene.model import Camera
from luxel.viewer.compare import Comparison, draw_error, join_halves, measure
from luxel.viewer.display import DisplayEncoder
from luxel.viewer.host_looks import HostLook, draw_interleaved, has_look, is_host_look
from luxel.viewer.interleaved import DisplaySettings, InterleavedView
from luxel.viewer.resolution import StrideController, fit_size
from luxel.viewer.snapshot import Snapshot
from luxel.viewer.world import World

STILL_AFTER = 0.25
"""Seconds after the last turn from which the camera rests."""
SETTLE_FRAMES = 6
"""Frames after a change of light or scene that are shown small, while the cache takes it in."""
FIRST_FRAMES = 8
REST_FRAMES = 256
"""Frames at rest after which a method's pixels need no more; a progressive one's need `PROGRESSIVE_REST_FRAMES`."""
PROGRESSIVE_REST_FRAMES = 4096
MEASURE_EVERY = 2.0
"""Seconds between two comparisons with the rival at rest."""
EXPOSURE_STEP = 0.25
"""Share of the way to the right exposure that a frame goes while the camera turns."""
EXPOSURE_SLACK = 0.01
"""Relative difference from the right exposure that is let be at rest."""


@dataclass(frozen=True)
class DisplayFrame:
    """A picture for the browser."""

    pixels: np.ndarray
    """(h, w, 3) uint8; the browser enlarges it to its window."""
    number: int
    moving: bool
    asked: float | None
    """When the camera movement that it answers arrived, `time.perf_counter`; None where it answers none."""


class Mailbox:
    """Holds the newest picture only: who takes late, misses the ones between."""

    def __init__(self) -> None:
        self._frame: DisplayFrame | None = None
        self._closed = False
        self._wake = threading.Condition()

    def put(self, frame: DisplayFrame) -> None:
        """Leave a picture; one that nobody took is gone, but what it answered is answered by this one."""
        with self._wake:
            if self._frame is not None and self._frame.asked is not None:
                frame = replace(frame, asked=self._frame.asked)
            self._frame = frame
            self._wake.notify_all()

    def take(self, timeout: float, calm: float = 0.0) -> DisplayFrame | None:
        """Wait for a picture; None after `timeout` seconds or once closed.

        A picture at rest is left for `calm` seconds, in which a newer one or a turning camera may replace it.
        """
        start = clock.perf_counter()
        with self._wake:
            while not self._closed:
                waited = clock.perf_counter() - start
                if self._frame is not None and (self._frame.moving or waited >= calm):
                    break
                if waited >= timeout:
                    return None
                self._wake.wait((timeout if self._frame is None else min(calm, timeout)) - waited + 1e-4)
            frame, self._frame = self._frame, None
            return frame

    def close(self) -> None:
        """Wake up whoever waits."""
        with self._wake:
            self._closed = True
            self._wake.notify_all()


class Visitor:
    """A visitor's own part of a session. Rendered by the render thread; `mailbox` and `notices` are read by others."""

    def __init__(self, number: int, camera: Camera, budget: tuple[int, int], pixel_filter: str = "none") -> None:
        self.number = number
        self.camera = camera
        self.window = budget
        """Size of the visitor's window, pixels."""
        self.budget = budget
        """(width, height) whose product no picture exceeds."""
        self.pixel_filter = pixel_filter
        """What smooths the picture at rest."""
        self.look = "image"
        self.auto_exposure = True
        self.exposure = 1.0
        self.bias_stops = 0.0
        """Stops above the automatic exposure."""
        self.comparison = Comparison()
        self.stride_controller = StrideController()
        self.mailbox = Mailbox()
        self.notices: deque[tuple[str, str]] = deque(maxlen=16)
        """(kind, sentence) for the visitor; kind is "error" or "info"."""
        self.answers_ms: deque[float] = deque(maxlen=64)
        """How long the last drags waited for their pictures, encoding and sending included."""
        self.figures: dict[str, float] = {}
        """Distance from the rival at rest, by name, and the `samples` a pixel behind it."""
        self.watches_stages = False
        """The visitor wants to see what the stages of a frame cost."""
        self.snapshots: list[Snapshot] = []
        """Pictures to keep that are being rendered."""
        self.frame_count = 0
        self._interleaved: dict[str, InterleavedView] = {}
        self._turned_at = -1e9
        self._turn_due = True
        """No small picture of this camera has been made yet."""
        self._asked: float | None = None
        self._seen_version = -1
        self._settle = 0
        self._exposed = False
        self._touched = False
        self.host_look: HostLook | None = None
        """The look in use where the host draws it, and its legend."""
        self._host_look_shown: tuple[str, bool] | None = None
        self._point: tuple[Host, Surface] | None = None
        """The point that was clicked last, and the upload of the scene that it is a point of."""
        self._host_look_at = -1e9
        self._error_map: np.ndarray | None = None
        self._measured_at = -1e9
        self._measuring: threading.Thread | None = None

    # ------------------------------------------------------------------ what the visitor does

    def turn(self, camera: Camera, asked: float) -> None:
        """Look through another camera; `asked` is when the visitor moved it."""
        self.camera = camera
        self._mark_turned()
        self._asked = asked if self._asked is None else self._asked

    def resize(self, window: tuple[int, int]) -> None:
        """Take another window size, pixels."""
        if window != self.window and min(window) > 0:
            self.window = window
            self._mark_turned()

    def _mark_turned(self) -> None:
        self._turned_at, self._turn_due = clock.perf_counter(), True

    def show(self, **changes: Any) -> None:
        """Change what is shown: `look`, `auto_exposure`, `exposure`, `bias_stops`."""
        for name, value in changes.items():
            setattr(self, name, value)
        self._exposed = False

    def choose_point(self, scene: Scene, point: Surface) -> None:
        """Choose the point of `scene` that looks of one point are drawn for, until another one is clicked."""
        dr.eval(point)
        self._point = scene.host, point
        self._host_look_shown = None

    def touch(self) -> None:
        """Say that something was asked for, so that another picture is due even at rest."""
        self._touched = True

    def notify(self, kind: str, sentence: str) -> None:
        """Leave a sentence for the visitor."""
        self.notices.append((kind, sentence))

    # ------------------------------------------------------------------ frames

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the full picture."""
        return fit_size(self.window, self.budget)

    @property
    def is_moving(self) -> bool:
        """Whether pictures should be quick rather than sharp."""
        return self._turn_due or self._settle > 0 or clock.perf_counter() - self._turned_at < STILL_AFTER

    @property
    def is_sharp(self) -> bool:
        """Whether every pixel has been rendered since the camera came to rest, all by the same light."""
        interleaved_views = list(self._interleaved.items())
        return bool(interleaved_views) and all(
            interleaved.is_even or _has_all(name, interleaved) for name, interleaved in interleaved_views
        )

    def has_rested(self, world: World) -> bool:
        """Return whether another frame would show nothing new."""
        if (
            self._touched
            or self.snapshots
            or self.is_moving
            or self._seen_version != world.version
            or not self._interleaved
        ):
            return False
        return all(_has_all(name, interleaved) for name, interleaved in self._interleaved.items())

    def methods(self, world: World) -> list[str]:
        """Return the methods whose pictures the visitor looks at."""
        rival = self.comparison.rival
        return [world.main] if rival is None or rival == world.main else [world.main, rival]

    def render(self, world: World, encoder: DisplayEncoder) -> None:
        """Make this frame's passes and leave the picture in the mailbox."""
        if self._seen_version != world.version:
            if self._seen_version >= 0:
                self._settle = SETTLE_FRAMES
            self._seen_version = world.version
            for interleaved in self._interleaved.values():
                interleaved.mark_changed()
        # The first pictures wait for kernels to be compiled, which is no answer to a drag.
        moving, asked = self.is_moving, self._asked if self.frame_count >= FIRST_FRAMES else None
        self._settle = max(self._settle - 1, 0)
        if moving:
            self.stride_controller.choose()
        names = self.methods(world)
        if not has_look(world.main, self.look):
            self.look = "image"
        shown = DisplaySettings("image" if is_host_look(self.look) else self.look, self.shown_exposure)
        for name in names:
            interleaved = self._interleaved_of(world, name)
            # A rival learns from the view as the method in use does, else it would be treated worse.
            learn = not world.frozen
            quick = moving or interleaved.middle_view.picture is None
            (interleaved.turn if quick else interleaved.rest)(self.camera, encoder, shown, learn)
        self._interleaved = {name: self._interleaved[name] for name in names}
        self._meter(self._interleaved[names[0]], moving)
        self._measure(names, moving)
        self._draw_host_look(self._interleaved[names[0]], moving)
        self._asked, self._turn_due, self._touched = None, False, False
        self.frame_count += 1
        self.mailbox.put(DisplayFrame(self._compose(names), self.frame_count, moving, asked))

    def _interleaved_of(self, world: World, name: str) -> InterleavedView:
        cache, size = world.cache(name), self.size
        aspect = self.window[0] / self.window[1]
        known = self._interleaved.get(name)
        # Beside another method figures are taken, and those belong to the pixels' centres.
        pixel_filter = self.pixel_filter if len(self.methods(world)) == 1 else "none"
        shape = cache, size, aspect, self.stride_controller.stride, pixel_filter
        if known is None or not known.fits(*shape):
            self._interleaved[name] = InterleavedView(*shape)
        return self._interleaved[name]

    @property
    def shown_exposure(self) -> float:
        """The factor that light is shown with."""
        return self.exposure * 2.0**self.bias_stops

    def _meter(self, interleaved: InterleavedView, moving: bool) -> None:
        """Follow the light as an eye does: smoothly while the camera turns, exactly at rest."""
        if not self.auto_exposure or interleaved.meter is None:
            return
        wanted = interleaved.meter.exposure()
        if not self._exposed:
            self.exposure, self._exposed = wanted, True
        elif moving:
            self.exposure *= (wanted / self.exposure) ** EXPOSURE_STEP
        elif interleaved.is_full and abs(wanted / self.exposure - 1.0) > EXPOSURE_SLACK:
            self.exposure = wanted

    def _compose(self, names: list[str]) -> np.ndarray:
        image = self._interleaved[names[0]].image() if self.host_look is None else self.host_look.pixels
        if len(names) == 1:
            return image
        right = self._interleaved[names[1]].image()
        if self.comparison.shows_map and self._error_map is not None:
            right = self._error_map
        return join_halves(image, right, self.comparison.split)

    def _draw_host_look(self, interleaved: InterleavedView, moving: bool) -> None:
        """Draw a look that the encoder has not: small while the camera turns, full at rest, then now and then."""
        if not is_host_look(self.look):
            self.host_look, self._host_look_shown = None, None
            return
        now = clock.perf_counter()
        fresh = moving or self._host_look_shown != (self.look, interleaved.is_full)
        if fresh or (interleaved.is_full and now - self._host_look_at > MEASURE_EVERY):
            try:
                self.host_look = draw_interleaved(
                    interleaved, self.look, self.shown_exposure, self._point_in(interleaved.cache.scene)
                )
            except LuxelError as error:
                # Such as a layer of probes that no box has: the picture goes on as the image.
                self.notify("error", str(error))
                self.look, self.host_look, self._host_look_shown = "image", None, None
                return
            self._host_look_shown, self._host_look_at = (self.look, interleaved.is_full), clock.perf_counter()

    def _point_in(self, scene: Scene) -> Surface | None:
        """Return the clicked point; None where the scene has been taken apart since, which renumbers its triangles."""
        return self._point[1] if self._point is not None and self._point[0] is scene.host else None

    def _measure(self, names: list[str], moving: bool) -> None:
        """At rest, now and then: how far the two pictures are apart."""
        pair = [self._interleaved[name] for name in names]
        if len(pair) < 2 or moving or not all(interleaved.is_full for interleaved in pair):
            self.figures, self._error_map = {}, None
            return
        now = clock.perf_counter()
        if now - self._measured_at < MEASURE_EVERY or (self._measuring is not None and self._measuring.is_alive()):
            return
        self._measured_at = now
        test, truth, samples = pair[0].layers(), pair[1].layers(), pair[1].samples

        def compare() -> None:
            self.figures = {**measure(test, truth), "samples": samples}
            self._error_map = draw_error(test, truth)

        # Only arrays from here on, so that the next picture need not wait.
        self._measuring = threading.Thread(target=compare, name="luxel-compare", daemon=True)
        self._measuring.start()

    # ------------------------------------------------------------------ what others ask

    def interleaved(self, name: str) -> InterleavedView | None:
        """Return the visitor's picture of method `name`; None where there is none."""
        return self._interleaved.get(name)


def _has_all(name: str, interleaved: InterleavedView) -> bool:
    """Return whether a picture of method `name` needs no more frames."""
    return interleaved.samples >= (PROGRESSIVE_REST_FRAMES if find_method(name).progressive else REST_FRAMES)
