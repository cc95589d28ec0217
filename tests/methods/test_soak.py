"""The long runs of `make soak`: memory and frame time stay flat, and light stays where it is known to be."""

from __future__ import annotations

import datetime
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from luxel import load, runtime
from luxel.bench.machine import machine_name, machine_record
from luxel.methods import METHODS
from luxel.metrics.temporal import drift
from luxel.render.renderer import Renderer

FRAMES = 1000
SETTLING = 200
"""Frames before the drift is looked at: the cache fills, and kernels are compiled."""
LONG_FRAMES = 10_000
DEVICE = os.environ.get("LUXEL_TEST_DEVICE", "cpu")
RESULTS = Path(__file__).parents[2] / "benchmarks" / "results"


@pytest.mark.soak
@pytest.mark.parametrize("name", sorted(METHODS))
def test_a_thousand_frames(name: str) -> None:
    """Drift is the Theil-Sen slope over the run over the median; medians of 20 frames keep other work out of it."""
    renderer = Renderer("cornell-box", name, size=(128, 128), device=DEVICE)
    renderer.run(SETTLING)
    recordings = renderer.compilations
    frame_ms, memory_mb, light = [], [], []
    for _ in range((FRAMES - SETTLING) // 20):
        frame_ms.append(float(np.median(renderer.run(20))))
        memory_mb.append(float(runtime.memory_mb()))
        light.append(float(renderer.layers().indirect.mean()))
    found = {
        "soak": name,
        "frames": FRAMES,
        "frame_ms": float(np.median(frame_ms)),
        "frame_ms_drift": drift(frame_ms),
        "memory_mb": memory_mb[-1],
        "memory_drift": drift(memory_mb),
        "light_drift": drift(light) if name != "none" else 0.0,
    }
    write(found)
    assert renderer.compilations == recordings
    assert abs(found["memory_drift"]) < 0.01
    assert abs(found["light_drift"]) < 0.01
    # A ratio with slack: the figure itself is what the record is for, and other work on the machine moves it.
    assert abs(found["frame_ms_drift"]) < 0.1


@pytest.mark.soak
@pytest.mark.parametrize("scene", ["furnace", "sphere"])
@pytest.mark.parametrize("name", ["gibs", "ddgi"])
def test_ten_thousand_frames_stay_on_the_known_value(name: str, scene: str) -> None:
    """Feedback closes on itself ten thousand times: an error of a millionth a frame would show."""
    data = load(scene)
    known = data.facts["indirect_irradiance"]
    renderer = Renderer(data, name, size=(64, 64), device=DEVICE)
    renderer.run(SETTLING)
    light = []
    for _ in range((LONG_FRAMES - SETTLING) // 100):
        renderer.run(100)
        layers = renderer.layers()
        light.append(float(layers.indirect[layers.hit].mean() / known))
    found = {
        "soak": name,
        "scene": scene,
        "frames": LONG_FRAMES,
        "error_mean": float(np.mean(light)) - 1.0,
        "error_max": float(np.abs(np.array(light) - 1.0).max()),
        "light_drift": drift(light),
    }
    write(found)
    assert found["error_max"] < 0.005
    assert abs(found["light_drift"]) < 0.001


def write(found: dict[str, Any]) -> None:
    """Add a record to the results of this machine."""
    found["machine"] = machine_record()
    found["date"] = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    folder = Path(os.environ.get("OUT", RESULTS))
    with (folder / f"{machine_name(found['machine'])}-soak.jsonl").open("a") as stream:
        stream.write(json.dumps(found) + "\n")
