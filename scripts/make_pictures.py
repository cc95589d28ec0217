"""Make the pictures of the docs: each method's image beside the truth, and their difference.

    python scripts/make_pictures.py [NAME ...] [--out docs/pictures]

Truths come from `benchmarks/references` where the view is committed there, else they are rendered and cached. Real
scenes are looked for in the folder LUXEL_TEST_SCENES (default `../shared/scenes`); without it they are left out.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
from material_pictures import picture_full, picture_spheres
from PIL import Image, ImageDraw, ImageFont
from sheets import PICTURES, REPOSITORY, write_jpeg

import luxel
from luxel.image.layers import Layers
from luxel.image.tonemap import to_display
from luxel.image.write import to_bytes
from luxel.render.exposure import auto_exposure
from luxel.render.flight import fly_through
from luxel.scene.edit import parse_camera
from luxel.scene.model import Camera, SceneData

FRAMES = 256
TRUTH_SPP = 1024
"""Paths a pixel of the truths that are not committed."""
LABEL_HEIGHT = 22
GAP = 4
AMPLIFY = 4.0
FPS = 30.0

COLUMNS = {"materials": 1, "looks": 4, "lightmap": 3, "lightmap-atrium": 3, "lightmap-truth": 3}
"""Panels in a row, for pictures of more than one row."""

Panel = tuple[str, np.ndarray]


# ---------- Pictures of panels ----------


def write_panels(path: Path, panels: list[Panel], columns: int = 0) -> None:
    """Write labelled panels, (H, W, 3) displayed, as a JPEG of at most 180 kB: side by side, or `columns` in a row."""
    columns = columns or len(panels)
    rows = [panels[start : start + columns] for start in range(0, len(panels), columns)]
    heights = [LABEL_HEIGHT + max(image.shape[0] for _, image in row) for row in rows]
    width = max(sum(image.shape[1] for _, image in row) + GAP * (len(row) - 1) for row in rows)
    sheet = Image.new("RGB", (width, sum(heights) + GAP * (len(rows) - 1)), "white")
    draw, font, y = ImageDraw.Draw(sheet), ImageFont.load_default(15), 0
    for row, height in zip(rows, heights, strict=True):
        x = 0
        for label, image in row:
            sheet.paste(Image.fromarray(to_bytes(image)), (x, y + LABEL_HEIGHT))
            draw.text((x + 3, y + 2), label, fill="black", font=font)
            x += image.shape[1] + GAP
        y += height + GAP
    write_jpeg(path, sheet, subsampling=0)


def compare_panels(test: np.ndarray, truth: Layers, label: str) -> list[Panel]:
    """Return image, truth and amplified difference, at the exposure that suits the truth."""
    exposure = auto_exposure(truth)
    shown, wanted = to_display(test, exposure), to_display(truth.image(), exposure)
    difference = np.clip(AMPLIFY * np.abs(shown - wanted), 0.0, 1.0)
    return [(label, shown), ("truth", wanted), (f"difference x{AMPLIFY:.0f}", difference)]


def render_truth_layers(data: SceneData, size: tuple[int, int], camera: Camera | None, time: float = 0.0) -> Layers:
    """Return the truth's layers."""
    truth = luxel.render_truth(data, camera=camera, size=size, spp=TRUTH_SPP, time=time)
    return truth.layers


# ---------- What the docs show ----------


def picture_scene(source: str, size: tuple[int, int] = (256, 256), view: str | None = None) -> list[Panel]:
    """Return gibs after 256 frames beside the truth."""
    data = luxel.load(source)
    camera = parse_camera(view, data) if view else None
    image = luxel.render_image(data, "gibs", size=size, frames=FRAMES, camera=camera, filter="none")
    return compare_panels(image, render_truth_layers(data, size, camera), f"gibs, {FRAMES} frames")


def picture_moving(time: float = 1.5) -> list[Panel]:
    """Return gibs at `time` of a run in which everything moves, beside the truth of that moment."""
    data, size = luxel.load("moving"), (256, 256)
    renderer = luxel.Renderer(data, "gibs", size=size)
    for index in range(round(time * FPS) + 1):
        renderer.step(time=index / FPS)
    truth = render_truth_layers(data, size, None, (round(time * FPS)) / FPS)
    return compare_panels(renderer.image(), truth, f"gibs, in motion, {time} s")


def picture_first_frames() -> list[Panel]:
    """Return the first frames of the Cornell box."""
    renderer = luxel.Renderer("cornell-box", "gibs", size=(256, 256))
    panels: list[Panel] = []
    exposure = auto_exposure(render_truth_layers(luxel.load("cornell-box"), (256, 256), None))
    for frame in (1, 4, 16, 64):
        renderer.run(frame - renderer.frame_index)
        panels.append((f"frame {frame}", to_display(renderer.image(), exposure)))
    return panels


def picture_probe_fixes() -> list[Panel]:
    """Return heat maps of the error in the attic: the base method, then fix by fix, and the probes by state."""
    from luxel.inspect.looks import draw_look, take_shot
    from luxel.inspect.ramps import colorize
    from luxel.metrics.error import absolute_error, display_pair

    data, size = luxel.load("attic"), (256, 256)
    truth = luxel.render_truth(data, size=size, spp=TRUTH_SPP).layers
    moments = {"depth_model": "moments"}
    variants: list[tuple[str, str | None, dict]] = [
        ("majercik", "majercik", {}),
        ("depth kept whole", None, {**moments, "far_depth": "keep"}),
        ("far depth rejected", None, moments),
        ("planes, not moved", None, {"offset_dead_probes": False}),
        ("all (default)", None, {}),
    ]
    panels: list[Panel] = []
    for label, preset, settings in variants:
        renderer = luxel.Renderer(data, "ddgi", settings, preset=preset, size=size)
        renderer.run(96)
        error = absolute_error(*display_pair(renderer.image(), truth.image()), truth.hit)
        panels.append((label, colorize(error, "heat")))
    return [*panels, ("its probes by state", draw_look("probe-state", take_shot(renderer)).image)]


def picture_looks() -> list[Panel]:
    """Return looks of both caches: surfels in the Cornell box, probes in the attic, each with its legend."""
    from luxel.inspect.looks import draw_look, take_shot
    from luxel.inspect.looks.legend import PAPER

    surfels = "indirect objects error surfels surfel-irradiance coverage cell-occupancy depth"
    probes = "probes probe-depth probe-state probe-shares weights top-share irradiance-atlas flip"
    panels: list[Panel] = []
    for scene, method, settings, names in (
        ("cornell-box", "gibs", {"surfel_target": 2500}, surfels),
        ("attic", "ddgi", {}, probes),
    ):
        size = (192, 192)
        renderer = luxel.Renderer(scene, method, settings, size=size)
        renderer.run(64)
        truth = luxel.render_truth(renderer.scene, size=size, spp=256).layers
        shot = take_shot(renderer, truth=truth)
        panels += [(f"{method}: {name}", draw_look(name, shot).with_legend()) for name in names.split()]
    # One height for all, so that the rows are even.
    height = max(image.shape[0] for _, image in panels)
    ground = np.array(PAPER, np.float32) / 255.0
    return [
        (label, np.concatenate([image, np.broadcast_to(ground, (height - len(image), *image.shape[1:]))]))
        for label, image in panels
    ]


def picture_presets() -> list[Panel]:
    """Return indirect light alone in the Cornell box: the document's setting, ours, the truth."""
    data, size = luxel.load("cornell-box"), (256, 256)
    truth = luxel.render_truth(data, size=size, spp=TRUTH_SPP).layers.indirect_radiance()
    exposure = auto_exposure(truth)
    panels: list[Panel] = []
    for label, preset, marks in (("ekberg", "ekberg", (FRAMES, 8 * FRAMES)), ("default", None, (FRAMES,))):
        renderer = luxel.Renderer(data, "gibs", preset=preset, size=size)
        for frame in marks:
            renderer.run(frame - renderer.frame_index)
            shown = to_display(renderer.layers().indirect_radiance(), exposure)
            panels.append((f"{label}, frame {frame:,}", shown))
    return [*panels, ("truth", to_display(truth, exposure))]


def picture_leak() -> list[Panel]:
    """Return the sealed room, which should be black, at the lit room's exposure and at 64 times that."""
    data, size = luxel.load("two-rooms"), (256, 256)
    dark = next(camera for camera in data.cameras if camera.name == "dark")
    renderer = luxel.Renderer(data, "gibs", size=size)
    fly_through(renderer)
    renderer.run(64)
    outside, exposure = renderer.image(), renderer.auto_exposure()
    for _ in range(64):
        renderer.step(camera=dark)
    inside = renderer.image()
    return [
        ("lit room", to_display(outside, exposure)),
        ("sealed room", to_display(inside, exposure)),
        ("sealed room, exposure x64", to_display(inside, 64.0 * exposure)),
    ]


def picture_lightmap(
    source: str, size: tuple[int, int], pixel: tuple[int, int], names: str, preset: str | None = None
) -> list[Panel]:
    """Return looks of `lightmap` by their `names`; `pixel` is the one whose texel's clusters are shown."""
    from luxel.inspect.looks import draw_look, take_shot

    renderer = luxel.Renderer(source, "lightmap", preset=preset, size=size)
    renderer.run(64)
    shot, sizes = take_shot(renderer, pixel=pixel), renderer.cache()
    labels = {
        "charts": "charts",
        "texels": f"{sizes['texel_count']:,} texels",
        "surfels": f"{sizes['surfel_count']:,} surfels",
        "tree-middle": "the tree cut into 256 clusters",
        "tree-coarse": "the tree cut into 32 clusters",
        "clusters": "what lights one texel",
    }
    return [(labels[name], draw_look(name, shot).image) for name in names.split()]


def picture_lightmap_truth() -> list[Panel]:
    """Return the lightmap beside the truth, in the Cornell box and in the atrium."""
    panels: list[Panel] = []
    for source in ("cornell-box", "atrium"):
        data, size = luxel.load(source), (256, 256)
        image = luxel.render_image(data, "lightmap", size=size, frames=FRAMES)
        panels += compare_panels(image, render_truth_layers(data, size, None), f"lightmap, {FRAMES} frames")
    return panels


def list_pictures() -> dict[str, Callable[[], list[Panel]]]:
    """Return the pictures by name; those of real scenes only where their files are."""
    folder = Path(os.environ.get("LUXEL_TEST_SCENES", REPOSITORY.parent / "shared" / "scenes"))
    story = "charts texels surfels tree-middle tree-coarse clusters"
    pictures: dict[str, Callable[[], list[Panel]]] = {
        "cornell-box": lambda: picture_scene("cornell-box"),
        "two-rooms": lambda: picture_scene("two-rooms"),
        "atrium": lambda: picture_scene("atrium"),
        "attic": lambda: picture_scene("attic"),
        "moving": picture_moving,
        "first-frames": picture_first_frames,
        "presets": picture_presets,
        "probe-fixes": picture_probe_fixes,
        "looks": picture_looks,
        "leak": picture_leak,
        "lightmap": lambda: picture_lightmap("cornell-box", (400, 400), (195, 376), story, "source"),
        "lightmap-atrium": lambda: picture_lightmap("atrium", (400, 400), (200, 312), "surfels tree-coarse clusters"),
        "lightmap-truth": picture_lightmap_truth,
        "materials": picture_spheres,
        "glossy": lambda: picture_full(luxel.load("glossy"), (400, 300)),
    }
    real: dict[str, tuple[str, tuple[int, int], str | None]] = {
        "sponza": ("sponza-crytek/Sponza.gltf", (480, 270), "-9,2,0;5,2.5,0;65"),
        "bathroom": ("bathroom/scene.xml", (384, 216), None),
        "fox": ("fox/Fox.glb", (256, 256), None),
    }
    for name, how in real.items():
        path = folder / how[0]
        if path.exists():
            pictures[name] = lambda path=path, how=how: picture_scene(str(path), *how[1:])
    bathroom = folder / "bathroom/scene.xml"
    if bathroom.exists():
        pictures["bathroom-full"] = lambda: picture_full(luxel.load(str(bathroom)), (384, 216))
    return pictures


def main() -> None:
    """Make the named pictures, or all of them."""
    pictures = list_pictures()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of: {', '.join(pictures)}")
    parser.add_argument("--out", type=Path, default=PICTURES)
    options = parser.parse_args()
    unknown = set(options.names) - set(pictures)
    if unknown:
        parser.error(f"no such picture: {', '.join(sorted(unknown))}")
    for name in options.names or pictures:
        write_panels(options.out / f"{name}.jpg", pictures[name](), COLUMNS.get(name, 0))


if __name__ == "__main__":
    main()
