"""The sources' measurements done again: their figures as printed, the pieces, and tiny runs."""

from __future__ import annotations

import importlib.util
import json
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from luxel import runtime
from luxel.bench.reproduce import StudyReport, Table, TableRow, ekberg, published
from luxel.bench.reproduce.ekberg import ray_settings, start_ekberg
from luxel.bench.reproduce.ekberg import split_stages as split_methods
from luxel.bench.reproduce.fast_object import (
    COLD,
    OBJECT_ID,
    WARM,
    Direction,
    TimeSeries,
    marks,
    measure_direction,
    start_fast_object,
    two_places,
)
from luxel.bench.reproduce.regions import chroma_distance, chroma_spread, mean_error, object_mask, region_mask
from luxel.bench.reproduce.rohacek import NO_OFFSETS, split_stages, start_rohacek, table_memory
from luxel.bench.reproduce.run_store import RunStore, describe_making
from luxel.bench.reproduce.runs import QUICK, PixelChanges, StudyView
from luxel.bench.reproduce.sponza_views import FLIGHT, PLANT, VIEWS, Region
from luxel.bench.reproduce.study import StudyRunner
from luxel.errors import LuxelError
from luxel.metrics.temporal import flicker
from luxel.render.renderer import Renderer
from luxel.scene.device import upload
from luxel.scene.edit import default_camera, parse_camera

DEVICE = os.environ.get("LUXEL_TEST_DEVICE", "cpu")


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LUXEL_CACHE", str(tmp_path_factory.mktemp("cache")))


# ---------- What the sources print ----------


def test_the_memory_table_is_the_formula() -> None:
    table = table_memory()
    assert len(table.rows) == 8
    assert [row.ours for row in table.rows] == [row.published for row in table.rows]


def test_sums_over_the_image_are_full_hd_means() -> None:
    for total, mean, _ in published.DEAD_PROBES.values():
        assert total / mean == pytest.approx(published.FULL_HD, rel=1e-4)
    for total, mean, _ in published.STABILITY.values():
        assert total == pytest.approx(mean * published.FULL_HD, rel=0.03)


def test_printed_stage_times_sum_to_their_totals() -> None:
    tables = (published.TIMES_OVER_RAYS, published.TIMES_OVER_DEPTH, published.TIMES_STILL, published.TIMES_FLOWN)
    unlike = {key for table in tables for key, (*parts, total) in table.items() if abs(sum(parts) - total) > 0.005}
    assert unlike == {256, 2}


def test_printed_memory_is_that_of_1650_probes() -> None:
    for (depth, light), (_, _, memory) in published.MAP_RESOLUTION.items():
        bytes_a_probe = (depth + 2) ** 2 * 4 + (light + 2) ** 2 * 8
        assert memory == pytest.approx(1650 * bytes_a_probe / 1024, abs=0.06)


def test_budgets_are_items_times_rays() -> None:
    for rays, (surfel, probe) in published.EKBERG_RAYS.items():
        assert 50_000 * surfel == 20 * 10 * 10 * probe == rays
    assert ray_settings("gibs", 100_000)["rays_per_surfel"] == 2
    assert ray_settings("ddgi", 100_000)["num_samples_per_probe"] == 50


# ---------- The pieces ----------


def test_columns_name_both_sides_where_both_exist(tmp_path: Path) -> None:
    rows = [TableRow(["a"], [1.0, 2], [3.0, None]), TableRow(["b"], [None, float("nan")], [4.0, None])]
    table = Table("1", "title", ["what"], ["mean", "own"], rows, ["a note"])
    assert table.columns == ["what", "mean (ours)", "mean (published)", "own (ours)"]
    assert table.cells(rows[0]) == ["a", 1.0, 3.0, 2]
    report = StudyReport(
        "t", "s", "scene", {"size": "1x1"}, ["differs"], {"cpu": "C", "cores": 2, "gpu": None}, "cpu", [table]
    )
    for path in report.write(tmp_path / "out"):
        assert path.exists()
    read = json.loads((tmp_path / "out" / "results.json").read_text())
    assert read["tables"][0]["rows"] == [["a", 1.0, 3.0, 2], ["b", None, 4.0, None]]
    page = (tmp_path / "out" / "tables.md").read_text()
    assert "| a | 1 | 3 | 2 |" in page
    assert "| b | - | 4 | - |" in page
    assert ("machine", "cpu: C, 2 cores") in report.header()


def test_changes_agree_with_flicker() -> None:
    images = np.random.default_rng(1).random((5, 4, 6, 3))
    changes = PixelChanges()
    changes.watch(iter(images))
    assert changes.mean() == pytest.approx(flicker(images).absolute)
    assert changes.largest() >= changes.mean()
    assert np.isnan([PixelChanges().largest(), PixelChanges().mean()]).all()


def test_a_run_store_goes_on_where_it_was(tmp_path: Path) -> None:
    made_with = describe_making({"commit": "c", "cpu": "C"}, "cpu", {"size": (1, 2)}, "scene")
    first = RunStore(tmp_path, made_with)
    first.put("run", {"errors": {"mean": 1.5, "none": float("nan")}})
    first.put("run", {"changes": {"mean": 0.25}})
    first.finish("4.2")
    again = RunStore(tmp_path, made_with)
    assert (again.kept, again.set_aside, again.tables, again.date) == (1, False, ["4.2"], first.date)
    # Fresh values and read ones are the same.
    assert again.get("run") == first.get("run") == {"errors": {"mean": 1.5, "none": None}, "changes": {"mean": 0.25}}
    assert again.get("other") == {}
    assert RunStore(tmp_path, made_with, fresh=True).kept == 0
    assert [path.name for path in tmp_path.iterdir()] == ["runs.json"]


@pytest.mark.parametrize(
    ("machine", "device", "settings", "scene"),
    [
        ({"commit": "d"}, "cpu", {"size": 1}, "scene"),
        ({"commit": "c"}, "cuda", {"size": 1}, "scene"),
        ({"commit": "c"}, "cpu", {"size": 2}, "scene"),
        ({"commit": "c"}, "cpu", {"size": 1}, "other"),
    ],
)
def test_runs_of_something_else_are_set_aside(
    machine: dict[str, str], device: str, settings: dict[str, int], scene: str, tmp_path: Path
) -> None:
    RunStore(tmp_path, describe_making({"commit": "c"}, "cpu", {"size": 1}, "scene")).put("run", {"errors": {}})
    other = RunStore(tmp_path, describe_making(machine, device, settings, scene))
    assert (other.kept, other.set_aside, other.runs) == (0, True, {})


def test_a_damaged_run_store_is_set_aside(tmp_path: Path) -> None:
    made_with = describe_making({}, "cpu", {}, "scene")
    RunStore(tmp_path, made_with).put("run", {"errors": {}})
    path = tmp_path / "runs.json"
    path.write_text(path.read_text()[:-20])
    assert RunStore(tmp_path, made_with).set_aside


def test_a_run_is_done_once_for_all_that_tables_ask() -> None:
    done: list[list[str]] = []
    shares: list[float] = []
    runner = StudyRunner(RunStore(None, {}), lambda text, share: shares.append(share))

    def ask(*parts: str) -> dict[str, int]:
        def make(wanted: frozenset[str], tick: Callable[[int], None]) -> dict[str, int]:
            tick(5)
            done.append(sorted(wanted))
            return dict.fromkeys(wanted, 7)

        return runner.ask("run", parts, lambda wanted: 10, make)

    runner.count([lambda: ask("a"), lambda: ask("b")])
    assert (runner.run_count, done) == (1, [])
    assert ask("a") == {"a": 7}
    assert ask("b") == {"b": 7}
    assert done == [["a", "b"]]
    assert shares == [0.0, 0.5]
    # What nobody counted is measured all the same.
    assert ask("c") == {"c": 7}
    assert done[-1] == ["a", "b", "c"]


def test_stages_are_shared_out() -> None:
    stages = {
        "ddgi/trace": 4.0,
        "ddgi/blend": 2.0,
        "ddgi/pack": 1.0,
        "ddgi/relocate": 0.5,
        "ddgi/gather": 0.25,
        "direct": 9.0,
    }
    assert split_stages(stages) == [4.0, 3.0, 0.5, 0.25, 7.75]
    assert split_methods(stages) == [4.0, 0.25, 3.5, 7.75]


def test_colour_on_a_part_of_the_picture() -> None:
    truth = np.ones((16, 16, 3))
    truth[:, 8:] = (2.0, 0.5, 0.5)
    grey = np.ones_like(truth)
    mask = np.zeros((16, 16), bool)
    mask[4:12] = True
    assert chroma_spread(grey, mask) == 0.0
    assert chroma_spread(truth, mask) > 0.1
    assert chroma_distance(truth, truth, mask) == 0.0
    assert chroma_distance(grey, truth, mask) > 0.1
    assert mean_error(truth, truth, mask) == (0.0, 0.0)
    assert mean_error(2.0 * truth, truth, mask)[1] == pytest.approx(1.0)
    assert np.isnan(mean_error(truth, truth, np.zeros_like(mask))).all()


def test_the_crate_is_found_where_it_went() -> None:
    data = two_places()
    scene, camera = upload(data), data.cameras[0]
    before, after = (object_mask(scene, camera, (64, 36), OBJECT_ID, time) for time in (0.0, 1.0))
    assert before[:, :32].sum() > 20
    assert after[:, 32:].sum() > 20
    assert not before[:, 32:].any()
    assert not after[:, :32].any()
    around = Region((COLD[0] - 0.5, 0.2, COLD[2] - 0.5), (COLD[0] + 0.5, 1.3, COLD[2] + 0.5))
    assert (region_mask(scene, camera, (64, 36), around) & after).sum() == after.sum()
    assert WARM[0] < 0.0 < COLD[0]


def test_arrival_is_the_frame_from_which_it_stays() -> None:
    assert TimeSeries([], [3.0, 0.05, 1.0, 0.09, 0.0], 0.0, 0.0).arrival() == 4
    assert TimeSeries([], [0.01, 0.02], 0.0, 0.0).arrival() == 1
    assert TimeSeries([], [0.01, 0.5], 0.0, 0.0).arrival() is None
    assert marks(10) == [1, 2, 4, 8, 10]


# ---------- Tiny runs ----------


def expect_ours_beside_theirs(report: StudyReport) -> None:
    assert [table.name for table in report.tables] == ["4.1", "4.2", "figure 4.8"]
    assert "not public" in report.scene
    dead = report.tables[1]
    direct, filtered = dead.rows[0], dead.rows[-1]
    assert list(direct.published[:3]) == [2294603, 1.106580, 2.925490]
    assert direct.labels == ["only direct light", "-"]
    assert filtered.labels == ["improved filtering", "luxel"] and filtered.published == [None] * 4
    # The room lives on indirect light: without it the error is far larger.
    assert (direct.ours[1] or 0.0) > 1.5 * (filtered.ours[1] or 0.0) > 0.0
    for row in report.tables[2].rows:
        assert (row.ours[1] or 0.0) > 0.0
    assert set(NO_OFFSETS.values()) == {False}


def test_a_stopped_study_keeps_its_runs_and_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[frozenset[str]] = []
    run = StudyView._run
    stop_at = 3

    def counted(view: StudyView, renderer: Renderer, parts: frozenset[str], *rest: Any) -> dict[str, Any]:
        if len(done) == stop_at:
            raise KeyboardInterrupt
        done.append(parts)
        return run(view, renderer, parts, *rest)

    monkeypatch.setattr(StudyView, "_run", counted)
    tables = ["4.1", "4.2", "4.8"]

    # Table 4.2 has two runs, figure 4.8 has two: the second of them is not reached.
    measured = start_rohacek(QUICK, tables=tables, folder=tmp_path).measure()
    made = [next(measured), next(measured)]
    with pytest.raises(KeyboardInterrupt):
        next(measured)
    assert len(done) == 3
    page = json.loads((tmp_path / "results.json").read_text())
    assert [table["name"] for table in page["tables"]] == ["4.1", "4.2"]
    assert page["tables"][1]["rows"][0][2] == made[1].rows[0].ours[0]

    stop_at = 99
    study = start_rohacek(QUICK, tables=tables, folder=tmp_path)
    assert study.runner.store.kept == 5, "three runs, and the truths of two views"
    report = study.finish()
    assert len(done) == 4
    assert report.tables[1] == made[1]
    expect_ours_beside_theirs(report)
    again = start_rohacek(QUICK, tables=["4.1"], folder=tmp_path)
    again.finish()
    assert len(done) == 4
    # What is not asked for this time stays in the folder.
    page = json.loads((tmp_path / "results.json").read_text())
    assert [table["name"] for table in page["tables"]] == ["4.1", "4.2", "figure 4.8"]

    start_rohacek(replace(QUICK, seed=1), tables=["4.1"], folder=tmp_path).finish()
    page = json.loads((tmp_path / "results.json").read_text())
    assert [table["name"] for table in page["tables"]] == ["4.1"], "runs of another seed are not these"


def test_nothing_is_measured_that_no_table_asks_for(monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[frozenset[str]] = []
    run = StudyView._run

    def counted(view: StudyView, renderer: Renderer, parts: frozenset[str], *rest: Any) -> dict[str, Any]:
        done.append(parts)
        return run(view, renderer, parts, *rest)

    monkeypatch.setattr(StudyView, "_run", counted)
    shares: list[tuple[str, float]] = []
    start_rohacek(QUICK, tables=["4.6"], progress=lambda text, share: shares.append((text, share))).finish()
    assert done == [frozenset({"cache", "stages"})] * 2
    assert shares[0] == ("4.6: run 1 of 2", 0.0)
    assert [share for _, share in shares] == sorted(share for _, share in shares)
    assert 0.9 < shares[-1][1] <= 1.0


def test_bad_input_is_one_sentence() -> None:
    with pytest.raises(LuxelError, match=r"no table '9\.9'"):
        start_rohacek(QUICK, tables=["9.9"])
    with pytest.raises(LuxelError, match="--bounces"):
        start_rohacek(QUICK, tables=["4.1"], bounces="never")
    with pytest.raises(LuxelError, match="reproduce needs"):
        start_rohacek(replace(QUICK, frames=0))
    with pytest.raises(LuxelError, match="choose from forth, back"):
        start_fast_object(QUICK, tables=["up"])


def test_the_object_gets_its_new_light() -> None:
    runtime.start(DEVICE)
    budget = replace(QUICK, size=(96, 54), frames=24, spp=64)
    direction = Direction(StudyRunner(RunStore(None, {})), budget, back=False)
    errors, arrival = measure_direction(direction, [("gibs", None), ("ambient", None)])
    first, last = errors.rows[0], errors.rows[-2]
    gibs = errors.figures.index("gibs")
    ambient = errors.figures.index("ambient")
    # Surfels ride along, but forget with the way; what is left at first is their noise.
    assert (first.ours[gibs] or 0.0) > (last.ours[gibs] or 0.0) > 0.0
    assert (first.ours[gibs] or 0.0) < 0.5 * (first.ours[ambient] or 0.0)
    assert first.ours[ambient] == last.ours[ambient]
    assert (last.ours[gibs] or 0.0) < 0.5 * (last.ours[ambient] or 0.0)
    assert [row.labels[0] for row in arrival.rows] == errors.figures


def test_a_fast_object_from_end_to_end(tmp_path: Path) -> None:
    study = start_fast_object(replace(QUICK, frames=3), tables=["back"], folder=tmp_path)
    report = study.finish()
    assert [table.name for table in report.tables] == ["back, error", "back, arrival"]
    assert [row.labels for row in report.tables[0].rows] == [["1"], ["2"], ["3"], ["settled"]]
    assert all(value is not None for row in report.tables[0].rows for value in row.ours)
    assert (tmp_path / "tables.md").read_text().count("| gibs:ekberg |") == 1
    kept = start_fast_object(replace(QUICK, frames=3), tables=["back"], folder=tmp_path).finish()
    assert kept.tables == report.tables


def test_ekberg_on_sponza(scenes_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ekberg, "FLIGHT", FLIGHT[:7])
    path = scenes_folder / "sponza-crytek" / "Sponza.gltf"
    if not path.exists():
        pytest.skip(f"no {path}")
    report = start_ekberg(path, replace(QUICK, frames=4), folder=tmp_path).finish()
    quality, still, flown, pillar, plant = report.tables
    assert [row.labels[0] for row in quality.rows] == ["hallway"] * 4
    assert quality.rows[1].ours[0] == 50_000
    assert quality.rows[3].ours[0] == 200_000
    assert all(row.published == [None] * 5 for row in quality.rows)
    assert all((row.ours[-1] or 0.0) > 0.0 for row in still.rows)
    # The flight is flown: it leaves surfels on all that the camera saw.
    surfels, probes, *at_full_hd = flown.rows
    assert [row.labels[:2] for row in at_full_hd] == [["gibs:ekberg", "4"], ["gibs", "4"]]
    assert list(at_full_hd[1].published) == [None] * 6
    assert (surfels.ours[0] or 0) >= 8, "half of a flight; at rest there are next to none"
    assert probes.ours[:2] == [2000, 200_000]
    assert list(surfels.published) == [None, None, 3.1, 12.2, 0.25, 15.55]
    assert pillar.rows[0].labels == ["truth"]
    assert sum(value or 0.0 for value in pillar.rows[0].ours[:3]) == pytest.approx(1.0)
    assert {row.labels[1] for row in plant.rows} >= {"ddgi:majercik", "gibs:ekberg"}
    again = start_ekberg(path, replace(QUICK, frames=4), folder=tmp_path)
    assert again.finish().tables == report.tables
    assert again.runner.runs_done == 0


def test_views_of_sponza_can_be_read() -> None:
    data = two_places()
    for text in [*(view.camera for view in VIEWS.values()), *FLIGHT]:
        assert parse_camera(text, data).name == "custom"
    assert PLANT.grown(0.1).lower[0] == pytest.approx(PLANT.lower[0] - 0.1)
    assert default_camera(data).fov > 90.0


# ---------- Into the docs ----------


def fill_reproduce() -> Any:
    path = Path(__file__).resolve().parents[2] / "scripts" / "fill_reproduce.py"
    spec = importlib.util.spec_from_file_location("fill_reproduce", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_measured_tables_go_where_they_are_asked_for(tmp_path: Path) -> None:
    script = fill_reproduce()
    rows = [TableRow(["a", "1"], [0.5, 2], [0.25, None]), TableRow(["b", "2"], [1.5, 3], [None, None])]
    table = Table("4.2", "title", ["what", "rays"], ["mean", "own"], rows, [])
    machine = {"cpu": "C", "cores": 2, "gpu": "NVIDIA H100 80GB", "commit": "abcdef0123456789"}
    settings = {"size": "8x4", "frames": 3, "truth": "9 samples a pixel", "seed": 0}
    StudyReport("Roháček 2022, again", "s", "scene", settings, [], machine, "cuda", [table], "2022-02-02").write(
        tmp_path
    )
    reports = script.read_reports([tmp_path])
    page = (
        "<!-- measured: rohacek | head -->\nold\n<!-- /measured -->\n"
        "<!-- measured: rohacek | 4.2 | what, mean (ours), mean (published) -->\n<!-- /measured -->\n"
        "<!-- measured: rohacek | 4.2 | what, own (ours) | rays=2 -->\n<!-- /measured -->\n"
        "<!-- measured: ekberg | 5.1 | view -->\nkept\n<!-- /measured -->\n"
    )
    filled = script.fill(page, reports)
    assert "*NVIDIA H100 80GB; 2022-02-02, commit abcdef012345; 8x4, 3 frames, truth of 9 samples a pixel" in filled
    assert (
        "| what | mean (ours) | mean (published) |\n| --- | ---: | ---: |\n| a | 0.5 | 0.25 |\n| b | 1.5 | - |"
        in filled
    )
    assert "| what | own (ours) |\n| --- | ---: |\n| b | 3 |\n" in filled
    assert "old" not in filled and "kept" in filled
    assert script.fill(filled, reports) == filled
    with pytest.raises(ValueError, match="no column 'other'"):
        script.fill(page.replace("own (ours)", "other"), reports)
    with pytest.raises(ValueError, match=r"without table 4\.9"):
        script.fill(page.replace("4.2 | what, own", "4.9 | what, own"), reports)


def test_the_page_asks_for_tables_that_there_are() -> None:
    """Each marker of docs/reproduce.md names a table and columns of the study that it is of."""
    script = fill_reproduce()
    text = script.PAGE.read_text()
    asked = [match.group(2).split("|") for match in script.MARKED.finditer(text)]
    assert {parts[0].strip() for parts in asked} == {"rohacek", "ekberg"}
    assert {parts[1].strip() for parts in asked} >= {"head", "4.2", "4.3", "figure 4.8", "5.1", "5.2 after a flight"}
