"""Bake one atlas by luxel and by Blender's Cycles: error at equal time, and time to the second image.

python -m benchmarks.cycles SCENE --blender PYTHON [--texels N] [--rounds N] [--repeat N] [--record FILE]
python -m benchmarks.cycles --table FILE

PYTHON is one that has `bpy` (`pip install bpy` in an environment of its own), which runs as a process of its own. SCENE
is `cornell-box` (with a bulb, which then moves) or `atrium` (whose sun then moves). Prints one line of JSON, and with
--record adds it to FILE; --table writes the lines of FILE as the tables of docs/bake.md.

Both sides run in turn on the same processor, so that other work on it slows both. Errors are relative to the mean
light of the texels compared (`truth.py` says which) and free of the truth's own noise. Luxel's time counts from
the scene to the texels, its atlas included; Cycles' from the order to bake until the pixels are read, its import apart.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel import runtime
from luxel.bake.core import Baked, bake_scene
from luxel.bake.files import relight, save_transport
from luxel.bake.light import light_texels
from luxel.bench.machine import machine_record
from luxel.errors import LuxelError
from luxel.kernels.triangle import read_positions, read_triangles
from luxel.methods.base import Frame
from luxel.scene import load
from luxel.scene.live import copy_scene_data, set_lights
from luxel.scene.model import Light, SceneData

from .blender import Blender
from .errors import judge, samples_for_error, samples_for_time
from .export import light_order, write_scene
from .table import write_tables
from .truth import Compared, Truth, choose_texels, make_truth

LADDER = (1, 4, 16, 64, 256)
"""Samples that Cycles is always measured at."""
FRAMES = (1, 2, 4, 8, 32)
"""Frames after which luxel is looked at when a light has moved."""
SETTLE = 48
"""Frames between two trials, under the light before."""
TRIES, NEAR = 3, 0.1
"""Bakes that look for an error, and the share of it that is near enough."""
TOTAL, INDIRECT = ["DIRECT", "INDIRECT"], ["INDIRECT"]


def cornell_before() -> SceneData:
    """The Cornell box with a bulb beside its lamp."""
    data = load("cornell-box")
    data.lights = [Light("point", (0.5, 0.5, 0.45), position=(-0.5, 0.3, 0.5), name="bulb")]
    return data


def move_light(data: SceneData) -> SceneData:
    """Return the scene with its one light elsewhere: the bulb to the other side, the sun to later in the day."""
    (light,) = data.lights
    moved = replace(light, position=(0.6, 0.5, 0.3)) if light.kind == "point" else None
    return replace(data, lights=[moved or replace(light, direction=(-0.55, -1.0, 0.2))])


SCENES: dict[str, Callable[[], SceneData]] = {"cornell-box": cornell_before, "atrium": lambda: load("atrium")}


@dataclass
class Bench:
    """What every measurement needs."""

    before: SceneData
    after: SceneData
    settings: dict[str, Any]
    blender: Blender
    baked: Baked
    texels: Compared
    repeat: int
    most: int

    def row(self, by: str, what: str, seconds: list[float], texels: np.ndarray, truth: Truth, **more: Any) -> dict:
        """Return one line of the result: `texels` (K, 3) irradiance of those compared, judged by `truth`."""
        halves = getattr(truth, what)
        figures = {key: round(value, 5) for key, value in judge(texels, halves, self.texels.patch).items()}
        return {"by": by, "what": what, **more, "s": round(statistics.median(seconds), 5), **figures}

    def cycles(self, what: str, samples: int, truth: Truth, times: int = 1, extra_s: float = 0.0, **more: Any) -> dict:
        """Bake by Cycles `times` times (as the same image) and judge it."""
        ran = [self.blender.bake(samples, TOTAL if what == "total" else INDIRECT) for _ in range(times)]
        texels = np.pi * self.texels.pick(self.baked.layout, ran[-1][0])
        seconds = [extra_s + seconds for _, seconds in ran]
        return self.row("cycles", what, seconds, texels, truth, samples=samples, **more)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("scene", nargs="?", default="cornell-box", choices=SCENES)
    parser.add_argument("--blender", default=os.environ.get("LUXEL_BLENDER_PYTHON"), help="a Python that has bpy")
    parser.add_argument("--texels", type=int, default=8192)
    parser.add_argument("--rounds", type=int, default=256, help="paths of the truth from each of 16 points a texel")
    parser.add_argument("--repeat", type=int, default=3, help="runs of which each time is the median")
    parser.add_argument("--most", type=int, default=4096, help="samples that Cycles may take to reach an error")
    parser.add_argument("--record", type=Path)
    parser.add_argument("--table", type=Path)
    chosen = parser.parse_args()
    if chosen.table is not None:
        print(write_tables([json.loads(line) for line in chosen.table.read_text().splitlines()]))
        return
    try:
        if not chosen.blender:
            raise LuxelError("name a Python that has bpy: --blender PYTHON, or LUXEL_BLENDER_PYTHON")
        line = json.dumps(compare(chosen))
    except LuxelError as error:
        sys.exit(str(error))
    print(line)
    if chosen.record is not None:
        with chosen.record.open("a") as stream:
            stream.write(line + "\n")


def compare(chosen: argparse.Namespace) -> dict[str, Any]:
    """Return everything measured of one scene."""
    runtime.start("auto")
    before = SCENES[chosen.scene]()
    after, settings = move_light(before), {"texel_target": chosen.texels}
    # The first bake of a process compiles; the second is the one to keep.
    cold_s = bake_by_luxel(before, settings)[1]
    baked, _ = bake_by_luxel(before, settings)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        write_scene(baked, folder)
        with Blender(chosen.blender, folder, os.cpu_count() or 1) as blender:
            blender.light(light_order(before))
            texels = choose_texels(baked.layout, scene_corners(baked), blender.bake(1, TOTAL)[0][..., 3] > 0.5)
            bench = Bench(before, after, settings, blender, baked, texels, chosen.repeat, chosen.most)
            truths = make_truth(baked.scene, baked.layout, chosen.rounds, 5, report)
            truths = tuple(truth.take(texels.texel) for truth in truths)
            first, luxel_s = compare_first(bench, *truths)
            second = compare_second(bench, folder, chosen.rounds)
            loaded = blender.about
    return {
        **machine_record(),
        "blender": loaded["blender"],
        "scene": chosen.scene,
        "texels": len(baked.layout.slot),
        "compared": len(texels.texel),
        "compared_share": round(texels.share, 3),
        "truth_paths": 16 * chosen.rounds,
        "truth_noise": round(truths[0].total.noise(), 4),
        "has_sky": max(before.sky.color) > 0.0,
        "luxel_bake_s": [round(value, 3) for value in luxel_s],
        "luxel_first_in_process_s": round(cold_s, 3),
        "cycles_load_s": round(loaded["load_s"], 3),
        "first": first,
        "second": second,
    }


def bake_by_luxel(data: SceneData, settings: dict[str, Any], indirect_only: bool = False) -> tuple[Baked, float]:
    """Bake, and return the seconds until the light was in the texels."""
    start = time.perf_counter()
    baked = bake_scene(copy_scene_data(data), "lightmap", dict(settings), indirect_only=indirect_only)
    return baked, time.perf_counter() - start


def scene_corners(baked: Baked) -> np.ndarray:
    """Return the corners (T, 3, 3) of all triangles of the scene."""
    return read_positions(baked.scene)[read_triangles(baked.scene).vertices].astype(np.float64)


def compare_first(bench: Bench, whole: Truth, inner: Truth) -> tuple[list[dict], list[float]]:
    """Return the rows of the first bake, and luxel's times. Truths are of the compared texels, `inner` of Cycles'."""
    ladder = climb(bench, "total", inner)
    rows, luxel_s, samples = compare_in_turn(bench, "total", ladder, whole, inner)
    rows.append(reach(bench, "total", rows[0]["rmse"], ladder, inner))
    # The first of them also loads the denoiser.
    bench.blender.bake_denoised(1)
    for count in (16, samples):
        sheet, seconds = bench.blender.bake_denoised(count)
        texels = np.pi * bench.texels.pick(bench.baked.layout, sheet)
        rows.append(bench.row("cycles", "total", [seconds], texels, inner, samples=count, denoised=True))
    if max(bench.before.sky.color) > 0.0:
        # Cycles counts the sky's first segment as direct light, luxel as indirect: no pass of Cycles is the same.
        seconds = [bake_by_luxel(bench.before, bench.settings, True)[1] for _ in range(bench.repeat)]
        texels = bench.baked.light.indirect[bench.texels.texel]
        rows.append(bench.row("luxel", "indirect", seconds, texels, whole))
    else:
        rows += compare_in_turn(bench, "indirect", climb(bench, "indirect", inner), whole, inner)[0]
    return rows, luxel_s


def climb(bench: Bench, what: str, truth: Truth, extra_s: float = 0.0) -> list[dict]:
    """Return the rows of Cycles at the samples of `LADDER`."""
    rows = []
    for number, samples in enumerate(LADDER):
        rows.append(bench.cycles(what, samples, truth, bench.repeat, extra_s))
        report(f"Cycles, {what}", (number + 1) / len(LADDER))
    return rows


def compare_in_turn(
    bench: Bench, what: str, ladder: list[dict], whole: Truth, inner: Truth
) -> tuple[list[dict], list[float], int]:
    """Return the rows of both sides at equal time and the ladder's, luxel's times, and the samples of that time."""
    own, theirs = [], []
    samples = 0
    # In turn, so that what else the machine does slows both; each pair puts the next one right.
    for number in range(bench.repeat):
        own.append(bake_by_luxel(bench.before, bench.settings, what == "indirect")[1])
        if number == 0:
            samples = samples_for_time([row["samples"] for row in ladder[2:]], [row["s"] for row in ladder[2:]], own[0])
        theirs.append(bench.cycles(what, samples, inner, equal_time=True))
        samples = max(1, round(samples * own[-1] / theirs[-1]["s"]))
        report(f"{what} at equal time", (number + 1) / bench.repeat)
    light = bench.baked.light
    texels = (light.irradiance if what == "total" else light.indirect)[bench.texels.texel]
    luxel = bench.row("luxel", what, own, texels, whole)
    equal = min(theirs, key=lambda row: abs(math.log(row["s"] / luxel["s"])))
    return [luxel, equal, *ladder], own, equal["samples"]


def compare_second(bench: Bench, folder: Path, rounds: int) -> list[dict]:
    """Return the rows of the image after the light has moved."""
    scene, layout = bench.baked.scene, bench.baked.layout
    live = Live(bench)
    set_lights(scene, bench.after.lights)
    truths = make_truth(scene, layout, rounds, 6, report)
    whole, inner = (truth.take(bench.texels.texel) for truth in truths)
    rows = live.frames(whole) + live.with_direct(whole)
    save_transport(bench.baked, folder / "bake.luxel.npz")
    seconds, relit = [], bench.baked
    for _ in range(bench.repeat):
        start = time.perf_counter()
        relit = relight(folder / "bake.luxel.npz", copy_scene_data(bench.after))
        seconds.append(time.perf_counter() - start)
    texels = relit.light.irradiance[bench.texels.texel]
    rows.append(bench.row("luxel", "total", seconds, texels, whole, how="relight from the file"))

    light_s = bench.blender.light(light_order(bench.after))
    for what in ("total",) if max(bench.before.sky.color) > 0.0 else ("total", "indirect"):
        ladder = climb(bench, what, inner, light_s)
        # The row of luxel that Cycles is to reach: settled, with direct light of one sample a point or without any.
        how = count_frames(FRAMES[-2]) + (", direct light by 1 sample a point" if what == "total" else "")
        wanted = next(row["rmse"] for row in rows if row["by"] == "luxel" and row.get("how") == how)
        rows += [*ladder, reach(bench, what, wanted, ladder, inner, light_s)]
    return rows


def reach(bench: Bench, what: str, wanted: float, ladder: list[dict], inner: Truth, extra_s: float = 0.0) -> dict:
    """Return the row of the bake by Cycles, of a few tries, whose error comes nearest to `wanted`."""
    tried = list(ladder)
    for _ in range(TRIES):
        samples = samples_for_error([row["samples"] for row in tried], [row["rmse"] for row in tried], wanted)
        samples = min(samples or bench.most, bench.most)
        if any(row["samples"] == samples for row in tried):
            break
        tried.append(bench.cycles(what, samples, inner, 1, extra_s))
        if abs(math.log(max(tried[-1]["rmse"], 1e-9) / wanted)) < NEAR:
            break
    nearest = min(tried, key=lambda row: abs(math.log(max(row["rmse"], 1e-9) / wanted)))
    return {**nearest, "wanted": wanted}


class Live:
    """Luxel's frames as a program that stays open runs them: recorded once, lights changed in place."""

    def __init__(self, bench: Bench) -> None:
        self.bench, self.baked = bench, bench.baked
        self.state: Any = bench.baked.state
        self.step = dr.freeze(bench.baked.method.update)
        self.number, self.still = dr.opaque(mi.UInt32, 7), dr.opaque(mi.Bool, True)
        self.index = 0

    def run(self, count: int) -> None:
        for _ in range(count):
            frame = Frame(dr.opaque(mi.UInt32, self.index), self.number, self.still)
            self.state = self.step(self.baked.scene, self.state, frame)
            self.index += 1

    def trial(self, count: int, samples: int) -> tuple[np.ndarray, float]:
        """Settle under the light before, move it, run `count` frames; return all texels' light and the seconds."""
        baked = self.baked
        set_lights(baked.scene, self.bench.before.lights)
        self.run(SETTLE)
        dr.sync_thread()
        start = time.perf_counter()
        set_lights(baked.scene, self.bench.after.lights)
        self.run(count)
        if samples:
            light = light_texels(
                baked.scene, baked.method, self.state, baked.layout, samples=samples, seed=baked.seed
            ).irradiance
        else:
            light = np.array(self.state.light).reshape(-1, 4)[baked.layout.slot, :3]
        return light, time.perf_counter() - start

    def measure(self, what: str, count: int, samples: int, whole: Truth, how: str) -> dict[str, Any]:
        self.trial(count, samples)
        ran = [self.trial(count, samples) for _ in range(max(self.bench.repeat, 5))]
        texels = ran[-1][0][self.bench.texels.texel]
        return self.bench.row("luxel", what, [seconds for _, seconds in ran], texels, whole, how=how)

    def frames(self, whole: Truth) -> list[dict[str, Any]]:
        """Return rows of the indirect light after some frames."""
        return [self.measure("indirect", count, 0, whole, count_frames(count)) for count in FRAMES]

    def with_direct(self, whole: Truth) -> list[dict[str, Any]]:
        """Return rows of all light: settled frames, and direct light cast for the texels themselves."""
        count = FRAMES[-2]
        rows = []
        for samples in (1, 16):
            how = f"{count_frames(count)}, direct light by {samples} sample{'s' * (samples > 1)} a point"
            rows.append(self.measure("total", count, samples, whole, how))
        return rows


def count_frames(count: int) -> str:
    """Return `count` frames in words, the name of a row."""
    return f"{count} frame{'s' * (count > 1)}"


def report(text: str, share: float) -> None:
    """Say on a terminal how far the work is."""
    if sys.stderr.isatty():
        print(f"\r{text}: {100.0 * share:.0f} %   ", end="\n" if share >= 1.0 else "", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
