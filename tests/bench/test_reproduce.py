"""The sources' measurements done again: their figures as printed, the pieces, and tiny runs."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from luxel.bench.reproduce import Report, Row, Table, published
from luxel.bench.reproduce.ekberg import ray_settings, reproduce_ekberg
from luxel.bench.reproduce.ekberg import split_stages as split_methods
from luxel.bench.reproduce.fast_object import COLD, OBJECT_ID, WARM, Course, marks, measure_direction, two_places
from luxel.bench.reproduce.regions import chroma_distance, chroma_spread, mean_error, object_mask, region_mask
from luxel.bench.reproduce.rohacek import NO_OFFSETS, reproduce_rohacek, split_stages, table_memory
from luxel.bench.reproduce.runs import QUICK, Changes
from luxel.bench.reproduce.sponza_views import FLIGHT, PLANT, VIEWS, Region
from luxel.errors import LuxelError
from luxel.metrics.temporal import flicker
from luxel.scene.device import upload
from luxel.scene.edit import default_camera, parse_camera


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
    rows = [Row(["a"], [1.0, 2], [3.0, None]), Row(["b"], [None, float("nan")], [4.0, None])]
    table = Table("1", "title", ["what"], ["mean", "own"], rows, ["a note"])
    assert table.columns == ["what", "mean (ours)", "mean (published)", "own (ours)"]
    assert table.cells(rows[0]) == ["a", 1.0, 3.0, 2]
    report = Report(
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
    changes = Changes()
    mean = flicker(changes.watch(iter(images))).absolute
    assert changes.total is not None
    assert changes.total.mean() / changes.count == pytest.approx(mean)
    assert changes.largest() >= mean
    assert np.isnan(Changes().largest())


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
    assert Course([], [3.0, 0.05, 1.0, 0.09, 0.0], 0.0, 0.0).arrival() == 4
    assert Course([], [0.01, 0.02], 0.0, 0.0).arrival() == 1
    assert Course([], [0.01, 0.5], 0.0, 0.0).arrival() is None
    assert marks(10) == [1, 2, 4, 8, 10]


# ---------- Tiny runs ----------


def test_rohacek_prints_ours_beside_theirs() -> None:
    report = reproduce_rohacek(QUICK, tables=["4.1", "4.2", "4.8"])
    assert [table.name for table in report.tables] == ["4.1", "4.2", "figure 4.8"]
    assert "not public" in report.scene
    dead = report.tables[1]
    direct, filtered = dead.rows[0], dead.rows[-1]
    assert list(direct.published[:3]) == [2294603, 1.106580, 2.925490]
    assert direct.labels == ["only direct light"]
    # The room lives on indirect light: without it the error is far larger.
    assert (direct.ours[1] or 0.0) > 1.5 * (filtered.ours[1] or 0.0) > 0.0
    for row in report.tables[2].rows:
        assert (row.ours[1] or 0.0) > 0.0
    assert set(NO_OFFSETS.values()) == {False}


def test_bad_input_is_one_sentence() -> None:
    with pytest.raises(LuxelError, match=r"no table '9\.9'"):
        reproduce_rohacek(QUICK, tables=["9.9"])
    with pytest.raises(LuxelError, match="--bounces"):
        reproduce_rohacek(QUICK, tables=["4.1"], bounces="never")
    with pytest.raises(LuxelError, match="reproduce needs"):
        reproduce_rohacek(replace(QUICK, frames=0))


def test_the_object_takes_time_to_get_its_new_light() -> None:
    budget = replace(QUICK, size=(96, 54), frames=24, spp=64)
    errors, arrival = measure_direction(budget, False, lambda text, share: None, [("gibs", None), ("ambient", None)])
    first, last = errors.rows[0], errors.rows[-2]
    gibs = errors.figures.index("gibs")
    ambient = errors.figures.index("ambient")
    # Surfels ride along with the strong light, and then forget it.
    assert (first.ours[gibs] or 0.0) > 3.0 * (last.ours[gibs] or 0.0)
    assert first.ours[ambient] == last.ours[ambient]
    assert (last.ours[gibs] or 0.0) < 0.5 * (last.ours[ambient] or 0.0)
    assert [row.labels[0] for row in arrival.rows] == errors.figures


def test_ekberg_on_sponza(scenes_folder: Path) -> None:
    path = scenes_folder / "sponza-crytek" / "Sponza.gltf"
    if not path.exists():
        pytest.skip(f"no {path}")
    report = reproduce_ekberg(path, replace(QUICK, frames=4), tables=["quality", "plant"])
    quality, plant = report.tables
    assert [row.labels[0] for row in quality.rows] == ["hallway"] * 4
    assert quality.rows[1].ours[0] == 50_000
    assert quality.rows[3].ours[0] == 200_000
    assert all(row.published == [None] * 5 for row in quality.rows)
    assert {row.labels[1] for row in plant.rows} >= {"ddgi:majercik", "gibs:ekberg"}


def test_views_of_sponza_can_be_read() -> None:
    data = two_places()
    for text in [*(view.camera for view in VIEWS.values()), *FLIGHT]:
        assert parse_camera(text, data).name == "custom"
    assert PLANT.grown(0.1).lower[0] == pytest.approx(PLANT.lower[0] - 0.1)
    assert default_camera(data).fov > 90.0
