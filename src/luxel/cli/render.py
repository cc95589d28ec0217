"""`luxel render`: one image or a sequence, its time, and its error against the truth."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from luxel.cli import console, options
from luxel.errors import LuxelError

if TYPE_CHECKING:
    from luxel.render.layers import Layers
    from luxel.render.renderer import Renderer
    from luxel.scene.model import SceneData

SHOWN_ERRORS = ("regional", "bias", "flip", "rmse_tonemapped", "abs_error_mean")
"""The figures that people get; `--json` has them all."""

Report = Callable[[str, float], None]


def render(
    scene: options.SceneName,
    method: options.Method = "gibs",
    preset: options.Preset = None,
    settings: options.Settings = None,
    size: options.Size = "512x512",
    frames: options.Frames = 64,
    seed: options.Seed = 0,
    device: options.DeviceName = "auto",
    flight: options.Flight = False,
    truth: Annotated[
        int | None,
        typer.Option(
            "--truth",
            min=1,
            metavar="[SPP]",
            help=f"Add the error against the truth; alone it means {options.TRUTH_SPP} samples a pixel.",
        ),
    ] = None,
    output: Annotated[
        str | None,
        typer.Option("-o", "--output", metavar="FILE", help="A .png or .exr; a folder, .gif or .mp4 for a sequence."),
    ] = None,
    sun: options.Sun = None,
    sky: options.Sky = None,
    envmap: options.EnvMap = None,
    camera: options.CameraText = None,
    time: Annotated[
        float,
        typer.Option("--time", metavar="SECONDS", help="Time in an animated scene.", rich_help_panel="Scene options"),
    ] = 0.0,
    exposure: Annotated[
        str, typer.Option("--exposure", metavar="auto|FACTOR", help="auto brings the mean luminance to 0.18.")
    ] = "auto",
    fps: Annotated[float, typer.Option("--fps", min=0.1, max=1000.0, help="Frames a second of a sequence.")] = 30.0,
    as_json: options.Json = False,
    debug: options.Debug = False,
) -> None:
    """Render a scene: an image after so many frames, or with a folder, .gif or .mp4 a sequence of them."""
    wanted, factor = options.parse_size(size), options.parse_exposure(exposure)
    given = options.parse_settings(settings)
    place = output or f"out/{_default_name(scene)}.png"
    _check_suffix(place)
    with console.logs_on_stderr(), console.progress_bar() as report:
        from luxel import runtime

        reason = runtime.start(device).reason
        from luxel.methods import make_params

        params = make_params(method, preset, given)
        data = options.load_scene(scene, sun=sun, sky=sky, envmap=envmap, camera=camera)
        _check_work(data, place, time, flight)
        renderer = _make_renderer(data, method, params, wanted, seed, time)
        if flight:
            report("flight", 0.0)
            renderer.fly()
        times, compiled = _render_frames(renderer, frames, place, factor, time, fps, report)
        layers = renderer.layers()
        result = {
            "scene": data.name,
            "method": method,
            "device": renderer.device.name,
            "size": list(wanted),
            "frames": frames,
            "image": place,
            "frame_ms": statistics.median(times),
            "stages": renderer.staged(),
            "rays_per_frame": renderer.rays_per_frame(),
            "cache": renderer.cache(),
            "compilations_after_warmup": compiled,
            "gpu_memory_mb" if renderer.device.name == "cuda" else "memory_mb": runtime.memory_mb(),
            "warnings": [*data.warnings, *renderer.method.warnings(renderer.state)],
        }
        if truth is not None:
            result["error"] = _measure_error(renderer, layers, truth, report)
    if as_json:
        from luxel.render.write import to_json

        print(to_json(result))
    else:
        console.warn(data.warnings)
        _print_result(result, reason)


# ---------- Frames ----------


def _make_renderer(
    data: SceneData, method: str, params: Any, size: tuple[int, int], seed: int, time: float
) -> Renderer:
    """Return the renderer for the scene at `time`."""
    from luxel.render.renderer import Renderer
    from luxel.scene.device import set_time, upload

    scene = upload(data)
    set_time(scene, time)
    return Renderer(scene, method=method, params=params, size=size, seed=seed)


def _render_frames(
    renderer: Renderer, frames: int, place: str, exposure: float | None, start: float, fps: float, report: Report
) -> tuple[list[float], int]:
    """Render and write; return the frame times in ms after warm-up, and the recordings after it."""
    from luxel.render.renderer import WARM_UP_FRAMES
    from luxel.render.sequence import is_sequence

    if is_sequence(place):
        return _render_sequence(renderer, frames, place, exposure, start, fps, report)
    from luxel.render.tonemap import auto_exposure, write_image

    warmup = min(WARM_UP_FRAMES, frames)
    times = renderer.run(warmup)
    recordings = renderer.compilations
    rest = renderer.run(frames - warmup, progress=lambda done: report("frames", (warmup + done) / frames))
    image = renderer.image()
    write_image(place, image, auto_exposure(image) if exposure is None else exposure)
    return rest or times, renderer.compilations - recordings


def _render_sequence(
    renderer: Renderer, frames: int, place: str, exposure: float | None, start: float, fps: float, report: Report
) -> tuple[list[float], int]:
    """Warm the cache up just before the start, then render and write frame i at `start` + i / fps seconds."""
    from luxel.render.renderer import WARM_UP_FRAMES
    from luxel.render.sequence import open_sequence
    from luxel.render.tonemap import auto_exposure, to_display

    times: list[float] = []
    with open_sequence(place, fps) as add:
        renderer.run(WARM_UP_FRAMES, time_of=lambda index: start + (index - WARM_UP_FRAMES) / fps)
        if exposure is None:
            # One exposure for the whole sequence: one a frame would pump.
            exposure = auto_exposure(renderer.image())
        recordings = renderer.compilations
        for index in range(frames):
            now = start + index / fps
            times += renderer.run(1, time_of=lambda _, now=now: now)
            add(to_display(renderer.image(), exposure))
            report("frames", (index + 1) / frames)
    return times, renderer.compilations - recordings


# ---------- Error ----------


def _measure_error(renderer: Renderer, layers: Layers, spp: int, report: Report) -> dict[str, Any]:
    """Return every figure of the last frame against the truth, and those of the trivial methods beside it."""
    import numpy as np

    from luxel.metrics import all_errors, ambient_irradiance
    from luxel.render.truth import render_truth

    film = renderer.film
    truth = render_truth(
        renderer.scene,
        camera=renderer.camera,
        size=(film.width, film.height),
        spp=spp,
        time=renderer.time,
        progress=lambda share: report("truth", share),
    )
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


# ---------- Output ----------


def _default_name(scene: str) -> str:
    """Return what the image is called without -o: the built-in scene without its dials, or the file's stem."""
    file = Path(scene)
    return file.stem if file.suffix.lower() in (".gltf", ".glb", ".xml") else scene.partition(":")[0].replace("/", "-")


def _check_work(data: SceneData, place: str, time: float, flight: bool) -> None:
    """Raise LuxelError before the work for what could only fail in it or after it."""
    from luxel.render.sequence import is_sequence
    from luxel.render.write import require_writable

    if flight and not data.flight:
        raise LuxelError(f"scene '{data.name}' names no flight; leave --flight out")
    if not math.isfinite(time):
        raise LuxelError(f"--time {time} is not a number of seconds")
    if not is_sequence(place):
        require_writable(place)


def _check_suffix(place: str) -> None:
    """Raise LuxelError where `place` is neither an image nor a sequence."""
    if not place.endswith("/") and Path(place).suffix.lower() not in ("", ".png", ".exr", ".gif", ".mp4"):
        raise LuxelError(f"cannot write {place}: give a .png or .exr, or for a sequence a folder, .gif or .mp4")


def _print_result(result: dict[str, Any], reason: str) -> None:
    width, height = result["size"]
    rows = [
        ("device", f"{result['device']} ({reason})"),
        ("frame", f"{console.format_number(result['frame_ms'])} ms (median of whole frames, {width}x{height})"),
        ("stages", "  ".join(f"{name} {ms:.2f}" for name, ms in result["stages"].items()) + " ms"),
        ("rays", f"{console.format_pairs(result['rays_per_frame'] or {})} a frame at most"),
        ("cache", console.format_pairs(result["cache"])),
    ]
    error = result.get("error")
    if error:
        every = {result["method"]: error, **error["baselines"]}
        for name, figures in every.items():
            shown = console.format_pairs({key: figures[key] for key in SHOWN_ERRORS})
            rows.append((f"error of {name}", shown))
        rows.append(("truth", f"{error['spp']} samples a pixel, noise {console.format_number(error['truth_noise'])}"))
    console.print_rows([*rows, ("image", result["image"])])
