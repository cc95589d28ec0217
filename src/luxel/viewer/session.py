"""The engine of the viewer, without a browser: one world, one render thread, any number of visitors.

Dr.Jit is used from the render thread only. Whoever wants something leaves a request; requests are carried out between
two frames, and one that fails becomes a sentence for who asked, with the world as it was. Pictures wait in each
visitor's mailbox, newest only, so that rendering never waits for a network.
"""

from __future__ import annotations

import contextlib
import threading
import time as clock
import traceback
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import count
from typing import Any

import drjit as dr

from luxel import runtime
from luxel.errors import LuxelError
from luxel.scene.choice import PICTURE_FILTER
from luxel.scene.edit import default_camera
from luxel.scene.host import Looks
from luxel.scene.model import SceneData
from luxel.viewer.display import DisplayEncoder
from luxel.viewer.share import LaunchOptions, describe_launch
from luxel.viewer.stats import Facts, Stats, measure_stages, read_cache
from luxel.viewer.visitor import Visitor
from luxel.viewer.world import Choice, World

Request = Callable[[World, Visitor], Any]
"""What is carried out between two frames, on the render thread."""

IDLE_WAIT = 0.5
"""Seconds that the render thread sleeps at most where nobody needs a frame; a request wakes it."""
FAULT_WAIT = 0.5
"""Seconds before the next frame after one that failed."""
CACHE_SHARE = {True: 0.5, False: 0.3}
"""Share of the time that the caches may take, at rest and while somebody drags: a slow cache then skips frames."""
STAGES_EVERY = 4.0
"""Seconds between two frames that are timed stage by stage, while somebody watches and nobody turns."""
TIDY_EVERY = 20.0
"""Seconds between two times that memory is given back while frames are made."""
READ_EVERY = 1.0
"""Seconds between two readings of the cache's sizes."""


@dataclass
class _Asked:
    """A request in the queue."""

    visitor: int
    request: Request
    done: threading.Event = field(default_factory=threading.Event)
    result: Any = None
    error: str = ""


class Session:
    """Owns the world and the render thread."""

    launch: LaunchOptions
    """What it was started with; there once it has started."""

    def __init__(
        self,
        data: SceneData,
        choice: Choice,
        *,
        size: tuple[int, int],
        device: str = "auto",
        seed: int = 0,
        pixel_filter: str = PICTURE_FILTER,
        text: str | None = None,
        options: dict[str, str] | None = None,
        materials: Looks = "diffuse",
    ) -> None:
        """`size` is the (width, height) whose pixel count no picture exceeds.

        `pixel_filter` smooths pictures at rest (`scene.choice.FILTERS`). `text` is the scene as a command line names
        it, `options` its scene options; both are only told on. `materials` are
        those of `World`.

        Raises LuxelError, before anything is served, for a scene or parameters that cannot be rendered.
        """
        self.device = runtime.start(device)
        self._text, self._options = text or data.name, options or {}
        self.size = size
        self.pixel_filter = pixel_filter
        self.cameras = list(data.cameras) or [default_camera(data)]
        """The scene's own, or one that fits it."""
        self.camera = self.cameras[0]
        self.stats = Stats(device=self.device.name)
        self.faults: list[str] = []
        """Tracebacks of frames and requests that failed for no reason of the user's."""
        self._visitors: dict[int, Visitor] = {}
        self._numbers = count(1)
        self._queue: OrderedDict[Any, _Asked] = OrderedDict()
        self._lock = threading.Lock()
        self._wake = threading.Event()
        self._stop = threading.Event()
        self._keys = count()
        self._started: threading.Event = threading.Event()
        self._tidied = False
        self._credit_ms = 0.0
        """Time that the caches may take; below 0 they wait."""
        self._failure: BaseException | None = None
        self._thread = threading.Thread(
            target=self._run, args=(data, choice, seed, materials), name="luxel-render", daemon=True
        )

    # ------------------------------------------------------------------ life

    def start(self) -> Session:
        """Start the render thread and wait until the world stands. Raises LuxelError where it cannot."""
        self._thread.start()
        while not self._started.wait(0.1):
            pass
        if self._failure is not None:
            raise self._failure
        return self

    def stop(self, timeout: float = 0.7) -> bool:
        """Ask the render thread to stop; return whether it did within `timeout` seconds."""
        self._stop.set()
        self._wake.set()
        for visitor in self.visitors():
            visitor.mailbox.close()
        self._thread.join(timeout)
        return not self._thread.is_alive()

    @property
    def facts(self) -> Facts:
        """The world as it was published last; there once it has started."""
        facts = self.stats.facts
        assert facts is not None, "start() comes first"
        return facts

    @property
    def running(self) -> bool:
        """Whether frames are still being made."""
        return self._thread.is_alive() and not self._stop.is_set()

    # ------------------------------------------------------------------ visitors

    def join(self) -> Visitor:
        """Return a new visitor, with the scene's first camera."""
        visitor = Visitor(next(self._numbers), self.camera, self.size, self.pixel_filter)
        with self._lock:
            self._visitors[visitor.number] = visitor
        self._wake.set()
        return visitor

    def leave(self, visitor: Visitor) -> None:
        """Let a visitor go: what was made for it is freed, and where it was the last one, frames stop."""
        with self._lock:
            self._visitors.pop(visitor.number, None)
            for key in [key for key, asked in self._queue.items() if asked.visitor == visitor.number]:
                self._queue.pop(key).done.set()
        visitor.mailbox.close()
        self._wake.set()

    def visitors(self) -> list[Visitor]:
        """Return those who are there."""
        with self._lock:
            return list(self._visitors.values())

    # ------------------------------------------------------------------ requests

    def post(self, visitor: Visitor, request: Request, key: str | None = None) -> None:
        """Leave a request. A later one with the same `key` takes the place of an earlier one that still waits."""
        self._enqueue(_Asked(visitor.number, request), key)

    def ask(self, visitor: Visitor, request: Request, timeout: float = 60.0) -> Any:
        """Leave a request, wait for it and return its result. Raises LuxelError where it failed or never came."""
        asked = _Asked(visitor.number, request)
        self._enqueue(asked, None)
        if not asked.done.wait(timeout):
            raise LuxelError("the viewer did not answer in time")
        if asked.error:
            raise LuxelError(asked.error)
        return asked.result

    def _enqueue(self, asked: _Asked, key: str | None) -> None:
        with self._lock:
            place = next(self._keys) if key is None else (asked.visitor, key)
            if place in self._queue:
                self._queue.pop(place).done.set()
            self._queue[place] = asked
        self._wake.set()

    def _apply_requests(self, world: World) -> None:
        while True:
            with self._lock:
                if not self._queue:
                    return
                _, asked = self._queue.popitem(last=False)
                visitor = self._visitors.get(asked.visitor)
            if visitor is not None:
                self._apply(world, visitor, asked)
            asked.done.set()

    def _apply(self, world: World, visitor: Visitor, asked: _Asked) -> None:
        visitor.touch()
        try:
            asked.result = asked.request(world, visitor)
        except LuxelError as error:
            asked.error = str(error)
            visitor.notify("error", asked.error)
        except Exception as error:
            asked.error = f"that did not work: {type(error).__name__}: {error}"
            self.faults.append(traceback.format_exc())
            visitor.notify("error", asked.error)

    # ------------------------------------------------------------------ the render thread

    def _run(self, data: SceneData, choice: Choice, seed: int, materials: Looks) -> None:
        try:
            # The variant is Mitsuba's thread-local choice.
            runtime.start(self.device.name)
            world = World(data, choice, seed, materials)
        except BaseException as error:
            self._failure = error
            self._started.set()
            return
        encoder = DisplayEncoder()
        self.stats.publish(world)
        self.launch = describe_launch(self._text, self._options, self.facts, seed, self.pixel_filter)
        self._started.set()
        before = tidied_at = clock.perf_counter()
        tidied_structure = world.structure
        while not self._stop.is_set():
            self._wake.clear()
            self._apply_requests(world)
            self.stats.publish(world)
            waiting = [visitor for visitor in self.visitors() if not visitor.has_rested(world)]
            if not waiting and not (world.clock.playing and self.visitors()):
                self._tidy()
                self._wake.wait(IDLE_WAIT)
                before = clock.perf_counter()
                continue
            if world.structure != tidied_structure and clock.perf_counter() - tidied_at > TIDY_EVERY:
                # Caches that were built anew leave holes of their sizes behind.
                runtime.release_memory()
                tidied_structure, tidied_at = world.structure, clock.perf_counter()
            start, self._tidied = clock.perf_counter(), False
            try:
                self._frame(world, encoder, start - before)
            except Exception:
                self._report_fault()
            before = start

    def _frame(self, world: World, encoder: DisplayEncoder, seconds: float) -> None:
        """Advance the world where it is due, and render every visitor's view of it."""
        visitors = self.visitors()
        wanted = [name for visitor in visitors for name in visitor.methods(world)]
        wanted += [snapshot.method for visitor in visitors for snapshot in visitor.snapshots]
        calm = not any(visitor.is_moving for visitor in visitors) and not world.clock.playing
        recordings = self._count_recordings(world, encoder)
        start = clock.perf_counter()
        if world.tick(seconds, wanted) or self._credit_ms >= 0.0:
            world.advance(wanted)
            if self.device.name == "cpu":
                dr.sync_thread()
            self._credit_ms = -1e3 * (clock.perf_counter() - start)
        looked = clock.perf_counter()
        for visitor in visitors:
            self._serve(world, encoder, visitor)
        end = clock.perf_counter()
        spent, share = 1e3 * (end - looked), CACHE_SHARE[calm]
        self._credit_ms += spent * share / (1.0 - share)
        if self._count_recordings(world, encoder) == recordings:
            # A frame that was recorded says nothing of the next ones.
            for visitor in visitors:
                visitor.stride_controller.observe(spent)
        self._update_stats(world, encoder, visitors, 1e3 * (end - start), calm)

    def _serve(self, world: World, encoder: DisplayEncoder, visitor: Visitor) -> None:
        """Render one visitor's view and pictures to keep; what fails is that visitor's alone."""
        try:
            visitor.render(world, encoder)
        except Exception:
            self._report_fault([visitor])
        for snapshot in list(visitor.snapshots):
            try:
                done = snapshot.step(world, encoder)
            except Exception:
                self._report_fault([visitor])
                done = True
            if done:
                visitor.snapshots.remove(snapshot)

    def _tidy(self) -> None:
        """Give memory back, once whenever nobody needs a frame."""
        if not self._tidied:
            runtime.release_memory()
            self._tidied = True

    def _count_recordings(self, world: World, encoder: DisplayEncoder) -> int:
        return encoder.recordings + sum(cache.recordings for cache in world.caches.values())

    def _update_stats(
        self, world: World, encoder: DisplayEncoder, visitors: list[Visitor], spent: float, calm: bool
    ) -> None:
        stats, now = self.stats, clock.perf_counter()
        stats.note_frame(spent, now, len(visitors), self._count_recordings(world, encoder))
        if now - stats.read_at > READ_EVERY:
            read_cache(stats, world)
            stats.read_at = clock.perf_counter()
        if calm and any(visitor.watches_stages for visitor in visitors) and now - stats.staged_at > STAGES_EVERY:
            stats.stages = measure_stages(world, visitors[0])
            stats.staged_at = clock.perf_counter()

    def _report_fault(self, visitors: list[Visitor] | None = None) -> None:
        text = traceback.format_exc()
        if text not in self.faults:
            self.faults.append(text)
            last = text.strip().splitlines()[-1]
            for visitor in self.visitors() if visitors is None else visitors:
                visitor.notify("error", f"a frame failed: {last}")
        with contextlib.suppress(Exception):
            self._stop.wait(FAULT_WAIT)
