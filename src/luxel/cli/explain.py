"""`luxel explain`: what lights one pixel, and why it is black where it is."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated

import typer

from luxel.cli import console, options
from luxel.errors import LuxelError

if TYPE_CHECKING:
    from luxel.inspect.explanation import Explanation

SHOWN_ITEMS = 12
"""Cache items that people get; `--json` has them all."""


def explain(
    scene: options.SceneName,
    pixel: Annotated[
        str, typer.Option("--pixel", metavar="X,Y", help="Column and row of the image, from 0 at the top left.")
    ],
    method: options.Method = "gibs",
    preset: options.Preset = None,
    settings: options.Settings = None,
    size: options.Size = "512x512",
    frames: options.Frames = 64,
    seed: options.Seed = 0,
    device: options.DeviceName = "auto",
    flight: options.Flight = False,
    sun: options.Sun = None,
    sky: options.Sky = None,
    envmap: options.EnvMap = None,
    camera: options.CameraText = None,
    animation: options.Animation = None,
    time: Annotated[
        float,
        typer.Option("--time", metavar="SECONDS", help="Time in an animated scene.", rich_help_panel="Scene options"),
    ] = 0.0,
    exposure: options.ExposureText = "auto",
    as_json: options.Json = False,
    debug: options.Debug = False,
) -> None:
    """Say what lights a pixel: its surface, its light, the cache items that answer and why others do not."""
    wanted, factor = options.parse_size(size), options.parse_exposure(exposure)
    given = options.parse_settings(settings)
    x, y = options.parse_pixel(pixel, wanted)
    method, preset = options.choose_method(method, preset, device)
    if not math.isfinite(time):
        raise LuxelError(f"--time {time} is not a number of seconds")
    with console.logs_on_stderr(), console.progress_bar() as report:
        from luxel import runtime

        runtime.start(device)
        from luxel.inspect.explain import explain_pixel
        from luxel.inspect.looks import take_shot
        from luxel.methods import make_params
        from luxel.render.flight import fly_through
        from luxel.render.renderer import Renderer
        from luxel.scene.device import set_time, upload

        params = make_params(method, preset, given)
        data = options.load_scene(scene, sun=sun, sky=sky, envmap=envmap, camera=camera, animation=animation)
        loaded = upload(data)
        set_time(loaded, time)
        renderer = Renderer(loaded, method, params, size=wanted, seed=seed, progress=report)
        if flight:
            report("flight", 0.0)
            fly_through(renderer)
        renderer.run(frames, progress=lambda done: report("frames", done / frames))
        found = explain_pixel(take_shot(renderer, exposure=factor), x, y)
    if as_json:
        from luxel.files import to_json

        print(to_json({"scene": data.name, **found.to_dict()}))
    else:
        console.warn([*data.warnings, *renderer.method.warnings(renderer.state)])
        print_explanation(found)


def print_explanation(found: Explanation) -> None:
    """Print the words, then the figures, then the items of the cache."""
    from luxel.inspect.explanation import show_place

    for sentence in found.words:
        print(sentence)
    print()
    rows = [("pixel", f"{found.pixel[0]},{found.pixel[1]}, shown as {_three(found.shown)} at {found.exposure:.3g}")]
    rows.append(("radiance", f"{_three(found.radiance)} W/(m^2 sr)"))
    if found.hit:
        assert found.position is not None and found.normal is not None and found.distance is not None
        side = "" if found.front else ", seen from its back"
        rows += [
            ("surface", f"{found.object_name}, material '{found.material_name}'{side}"),
            ("position", f"{show_place(found.position, found.distance)}, {found.distance:.3g} m from the eye"),
            ("normal", _three(found.normal)),
            ("albedo", _three(found.albedo)),
            ("direct", f"{_three(found.direct)} W/m^2"),
            ("indirect", f"{_three(found.indirect)} W/m^2, answered with weight {found.weight:.3g}"),
        ]
    console.print_rows(rows)
    if found.contributions:
        print()
        _print_items(found)


def _print_items(found: Explanation) -> None:
    from luxel.inspect.explanation import show_place

    print(f"{found.item:>8}  {'share':>6}  {'irradiance':<24}  {'position':<24}  reason")
    for item in found.contributions[:SHOWN_ITEMS]:
        place = show_place(item.p, found.distance) if item.p is not None else ""
        light = _three(item.irradiance)
        print(f"{item.item:>8}  {item.weight:>6.1%}  {light:<24}  {place:<24}  {item.reason}".rstrip())
    rest = len(found.contributions) - SHOWN_ITEMS
    if rest > 0:
        print(f"{'':>8}  {'':>6}  and {rest} more (--json lists all)")


def _three(values: tuple[float, float, float]) -> str:
    # What is nothing beside the others is rounding.
    least = 1e-6 * max(abs(value) for value in values)
    return "  ".join(f"{value if abs(value) > least else 0.0:.3g}" for value in values)
