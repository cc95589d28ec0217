"""Time a relighting step of the lightmap.

python benchmarks/relight_step.py [SCENE] [--large] [--steps N]

Prints one line of JSON: stages in the order of the lightmap's source (surfels, clusters, texels; device time), the
whole step as a caller waits for it (frozen, median and quickest), and the floor: the bare shadow rays and the bytes
that the step must move over the measured bandwidth.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel import runtime
from luxel.bench.machine import machine_record
from luxel.kernels.trace import offset_origin, trace_occluded
from luxel.methods.base import Frame
from luxel.methods.lightmap.method import Lightmap
from luxel.methods.lightmap.run.state import LightmapState, bake_of
from luxel.methods.lightmap.workload import LightmapWorkload
from luxel.methods.params import make_params
from luxel.render.floor import light_targets, measure_bandwidth
from luxel.scene import load
from luxel.scene.device import Scene, upload
from luxel.stages import recording


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("scene", nargs="?", default="cornell-box")
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--large", action="store_true", help="the defaults in place of the source's sizes")
    chosen = parser.parse_args()
    runtime.start("auto")
    method, scene = Lightmap(), upload(load(chosen.scene))
    start = time.perf_counter()
    state = method.build(scene, make_params("lightmap", None if chosen.large else "source"), 0)
    bake_s = time.perf_counter() - start
    report = {**machine_record(), "scene": chosen.scene, "bake_s": round(bake_s, 2)}
    print(json.dumps({**report, **describe_sizes(state), **time_step(method, scene, state, chosen.steps)}))


def describe_sizes(state: LightmapState) -> dict[str, float]:
    """Return how much of everything there is."""
    bake = bake_of(state)
    return {
        "surfels": len(bake.surfel_p),
        "clusters": len(bake.tree_low),
        "texels": len(bake.texel_slot),
        "rows": len(bake.words),
        "clusters_per_texel": round(float((bake.words != 0).sum(axis=1).mean()), 1),
    }


def time_step(method: Lightmap, scene: Scene, state: LightmapState, steps: int) -> dict[str, Any]:
    """Return the milliseconds of a step: by stages, whole and frozen, and its floor."""
    frame = Frame(dr.opaque(mi.UInt32, 0), dr.opaque(mi.UInt32, 1), dr.opaque(mi.Bool, False))
    step = dr.freeze(method.update)
    spent = []
    for _ in range(steps + 20):
        start = time.perf_counter()
        state = step(scene, state, frame)
        dr.sync_thread()
        spent.append(1e3 * (time.perf_counter() - start))
        frame = replace(frame, index=frame.index + 1)
        dr.eval(frame.index)
    with recording() as recorder:
        for _ in range(50):
            state = method.update(scene, state, frame)
            dr.eval(state.light)
    median, floor = statistics.median(spent[20:]), floor_ms(method, scene, state)
    return {
        "stages_ms": {name: round(ms, 4) for name, ms in recorder.medians().items()},
        "step_ms": round(median, 4),
        "step_ms_quickest": round(min(spent[20:]), 4),
        "floor_ms": round(floor, 4),
        "step_over_floor": round(median / floor, 2),
    }


def floor_ms(method: Lightmap, scene: Scene, state: LightmapState) -> float:
    """Return the bare shadow rays of a step and its bytes over the bandwidth, milliseconds."""
    surfels = state.surfels
    lane = dr.arange(mi.UInt32, surfels.count * surfels.samples) * surfels.sets
    p, n = dr.gather(mi.Point3f, surfels.p, lane), dr.gather(mi.Normal3f, surfels.n_geometric, lane)
    origin = offset_origin(scene, p, n)
    rays = 0.0
    for target, is_point, count in light_targets(scene):
        way = target - origin if is_point else mi.Vector3f(target)
        distance = dr.norm(way) * 0.999 if is_point else mi.Float(1e10)
        wanted = dr.dot(way, n) > 0.0
        way = dr.normalize(way)
        dr.eval(origin, way, distance, wanted)
        rays += count * _median_ms(lambda w=way, d=distance, a=wanted: trace_occluded(scene, origin, w, d, a))
    return rays + 1e3 * LightmapWorkload().touched_bytes(state) / measure_bandwidth()


def _median_ms(function: Callable[[], mi.Bool]) -> float:
    spent = []
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for _ in range(50):
            dr.sync_thread()
            dr.kernel_history_clear()
            dr.eval(function())
            dr.sync_thread()
            spent.append(sum(entry["execution_time"] for entry in dr.kernel_history()))
    return float(np.median(spent))


if __name__ == "__main__":
    main()
