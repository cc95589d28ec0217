"""Print tables of the docs: what the departures of `gibs` are worth, what each fix of `ddgi` is worth, how calm it is.

python benchmarks/tables.py [ablation|fixes|accuracy|calm ...] [--sponza Sponza.gltf] [--frames 256]

Views are judged by the committed truths (`benchmarks/references`). Rows of Sponza are left out without its file, and
said so. `calm` takes 1920x1080 and a GPU.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import date
from typing import Any

import numpy as np

import luxel
from luxel import runtime
from luxel.image.tonemap import mean_exposure, to_display
from luxel.metrics.error import all_errors
from luxel.metrics.temporal import flicker, lag_frames
from luxel.scene.device import Scene, upload
from luxel.scene.edit import default_camera, parse_camera
from luxel.scene.model import Camera

Settings = dict[str, Any]

SPONZA_CAMERA = "-9,2,0;5,2.5,0;65"
SETTLE_FRAMES, STILL_FRAMES, LAG_FRAMES = 256, 50, 120

ABLATION: list[tuple[str, str, Settings, int]] = [
    ("default", "gibs", {}, 1),
    ("without surfels at ray hits, `fill_bare=false`", "gibs", {"hit_spawn_threshold": 0.0, "fill_bare": False}, 1),
    ("estimator from cold", "gibs", {"warm_samples": 0}, 1),
    ("16x16 tiles, 8 % chance, no rule of one a cell", "gibs",
     {"tile_size": 16, "spawn_chance": 0.08, "spawn_once_a_cell": False}, 1),
    ("random rays", "gibs", {"low_discrepancy": False}, 1),
    ("normals' cosine to the power 1", "gibs", {"normal_power": 1}, 1),
    ("all of them: `--preset ekberg`", "gibs:ekberg", {}, 1),
    ("1 ray a surfel", "gibs", {"rays_per_surfel": 1}, 1),
    ("16 rays a surfel", "gibs", {"rays_per_surfel": 16}, 1),
    ("`surfel_target=100000`", "gibs", {"surfel_target": 100_000}, 1),
    ("`surfel_target=200000`", "gibs", {"surfel_target": 200_000}, 1),
    ("`ambient`", "ambient", {}, 1),
    ("`none`", "none", {}, 1),
    ("`--preset ekberg` after 16 times the frames", "gibs:ekberg", {}, 16),
    ("default after 16 times the frames", "gibs", {}, 16),
]  # fmt: skip
"""Label, method, settings, times the frames."""
MOMENTS: Settings = {"depth_model": "moments"}
FIXES: list[tuple[str, str, Settings, int]] = [
    ("default", "ddgi", {}, 1),
    ("`bounces=path`", "ddgi", {"bounces": "path"}, 1),
    ("`offset_dead_probes=false`", "ddgi", {"offset_dead_probes": False}, 1),
    ("`corrected_weights=false`", "ddgi", {"corrected_weights": False}, 1),
    ("`depth_model=moments`", "ddgi", MOMENTS, 1),
    ("`depth_model=moments far_depth=clamp`", "ddgi", MOMENTS | {"far_depth": "clamp"}, 1),
    ("`depth_model=moments far_depth=keep`", "ddgi", MOMENTS | {"far_depth": "keep"}, 1),
    ("`--preset majercik` (none of the fixes)", "ddgi:majercik", {}, 1),
]
CALM_RAYS = (8, 16, 32, 64, 128, 256)
GRID: Settings = {"num_probes_x": 11, "num_probes_y": 10, "num_probes_z": 15}


@dataclass
class View:
    """A scene, where it is seen from, and how large."""

    name: str
    scene: Scene
    camera: Camera
    size: tuple[int, int]

    def judge(self, method: str, settings: Settings, frames: int) -> dict[str, float]:
        """Return every figure of `method` after `frames` frames."""
        truth = luxel.render_truth(self.scene, camera=self.camera, size=self.size, spp=1024)
        name, _, preset = method.partition(":")
        renderer = luxel.Renderer(self.scene, name, settings, preset=preset or None, size=self.size, camera=self.camera)
        renderer.run(frames)
        return all_errors(renderer.layers(), truth.layers, truth.halves)


def find_views(names: Sequence[str], sponza: str | None) -> Iterator[View]:
    """Yield the views of the committed truths: built-in scenes by name, `sponza` and `sponza-default`."""
    for name in names:
        if not name.startswith("sponza"):
            data = luxel.load(name)
            yield View(name, upload(data), default_camera(data), (256, 256))
        elif sponza is None:
            print(f"(no --sponza: {name} is left out)")
        else:
            data = luxel.load(sponza)
            camera = parse_camera(SPONZA_CAMERA, data) if name == "sponza" else default_camera(data)
            yield View(name, upload(data), camera, (480, 270))


def print_rows(view: View, rows: Sequence[tuple[str, str, Settings, int]], frames: int, keys: Sequence[str]) -> None:
    """Print a Markdown table of a view, a row each."""
    print(f"\n| {view.name}, frame {frames} | {' | '.join(keys)} |\n| --- |{' --- |' * len(keys)}")
    for label, method, settings, times in rows:
        found = view.judge(method, settings, frames * times)
        cells = (f"{100.0 * found[key]:+.2f} %" if key == "bias" else f"{found[key]:.4f}" for key in keys)
        print(f"| {label} | {' | '.join(cells)} |", flush=True)


def print_calm() -> None:
    """Print flicker and the frames to nine tenths of halved and doubled light, by rays a probe."""
    print("\n| rays a probe | `flicker_absolute` | halved | doubled |\n| --- | --- | --- | --- |")
    scene = upload(luxel.load("atrium"))
    for rays in CALM_RAYS:
        renderer = luxel.Renderer(scene, "ddgi", GRID | {"num_samples_per_probe": rays}, size=(1920, 1080))
        renderer.run(SETTLE_FRAMES)
        direct, exposure = renderer.layers().direct, mean_exposure(renderer.image())
        calm = flicker(to_display(image, exposure) for image in _still_images(renderer, direct)).absolute
        lags = [_measure_lag(renderer, scene, scale) for scale in (0.5, 2.0)]
        print(f"| {rays} | {calm:.5f} | {lags[0]} | {lags[1]} |", flush=True)


def _still_images(renderer: luxel.Renderer, direct: np.ndarray) -> Iterator[np.ndarray]:
    for _ in range(STILL_FRAMES + 1):
        renderer.step()
        yield replace(renderer.layers(), direct=direct).image()


def _measure_lag(renderer: luxel.Renderer, scene: Scene, scale: float) -> int | None:
    """Return how many frames indirect light takes to follow all lights times `scale`; then they are as before."""
    from luxel.scene.live import set_light_scale

    before = float(renderer.layers().indirect.mean())
    set_light_scale(scene, scale)
    series = []
    for _ in range(LAG_FRAMES):
        renderer.step()
        series.append(float(renderer.layers().indirect.mean()))
    set_light_scale(scene, 1.0)
    renderer.run(SETTLE_FRAMES)
    return lag_frames(before, series, scale)


def main() -> None:
    """Print the tables that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tables", nargs="*", default=["ablation", "fixes", "accuracy", "calm"])
    parser.add_argument("--sponza", help="Crytek Sponza as glTF")
    parser.add_argument("--frames", type=int, default=256)
    given = parser.parse_args()
    print(f"{runtime.start('auto').name}, {date.today()}, seed 0")
    for table in given.tables:
        if table == "ablation":
            for view in find_views(["cornell-box", "sponza"], given.sponza):
                print_rows(view, ABLATION, given.frames, ["regional", "bias", "flip"])
        elif table == "fixes":
            for view in find_views(["attic"], None):
                print_rows(view, FIXES, given.frames, ["regional", "bias", "abs_error_mean", "block_error_max"])
        elif table == "accuracy":
            names = ["cornell-box", "two-rooms", "atrium", "attic", "sponza", "sponza-default"]
            for view in find_views(names, given.sponza):
                print_rows(view, [("`ddgi`", "ddgi", {}, 1)], given.frames, ["regional", "bias", "flip"])
        elif table == "calm":
            print_calm()
        else:
            parser.error(f"no such table: {table}")


if __name__ == "__main__":
    main()
