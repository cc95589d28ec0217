"""`bench`: its figures, and the line that it records."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from luxel.bench import bench, machine_name, record
from luxel.errors import LuxelError
from luxel.render.renderer import Renderer

PARAMS = {"surfel_target": "500", "share_rays": "false"}
"""So that each surfel has as many rays as any other."""


@pytest.fixture(scope="module")
def result() -> dict[str, Any]:
    return bench("gibs", "furnace", size=(24, 16), frames=3, seed=5, params=PARAMS)


def test_figures_are_consistent(result: dict[str, Any]) -> None:
    frame = result["frame_ms"]
    assert 0.0 < frame["min"] <= frame["median"] <= frame["max"]
    assert result["ratio"] == pytest.approx(frame["median"] / result["floor_ms"])
    count = result["cache"]["surfel_count"]
    assert result["rays_per_frame"].pop("short") == 2 * count, "two texels of each surfel's depth map"
    rays = sum(result["rays_per_frame"].values())
    cached, odd = divmod(rays - 2 * 24 * 16, 2 * 4)
    assert odd == 0, "a primary ray a pixel, four a surfel, and a shadow ray for each"
    assert 0.95 * count < cached <= count, "those that the last frame spawned have none yet"
    assert result["rays_per_second"] == pytest.approx(1e3 * rays / frame["median"])
    assert result["size"] == [24, 16] and result["materials"] == "diffuse"
    assert result["params"] == PARAMS
    assert result["compilations_after_warmup"] == 0
    assert result["gpu_memory_mb" if result["device"] == "cuda" else "memory_mb"] > 0.0
    assert "gbuffer" in result["stages"]


def test_a_path_tracer_reports_no_floor() -> None:
    """Its paths end by chance: a count of rays would be a guess, so there is none."""
    found = bench("path", "furnace", size=(24, 16), frames=2, params={"samples": "2"})
    assert found["floor_ms"] is None and found["ratio"] is None and found["rays_per_frame"] is None
    assert found["stages"]["path/trace"] > 0.0


def test_the_path_tracer_is_timed_with_full_materials(monkeypatch: pytest.MonkeyPatch) -> None:
    timed: list[Any] = []
    monkeypatch.setattr("luxel.bench.run.time_pipelined", lambda renderer, frames: timed.append(renderer) or 1.0)
    full = bench("path", "glossy", size=(16, 16), frames=2, materials="full")
    assert timed[0].scene.features.gloss and timed[0].layers().glossy.any()
    assert full["materials"] == "full" and full["compilations_after_warmup"] == 0 and full["stages"]["path/trace"] > 0.0


def test_each_record_is_one_line(result: dict[str, Any], tmp_path: Path) -> None:
    folder = tmp_path / "benchmarks" / "results"
    path = record(result, folder)
    assert record(result, folder) == path == folder / f"{machine_name(result['machine'])}.jsonl"
    lines = path.read_text().splitlines()
    assert len(lines) == 2
    assert json.loads(lines[0]) == json.loads(lines[1])
    assert json.loads(lines[0])["method"] == "gibs"


def test_bad_input_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(LuxelError, match="1 or more"):
        bench(frames=0)
    (tmp_path / "file").write_text("")
    with pytest.raises(LuxelError, match="cannot append"):
        record({"machine": {"cpu": "x", "cores": 1, "gpu": None, "device": "cpu"}}, tmp_path / "file")


def test_path_is_timed_with_full_materials(monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[str] = []

    class Spy(Renderer):
        def __init__(self, *given: Any, **named: Any) -> None:
            super().__init__(*given, **named)
            shown.append(self.scene.host.looks)

    monkeypatch.setattr("luxel.render.renderer.Renderer", Spy)
    for materials in ("full", "diffuse"):
        assert bench("path", "furnace", size=(8, 8), frames=1, materials=materials)["materials"] == materials
    assert shown == ["full", "diffuse"]


@pytest.mark.parametrize(("materials", "words"), [("full", "diffuse materials"), ("half", "diffuse or full")])
def test_materials_that_a_method_does_not_show_are_refused(materials: str, words: str) -> None:
    with pytest.raises(LuxelError, match=words):
        bench("gibs", "furnace", size=(8, 8), frames=1, materials=materials)
