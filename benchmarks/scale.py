"""A room with strays, a dome or a wide ground around it, and far from the origin: error and time beside the clean room.

python benchmarks/scale.py [--methods gibs,ddgi,lightmap,path] [--size 320x240] [--frames 192] [--spp 4096] [--json OUT]

Each scene is judged by its own truth. `bias`: indirect light over the truth's, minus one. `darkest`: the darkest pixel
of lit walls, indirect light over the median. `time`: the median frame over the clean room's, in this run.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
from collections.abc import Iterator
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np

import luxel
from luxel import runtime
from luxel.image.layers import Layers
from luxel.metrics.error import bias, regional
from luxel.scene.colours import luminance
from luxel.scene.device import upload

WALLS = (
    ("-2 1.5 0", "y", 90, "2 1.5", "0.63 0.06 0.05"),
    ("2 1.5 0", "y", -90, "2 1.5", "0.14 0.45 0.09"),
    ("0 0 0", "x", -90, "2 2", "0.7 0.7 0.7"),
    ("0 3 0", "x", 90, "2 2", "0.7 0.7 0.7"),
    ("0 1.5 -2", "y", 0, "2 1.5", "0.7 0.7 0.7"),
)
"""Middle, axis and degrees of turn, half sides, reflectance; the room is open towards +Z."""
LAMP = "4 4 4"


def make_scene(around: str = "", at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> str:
    """Return a Mitsuba scene of the room at `at`, with the shapes `around` beside it."""
    shapes = "".join(
        f'<shape type="rectangle"><transform name="to_world"><scale x="{half.split()[0]}" y="{half.split()[1]}"/>'
        f'<rotate {axis}="1" angle="{angle}"/><translate value="{_place(middle, at)}"/></transform>'
        f'<bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="{color}"/></bsdf></bsdf></shape>'
        for middle, axis, angle, half, color in WALLS
    )
    lamp = (
        '<shape type="rectangle"><transform name="to_world"><scale x="0.4" y="0.4"/><rotate x="1" angle="90"/>'
        f'<translate value="{_place("0 2.98 0", at)}"/></transform><emitter type="area">'
        f'<rgb name="radiance" value="{LAMP}"/></emitter></shape>'
    )
    camera = (
        '<sensor type="perspective"><float name="fov" value="60"/><transform name="to_world">'
        f'<lookat origin="{_place("0.3 1.6 4.2", at)}" target="{_place("0 1.4 0", at)}" up="0 1 0"/>'
        "</transform></sensor>"
    )
    sky = '<emitter type="constant"><rgb name="radiance" value="0.3 0.35 0.45"/></emitter>'
    return f'<scene version="3.0.0">{shapes}{lamp}{camera}{sky}{around}</scene>'


def _place(middle: str, at: tuple[float, float, float]) -> str:
    return " ".join(f"{float(part) + shift:.9g}" for part, shift in zip(middle.split(), at, strict=True))


def _diffuse(kind: str, transform: str, color: str, extra: str = "") -> str:
    surface = f'<bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="{color}"/></bsdf></bsdf>'
    return f'<shape type="{kind}"><transform name="to_world">{transform}</transform>{surface}{extra}</shape>'


STRAY = _diffuse("rectangle", '<scale value="0.05"/><translate x="300" y="300" z="300"/>', "0.5 0.5 0.5")
DOME = _diffuse("sphere", '<scale value="500"/>', "0.5 0.5 0.5")
GROUND = _diffuse("rectangle", '<scale value="1000"/><rotate x="1" angle="-90"/><translate y="-0.01"/>', "0.4 0.35 0.3")
CASES = {
    "clean": make_scene(),
    "stray triangle at 300 m": make_scene(STRAY),
    "dome of 500 m": make_scene(DOME),
    "ground of 2 km": make_scene(GROUND),
    "carried 10 km": make_scene(at=(10_000.0, 0.0, -3_000.0)),
    "carried 100 km": make_scene(at=(60_000.0, 2_000.0, 80_000.0)),
}


def measure(name: str, methods: list[str], size: tuple[int, int], frames: int, spp: int) -> Iterator[dict[str, Any]]:
    """Yield the figures of each method in one scene."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.xml"
        path.write_text(CASES[name])
        data = luxel.load(str(path))
    scene = upload(data)
    truth = luxel.render_truth(scene, size=size, spp=spp).layers
    for method in methods:
        renderer = luxel.Renderer(scene, method, size=size)
        times = renderer.run(frames)
        layers = renderer.layers()
        yield {
            "scene": name, "method": method, "bias": bias(layers, truth), "regional": regional(layers, truth),
            "darkest": find_darkest(layers, truth), "frame_ms": statistics.median(times[len(times) // 2 :]),
        }  # fmt: skip


def find_darkest(layers: Layers, truth: Layers) -> float:
    """Return the least indirect irradiance of pixels that the truth lights, over the truth's median there."""
    wanted, found = luminance(truth.indirect), luminance(layers.indirect)
    middle = float(np.median(wanted[truth.hit]))
    lit = truth.hit & (wanted > 0.1 * middle)
    return float(found[lit].min()) / middle


def main() -> None:
    """Print a table, and write it as JSON where asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--methods", default="gibs,ddgi,lightmap,path")
    parser.add_argument("--size", default="320x240")
    parser.add_argument("--frames", type=int, default=192)
    parser.add_argument("--spp", type=int, default=4096)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    device = runtime.start("auto")
    width, height = (int(part) for part in given.size.split("x"))
    rows: list[dict[str, Any]] = []
    clean: dict[str, float] = {}
    print(f"{device.name}, {date.today()}, {given.size}, {given.frames} frames, truth of {given.spp} paths a pixel\n")
    print("| scene | method | bias | regional | darkest | ms | time |\n| --- | --- | --- | --- | --- | --- | --- |")
    for name in CASES:
        for row in measure(name, given.methods.split(","), (width, height), given.frames, given.spp):
            clean.setdefault(row["method"], row["frame_ms"])
            row["time"] = row["frame_ms"] / clean[row["method"]]
            rows.append(row)
            print(
                f"| {row['scene']} | `{row['method']}` | {100 * row['bias']:+.2f} % | {row['regional']:.4f} | "
                f"{row['darkest']:.3g} | {row['frame_ms']:.2f} | {row['time']:.2f} |",
                flush=True,
            )
    if given.json:
        given.json.write_text(json.dumps({"device": device.name, "date": str(date.today()), "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
