"""What `luxel render` does once its words are read: the renderer, the frames, the figures, the cache's files."""

from __future__ import annotations

import math
import statistics
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from luxel.cli import options
from luxel.cli.looks import write_looks
from luxel.cli.remarks import remark
from luxel.errors import LuxelError

if TYPE_CHECKING:
    from luxel.image.layers import Layers
    from luxel.render.exposure import Exposure
    from luxel.render.renderer import Renderer
    from luxel.render.truth import Truth
    from luxel.scene.host import Looks
    from luxel.scene.model import SceneData

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Sequence:
    """What only a sequence asks for."""

    start: float
    """Seconds."""
    fps: float
    warm_up: int | None
    """Frames before the first picture; None: until the view is covered."""


@dataclass(frozen=True)
class CacheFiles:
    """Where the cache comes from and goes to."""

    save: str | None
    load: str | None
    atlases: str | None

    def check_names(self, method: str) -> None:
        """Raise LuxelError, before anything heavy starts, for what the names alone tell."""
        if self.atlases is not None:
            from luxel.methods.params import find_method

            inspector = find_method(method).inspector
            if inspector is None or not inspector.atlases:
                raise LuxelError(f"--atlases writes the probes of method 'ddgi', not of '{method}'; leave it out")
        if self.save is not None and Path(self.save).suffix.lower() != ".npz":
            raise LuxelError(f"cannot write {self.save}: a cache is written as .npz")

    def check_places(self) -> None:
        """Raise LuxelError before the work where a file could not be read or written after it."""
        from luxel.files import require_writable

        if self.load is not None and not Path(self.load).is_file():
            raise LuxelError(f"cannot read {self.load}: there is no such file; write one with --save-cache")
        if self.save is not None:
            require_writable(self.save)
        if self.atlases is not None:
            require_writable(Path(self.atlases) / "probes.json")

    def write(self, renderer: Renderer) -> dict[str, Any]:
        """Write what was asked for; return what the result says of it."""
        written: dict[str, Any] = {}
        if self.save is not None:
            renderer.method.save(renderer.state, Path(self.save))
            written["cache_file"] = self.save
        if self.atlases is not None:
            from luxel.methods.inspect import inspector_of

            files = inspector_of(renderer.method).write_atlases(renderer.state, self.atlases)
            written["atlases"] = [str(path) for path in files]
        return written


@dataclass(frozen=True)
class Order:
    """What one call of `luxel render` asks for, its words read."""

    scene: str
    changes: dict[str, str | None]
    """Scene options by name, each as its flag has it."""
    method: str
    params: dict[str, str]
    """Settings of the method, on top of the preset."""
    preset: str | None
    size: tuple[int, int]
    frames: int
    seed: int
    device: str
    flight: bool
    truth: int | None
    """Samples a pixel of the truth to measure against; None: there is none."""
    place: str
    """Where the image or the sequence goes."""
    exposure: Exposure
    materials: str
    pixel_filter: str
    film: Sequence
    files: CacheFiles
    looks: list[str]
    point: tuple[int, int] | None
    quiet: bool
    """Nothing is said meanwhile."""


def fulfil(order: Order, report: Progress) -> tuple[dict[str, Any], str]:
    """Render, write and measure what is asked for; return what `--json` prints, and why the device is the one it is.

    Raises LuxelError for a scene, parameters or places that cannot be used.
    """
    from luxel import runtime

    reason = runtime.start(order.device).reason
    from luxel.render.flight import fly_through

    renderer, data = _prepare(order, report)
    if order.flight:
        report("flight", 0.0)
        fly_through(renderer)
    times, compiled = _render_frames(order, renderer, report)
    layers = renderer.layers()
    written = order.files.write(renderer)
    result = {
        **_describe(order, renderer, times, compiled),
        "warnings": remark(data, renderer, layers, order.materials, order.truth is not None),
        **written,
    }
    measured = None
    if order.truth is not None:
        measured = _render_truth(renderer, order.truth, report)
        result["error"] = _measure_error(layers, measured)
    if order.looks:
        given = None if measured is None else measured.layers
        result["looks"] = write_looks(renderer, order.looks, order.place, given, order.exposure, order.point)
    return result, reason


def _prepare(order: Order, report: Progress) -> tuple[Renderer, SceneData]:
    """Return the renderer at the time that is asked for, and the scene as it was read.

    First say what it will allocate, unless the order is quiet. Methods that light the diffuse part alone get a scene of
    diffuse materials, whatever is asked for.
    """
    from luxel.methods import make_params
    from luxel.methods.params import find_method
    from luxel.render.renderer import Renderer
    from luxel.scene.device import set_time, upload

    params = make_params(order.method, order.preset, order.params)
    data = options.load_scene(order.scene, **order.changes)
    _check_work(order.place, order.film.start)
    order.files.check_places()
    found = find_method(order.method)
    scene = upload(data, materials=found.shown_materials(cast("Looks", order.materials)))
    set_time(scene, order.film.start)
    plan = found.plan(scene, params)
    if not order.quiet:
        for line in plan:
            print(f"luxel: {line}", file=sys.stderr)
    load = order.files.load
    renderer = Renderer(
        scene,
        method=order.method,
        params=params,
        size=order.size,
        seed=order.seed,
        # Figures belong to the pixels' centres: then a filtered picture is one more look, and of an image only.
        filter="none" if order.truth is not None else order.pixel_filter,
        state=None if load is None else found.load(scene, params, Path(load)),
        progress=report,
    )
    return renderer, data


def _describe(order: Order, renderer: Renderer, times: list[float], compiled: int) -> dict[str, Any]:
    """Return what the result says of the run itself."""
    from luxel import runtime
    from luxel.render.floor import count_rays

    return {
        "scene": renderer.data.name,
        "method": order.method,
        "device": renderer.device.name,
        "size": list(order.size),
        "frames": order.frames,
        "image": order.place,
        "frame_ms": statistics.median(times),
        "stages": renderer.staged(),
        "rays_per_frame": count_rays(renderer),
        "cache": renderer.cache(),
        "compilations_after_warmup": compiled,
        "gpu_memory_mb" if renderer.device.name == "cuda" else "memory_mb": runtime.memory_mb(),
        "materials": renderer.scene.host.looks,
    }


def _render_frames(order: Order, renderer: Renderer, report: Progress) -> tuple[list[float], int]:
    """Render and write; return the frame times in ms after warm-up, and the recordings after it."""
    from luxel.render.renderer import WARM_UP_FRAMES
    from luxel.render.sequence import is_sequence

    frames, film = order.frames, order.film
    if is_sequence(order.place):
        from luxel.render.animate import render_sequence

        return render_sequence(
            renderer, order.place, frames, fps=film.fps, start=film.start, exposure=order.exposure,
            warm_up_frames=film.warm_up,
            progress=lambda done: report("frames", done / frames),
        )  # fmt: skip
    from luxel.image.tonemap import write_image

    warmup = min(WARM_UP_FRAMES, frames)
    times = renderer.run(warmup)
    recordings = renderer.compilations
    rest = renderer.run(frames - warmup, progress=lambda done: report("frames", (warmup + done) / frames))
    if renderer.film.filter == order.pixel_filter:
        layers = renderer.layers()
    else:
        layers = renderer.filtered_layers(order.pixel_filter, frames)
    write_image(order.place, layers.image(), order.exposure.of(layers))
    return rest or times, renderer.compilations - recordings


def _render_truth(renderer: Renderer, spp: int, report: Progress) -> Truth:
    """Return the truth of the last frame."""
    from luxel.render.truth import render_truth

    film = renderer.film
    return render_truth(
        renderer.scene,
        camera=renderer.camera,
        size=(film.width, film.height),
        spp=spp,
        time=renderer.time,
        progress=lambda share: report("truth", share),
    )


def _measure_error(layers: Layers, truth: Truth) -> dict[str, Any]:
    """Return every figure of the last frame against the truth, and those of the trivial methods beside it."""
    import numpy as np

    from luxel.metrics import all_errors, ambient_irradiance

    ambient = np.broadcast_to(np.asarray(ambient_irradiance(truth.layers), np.float32), layers.indirect.shape)
    trivial = {"none": np.zeros_like(layers.indirect), "ambient": ambient}
    return {
        **all_errors(layers, truth.layers, truth.halves),
        "spp": truth.spp,
        "baselines": {
            name: all_errors(replace(layers, indirect=indirect), truth.layers, truth.halves)
            for name, indirect in trivial.items()
        },
    }


def _check_work(place: str, time: float) -> None:
    """Raise LuxelError before the work for what could only fail in it or after it."""
    from luxel.files import require_writable
    from luxel.render.sequence import is_sequence

    if not math.isfinite(time):
        raise LuxelError(f"--time {time} is not a number of seconds")
    if not is_sequence(place):
        require_writable(place)
