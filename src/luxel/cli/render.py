"""`luxel render`: one image or a sequence, its time, and its error against the truth."""

from __future__ import annotations

import math
import statistics
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from luxel.cli import console, options
from luxel.cli.looks import parse_looks, parse_point, print_looks, write_looks
from luxel.cli.remarks import remark
from luxel.errors import LuxelError
from luxel.scene.choice import PICTURE_FILTER, check_filter, check_materials

if TYPE_CHECKING:
    from luxel.image.layers import Layers
    from luxel.render.exposure import Exposure
    from luxel.render.renderer import Renderer
    from luxel.render.truth import Truth
    from luxel.scene.host import Looks
    from luxel.scene.model import SceneData

SHOWN_ERRORS = ("regional", "bias", "flip", "rmse_tonemapped", "abs_error_mean")
"""The figures that people get; `--json` has them all."""

_CACHE = "Cache options"

Progress = Callable[[str, float], None]


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
    animation: options.Animation = None,
    time: Annotated[
        float,
        typer.Option("--time", metavar="SECONDS", help="Time in an animated scene.", rich_help_panel="Scene options"),
    ] = 0.0,
    materials: options.Materials = "full",
    exposure: options.ExposureText = "auto",
    pixel_filter: options.Filter = PICTURE_FILTER,
    fps: Annotated[float, typer.Option("--fps", min=0.1, max=1000.0, help="Frames a second of a sequence.")] = 30.0,
    warm_up: Annotated[
        int | None,
        typer.Option(
            "--warm-up",
            min=0,
            metavar="FRAMES",
            help="Frames before the first picture of a sequence; without, until the view is covered.",
        ),
    ] = None,
    save_cache: Annotated[
        str | None,
        typer.Option(
            "--save-cache",
            metavar="FILE.npz",
            help="Write the method's cache after the frames.",
            rich_help_panel=_CACHE,
        ),
    ] = None,
    load_cache: Annotated[
        str | None,
        typer.Option(
            "--load-cache",
            metavar="FILE.npz",
            help="Go on from a cache of the same scene and parameters.",
            rich_help_panel=_CACHE,
        ),
    ] = None,
    atlases: Annotated[
        str | None,
        typer.Option(
            "--atlases", metavar="DIR", help="ddgi: write the probes' atlases as EXR.", rich_help_panel=_CACHE
        ),
    ] = None,
    look: Annotated[
        list[str] | None,
        typer.Option(
            "--look",
            metavar="NAME",
            help="Also draw NAME beside the image; a comma list; `list` names all.",
        ),
    ] = None,
    pixel: Annotated[
        str | None,
        typer.Option("--pixel", metavar="X,Y", help="The point of a look that shows what lights one; else the middle."),
    ] = None,
    as_json: options.Json = False,
    debug: options.Debug = False,
) -> None:
    """Render a scene: an image after so many frames, or with a folder, .gif or .mp4 a sequence of them."""
    wanted, factor = options.parse_size(size), options.parse_exposure(exposure)
    given = options.parse_settings(settings)
    check_filter(pixel_filter)
    check_materials(materials)
    place = output or f"out/{_default_name(scene)}.png"
    _check_suffix(place)
    _check_warm_up(place, warm_up)
    method, preset = options.choose_method(method, preset, device)
    files = CacheFiles(save_cache, load_cache, atlases)
    files.check_names(method)
    looks = parse_looks(look, method, place, truth is not None)
    if looks is None:
        return print_looks(method, as_json)
    point = parse_point(pixel, wanted, looks, method)
    with console.logs_on_stderr(), console.progress_bar() as report:
        from luxel import runtime

        reason = runtime.start(device).reason
        from luxel.methods import make_params
        from luxel.render.flight import fly_through
        from luxel.render.floor import count_rays

        params = make_params(method, preset, given)
        data = options.load_scene(scene, sun=sun, sky=sky, envmap=envmap, camera=camera, animation=animation)
        _check_work(place, time)
        files.check_places()
        # Figures belong to the pixels' centres: then a filtered picture is one more look, and of an image only.
        of_frames = "none" if truth is not None else pixel_filter
        renderer = _make_renderer(
            data, method, params, wanted, seed, time, _Looks(materials, of_frames), files, as_json, report
        )
        if flight:
            report("flight", 0.0)
            fly_through(renderer)
        film = Sequence(time, fps, warm_up)
        times, compiled = _render_frames(renderer, frames, place, factor, pixel_filter, film, report)
        layers = renderer.layers()
        written = files.write(renderer)
        result = {
            "scene": data.name,
            "method": method,
            "device": renderer.device.name,
            "size": list(wanted),
            "frames": frames,
            "image": place,
            "frame_ms": statistics.median(times),
            "stages": renderer.staged(),
            "rays_per_frame": count_rays(renderer),
            "cache": renderer.cache(),
            "compilations_after_warmup": compiled,
            "gpu_memory_mb" if renderer.device.name == "cuda" else "memory_mb": runtime.memory_mb(),
            "materials": renderer.scene.host.looks,
            "warnings": remark(data, renderer, layers, materials, truth is not None),
            **written,
        }
        measured = None
        if truth is not None:
            measured = _render_truth(renderer, truth, report)
            result["error"] = _measure_error(layers, measured)
        if looks:
            given = None if measured is None else measured.layers
            result["looks"] = write_looks(renderer, looks, place, given, factor, point)
    if as_json:
        from luxel.files import to_json

        print(to_json(result))
    else:
        console.warn(result["warnings"])
        _print_result(result, reason)


# ---------- Cache files ----------


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


# ---------- Frames ----------


@dataclass(frozen=True)
class Sequence:
    """What only a sequence asks for."""

    start: float
    """Seconds."""
    fps: float
    warm_up: int | None
    """Frames before the first picture; None: until the view is covered."""


@dataclass(frozen=True)
class _Looks:
    """How a scene is to be shown."""

    materials: str
    """What is asked for."""
    pixel_filter: str


def _make_renderer(
    data: SceneData,
    method: str,
    params: Any,
    size: tuple[int, int],
    seed: int,
    time: float,
    looks: _Looks,
    files: CacheFiles,
    quiet: bool,
    report: Progress,
) -> Renderer:
    """Return the renderer for the scene at `time`; first say what it will allocate, unless `quiet`.

    Methods that light the diffuse part alone get a scene of diffuse materials, whatever is asked for.
    """
    from luxel.methods.params import find_method
    from luxel.render.renderer import Renderer
    from luxel.scene.device import set_time, upload

    found = find_method(method)
    scene = upload(data, materials=found.shown_materials(cast("Looks", looks.materials)))
    set_time(scene, time)
    plan = found.plan(scene, params)
    if not quiet:
        for line in plan:
            print(f"luxel: {line}", file=sys.stderr)
    state = None if files.load is None else found.load(scene, params, Path(files.load))
    return Renderer(
        scene,
        method=method,
        params=params,
        size=size,
        seed=seed,
        filter=looks.pixel_filter,
        state=state,
        progress=report,
    )


def _render_frames(
    renderer: Renderer,
    frames: int,
    place: str,
    exposure: Exposure,
    pixel_filter: str,
    film: Sequence,
    report: Progress,
) -> tuple[list[float], int]:
    """Render and write; return the frame times in ms after warm-up, and the recordings after it."""
    from luxel.render.renderer import WARM_UP_FRAMES
    from luxel.render.sequence import is_sequence

    if is_sequence(place):
        from luxel.render.animate import render_sequence

        return render_sequence(
            renderer, place, frames, fps=film.fps, start=film.start, exposure=exposure, warm_up_frames=film.warm_up,
            progress=lambda done: report("frames", done / frames),
        )  # fmt: skip
    from luxel.image.tonemap import write_image

    warmup = min(WARM_UP_FRAMES, frames)
    times = renderer.run(warmup)
    recordings = renderer.compilations
    rest = renderer.run(frames - warmup, progress=lambda done: report("frames", (warmup + done) / frames))
    if renderer.film.filter == pixel_filter:
        layers = renderer.layers()
    else:
        layers = renderer.filtered_layers(pixel_filter, frames)
    write_image(place, layers.image(), exposure.of(layers))
    return rest or times, renderer.compilations - recordings


# ---------- Error ----------


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


# ---------- Output ----------


def _default_name(scene: str) -> str:
    """Return what the image is called without -o: the built-in scene without its dials, or the file's stem."""
    file = Path(scene)
    return file.stem if file.suffix.lower() in (".gltf", ".glb", ".xml") else scene.partition(":")[0].replace("/", "-")


def _check_work(place: str, time: float) -> None:
    """Raise LuxelError before the work for what could only fail in it or after it."""
    from luxel.files import require_writable
    from luxel.render.sequence import is_sequence

    if not math.isfinite(time):
        raise LuxelError(f"--time {time} is not a number of seconds")
    if not is_sequence(place):
        require_writable(place)


def _check_suffix(place: str) -> None:
    """Raise LuxelError where `place` is neither an image nor a sequence."""
    if not place.endswith("/") and Path(place).suffix.lower() not in ("", ".png", ".exr", ".gif", ".mp4"):
        raise LuxelError(f"cannot write {place}: give a .png or .exr, or for a sequence a folder, .gif or .mp4")


def _check_warm_up(place: str, frames: int | None) -> None:
    """Raise LuxelError where a single image is asked to start warm: its frames are the warm-up."""
    from luxel.render.sequence import is_sequence

    if frames is not None and not is_sequence(place):
        raise LuxelError(f"--warm-up is for sequences; {place} is one image, so use --frames")


def _print_result(result: dict[str, Any], reason: str) -> None:
    width, height = result["size"]
    rows = [
        ("device", f"{result['device']} ({reason})"),
        ("frame", f"{console.format_number(result['frame_ms'])} ms (median of whole frames, {width}x{height})"),
        ("stages", "  ".join(f"{name} {ms:.2f}" for name, ms in result["stages"].items()) + " ms"),
        ("rays", console.format_rays(result["rays_per_frame"])),
        ("cache", console.format_pairs(result["cache"])),
    ]
    error = result.get("error")
    if error:
        every = {result["method"]: error, **error["baselines"]}
        for name, figures in every.items():
            shown = console.format_pairs({key: figures[key] for key in SHOWN_ERRORS})
            rows.append((f"error of {name}", shown))
        rows.append(("truth", f"{error['spp']} samples a pixel, noise {console.format_number(error['truth_noise'])}"))
    rows += [("cache file", result.get("cache_file", "")), ("atlases", "  ".join(result.get("atlases", ())))]
    rows.append(("looks", "  ".join(result.get("looks", {}).values())))
    console.print_rows([*rows, ("image", result["image"])])
