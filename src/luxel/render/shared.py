"""One cache of light, seen by any number of cameras: the frame of `renderer`, cut in two.

    scene(t) -> Cache.advance (the world, once a frame) -> Eye.look (each camera in turn)

Both halves are frozen functions. Cameras of one image size share a recording, so that a second visitor or a turned
camera records nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi

from luxel.kernels.camera import Pinhole, make_pinhole
from luxel.kernels.film import Film
from luxel.methods.base import Frame, Method
from luxel.methods.params import find_method
from luxel.render.collection import collection_paused
from luxel.render.layers import Layers
from luxel.render.renderer import Picture, View, layer_seed, make_film, render_view, take_apart
from luxel.scene.device import Scene, choose_layer
from luxel.scene.model import Camera

KEPT_RECORDINGS = 8
FILM_LIMIT = 24
"""Recordings kept, one an image size; the oldest go first."""


class Replay:
    """A frozen function that records itself anew where Dr.Jit's registry of shapes has changed.

    Scenes that come and go elsewhere in the process change it, and a replay then refuses before it launches anything.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function
        self._frozen: Any = self._freeze()
        self._before = 0

    def __call__(self, *arguments: Any) -> Any:
        with collection_paused():
            try:
                return self._frozen(*arguments)
            except RuntimeError as error:
                if "registry" not in str(error):
                    raise
            self._before += self._frozen.n_recordings
            self._frozen = self._freeze()
            return self._frozen(*arguments)

    def _freeze(self) -> Any:
        # Whoever turns the dials may ask for many recordings over a session; only the last ones are kept.
        return dr.freeze(self._function, limit=KEPT_RECORDINGS, warn_after=1 << 30)

    @property
    def recordings(self) -> int:
        """How often the function was recorded; each recording may compile kernels, a replay never does."""
        return self._before + self._frozen.n_recordings


class Cache:
    """A method's state of one scene, and what replays its frames. Nothing in it belongs to a camera."""

    def __init__(self, scene: Scene, method: str, params: Any, seed: int = 0) -> None:
        """Build the state. Raises LuxelError for an unknown method or bad parameters."""
        self.method: Method = find_method(method)
        self.seed = seed
        self.generation = 0
        """Counts the states built: screens of an older one do not fit."""
        self._look_index = 0
        self.rebuild(scene, params)
        self._advance = Replay(_advance_step(self.method))
        self._looks: dict[tuple[int, int, bool], Replay] = {}
        self._dropped = 0

    def rebuild(self, scene: Scene, params: Any) -> None:
        """Start anew with `scene` and `params`. Raises LuxelError for bad ones, and then changes nothing."""
        state = self.method.build(scene, params, self.seed)
        self.scene, self.params, self.state = scene, params, state
        self.frame_index = 0
        self.generation += 1

    def retune(self, params: Any) -> bool:
        """Go on with `params`; return whether all that the cache had learned could be kept. Raises as `rebuild`."""
        state = self.method.retune(self.scene, self.state, params)
        if state is None:
            self.rebuild(self.scene, params)
            return False
        self.state, self.params = state, params
        return True

    def advance(self) -> None:
        """Advance the world by one frame, asynchronously; no camera takes part."""
        self.state = self._advance(self.scene, self.state, self.make_frame(self.frame_index, still=False))
        self.frame_index += 1

    def make_frame(self, number: int, still: bool) -> Frame:
        """Return a frame's number and seed as opaque values of their own."""
        seed = (self.seed * 0x9E3779B1 + 1) & 0xFFFFFFFF
        return Frame(dr.opaque(mi.UInt32, number), dr.opaque(mi.UInt32, seed), dr.opaque(mi.Bool, still))

    def next_look(self) -> int:
        """Return a number for a look: each has its own random numbers, however often the world advances between."""
        self._look_index += 1
        return self._look_index

    def look(self, film: Film, screen: Any, view: View, learn: bool) -> tuple[Any, View, Picture]:
        """Show the state to one camera; with `learn` the method may learn from what it saw."""
        key = (film.width, film.height, learn)
        if key not in self._looks:
            while len(self._looks) >= FILM_LIMIT:
                self._dropped += self._looks.pop(next(iter(self._looks))).recordings
            self._looks[key] = Replay(_look_step(self.method, film, learn))
        self.state, screen, view, picture = self._looks[key](self.scene, self.state, screen, view)
        return screen, view, picture

    @property
    def recordings(self) -> int:
        """How often any part of the frame was recorded."""
        return self._dropped + self._advance.recordings + sum(look.recordings for look in self._looks.values())


@dataclass(frozen=True)
class _Pose:
    """Where an eye looks from."""

    camera: Camera
    shift: tuple[float, float]
    time: float

    def differs(self, other: _Pose) -> bool:
        """Return whether the view is another one."""
        moved = self.camera.motion is not None and self.time != other.time
        return self.camera is not other.camera or self.shift != other.shift or moved


class Eye:
    """One camera on a cache: its film, its history, its running mean of direct light."""

    def __init__(self, cache: Cache, size: tuple[int, int], aspect: float | None = None) -> None:
        """`size` is (width, height); `aspect` the picture's width over height where its pixels are not square.

        Raises LuxelError for a size that cannot be rendered.
        """
        self.cache = cache
        self.film = make_film(size)
        self.aspect = size[0] / size[1] if aspect is None else aspect
        self.generation = cache.generation
        self.screen: Any = cache.method.screen(cache.scene, cache.state, self.film.lane_count)
        self.picture: Picture | None = None
        self.still_frames = 0
        """Frames since camera, scene or lights last changed."""
        self._pose: _Pose | None = None
        self._view: View | None = None
        self._changed = True
        self._turned_before = False

    def mark_changed(self) -> None:
        """Say that scene or lights are not those of the last look, so that histories start anew."""
        self._changed = True

    def look(self, camera: Camera, shift: tuple[float, float] = (0.0, 0.0), *, learn: bool = True) -> Picture:
        """Render this camera's view of the cache as it is, asynchronously.

        `shift` moves the picture by image coordinates (x to the right, y up, the whole picture being 2 x 2): what is
        seen through other points of the pixels. With `learn` the method may learn from what is seen.
        """
        pose = _Pose(camera, shift, self.cache.scene.host.time)
        before = self._pose or pose
        turned = pose.differs(before)
        if self._view is None:
            self._view = self._first_view(pose)
        view = self._view
        if turned or self._turned_before:
            view = replace(view, camera=self._pinhole(pose), before=self._pinhole(before))
        still = not (turned or self._changed)
        self._pose, self._turned_before, self._changed = pose, turned, False
        self.still_frames = self.still_frames + 1 if still else 0
        view = replace(view, frame=self.cache.make_frame(self.cache.next_look(), still))
        self.screen, self._view, self.picture = self.cache.look(self.film, self.screen, view, learn)
        return self.picture

    def _first_view(self, pose: _Pose) -> View:
        view = View(
            camera=self._pinhole(pose),
            before=self._pinhole(pose),
            frame=self.cache.make_frame(0, still=False),
            direct=dr.zeros(mi.Color3f, self.film.lane_count),
            direct_count=dr.opaque(mi.UInt32, 0),
        )
        dr.make_opaque(view.direct)
        return view

    def _pinhole(self, pose: _Pose) -> Pinhole:
        """Return the pinhole with its centre moved by the shift."""
        width, height = self.film.width, self.film.height
        return make_pinhole(pose.camera, width, height, pose.time, aspect=self.aspect, shift=pose.shift)

    @property
    def view(self) -> View | None:
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
        return method.update(choose_layer(scene, layer_seed(frame)), state, frame)

    return advance


def _look_step(method: Method, film: Film, learn: bool) -> Callable[..., Any]:
    def look(scene: Scene, state: Any, screen: Any, view: View) -> Any:
        return render_view(method, film, scene, state, screen, view, learn)

    return look
