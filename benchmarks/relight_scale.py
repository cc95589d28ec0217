"""How the lightmap scales: the source's sizes (1,008 surfels, 6,453 texels), 10 times and 100 times as many.

python benchmarks/relight_scale.py [SCENE ...] [--factors 1,10,100] [--steps N] [--settings NAME=VALUE ...]

Prints one line of JSON a scene and factor, each from a process of its own: the bake's time and its memory, the
relighting step as relight_step.py times it, and the error against the committed truth at a fixed number of clusters a
texel. `--settings texel_target=...` holds one size while
the factor changes the other.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from dataclasses import fields, is_dataclass

import drjit as dr
from relight_step import describe_sizes, time_step

from luxel import runtime
from luxel.bench.machine import machine_record
from luxel.methods.lightmap.method import Lightmap
from luxel.methods.lightmap.params import SOURCE
from luxel.methods.params import make_params
from luxel.metrics.error import bias, regional
from luxel.render.renderer import Renderer
from luxel.render.truth import render_truth
from luxel.scene import load
from luxel.scene.device import upload

SIZE = (256, 256)
FRAMES = 64
SPP = 4096
"""Paths a pixel of the committed truths, at least."""


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("scenes", nargs="*", default=["cornell-box", "atrium"])
    parser.add_argument("--factors", default="1,10,100")
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--settings", nargs="*", default=[], metavar="NAME=VALUE")
    parser.add_argument("--no-error", action="store_true", help="leave the truth out, as where there is none")
    parser.add_argument("--here", action="store_true", help="in this process: one scene, one factor")
    chosen = parser.parse_args()
    if chosen.here:
        print(json.dumps(measure(chosen.scenes[0], float(chosen.factors), chosen)), flush=True)
        return
    for scene in chosen.scenes:
        for factor in chosen.factors.split(","):
            command = [sys.executable, __file__, scene, "--here", "--factors", factor, "--steps", str(chosen.steps)]
            command += ["--no-error"] if chosen.no_error else []
            subprocess.run([*command, "--settings", *chosen.settings], check=True)


def measure(name: str, factor: float, chosen: argparse.Namespace) -> dict:
    """Bake, time and render one scene at one size."""
    runtime.start("auto")
    settings = {key: float(text) for key, text in (item.split("=") for item in chosen.settings)}
    sizes = {key: int(SOURCE[key] * factor) for key in ("texel_target", "surfel_target")}
    params = make_params("lightmap", None, {**sizes, **settings})
    method, scene = Lightmap(), upload(load(name))
    before = _peak_mib()
    start = time.perf_counter()
    state = method.build(scene, params, 0)
    dr.sync_thread()
    report = {
        **machine_record(),
        "scene": name,
        "factor": factor,
        **describe_sizes(state),
        "bake_s": round(time.perf_counter() - start, 2),
        "bake_peak_mib": round(_peak_mib() - before),
        "state_mib": round(_state_bytes(state) / 2**20, 1),
        **time_step(method, scene, state, chosen.steps),
    }
    return report if chosen.no_error else {**report, **_errors(name, scene, params, state)}


def _errors(name: str, scene, params, state) -> dict[str, float]:  # noqa: ANN001
    truth = render_truth(load(name), size=SIZE, spp=SPP)
    if truth.seconds > 0.0:
        raise SystemExit(f"{name}: its truth is not committed; --no-error leaves it out")
    renderer = Renderer(scene, "lightmap", params, size=SIZE, state=state)
    renderer.run(FRAMES)
    layers = renderer.layers()
    return {"regional": round(regional(layers, truth.layers), 4), "bias": round(bias(layers, truth.layers), 4)}


def _state_bytes(value: object) -> int:
    """Return the bytes of the arrays of a state: all of words of 4 bytes."""
    if dr.is_array_v(value):
        parts = [value] if dr.depth_v(value) == 1 else list(value)  # type: ignore[call-overload]
        return sum(4 * dr.width(part) for part in parts)
    if isinstance(value, list):
        return sum(_state_bytes(item) for item in value)
    return sum(_state_bytes(getattr(value, item.name)) for item in fields(value)) if is_dataclass(value) else 0


def _peak_mib() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


if __name__ == "__main__":
    main()
