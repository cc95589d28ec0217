"""One scene, one method, one camera, frame by frame: what most programs use.

`frame.py` has the frame itself, `shared.py` what records and replays it, `live.py` the edits of a scene under way.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import is_dataclass
from numbers import Integral
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np

from luxel import runtime
from luxel.errors import LuxelError
from luxel.image.layers import Layers
from luxel.kernels.camera import Pinhole
from luxel.kernels.film import Film
from luxel.methods.base import Method, Progress
from luxel.methods.params import change_params, copy_params, find_method, hold_params, make_params
from luxel.render.exposure import auto_exposure
from luxel.render.frame import make_film
from luxel.render.live import LiveScene
from luxel.render.shared import Cache, CameraView
from luxel.scene.check import check_camera
from luxel.scene.choice import check_materials
from luxel.scene.device import Scene, set_time, upload
from luxel.scene.edit import default_camera
from luxel.scene.held import hold_scene
from luxel.scene.host import Looks
from luxel.scene.live import find_index
from luxel.scene.model import Camera, SceneData
from luxel.scene.rules import LARGEST, is_number, show
from luxel.stages import Recorder, recording

WARM_UP_FRAMES = 8
"""Frames in which kernels may still be recorded; none after."""


class Renderer(LiveScene):
    """One scene, one method, one camera, frame by frame.

    What can change while it runs changes by its calls (`set_light`, `set_material`, `move_object` ...; docs/live.md);
    an assignment does the same (`camera`, `params`, `time`, `state`, `average_direct`) or raises. It keeps a copy of
    the scene's data: yours stays as it is, and may be changed and given to another renderer.

    Raises LuxelError for a bad size, method or parameter.
    """

    def __init__(
        self,
        scene: SceneData | Scene | str | Path,
        method: str = "gibs",
        params: Any = None,
        *,
        preset: str | None = None,
        size: tuple[int, int] = (512, 512),
        seed: int = 0,
        camera: Camera | str | int | None = None,
        device: str = "auto",
        average_direct: bool = True,
        filter: str = "none",
        freeze: bool = True,
        state: Any = None,
        progress: Progress | None = None,
        materials: Looks = "diffuse",
    ) -> None:
        """`size` is (width, height); `params` a `Params` or a dict of settings; `camera` None takes the scene's first.

        `filter` `box` or `gaussian` smooths edges: while all stands still, each frame's rays go through other points of
        the pixels, and images are averaged; layers are then for show. `state` continues with a state that `Method.load`
        read. `freeze` False traces every frame anew (for debugging).
        `progress` hears what a method does that takes long to build, and how far it is.
        `materials`: "full" for all that they do where the method shows it (`path`), else and with "diffuse" their
        diffuse part; a scene on the device keeps those that it was uploaded with. The default is what methods are
        compared by; pictures (`render_image`, `luxel render`) have "full".
        """
        check_materials(materials)
        self._device = runtime.start(device)
        if isinstance(scene, str | Path):
            from luxel.render.loading import load

            scene = load(scene)
        if not isinstance(scene, SceneData | Scene):
            raise LuxelError(f"a renderer takes a scene's name, its file or a SceneData, not {type(scene).__name__}")
        shown = find_method(method).shown_materials(materials)
        make_film(size, filter)
        whole = params is not None and not isinstance(params, dict)
        params = copy_params(method, params) if whole else make_params(method, preset, params)
        uploaded = upload(scene, recentre=True, materials=shown) if isinstance(scene, SceneData) else scene
        if isinstance(seed, bool) or not isinstance(seed, Integral):
            raise LuxelError(f"a seed is a whole number, not {show(seed)}")
        if state is not None and not is_dataclass(type(state)):
            raise LuxelError(f"a state is what Method.load has read, not {show(state)}")
        self._camera = self._find_camera(uploaded, camera, size)
        self._time = uploaded.host.time
        self._cache = Cache(uploaded, method, params, int(seed), state=state, progress=progress, freeze=freeze)
        self._view = CameraView(self._cache, size, average_direct=average_direct, filter=filter)
        self._held_params: tuple[Any, Any] = (None, None)

    def __setattr__(self, name: str, value: Any) -> None:
        own = getattr(type(self), name, None)
        if not (name.startswith("_") or getattr(own, "fset", None)):
            reason = "is nothing that it has" if own is None else "is settled when it is made: make another one"
            raise LuxelError(f"a renderer's '{name}' cannot be assigned: it {reason} (docs/live.md lists its calls)")
        object.__setattr__(self, name, value)

    def _caches(self) -> list[Cache]:
        return [self._cache]

    # ------------------------------------------------------------------ what it has

    @property
    def device(self) -> runtime.Device:
        """What renders."""
        return self._device

    @property
    def scene(self) -> Scene:  # type: ignore[override]
        """The uploaded scene."""
        return self._cache.scene

    @property
    def method(self) -> Method:
        """The method in use."""
        return self._cache.method

    @property
    def params(self) -> Any:
        """The method's parameters, held: `set_params` changes them."""
        if self._held_params[0] is not self._cache.params:
            self._held_params = self._cache.params, hold_params(self._cache.params)
        return self._held_params[1]

    @params.setter
    def params(self, params: Any) -> None:
        self.set_params(params)

    @property
    def seed(self) -> int:
        """What the random numbers begin with."""
        return self._cache.seed

    @property
    def state(self) -> Any:
        """The method's state."""
        return self._cache.state

    @state.setter
    def state(self, state: Any) -> None:
        wanted = type(self.state)
        if type(state) is not wanted:
            given = "class" if isinstance(state, type) else type(state).__name__
            raise LuxelError(f"a {self.method.name} renderer's state is its own {wanted.__name__}, not a {given}")
        self._cache.take_state(state)

    @property
    def screen(self) -> Any:
        """The method's history of this camera."""
        return self._view.screen

    @property
    def film(self) -> Film:
        """The image's size and the order of its pixels."""
        return self._view.film

    @property
    def camera(self) -> Camera:
        """The camera of the next frame, held: `set_camera` changes it."""
        return self._camera

    @camera.setter
    def camera(self, camera: Camera | str | int) -> None:
        self.set_camera(camera)

    @property
    def time(self) -> float:
        """Seconds that the next frame shows."""
        return self._time

    @time.setter
    def time(self, seconds: float) -> None:
        self.set_time(seconds)

    @property
    def average_direct(self) -> bool:
        """Whether a still view averages its noisy direct light."""
        return self._view.average_direct

    @average_direct.setter
    def average_direct(self, average: bool) -> None:
        if not isinstance(average, bool | np.bool_):
            raise LuxelError(f"average_direct is True or False, not {show(average)}")
        self._view.average_direct = bool(average)

    @property
    def frame_index(self) -> int:
        """Frames rendered since the state was built."""
        return self._cache.frame_index

    # ------------------------------------------------------------------ frames

    def step(self, time: float | None = None, camera: Camera | None = None) -> None:
        """Render one frame, asynchronously; `time` in seconds moves the scene, `camera` the view."""
        self._prepare(time, camera)
        self._view.step(self._camera)

    def run(
        self,
        frames: int,
        *,
        time_of: Callable[[int], float] | None = None,
        progress: Callable[[int], None] | None = None,
    ) -> list[float]:
        """Render `frames` frames and wait for each; return their whole-frame milliseconds."""
        if isinstance(frames, bool) or not isinstance(frames, Integral) or frames < 0:
            raise LuxelError(f"{show(frames)} is no number of frames: give a whole number of 0 or more")
        spent = []
        for index in range(int(frames)):
            start = clock.perf_counter()
            self.step(None if time_of is None else time_of(index))
            dr.sync_thread()
            spent.append(1e3 * (clock.perf_counter() - start))
            if progress is not None:
                progress(index + 1)
        return spent

    def staged(self, frames: int = 5) -> dict[str, float]:
        """Render `frames` frames stage by stage; return stage -> median milliseconds of device time."""
        return self.record(frames).medians()

    def record(self, frames: int = 5) -> Recorder:
        """Render `frames` frames stage by stage and return the recorder."""
        with recording() as recorder:
            for _ in range(frames):
                self._prepare(None, None)
                self._view.step(self._camera, staged=True)
                dr.sync_thread()
                dr.kernel_history_clear()
        return recorder

    def _prepare(self, time: float | None, camera: Camera | None) -> None:
        """Bring the scene to this frame's time, and take the camera."""
        if camera is not None and not (isinstance(camera, Camera) and camera == self._camera):
            self.set_camera(camera)
        if time is not None:
            self.set_time(time)
        # Motion vectors span the time between two calls, so that a scene at rest needs them too.
        if self.scene.features.moving or self._time != self.scene.host.time:
            set_time(self.scene, self._time)

    # ------------------------------------------------------------------ camera, time, parameters

    def set_camera(self, camera: Camera | str | int) -> None:
        """Look through another camera, or the scene's of that name or index, from the next frame on."""
        self._camera = self._find_camera(self.scene, camera, (self.film.width, self.film.height))

    def set_time(self, seconds: float) -> None:
        """Let the next frame show the scene at a time of its animation, seconds."""
        if not is_number(seconds):
            raise LuxelError(f"a scene has no time {seconds!r}: give finite seconds")
        self._time = float(seconds)

    def set_params(self, params: Any = None, *, preset: str | None = None, **settings: Any) -> bool:
        """Change the method's parameters: `set_params(rays_per_surfel=4)`, a preset, a dict or a whole `Params`.

        Return whether the cache could go on; else it starts anew. Raises LuxelError for a value that cannot be, and
        then changes nothing.
        """
        name, start = self.method.name, self._cache.params
        if isinstance(params, dict):
            settings = {**params, **settings}
        elif params is not None:
            start = copy_params(name, params)
        if preset is not None:
            start = make_params(name, preset)
        kept = self._cache.retune(change_params(name, start, settings))
        self._view.mark_changed()
        return kept

    @staticmethod
    def _find_camera(scene: Scene, camera: Camera | str | int | None, size: tuple[int, int]) -> Camera:
        data = scene.host.data
        if camera is None:
            return hold_scene(default_camera(data, size[0] / size[1]))
        if isinstance(camera, str | int):
            return data.cameras[find_index(data.cameras, camera, "camera")]
        if not isinstance(camera, Camera):
            raise LuxelError(f"a camera is a luxel.Camera or the name of one, not {camera!r}")
        check_camera(camera)
        return hold_scene(camera)

    # ------------------------------------------------------------------ what came out

    def image(self) -> np.ndarray:
        """Return the last frame, (H, W, 3) float32, linear scene-referred radiance."""
        return self.layers().image()

    def layers(self) -> Layers:
        """Return the last frame taken apart."""
        if self._view.picture is None:
            raise LuxelError("nothing has been rendered yet: call step() or run() first")
        return self._view.layers()

    def filtered_layers(self, filter: str, frames: int) -> Layers:
        """Return the last frame's view through a pixel filter: `frames` looks at the cache, which learns nothing."""
        view = CameraView(self._cache, (self.film.width, self.film.height), filter=filter)
        for _ in range(frames):
            view.look(self._camera, learn=False)
        return view.layers()

    def auto_exposure(self) -> float:
        """Return the exposure that suits the last frame: its lit surfaces at middle grey."""
        return auto_exposure(self.layers())

    def irradiance_at(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Return the method's indirect irradiance (N, 3) at free world `points` (N, 3) facing `normals` (N, 3).

        Points are in the file's coordinates, metres. Raises LuxelError for one that no scene has.
        """
        from luxel.kernels.surface import free_surface

        places = np.asarray(points, np.float64)
        if places.ndim != 2 or places.shape[1] != 3:
            raise LuxelError(f"irradiance is asked for at an array of points (N, 3), not {show(places)}")
        beyond = ~(np.abs(places) <= LARGEST).all(axis=1)
        if beyond.any():
            raise LuxelError(f"no scene reaches to {show(tuple(places[beyond][0].tolist()))}: ask at another point")
        places = places - self.scene.host.origin
        light = self.method.query(self.scene, self.state, free_surface(places, normals))
        return np.array(light.irradiance).T

    # ------------------------------------------------------------------ figures

    def cache(self) -> dict[str, int | float]:
        """Return the sizes of the method's cache."""
        return self.method.cache(self.state)

    @property
    def view_camera(self) -> Pinhole:
        """The pinhole of the last frame."""
        return self._view.pinhole

    @property
    def compilations(self) -> int:
        """How often the frame was recorded; each recording may compile kernels, a replay never does."""
        return self._cache.recordings
