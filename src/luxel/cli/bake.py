"""`luxel bake` and `luxel relight`: light in files that other programs show, and other light in the same files."""

from __future__ import annotations

import shutil
import sys
import time as clock
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from luxel.cli import console, options
from luxel.scene.choice import check_materials

if TYPE_CHECKING:
    from luxel.bake.core import Baked
    from luxel.scene.host import Looks

Output = Annotated[str, typer.Option("-o", "--output", metavar="OUT.glb", help="The .glb; its .exr stands beside it.")]
LightOnly = Annotated[
    bool, typer.Option("--light-only", help="The texture holds light alone, without the surfaces' colours.")
]
Lights = Annotated[
    list[str] | None,
    typer.Option(
        "--light",
        metavar="NAME=FACTOR",
        help="Multiply the power of a light, an emissive material or `sky`; repeatable.",
        rich_help_panel="Scene options",
    ),
]


def bake(
    scene: options.SceneName,
    output: Output,
    method: Annotated[
        str,
        typer.Option(
            "--method",
            metavar="NAME|FILE.py:Class",
            help="What brings the indirect light: lightmap, ddgi, path, or a bakeable class of your own.",
        ),
    ] = "lightmap",
    preset: options.Preset = None,
    settings: options.Settings = None,
    light_only: LightOnly = False,
    indirect_only: Annotated[
        bool,
        typer.Option("--indirect-only", help="Leave direct light out, for programs that light directly themselves."),
    ] = False,
    frames: Annotated[
        int | None, typer.Option("--frames", min=1, help="Frames in which light bounces on; without, until it settles.")
    ] = None,
    samples: Annotated[
        int, typer.Option("--samples", min=1, max=4096, help="Light samples, and paths of `path`, a texel's point.")
    ] = 16,
    materials: Annotated[
        str,
        typer.Option(
            "--materials",
            metavar="diffuse|full",
            help="What counts of the scene's materials: their diffuse albedo, or all of them. The texture holds "
            "diffuse light; full ones keep their gloss beside it, and the light of `path` has seen it.",
        ),
    ] = "full",
    exposure: options.ExposureText = "auto",
    seed: options.Seed = 0,
    device: options.DeviceName = "auto",
    sun: options.Sun = None,
    sky: options.Sky = None,
    envmap: options.EnvMap = None,
    animation: options.Animation = None,
    lights: Lights = None,
    as_json: options.Json = False,
    debug: options.Debug = False,
) -> None:
    """Bake a scene's light into a texture and write a .glb that any viewer shows."""
    factor, given = options.parse_exposure(exposure), options.parse_settings(settings)
    check_materials(materials)
    method, preset = options.choose_method(method, preset, device)
    with console.logs_on_stderr(), console.progress_bar() as report:
        from luxel.bake.core import bake_scene
        from luxel.bake.files import check_places, workdir_of, write_bake
        from luxel.bake.lamps import parse_lights, scale_lights

        changed = parse_lights(lights)
        check_places(output)
        loaded = options.load_scene(scene, sun=sun, sky=sky, envmap=envmap, animation=animation)
        data = scale_lights(loaded, changed)
        work = workdir_of(output)
        start = clock.perf_counter()
        try:
            baked = bake_scene(
                data, method, given, preset=preset, frames=frames, samples=samples, seed=seed,
                indirect_only=indirect_only, materials=cast("Looks", materials), device=device, workdir=work,
                report=report,
            )  # fmt: skip
        except KeyboardInterrupt:
            if work.is_dir():
                print(f"luxel: stopped; the same command goes on from what '{work}' keeps", file=sys.stderr)
            raise
        spent = clock.perf_counter() - start
        written = write_bake(baked, output, light_only, factor)
        # Everything is written: what a stopped bake would have gone on from has served.
        shutil.rmtree(work, ignore_errors=True)
    _tell(baked, written, spent, as_json)


def relight(
    transport: Annotated[str, typer.Argument(metavar="OUT.luxel.npz", help="What `luxel bake` left beside its .glb.")],
    scene: options.SceneName,
    output: Output,
    light_only: Annotated[
        bool | None,
        typer.Option("--light-only/--with-colours", help="What the texture holds; without, what the bake's held."),
    ] = None,
    frames: Annotated[
        int | None, typer.Option("--frames", min=1, help="Frames in which light bounces on; without, as the bake.")
    ] = None,
    samples: Annotated[
        int | None,
        typer.Option("--samples", min=1, max=4096, help="Light samples a texel's point; without, as the bake."),
    ] = None,
    exposure: Annotated[
        str,
        typer.Option(
            "--exposure",
            metavar="bake|auto|FACTOR|STOPSev",
            help="bake keeps that of the bake; the others are those of `luxel bake`.",
        ),
    ] = "bake",
    device: options.DeviceName = "auto",
    sun: options.Sun = None,
    sky: options.Sky = None,
    envmap: options.EnvMap = None,
    animation: options.Animation = None,
    lights: Lights = None,
    as_json: options.Json = False,
    debug: options.Debug = False,
) -> None:
    """Light a finished bake anew: no new bake, and no rays but shadow rays."""
    keep = exposure.strip().lower() == "bake"
    factor = None if keep else options.parse_exposure(exposure)
    with console.logs_on_stderr(), console.progress_bar() as report:
        from luxel.bake.files import check_places, read_about, write_bake
        from luxel.bake.files import relight as relight_bake
        from luxel.bake.lamps import parse_lights, scale_lights

        changed = parse_lights(lights)
        check_places(output)
        about, _ = read_about(transport)
        loaded = options.load_scene(scene, sun=sun, sky=sky, envmap=envmap, animation=animation)
        data = scale_lights(loaded, changed)
        start = clock.perf_counter()
        baked = relight_bake(transport, data, frames=frames, samples=samples, device=device, report=report)
        spent = clock.perf_counter() - start
        written = write_bake(baked, output, light_only, about.get("exposure") if keep else factor)
    _tell(baked, written, spent, as_json, relit=True)


def _tell(baked: Baked, written: dict[str, Any], spent: float, as_json: bool, relit: bool = False) -> None:
    """Print what came of it."""
    from luxel.bake.gltf_materials import OWN
    from luxel.bake.lamps import NAMED, name_lights

    layout, lights = baked.layout, name_lights(baked.data)
    result = {
        "scene": baked.data.name,
        "method": baked.method.name,
        "materials": baked.materials,
        **written,
        "atlas": [layout.width, layout.height],
        "texel_count": len(layout.slot),
        "texels_per_metre": 1.0 / layout.texel_size,
        "seam_count": baked.seam_count,
        "seam_difference": baked.seam,
        "seam_difference_before": baked.seam_before,
        "seconds": spent,
        "frames": baked.frames_run,
        "surfel_shadow_rays": baked.surfel_rays,
        "texel_shadow_rays": baked.light.shadow_rays,
        "lights": lights,
        "warnings": baked.notes,
    }
    if as_json:
        from luxel.files import to_json

        print(to_json(result))
        return
    console.warn(baked.notes)
    rays = f"shadow rays only: surfels {baked.surfel_rays:,}, texels {baked.light.shadow_rays:,}" if relit else ""
    seams = f"{100.0 * baked.seam:.2f} % of the mean light ({100.0 * baked.seam_before:.2f} % before they were closed)"
    console.print_rows(
        [
            ("bake", f"{written['glb']}  exposure {written['exposure']:.4g}"),
            ("shown", f"unlit, the light on TEXCOORD_{written['texcoord']}; the file's materials as variant '{OWN}'"),
            ("light", written["exr"]),
            ("transport", written.get("transport", "")),
            ("atlas", f"{layout.width} x {layout.height}, {len(layout.slot):,} texels, "
             f"{1.0 / layout.texel_size:.3g} a metre"),
            ("seams", seams if baked.seam_count else "no smooth surface is cut"),
            ("lights", ", ".join(lights[:NAMED])
             + (f" and {len(lights) - NAMED} more (--json lists all)" if len(lights) > NAMED else "")),
            ("time", f"{spent:.1f} s"),
            ("rays", rays),
        ]
    )  # fmt: skip
