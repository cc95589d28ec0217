"""`luxel render`: one image or a sequence, its time, and its error against the truth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from luxel.cli import console, options
from luxel.cli import render_options as own
from luxel.cli.looks import parse_looks, parse_point, print_looks
from luxel.cli.render_work import CacheFiles, Order, Sequence, fulfil
from luxel.errors import LuxelError
from luxel.scene.choice import PICTURE_FILTER, check_filter, check_materials

SHOWN_ERRORS = ("regional", "bias", "flip", "rmse_tonemapped", "abs_error_mean")
"""The figures that people get; `--json` has them all."""


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
    truth: own.Truth = None,
    output: own.Output = None,
    sun: options.Sun = None,
    sky: options.Sky = None,
    envmap: options.EnvMap = None,
    camera: options.CameraText = None,
    animation: options.Animation = None,
    time: own.Time = 0.0,
    materials: options.Materials = "full",
    exposure: options.ExposureText = "auto",
    pixel_filter: options.Filter = PICTURE_FILTER,
    fps: own.FramesASecond = 30.0,
    warm_up: own.WarmUp = None,
    save_cache: own.SaveCache = None,
    load_cache: own.LoadCache = None,
    atlases: own.Atlases = None,
    look: own.Look = None,
    pixel: own.Pixel = None,
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
    changes = {"sun": sun, "sky": sky, "envmap": envmap, "camera": camera, "animation": animation}
    order = Order(
        scene, changes, method, given, preset, wanted, frames, seed, device, flight, truth, place, factor, materials,
        pixel_filter, Sequence(time, fps, warm_up), files, looks, point, quiet=as_json,
    )  # fmt: skip
    with console.logs_on_stderr(), console.progress_bar() as report:
        result, reason = fulfil(order, report)
    if as_json:
        from luxel.files import to_json

        print(to_json(result))
    else:
        console.warn(result["warnings"])
        _print_result(result, reason)


def _default_name(scene: str) -> str:
    """Return what the image is called without -o: the built-in scene without its dials, or the file's stem."""
    file = Path(scene)
    return file.stem if file.suffix.lower() in (".gltf", ".glb", ".xml") else scene.partition(":")[0].replace("/", "-")


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
