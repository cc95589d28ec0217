"""`luxel compare`: methods beside the truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from luxel.cli import console, options

COLUMNS = ("regional", "bias", "flip", "flicker", "lag_frames", "leak", "frame_ms", "floor_ms")
"""The figures that people get; `--json` and results.json have them all."""


def compare(
    scenes: Annotated[list[str], typer.Argument(metavar="SCENE...", help="Built-in scenes or scene files.")],
    output: Annotated[str, typer.Option("-o", "--output", metavar="DIR", help="Folder for results and images.")],
    methods: Annotated[
        str,
        typer.Option(
            "--methods", metavar="A,B", help="Methods; one with a preset is gibs:ekberg. none and ambient always run."
        ),
    ] = "gibs",
    reference: Annotated[
        str,
        typer.Option("--reference", metavar="diffuse|full", help="full keeps the scene's own materials in the truth."),
    ] = "diffuse",
    reference_spp: Annotated[int | None, typer.Option(min=1, metavar="N", help="Samples a pixel of the truth.")] = None,
    seeds: Annotated[str, typer.Option("--seeds", metavar="0,1,2", help="One run for each; means are reported.")] = "0",
    size: options.Size = "512x512",
    frames: options.Frames = 64,
    flight: options.Flight = False,
    device: options.DeviceName = "auto",
    sun: options.Sun = None,
    sky: options.Sky = None,
    envmap: options.EnvMap = None,
    camera: options.CameraText = None,
    as_json: options.Json = False,
    debug: options.Debug = False,
) -> None:
    """Compare methods with the truth and with each other: results.json, images and FLIP maps in a folder."""
    wanted, numbers = options.parse_size(size), options.parse_seeds(seeds)
    with console.logs_on_stderr(), console.progress_bar() as report:
        from luxel import runtime
        from luxel.report.compare import compare as run_comparison

        runtime.start(device)
        loaded = [options.load_scene(name, sun=sun, sky=sky, envmap=envmap, camera=camera) for name in scenes]
        results = run_comparison(
            loaded,
            methods.split(","),
            reference=reference,
            reference_spp=reference_spp,
            seeds=numbers,
            size=wanted,
            frames=frames,
            flight=flight,
            device=device,
            out=Path(output),
            progress=report,
        )
    if as_json:
        from luxel.render.write import to_json

        print(to_json(results))
        return
    for data in loaded:
        console.warn(data.warnings)
    for name, scene in results["scenes"].items():
        _print_table(name, scene)
    print(f"wrote {Path(output) / 'results.json'}")


def _print_table(name: str, scene: dict[str, Any]) -> None:
    """Print one scene: a row a method, a column a figure."""
    methods = scene["methods"]
    noise = next(iter(methods.values()))["truth_noise"]
    spp = scene["reference"]["spp"]
    print(f"{name} (truth: {spp} samples a pixel, noise {console.format_number(noise)})")
    width = max(map(len, ("method", *methods)))
    print(f"  {'method':<{width}}" + "".join(f"{column:>12}" for column in COLUMNS))
    for label, figures in methods.items():
        cells = "".join(f"{console.format_number(figures[column]):>12}" for column in COLUMNS)
        print(f"  {label:<{width}}{cells}")
