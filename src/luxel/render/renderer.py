"""The frame, top to bottom.

    scene(t) -> update -> g-buffer -> shade -> direct light -> compose -> observe

`Renderer` runs it for one camera; the whole frame is one frozen function, recorded twice or thrice and then replayed.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel import runtime
from luxel.errors import LuxelError
from luxel.kernels.camera import Pinhole, make_pinhole
from luxel.kernels.direct import direct_irradiance
from luxel.kernels.film import Film
from luxel.kernels.gbuffer import GBuffer, trace_gbuffer
from luxel.methods.base import Frame, Method, Report
from luxel.methods.params import find_method, make_params
from luxel.render.collection import collection_paused
from luxel.render.layers import Layers
from luxel.scene.device import Scene, choose_layer, set_time, upload
from luxel.scene.edit import default_camera
from luxel.scene.model import Camera, SceneData
from luxel.stages import Recorder, recording, stage

SIZE_LIMIT = 16384
WARM_UP_FRAMES = 8
"""Frames in which kernels may still be recorded; none after."""


@dataclass
class View:
    """One camera's part of a frame: where it looks, and the running mean of its noisy direct light."""

    camera: Pinhole
    before: Pinhole
    frame: Frame
    direct: mi.Color3f
    direct_count: mi.UInt32
    mean: Picture | None = None
    """Scenes with blended surfaces: the running mean of the stochastic layers that a still view has seen."""


@dataclass
class Picture:
    """The layers of a finished frame, in tile order."""

    albedo: mi.Color3f
    emission: mi.Color3f
    direct: mi.Color3f
    indirect: mi.Color3f
    glossy: mi.Color3f
    weight: mi.Float
    hit: mi.Bool
    depth: mi.Float
    """Distance from the eye, metres; infinite for a miss."""
    normal: mi.Normal3f
    """World unit shading normal, on the viewer's side."""


def render_frame(
    method: Method, film: Film, scene: Scene, state: Any, screen: Any, view: View
) -> tuple[Any, Any, View, Picture]:
    """Advance everything by one frame. Returns the next state, screen and view, and the picture."""
    # Advance the world: the method's caches, without a camera.
    state = method.update(choose_layer(scene, layer_seed(view.frame)), state, view.frame)
    return render_view(method, film, scene, state, screen, view)


def render_view(
    method: Method, film: Film, scene: Scene, state: Any, screen: Any, view: View, learn: bool = True
) -> tuple[Any, Any, View, Picture]:
    """Look at the world as it is; of its state, only what the method learns from the view changes.

    Several cameras may look at one state in turn. `learn` False leaves the state alone. Returns as `render_frame`.
    """
    # Blended surfaces: each frame sees one layer of them, so what stands still is the view, not the surface behind
    # a pixel; whatever a method would average there waits for the mean of the layers at the end.
    frame = view.frame
    scene = choose_layer(scene, layer_seed(frame))
    if scene.features.blended:
        frame = replace(frame, still=mi.Bool(False))

    # See through the pixels' centres.
    with stage("gbuffer") as current:
        gbuffer = trace_gbuffer(scene, film, view.camera, view.before)
        current.keep(*seen_fields(gbuffer))
    surface = gbuffer.surface

    # Ask the method for the indirect light there.
    light, screen = method.shade(scene, state, screen, frame, gbuffer)

    # Light it directly; a still view averages the noise away over the frames.
    with stage("direct") as current:
        direct, count = mi.Color3f(0.0), mi.UInt32(0)
        if "direct" not in method.holds:
            seed = frame.seed + frame.index * 0x2545F491
            fresh = direct_irradiance(scene, surface, seed, gbuffer.lane, surface.active)
            count = dr.select(frame.still, view.direct_count, 0)
            direct = dr.lerp(view.direct, fresh, 1.0 / (mi.Float(count) + 1.0))
            direct = dr.select(count == 0, fresh, direct)
        current.keep(direct)

    # Compose the picture.
    with stage("compose") as current:
        picture = Picture(
            albedo=surface.albedo,
            emission=surface.emission + gbuffer.background,
            direct=direct,
            indirect=light.irradiance,
            glossy=light.radiance,
            weight=light.weight,
            hit=surface.active,
            depth=gbuffer.depth,
            normal=surface.n_shading,
        )
        mean = view.mean
        if scene.features.blended:
            picture, mean = average_layers(mean, picture, view.frame.still, view.direct_count)
            count = dr.select(view.frame.still, view.direct_count, 0)
        current.keep(picture)

    # Let the method learn from what this camera saw.
    if learn:
        state = method.observe(scene, state, frame, gbuffer, light)
    following = Frame(frame.index + 1, frame.seed, view.frame.still)
    return state, screen, View(view.camera, view.before, following, direct, count + 1, mean), picture


def average_layers(before: Picture | None, fresh: Picture, still: mi.Bool, count: mi.UInt32) -> tuple[Picture, Picture]:
    """Return the picture of all layers that a still view has seen, and the means to go on with.

    `before` are the means over `count` frames. Irradiances are averaged times
    albedo, as each layer reflects by its own.
    """
    products = replace(fresh, direct=fresh.albedo * fresh.direct, indirect=fresh.albedo * fresh.indirect)
    before = products if before is None else before
    share = dr.select(still, 1.0 / (mi.Float(count) + 1.0), 1.0)
    names = ("albedo", "emission", "direct", "indirect", "glossy", "weight")
    means = {name: dr.lerp(getattr(before, name), getattr(products, name), share) for name in names}
    mean = replace(products, **means, hit=fresh.hit | (still & before.hit))

    def demodulated(product: mi.Color3f, layer: mi.Color3f) -> mi.Color3f:
        return dr.select(mean.albedo > 1e-4, product / dr.fmax(mean.albedo, 1e-4), layer)

    picture = replace(
        mean, direct=demodulated(mean.direct, fresh.direct), indirect=demodulated(mean.indirect, fresh.indirect)
    )
    return picture, mean


def layer_seed(frame: Frame) -> mi.UInt32:
    """Return the number of the layer of blended surfaces that a frame sees."""
    return frame.seed + frame.index * 0x68E31DA4


class Renderer:
    """One scene, one method, one camera, frame by frame.

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
        camera: Camera | None = None,
        device: str = "auto",
        average_direct: bool = True,
        freeze: bool = True,
        state: Any = None,
        progress: Report | None = None,
    ) -> None:
        """`size` is (width, height); `params` a `Params` or a dict of settings; `camera` None takes the scene's first.

        `state` continues with a state that `Method.load` read. `freeze` False traces every frame anew (for debugging).
        `progress` hears what a method does that takes long to build, and how far it is.
        """
        self.device = runtime.start(device)
        if isinstance(scene, str | Path):
            from luxel.render.loading import load

            scene = load(scene)
        self.film = make_film(size)
        self.method = find_method(method)
        self.params = make_params(method, preset, params) if params is None or isinstance(params, dict) else params
        self.scene: Scene = upload(scene) if isinstance(scene, SceneData) else scene
        self.seed = seed
        self.camera = camera if camera is not None else default_camera(self.scene.host.data)
        self.state = self.method.build(self.scene, self.params, seed, progress=progress) if state is None else state
        self.screen = self.method.screen(self.scene, self.state, self.film.lane_count)
        self.average_direct = average_direct
        self.frame_index = 0
        self.time = self.scene.host.time
        self._changed = True
        self._flags = {value: dr.opaque(mi.Bool, value) for value in (False, True)}
        width, height = size
        self._view = View(
            camera=make_pinhole(self.camera, width, height, self.time),
            before=make_pinhole(self.camera, width, height, self.time),
            frame=Frame(
                dr.opaque(mi.UInt32, 0), dr.opaque(mi.UInt32, (seed * 0x9E3779B1 + 1) & 0xFFFFFFFF), self._flags[False]
            ),
            direct=dr.zeros(mi.Color3f, self.film.lane_count),
            direct_count=dr.opaque(mi.UInt32, 0),
        )
        dr.make_opaque(self._view.direct)
        self._picture: Picture | None = None
        self._recordings = 0
        self._frozen: Any = _freeze_frame(self.method, self.film) if freeze else _plain_frame(self.method, self.film)

    # ------------------------------------------------------------------ frames

    def step(self, time: float | None = None, camera: Camera | None = None) -> None:
        """Render one frame, asynchronously; `time` in seconds moves the scene, `camera` the view."""
        self._prepare(time, camera)
        self.state, self.screen, self._view, self._picture = self._advance()
        self.frame_index += 1

    def _advance(self) -> Any:
        """Replay the frozen frame.

        Scenes that come and go elsewhere in the process change Dr.Jit's registry of shapes, and a replay then refuses
        before it launches anything: the frame is recorded anew.
        """
        try:
            with collection_paused():
                return self._frozen(self.scene, self.state, self.screen, self._view)
        except RuntimeError as error:
            if "registry" not in str(error):
                raise
            self._recordings += self._frozen.n_recordings
            self._frozen = _freeze_frame(self.method, self.film)
            with collection_paused():
                return self._frozen(self.scene, self.state, self.screen, self._view)

    def run(
        self,
        frames: int,
        *,
        time_of: Callable[[int], float] | None = None,
        progress: Callable[[int], None] | None = None,
    ) -> list[float]:
        """Render `frames` frames and wait for each; return their whole-frame milliseconds."""
        spent = []
        for index in range(frames):
            start = clock.perf_counter()
            self.step(None if time_of is None else time_of(index))
            dr.sync_thread()
            spent.append(1e3 * (clock.perf_counter() - start))
            if progress is not None:
                progress(index + 1)
        return spent

    def fly(self, frames_a_view: int = 8) -> None:
        """Fly along the scene's `flight`, so that the method has seen every surface; then return to the camera."""
        from luxel.render.flight import fly_through

        fly_through(self, frames_a_view)

    def staged(self, frames: int = 5) -> dict[str, float]:
        """Render `frames` frames stage by stage; return stage -> median milliseconds of device time."""
        return self.record(frames).medians()

    def record(self, frames: int = 5) -> Recorder:
        """Render `frames` frames stage by stage and return the recorder."""
        plain = _plain_frame(self.method, self.film)
        with recording() as recorder:
            for _ in range(frames):
                self._prepare(None, None)
                result = plain(self.scene, self.state, self.screen, self._view)
                self.state, self.screen, self._view, self._picture = result
                dr.eval(*result)
                dr.sync_thread()
                dr.kernel_history_clear()
                self.frame_index += 1
        return recorder

    def _prepare(self, time: float | None, camera: Camera | None) -> None:
        """Bring scene and view to this frame; decide whether anything stood still."""
        moved = self._changed
        self._changed = False
        if time is not None or self.scene.features.moving:
            self.time = self.time if time is None else time
            moved |= set_time(self.scene, self.time)
        camera = self.camera if camera is None else camera
        turned = camera is not self.camera or (camera.motion is not None and moved)
        width, height = self.film.width, self.film.height
        view = self._view
        if turned or self._turned_before:
            before = make_pinhole(self.camera, width, height, self._time_before)
            view = replace(view, camera=make_pinhole(camera, width, height, self.time), before=before)
            self.camera = camera
        self._turned_before, self._time_before = turned, self.time
        still = not moved and not turned and self.average_direct
        self._view = replace(view, frame=replace(view.frame, still=self._flags[still]))

    _turned_before = False
    _time_before = 0.0

    # ------------------------------------------------------------------ what came out

    def image(self) -> np.ndarray:
        """Return the last frame, (H, W, 3) float32, linear scene-referred radiance."""
        return self.layers().image()

    def layers(self) -> Layers:
        """Return the last frame taken apart."""
        if self._picture is None:
            raise LuxelError("nothing has been rendered yet: call step() or run() first")
        return take_apart(self._picture, self.film)

    def irradiance_at(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Return the method's indirect irradiance (N, 3) at free world `points` (N, 3) facing `normals` (N, 3)."""
        from luxel.kernels.surface import free_surface

        light = self.method.query(self.scene, self.state, free_surface(points, normals))
        return _to_numpy(light.irradiance)

    # ------------------------------------------------------------------ dials and figures

    def set_light_scale(self, factor: float) -> None:
        """Multiply every light, emission and sky by `factor`; compiles nothing."""
        self.scene.lights.scale = dr.opaque(mi.Float, float(factor))
        self._changed = True

    def rays_per_frame(self) -> dict[str, int] | None:
        """Return rays a frame at most, by kind: `closest` and `shadow`, g-buffer and direct light included.

        None where the method does not count its rays.
        """
        from luxel.render.floor import count_rays

        return count_rays(self) if self.method.counts_rays else None

    def floor_ms(self, repeats: int = 5) -> float | None:
        """Return the floor: the bare ray casts of a frame plus its unavoidable memory traffic, milliseconds.

        None where the method does not count its rays.
        """
        from luxel.render.floor import measure_floor

        return measure_floor(self, repeats) if self.method.counts_rays else None

    @property
    def view_camera(self) -> Pinhole:
        """The pinhole of the last frame."""
        return self._view.camera

    def cache(self) -> dict[str, int | float]:
        """Return the sizes of the method's cache."""
        return self.method.cache(self.state)

    @property
    def compilations(self) -> int:
        """How often the frame was recorded; each recording may compile kernels, a replay never does."""
        return self._recordings + getattr(self._frozen, "n_recordings", 0)


def seen_fields(gbuffer: GBuffer) -> list[Any]:
    """Return what every frame needs of the g-buffer; the rest is computed only where a method asks for it."""
    surface = gbuffer.surface
    shape = [surface.p, surface.n_geometric, surface.n_shading, surface.prim_id, surface.barycentric, surface.front]
    return [*shape, surface.albedo, surface.emission, surface.active, gbuffer.background, gbuffer.depth]


def take_apart(picture: Picture, film: Film) -> Layers:
    """Return a picture's layers as arrays of `film`'s size; waits for it."""
    plane = film.to_image
    return Layers(
        albedo=plane(picture.albedo),
        emission=plane(picture.emission),
        direct=plane(picture.direct),
        indirect=plane(picture.indirect),
        glossy=plane(picture.glossy),
        weight=plane(picture.weight),
        hit=plane(picture.hit).astype(bool),
    )


def make_film(size: tuple[int, int]) -> Film:
    """Return the film of (width, height). Raises LuxelError for a size that cannot be rendered."""
    width, height = size
    if not (1 <= width <= SIZE_LIMIT and 1 <= height <= SIZE_LIMIT):
        raise LuxelError(f"size {width}x{height} cannot be rendered: width and height go from 1 to {SIZE_LIMIT}")
    return Film(int(width), int(height))


def _plain_frame(method: Method, film: Film) -> Callable[..., Any]:
    def frame(scene: Scene, state: Any, screen: Any, view: View) -> Any:
        return render_frame(method, film, scene, state, screen, view)

    return frame


def _freeze_frame(method: Method, film: Film) -> Callable[..., Any]:
    return dr.freeze(_plain_frame(method, film))


def _to_numpy(value: Any) -> np.ndarray:
    """Return a Dr.Jit array or colour as (N,) or (N, 3)."""
    array = np.array(value)
    return array.T if array.ndim == 2 else array


__all__ = ["Picture", "Renderer", "View", "make_film", "render_frame", "render_view", "take_apart"]
