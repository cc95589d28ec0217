"""`luxel bench`: how fast a method is, beside the floor of the same run."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from luxel.cli import console, options


def bench(
    method: Annotated[str, typer.Argument(metavar="[METHOD|FILE.py:Class]", help="The method to time.")] = "gibs",
    scene: Annotated[
        str, typer.Option("--scene", metavar="SCENE", help="A built-in scene or a scene file.")
    ] = "cornell-box",
    preset: options.Preset = None,
    settings: options.Settings = None,
    size: options.Size = "512x512",
    frames: options.Frames = 64,
    seed: options.Seed = 0,
    materials: options.Materials = "diffuse",
    device: options.DeviceName = "auto",
    flight: options.Flight = False,
    sun: options.Sun = None,
    sky: options.Sky = None,
    envmap: options.EnvMap = None,
    camera: options.CameraText = None,
    animation: options.Animation = None,
    as_json: options.Json = False,
    record: Annotated[
        bool, typer.Option("--record", help="Append the result to benchmarks/results/<machine>.jsonl.")
    ] = False,
    debug: options.Debug = False,
) -> None:
    """Time whole frames and stages after a warm-up, and the bare rays of such a frame in the same run."""
    wanted, given = options.parse_size(size), options.parse_settings(settings)
    method, preset = options.choose_method(method, preset, device)
    place = None
    with console.logs_on_stderr(), console.progress_bar() as report:
        from luxel import runtime

        runtime.start(device)
        from luxel import bench as benchmarks
        from luxel.methods import make_params

        make_params(method, preset, given)
        data = options.load_scene(scene, sun=sun, sky=sky, envmap=envmap, camera=camera, animation=animation)
        result = benchmarks.bench(
            method,
            data,
            size=wanted,
            frames=frames,
            seed=seed,
            materials=materials,
            preset=preset,
            params=given,
            flight=flight,
            device=device,
            progress=report,
        )
        if record:
            place = benchmarks.record(result)
    if as_json:
        from luxel.files import to_json

        print(to_json(result))
        return
    console.warn(result["warnings"])
    _print_result(result)
    if place is not None:
        print(f"appended to {place}")


def _print_result(result: dict[str, Any]) -> None:
    width, height = result["size"]
    frame, number = result["frame_ms"], console.format_number
    machine = result["machine"]
    on_gpu = result["device"] == "cuda"
    rate = result["rays_per_second"]
    floor = f"{number(result['floor_ms'])} ms; the frame takes {number(result['ratio'])} times as long"
    if result["floor_ms"] is None:
        floor = "none: the method does not count its rays"
    memory = result.get("gpu_memory_mb", result.get("memory_mb"))
    console.print_rows(
        [
            ("device", f"{result['device']}: {machine['gpu'] if on_gpu else machine['cpu']}, {machine['cores']} cores"),
            (
                "run",
                f"{result['method']} on {result['scene']}, {width}x{height}, {result['frames']} frames, "
                f"{result['materials']} materials",
            ),
            ("frame", f"{number(frame['median'])} ms (median; {number(frame['min'])} to {number(frame['max'])})"),
            ("floor", floor),
            ("stages", "  ".join(f"{name} {ms:.2f}" for name, ms in result["stages"].items()) + " ms"),
            ("rays", console.format_rays(result["rays_per_frame"])),
            ("", "") if rate is None else ("ray rate", f"{number(rate / 1e6)} million a second"),
            ("cache", console.format_pairs(result["cache"])),
            ("memory", f"{number(memory)} MB"),
            ("warm-up", f"{number(result['warmup_ms'])} ms, compilation included"),
        ]
    )
