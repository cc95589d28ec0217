"""One cache of light, seen by any number of cameras: the one driver of frames, of `Renderer` and the viewer alike.

    scene(t) -> Cache.advance (the world, once a frame) -> CameraView.look (each camera in turn)
    scene(t) -> CameraView.step (both in one frozen function: quicker where there is one camera)

All are frozen functions. Cameras of one image size share a recording, so that a second visitor or a turned camera
records nothing. Every step of a frame, and every look at it, has the frame's number; each look has its own seed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi

from luxel.errors import LuxelError
from luxel.image.layers import Layers
from luxel.kernels.camera import Pinhole, make_pinhole
from luxel.kernels.film import Film
from luxel.kernels.reproject import forget
from luxel.kernels.surface_bsdf import prepare_bsdf
from luxel.methods.base import Frame, Method, Progress
from luxel.methods.params import find_method
from luxel.render.frame import (
    Picture,
    ViewState,
    advance_world,
    averages,
    blank_picture,
    make_film,
    render_frame,
    render_view,
    take_apart,
)
from luxel.render.replay import Replay, constants_of
from luxel.scene.device import Scene
from luxel.scene.model import Camera

FILM_LIMIT = 24
"""Recordings kept, one an image size and kind; the oldest go first."""
LOOK_SEED = 0x6C8E9CF5
"""Between the seeds of two looks at one frame."""


class Cache:
    """A method's state of one scene, and what replays its frames. Nothing in it belongs to a camera."""

    def __init__(
        self,
        scene: Scene,
        method: str,
        params: Any,
        seed: int = 0,
        *,
        state: Any = None,
        progress: Progress | None = None,
        freeze: bool = True,
    ) -> None:
        """Build the state, or take `state` that `Method.load` read. `freeze` False traces every frame anew.

        Raises LuxelError for an unknown method or bad parameters.
        """
        self.method: Method = find_method(method)
        self.seed = seed
        self.generation = 0
        """Counts the states built: screens of an older one do not fit."""
        self._freeze = freeze
        self._replays: dict[tuple[Any, ...], Replay] = {}
        self._dropped = 0
        self._first_seed = self._make_seed(0)
        self._flags = {value: dr.opaque(mi.Bool, value) for value in (False, True)}
        built = self.method.build(scene, params, seed, progress=progress) if state is None else state
        self.restart(scene, params, built)

    def rebuild(self, scene: Scene, params: Any) -> None:
        """Start anew with `scene` and `params`. Raises LuxelError for bad ones, and then changes nothing."""
        self.restart(scene, params, self.method.build(scene, params, self.seed))

    def restart(self, scene: Scene, params: Any, state: Any) -> None:
        """Start anew with a `state` that was built for `scene` and `params`."""
        self.scene, self.params, self.state = scene, params, state
        self._host = scene.host
        scene.host.caches.add(self)
        self.frame_index = 0
        """Frames that the world has advanced since the state was built."""
        self._looks = 0
        self.generation += 1
        self._state_constants = constants_of(state)
        self._read_constants()

    def retune(self, params: Any) -> bool:
        """Go on with `params`; return whether all that the cache had learned could be kept. Raises as `rebuild`."""
        state = self.method.retune(self.scene, self.state, params)
        if state is None:
            self.rebuild(self.scene, params)
            return False
        self.params = params
        self.take_state(state)
        return True

    def take_state(self, state: Any) -> None:
        """Go on with another state of the same scene."""
        self.state, self._state_constants = state, constants_of(state)
        self._read_constants()

    def _read_constants(self) -> None:
        scene = self.scene
        prepare_bsdf(scene)
        self._constants = self._state_constants, constants_of(scene.lights, scene.materials, scene.features)
        self._tables = scene.lights, scene.materials

    def check_edit(self, part: str, words: str) -> None:
        """Raise LuxelError where `words`, an edit of `part` of the scene, would leave the state wrong.

        Parts are those of `Method.bakes`.
        """
        if part in self.method.bakes:
            raise LuxelError(
                f"{words} is an edit of a scene that a {self.method.name} was baked for: make a new renderer with the "
                "changed scene"
            )

    def follow_scene(self) -> None:
        """Take note of edits, and build the state anew where somebody else has uploaded the scene anew."""
        if self.scene.host is not self._host:
            self.check_edit("geometry", "taking an object out of the still scene")
            self.rebuild(self.scene, self.params)
        elif self.scene.lights is not self._tables[0] or self.scene.materials is not self._tables[1]:
            if self.method.fits(self.scene, self.state, self.params):
                self._read_constants()
            else:
                self.rebuild(self.scene, self.params)

    # ------------------------------------------------------------------ frames

    def advance(self) -> None:
        """Advance the world by one frame, asynchronously; no camera takes part."""
        self.follow_scene()
        frame = self.next_frame()
        self._looks = 0
        self.state = self._replay("advance")(self.scene, self.state, frame)

    def look(self, film: Film, screen: Any, view: ViewState, learn: bool) -> tuple[Any, ViewState, Picture]:
        """Show the state to one camera; with `learn` the method may learn from what it saw."""
        self.state, screen, view, picture = self._replay("look", film, learn)(self.scene, self.state, screen, view)
        return screen, view, picture

    def step(self, film: Film, screen: Any, view: ViewState) -> tuple[Any, ViewState, Picture]:
        """Advance the world and show it."""
        self.state, screen, view, picture = self._replay("step", film)(self.scene, self.state, screen, view)
        return screen, view, picture

    def run_staged(self, film: Film, screen: Any, view: ViewState, keep: bool = True) -> tuple[Any, ViewState, Picture]:
        """Advance the world and show it without replay, so that stages can be told apart; waits for the values.

        `keep` False leaves the state as it was.
        """
        state, screen, view, picture = render_frame(self.method, film, self.scene, self.state, screen, view)
        dr.eval(state, screen, view, picture)
        if keep:
            self.state = state
        return screen, view, picture

    def next_frame(self, still: bool = False) -> Frame:
        """Begin the next frame of the world; return its number and seed as opaque values."""
        self.frame_index += 1
        self._looks = 0
        return self.this_frame(still)

    def this_frame(self, still: bool) -> Frame:
        """Return the frame that the world is at, for one more look: each has its own random numbers."""
        seed = self._make_seed(self._looks) if self._looks else self._first_seed
        self._looks += 1
        return Frame(dr.opaque(mi.UInt32, max(self.frame_index - 1, 0)), seed, self._flags[still])

    def _make_seed(self, look: int) -> mi.UInt32:
        return dr.opaque(mi.UInt32, (self.seed * 0x9E3779B1 + 1 + look * LOOK_SEED) & 0xFFFFFFFF)

    def _replay(self, kind: str, *options: Any) -> Callable[..., Any]:
        make = {"advance": _advance_step, "look": _look_step, "step": _whole_step}[kind]
        if not self._freeze:
            return make(self.method, *options)
        key = (kind, *options, self._constants)
        if key not in self._replays:
            while len(self._replays) >= FILM_LIMIT:
                self._dropped += self._replays.pop(next(iter(self._replays))).recordings
            self._replays[key] = Replay(make(self.method, *options))
        return self._replays[key]

    @property
    def recordings(self) -> int:
        """How often any part of the frame was recorded; each recording may compile kernels, a replay never does."""
        return self._dropped + sum(replay.recordings for replay in self._replays.values())


@dataclass(frozen=True)
class _Pose:
    """Where a view looks from."""

    camera: Camera
    shift: tuple[float, float]
    time: float

    def differs(self, other: _Pose) -> bool:
        """Return whether the view is another one."""
        moved = self.camera.motion is not None and self.time != other.time
        return self.camera != other.camera or self.shift != other.shift or moved


class CameraView:
    """One camera on a cache: its film, its history, its running mean of direct light."""

    def __init__(
        self, cache: Cache, size: tuple[int, int], aspect: float | None = None, average_direct: bool = True,
        *, filter: str = "none", spread: float = 1.0,
    ) -> None:  # fmt: skip
        """`size` is (width, height); `aspect` the picture's width over height where its pixels are not square.

        `average_direct` False shows the noise of one frame. `filter` and `spread` are the film's. Raises LuxelError for
        a size that cannot be rendered, and for an unknown filter.
        """
        self.cache = cache
        self.film = make_film(size, filter, spread)
        self.aspect = self.film.width / self.film.height if aspect is None else aspect
        self.average_direct = average_direct
        self.picture: Picture | None = None
        self.still_frames = 0
        """Frames since camera, scene or lights last changed."""
        self._pose: _Pose | None = None
        self._view: ViewState | None = None
        self._changed = True
        self._turned_before = False
        self._epoch = -1
        self._start_screen()

    def _start_screen(self) -> None:
        cache = self.cache
        self.generation, self._changed = cache.generation, True
        if self._view is not None:
            # What was seen had the numbers of another scene, or of another state.
            self._view = replace(self._view, last=None)
        self.screen: Any = cache.method.screen(cache.scene, cache.state, self.film)

    def mark_changed(self) -> None:
        """Say that scene or lights are not those of the last look, so that histories start anew."""
        self._changed = True

    def look(self, camera: Camera, shift: tuple[float, float] = (0.0, 0.0), *, learn: bool = True) -> Picture:
        """Render this camera's view of the cache as it is, asynchronously.

        `shift` moves the picture by image coordinates (x to the right, y up, the whole picture being 2 x 2): what is
        seen through other points of the pixels. With `learn` the method may learn from what is seen.
        """
        view, still = self._turn(camera, shift)
        view = replace(view, frame=self.cache.this_frame(still))
        return self._keep(*self.cache.look(self.film, self.screen, view, learn))

    def step(self, camera: Camera, *, staged: bool = False) -> Picture:
        """Advance the cache by one frame and render this camera's view of it, asynchronously.

        The same picture as `Cache.advance` and `look` give. `staged` runs it without replay, and waits for its values.
        """
        view, still = self._turn(camera, (0.0, 0.0))
        view = replace(view, frame=self.cache.next_frame(still))
        run = self.cache.run_staged if staged else self.cache.step
        return self._keep(*run(self.film, self.screen, view))

    def repeat_staged(self, advance: bool) -> bool:
        """Do the last look once more without replay, for times by stage; `advance` also takes the world a frame on.

        Return whether there was a look to repeat. The picture and the histories stay those of the last look.
        """
        view = self._view
        if view is None or self.generation != self.cache.generation:
            return False
        frame = self.cache.next_frame() if advance else self.cache.this_frame(still=False)
        self.cache.run_staged(self.film, self.screen, replace(view, frame=frame), advance)
        return True

    def _keep(self, screen: Any, view: ViewState, picture: Picture) -> Picture:
        self.screen, self._view, self.picture = screen, view, picture
        return picture

    def _turn(self, camera: Camera, shift: tuple[float, float]) -> tuple[ViewState, bool]:
        """Return the view from `camera`, and whether all stands still since the last one."""
        cache = self.cache
        cache.follow_scene()
        if self.generation != cache.generation:
            self._start_screen()
        host = cache.scene.host
        pose = _Pose(camera, shift, host.time)
        before = self._pose or pose
        turned = pose.differs(before)
        if self._view is None:
            self._view = self._first_view(pose)
        view = self._view
        if turned or self._turned_before:
            view = replace(view, camera=self._pinhole(pose), before=self._pinhole(before))
        still = not (turned or self._changed or self._epoch != host.epoch) and self.average_direct
        if cache.method.reprojects(cache.state) != (view.last is not None):
            view = replace(view, last=forget(self.film) if view.last is None else None)
        self._pose, self._turned_before, self._changed, self._epoch = pose, turned, False, host.epoch
        self.still_frames = self.still_frames + 1 if still else 0
        return view, still

    def _first_view(self, pose: _Pose) -> ViewState:
        cache = self.cache
        view = ViewState(
            camera=self._pinhole(pose),
            before=self._pinhole(pose),
            frame=Frame(mi.UInt32(0), mi.UInt32(0), mi.Bool(False)),
            direct=dr.zeros(mi.Color3f, self.film.lane_count),
            direct_count=dr.opaque(mi.UInt32, 0),
            mean=blank_picture(self.film, cache.scene, cache.method) if averages(self.film, cache.scene) else None,
        )
        dr.make_opaque(view.direct)
        return view

    def _pinhole(self, pose: _Pose) -> Pinhole:
        """Return the pinhole with its centre moved by the shift."""
        film, origin = self.film, self.cache.scene.host.origin
        return make_pinhole(
            pose.camera, film.width, film.height, pose.time, aspect=self.aspect, shift=pose.shift, origin=origin
        )

    @property
    def view(self) -> ViewState | None:
        """What the last look used and left; None before the first."""
        return self._view

    @property
    def pinhole(self) -> Pinhole:
        """The pinhole of the last look."""
        assert self._view is not None, "look() comes first"
        return self._view.camera

    def layers(self) -> Layers:
        """Return the last picture taken apart, as arrays; waits for it."""
        assert self.picture is not None, "look() comes first"
        return take_apart(self.picture, self.film)


def _advance_step(method: Method) -> Callable[..., Any]:
    def advance(scene: Scene, state: Any, frame: Frame) -> Any:
        return advance_world(method, scene, state, frame)

    return advance


def _look_step(method: Method, film: Film, learn: bool) -> Callable[..., Any]:
    def look(scene: Scene, state: Any, screen: Any, view: ViewState) -> Any:
        return render_view(method, film, scene, state, screen, view, learn)

    return look


def _whole_step(method: Method, film: Film) -> Callable[..., Any]:
    def step(scene: Scene, state: Any, screen: Any, view: ViewState) -> Any:
        return render_frame(method, film, scene, state, screen, view)

    return step
