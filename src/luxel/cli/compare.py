"""`luxel compare`: methods beside the truth."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from luxel.cli import console, options
from luxel.errors import LuxelError

COLUMNS = ("regional", "bias", "flip", "flicker", "lag_frames", "leak", "frame_ms", "floor_ms")
"""The figures that people get; `--json` and results.json have them all."""
PEER_TITLE = "path in the time of"
PEER_COLUMNS = ("regional", "bias", "flip", "samples", "ms", "of_ms")
MOTION_COLUMNS = ("regional", "worst", "bias", "flip", "flicker", "cut", "ms")
"""Those of a flight: their names are shorter here, as the line above them says what they are of."""
MOTION_PEER_COLUMNS = ("regional", "bias", "flip", "flicker", "samples", "history", "ms", "time_ratio")
MOTION_KEYS = {
    "regional": "motion_regional", "worst": "motion_regional_worst", "bias": "motion_bias", "flip": "motion_flip",
    "flicker": "motion_flicker", "cut": "cut_regional", "ms": "motion_ms",
}  # fmt: skip


def compare(
    context: typer.Context,
    scenes: Annotated[
        list[str], typer.Argument(metavar="SCENE...|SUITE.toml", help="Scenes by name or file, or one suite of them.")
    ],
    output: Annotated[str, typer.Option("-o", "--output", metavar="DIR", help="Folder for results and images.")],
    methods: Annotated[
        str,
        typer.Option(
            "--methods",
            metavar="A,B",
            help="Methods; one with a preset is gibs:ekberg, your own FILE.py:Class. none and ambient always run.",
        ),
    ] = "gibs",
    materials: Annotated[
        str,
        typer.Option(
            "--materials",
            metavar="diffuse|full",
            help="What the truth knows of the scene's materials: their diffuse albedo, as in every table of ours, or "
            "all of them; then displayed images are judged. `path` shows all of them, other methods light the "
            "diffuse part.",
        ),
    ] = "diffuse",
    reference: Annotated[str | None, typer.Option("--reference", hidden=True)] = None,
    reference_spp: Annotated[int | None, typer.Option(min=1, metavar="N", help="Samples a pixel of the truth.")] = None,
    seeds: Annotated[
        str, typer.Option("--seeds", metavar="0,1,2", help="One run for each; mean and spread are reported.")
    ] = "0",
    size: options.Size = "512x512",
    frames: options.Frames = 64,
    flight: options.Flight = False,
    peers: Annotated[
        bool, typer.Option("--peers/--no-peers", help="Give the path tracer each method's time, bare and denoised.")
    ] = True,
    motion: Annotated[
        bool,
        typer.Option(
            "--motion",
            help="Fly every method through the scene as well, at most 2 m/s and 60 degrees/s, and hold every sixth "
            "frame against its truth.",
        ),
    ] = False,
    motion_frames: Annotated[
        int, typer.Option("--motion-frames", min=6, metavar="N", help="Frames flown by --motion, 30 a second.")
    ] = 96,
    motion_spp: Annotated[
        int | None,
        typer.Option(
            "--motion-spp",
            min=1,
            metavar="N",
            help="Samples a pixel of the truth of each judged frame; without, 512, or on a CPU the committed sums of "
            "that flight.",
        ),
    ] = None,
    flight_path: Annotated[
        str | None,
        typer.Option(
            "--flight-path",
            metavar="EYE;EYE;TARGET;TARGET[;FOV]",
            help="What --motion flies instead of the scene's key views: a straight line, in exactly its frames.",
        ),
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Let the Dask cluster at tcp://HOST:PORT do the work.")
    ] = None,
    device: options.DeviceName = "auto",
    sun: options.Sun = None,
    sky: options.Sky = None,
    envmap: options.EnvMap = None,
    camera: options.CameraText = None,
    animation: options.Animation = None,
    as_json: options.Json = False,
    debug: options.Debug = False,
) -> None:
    """Compare methods with the truth and with each other: results.json, images and FLIP maps in a folder.

    A suite (`luxel compare SUITE.toml`) names scenes, methods, seeds and sizes; flags beside it go before it.
    """
    if reference is not None:
        materials = _take_old_name(context, reference)
    flags: dict[str, Any] = {
        "methods": methods,
        "materials": materials,
        "reference_spp": reference_spp,
        "seeds": options.parse_seeds(seeds),
        "size": options.parse_size(size),
        "frames": frames,
        "flight": flight,
        "peers": peers,
        "motion": motion,
        "motion_frames": motion_frames,
        "motion_spp": motion_spp,
    }
    changes = {"sun": sun, "sky": sky, "envmap": envmap, "camera": camera, "animation": animation}
    changes["flight_path"] = flight_path
    with console.logs_on_stderr(), console.progress_bar() as report:
        from luxel import runtime
        from luxel.methods.own import split_list
        from luxel.report.compare import compare as run_comparison

        if scheduler is None:
            runtime.start(device)
        flags["methods"] = split_list(methods)
        asked = _arrange(scenes, flags, {name: text for name, text in changes.items() if text is not None}, context)
        _check_motion(context, asked["motion"])
        results = run_comparison(
            **asked,
            device=device,
            scheduler=scheduler,
            command=_write_command(context),
            out=Path(output),
            progress=report,
        )
    if as_json:
        from luxel.files import to_json

        print(to_json(results))
        return
    if "machines" in results:
        console.warn(["The jobs ran on machines that differ, so their times cannot be compared."])
    for name, scene in results["scenes"].items():
        console.warn(scene["warnings"])
        for label, method in scene["methods"].items():
            console.warn([f"{name}, {label}: {text}" for text in method["warnings"]])
        _print_scene(name, scene)
    if any(scene["peers"] for scene in results["scenes"].values()):
        print(f"denoiser: {results['denoiser']['reason']}")
    print(f"wrote {Path(output) / 'report.html'} and, for machines, results.json")


def _arrange(
    scenes: list[str], flags: dict[str, Any], changes: dict[str, str], context: typer.Context
) -> dict[str, Any]:
    """Return the arguments of `compare`: those of the flags, or of the suite with the flags that were given."""
    from luxel.report.suite import SUFFIX, read_suite
    from luxel.scene.choice import SceneChoice

    if not any(Path(scene).suffix.lower() == SUFFIX for scene in scenes):
        return {**flags, "scenes": [SceneChoice(scene, **changes) for scene in scenes]}
    if len(scenes) > 1:
        raise LuxelError("a suite stands alone: write its scenes into it, or leave it out")
    suite = read_suite(scenes[0], warn=lambda sentence: console.warn([sentence]))
    if "size" in suite:
        options.check_size(*suite["size"])
    chosen = {name: value for name, value in flags.items() if _is_given(context, name) or name not in suite}
    return {**suite, **chosen, "scenes": [replace(scene, **changes) for scene in suite["scenes"]]}


def _check_motion(context: typer.Context, motion: bool) -> None:
    """Raise LuxelError where a flag says how to fly and nothing says that there is a flight."""
    given = [name for name in ("motion_frames", "motion_spp", "flight_path") if _is_given(context, name)]
    if given and not motion:
        raise LuxelError(
            f"--{given[0].replace('_', '-')} is about the flight of --motion: add --motion, or leave it out"
        )


def _take_old_name(context: typer.Context, materials: str) -> str:
    """Take what `--reference` says for `--materials`, its name of today, as if it had been given under that."""
    from luxel.report.compare import RENAMED

    if _is_given(context, "materials"):
        raise LuxelError("--reference is the old name of --materials; leave it out")
    console.warn([RENAMED.format(old="--reference", new="--materials")])
    sources = [context.get_parameter_source(name) for name in ("reference", "materials")]
    for name, value, source in zip(("materials", "reference"), (materials, None), sources, strict=True):
        context.params[name] = value
        if source is not None:
            context.set_parameter_source(name, source)
    return materials


def _is_given(context: typer.Context, name: str) -> bool:
    """Return whether a parameter stands on the command line."""
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


def _write_command(context: typer.Context) -> str:
    """Return the line that repeats this run, for a shell: the arguments, then the flags that were given."""
    words: list[str] = []
    for parameter in sorted(context.command.params, key=lambda one: one.param_type_name != "argument"):
        name = parameter.name or ""
        if not _is_given(context, name):
            continue
        value = context.params[name]
        if parameter.param_type_name == "argument":
            words += value
        elif isinstance(value, bool):
            words.append(max((parameter.opts if value else parameter.secondary_opts), key=len))
        else:
            words += [max(parameter.opts, key=len), str(value)]
    return shlex.join(["luxel", "compare", *words])


def _print_scene(name: str, scene: dict[str, Any]) -> None:
    """Print one scene: a row a method, a column a figure; below it the peers."""
    methods, motion = scene["methods"], scene["reference"]["motion"]
    noise = next(iter(methods.values()))["truth_noise"]
    spp = scene["reference"]["spp"]
    materials = scene["reference"]["kind"]
    print(f"{name} ({materials} materials; truth: {spp} samples a pixel, noise {console.format_number(noise)})")
    peers, flown = (
        {_peer_label(peer): peer for peer in scene["peers"] if peer["run"] == run} for run in ("rest", "motion")
    )
    width = max(map(len, ("method", *methods, *((PEER_TITLE, *peers, *flown) if peers else ()))))
    _print_rows("method", methods, COLUMNS, width)
    if peers:
        _print_rows(PEER_TITLE, peers, PEER_COLUMNS, width)
    if motion:
        way = motion["path"] or "the scene's key views"
        print(
            f"{name} in motion ({motion['frames']} frames along {way}; truth: {motion['spp']} samples a pixel, noise "
            f"{console.format_number(motion['noise'])})"
        )
        _print_rows("method", {label: _motion_row(one) for label, one in methods.items()}, MOTION_COLUMNS, width)
    if flown:
        _print_rows(PEER_TITLE, {label: _motion_row(one) for label, one in flown.items()}, MOTION_PEER_COLUMNS, width)


def _peer_label(peer: dict[str, Any]) -> str:
    """Return whose time a peer has, and what is done beyond plain paths: a preset's name, a denoiser."""
    preset = peer["label"].partition(":")[2]
    return ", ".join(text for text in (peer["of"], preset, peer["denoised"]) if text)


def _motion_row(figures: dict[str, Any]) -> dict[str, Any]:
    """Return the figures of a flight under the names of their columns."""
    return figures | {name: figures[key] for name, key in MOTION_KEYS.items()}


def _print_rows(title: str, rows: dict[str, dict[str, Any]], columns: tuple[str, ...], width: int) -> None:
    print(f"  {title:<{width}}" + "".join(f"{column:>12}" for column in columns))
    for label, figures in rows.items():
        cells = "".join(f"{console.format_number(figures[column]):>12}" for column in columns)
        print(f"  {label:<{width}}{cells}")
