"""Options that several commands share, and how their texts are read."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Annotated

import typer

from luxel.cli import console
from luxel.errors import LuxelError

if TYPE_CHECKING:
    from luxel.render.exposure import Exposure
    from luxel.scene.model import SceneData

TRUTH_SPP = 256
"""Samples a pixel of the truth where `--truth` names none."""
PIXEL_LIMIT = 1 << 25
"""Pixels of the largest image: 8K, beyond which memory rather than patience ends."""

_SCENE = "Scene options"

SceneName = Annotated[
    str, typer.Argument(metavar="SCENE", help="A built-in scene (`luxel scenes`), or a .gltf, .glb or .xml file.")
]
Method = Annotated[
    str,
    typer.Option(
        "--method",
        metavar="NAME|FILE.py:Class",
        help="How indirect light is found: gibs, ddgi, lightmap, path, none, ambient, or a class of your own.",
    ),
]
Preset = Annotated[str | None, typer.Option("--preset", metavar="NAME", help="A named set of the method's parameters.")]
Settings = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Set one of the method's parameters; repeatable.")
]
Size = Annotated[str, typer.Option("--size", metavar="WxH", help="Image size in pixels.")]
Frames = Annotated[int, typer.Option("--frames", min=1, help="Frames to render.")]
Seed = Annotated[int, typer.Option("--seed", min=0, max=2**32 - 1, help="The same seed gives the same image.")]
DeviceName = Annotated[str, typer.Option("--device", metavar="auto|cpu|cuda", help="What to compute on.")]
Flight = Annotated[
    bool, typer.Option("--flight", help="First fly the scene's camera path, or for a file one found for it.")
]
ExposureText = Annotated[
    str,
    typer.Option(
        "--exposure",
        metavar="auto|FACTOR|STOPSev",
        help="auto shows lit surfaces at middle grey; +1.5ev is that and 1.5 stops more; a number is the factor.",
    ),
]
Filter = Annotated[
    str,
    typer.Option(
        "--filter",
        metavar="box|gaussian|none",
        help="What a pixel shows of what is around its centre, once frames of a still view are averaged: smooth edges.",
    ),
]
Materials = Annotated[
    str,
    typer.Option(
        "--materials",
        metavar="diffuse|full",
        help="What counts of the scene's materials: their diffuse albedo, as in every table of ours, or all of them. "
        "Only `path` shows all of them; other methods light the diffuse part.",
    ),
]
Debug = Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else on stdout.")]
Sun = Annotated[
    str | None,
    typer.Option(
        "--sun",
        metavar="AZIMUTH,ELEVATION[,STRENGTH[,DIAMETER]]",
        help="Replace the sun. Degrees: azimuth from +Z towards +X, elevation above the horizon, diameter 0 (sharp) "
        "to 90. Suns in a sky image stay.",
        rich_help_panel=_SCENE,
    ),
]
Sky = Annotated[
    str | None,
    typer.Option(
        "--sky", metavar="none|L|R,G,B", help="Replace the sky by a constant radiance.", rich_help_panel=_SCENE
    ),
]
EnvMap = Annotated[
    str | None,
    typer.Option(
        "--envmap", metavar="FILE", help="Replace the sky by a latitude-longitude image.", rich_help_panel=_SCENE
    ),
]
CameraText = Annotated[
    str | None,
    typer.Option(
        "--camera",
        metavar="NAME|EYE;TARGET[;FOV]",
        help="A camera of the scene, or a new one; fov in degrees, horizontal.",
        rich_help_panel=_SCENE,
    ),
]
Animation = Annotated[
    str | None,
    typer.Option(
        "--animation",
        metavar="NAME|INDEX|all",
        help="Which animation of a glTF file plays; without, the first. INDEX starts at 0.",
        rich_help_panel=_SCENE,
    ),
]


def choose_method(method: str, preset: str | None, device: str) -> tuple[str, str | None]:
    """Return name and preset of `NAME[:PRESET]` or `FILE.py:Class[:PRESET]`; the class of a file is loaded.

    Raises LuxelError for a file or class that cannot be used, and for two presets.
    """
    from luxel.methods.own import is_file, split_method

    name, own = split_method(method)
    if own is not None and preset is not None and own != preset:
        raise LuxelError(f"--method {method} names the preset '{own}', and --preset another one, '{preset}'")
    if is_file(name):
        from luxel import runtime
        from luxel.methods.own import load_method

        # What the file prints while it is imported is no result.
        with console.logs_on_stderr():
            runtime.start(device)
            name = load_method(name).name
    return name, own or preset


def parse_size(text: str) -> tuple[int, int]:
    """Return (width, height) of `512x512`. Raises LuxelError for anything that is no size or too large."""
    found = re.fullmatch(r"\s*(\d+)\s*[xX×]\s*(\d+)\s*", text)
    if found is None:
        raise LuxelError(f"size '{text}' is not WIDTHxHEIGHT, such as 512x512")
    return check_size(int(found[1]), int(found[2]))


def check_size(width: int, height: int) -> tuple[int, int]:
    """Return (width, height). Raises LuxelError for no pixels or more than fit into memory."""
    if width < 1 or height < 1:
        raise LuxelError(f"size {width}x{height} has no pixels; width and height start at 1")
    if width * height > PIXEL_LIMIT:
        raise LuxelError(f"size {width}x{height} is too large: at most {PIXEL_LIMIT:,} pixels, such as 7680x4320")
    return width, height


def parse_settings(settings: list[str] | None) -> dict[str, str]:
    """Return the `key=value` texts as a dict. Raises LuxelError for one that is not of that form."""
    result: dict[str, str] = {}
    for text in settings or []:
        key, equals, value = text.partition("=")
        if not key.strip() or not equals or not value.strip():
            raise LuxelError(f"--set {text} is not KEY=VALUE, such as rays_per_surfel=4")
        result[key.strip()] = value.strip()
    return result


def parse_exposure(text: str) -> Exposure:
    """Return the exposure of `auto`, a factor, or stops from auto such as `+1.5ev`; LuxelError for anything else."""
    from luxel.render.exposure import FACTOR_MAX, STOPS_MAX, Exposure

    word = text.strip().lower()
    if word == "auto":
        return Exposure()
    is_stops = word.endswith("ev")
    try:
        number = float(word.removesuffix("ev"))
    except ValueError:
        number = math.nan
    if is_stops and abs(number) <= STOPS_MAX:
        return Exposure(stops=number)
    if word[:1] in ("+", "-") and math.isfinite(number) and not is_stops:
        raise LuxelError(
            f"--exposure {text} has a sign and no unit: write {word}ev for stops from auto, {word[1:]} for a factor"
        )
    if is_stops or not 1.0 / FACTOR_MAX <= number <= FACTOR_MAX:
        raise LuxelError(
            f"--exposure {text} is neither auto, nor a factor from {1.0 / FACTOR_MAX:g} to {FACTOR_MAX:g}, nor stops "
            f"from auto such as +1.5ev (at most {STOPS_MAX:g} either way)"
        )
    return Exposure(factor=number)


def parse_pixel(text: str, size: tuple[int, int]) -> tuple[int, int]:
    """Return column and row of `X,Y`. Raises LuxelError for anything else, and outside an image of `size`."""
    found = re.fullmatch(r"\s*(\d+)\s*,\s*(\d+)\s*", text)
    if found is None:
        raise LuxelError(f"--pixel {text} is not X,Y, such as 256,128")
    x, y = int(found[1]), int(found[2])
    if x >= size[0] or y >= size[1]:
        raise LuxelError(
            f"--pixel {x},{y} is outside the image of {size[0]}x{size[1]}: columns go from 0 to {size[0] - 1}, "
            f"rows to {size[1] - 1}"
        )
    return x, y


def parse_seeds(text: str) -> list[int]:
    """Return the seeds of `0,1,2`, each once. Raises LuxelError for anything else."""
    parts = [part.strip() for part in text.split(",") if part.strip()]
    if not parts or not all(part.isdecimal() and int(part) < 2**32 for part in parts):
        raise LuxelError(f"--seeds {text} is not a list of whole numbers from 0, such as 0,1,2")
    return list(dict.fromkeys(int(part) for part in parts))


def load_scene(
    name: str,
    *,
    sun: str | None = None,
    sky: str | None = None,
    envmap: str | None = None,
    camera: str | None = None,
    animation: str | None = None,
) -> SceneData:
    """Return the scene with the options applied; its name is what reports call it, its first camera the chosen one.

    Raises LuxelError for an unknown scene, a bad file or a bad option.
    """
    from luxel.render.loading import load_choice
    from luxel.scene.choice import SceneChoice

    return load_choice(SceneChoice(name, sun, sky, envmap, camera, animation=animation))
