"""The report's section "In motion": what it says, draws and shows, and how much room its pictures take."""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from luxel.report.conclusions import describe_all, warn_all
from luxel.report.motion_page import describe_motion
from luxel.report.page import write_report
from luxel.report.plots import Line, linear_ticks, plot_error
from luxel.report.results import SceneResults, read_results
from luxel.report.strips import STRIP_BUDGET, read_strips

Comparison = Callable[..., Path]
Flown = Callable[..., dict[str, Any]]
JUDGED = list(range(6, 97, 6))


def make_series(regional: float | None, flip: float | None = 0.02) -> dict[str, Any]:
    return {
        "frame": JUDGED,
        "regional": [regional] * 16,
        "bias": [0.0] * 16,
        "flip": [flip] * 16,
        "flicker": [0.01] * 16,
        "cut": {"frame": [1, 4, 16], "regional": [regional and factor * regional for factor in (3.0, 2.0, 1.0)]},
    }


def make_motion(regional: float | None, flip: float | None = 0.02) -> dict[str, Any]:
    """Return the motion's part of an entry."""
    return {
        "motion_regional": regional, "motion_regional_worst": regional and 1.5 * regional, "motion_flip": flip,
        "motion_bias": 0.01, "motion_flicker": 0.01, "cut_regional": regional and 2.0 * regional, "motion_ms": 40.0,
        "motion": make_series(regional, flip),
    }  # fmt: skip


def make_flown_peer(of: str, regional: float | None, preset: str = "", denoised: str | None = None) -> dict[str, Any]:
    file = "_".join(part for part in (f"path_at_{of}", preset, "denoised" if denoised else "") if part)
    return {
        **make_motion(regional), "of": of, "denoised": denoised, "ms": 36.0, "of_ms": 40.0, "run": "motion",
        "label": f"path:{preset}" if preset else "path", "file": file, "regional": None, "flip": None, "samples": 7,
        "time_ratio": 0.9, "history": 12 if preset else None,
    }  # fmt: skip


@pytest.fixture
def make_flown(usual_results: dict[str, Any]) -> Flown:
    """A function that returns a comparison whose first scene was flown through, `changes` in the flight's record."""
    return lambda **changes: fly_through_box(copy.deepcopy(usual_results), **changes)


def fly_through_box(results: dict[str, Any], **changes: Any) -> dict[str, Any]:
    scene = results["scenes"]["box"]
    scene["reference"]["motion"] = {
        "frames": 96, "path": None, "judged": JUDGED, "pictured": [6, 24, 42, 60, 78, 96], "spp": 512, "noise": 0.001,
        "kept": "layers", "exposure": 0.5, **changes,
    }  # fmt: skip
    for name, regional in {"none": 1.0, "ambient": 0.3, "gibs": 0.04, "ddgi": 0.06}.items():
        scene["methods"][name] |= make_motion(regional)
    scene["peers"] += [
        make_flown_peer("gibs", 0.16),
        make_flown_peer("gibs", 0.0405, "reproject"),
        make_flown_peer("gibs", 0.02, "reproject", "oidn"),
    ]
    return results


def write(folder: Path, results: dict[str, Any]) -> SceneResults:
    """Write results.json alone, and read its first scene."""
    folder.mkdir(exist_ok=True)
    (folder / "results.json").write_text(json.dumps(results))
    return read_results(folder).scenes[0]


def paint_strips(folder: Path, scene: SceneResults, size: tuple[int, int] = (1920, 180), noisy: bool = False) -> None:
    random = np.random.default_rng(1)
    (folder / scene.folder).mkdir(exist_ok=True)
    for stem in ("truth", *(entry.file for entry in (*scene.pick("method"), *scene.motion_peers))):
        grey = (
            random.integers(0, 256, (size[1], size[0], 3), np.uint8)
            if noisy
            else np.full((*size[::-1], 3), 90, np.uint8)
        )
        Image.fromarray(grey).save(folder / scene.folder / f"{stem}_motion.png")


def test_the_verdict_is_arithmetic(make_flown: Flown, tmp_path: Path) -> None:
    section = describe_motion(write(tmp_path, make_flown()), {})
    assert section is not None
    said = dict(section["sentences"])
    # 0.04 against 0.06 with a noise of 0.001; ambient 0.3 is 7.5 times as far off; at rest it was 0.02.
    assert (
        said["Nearest"] == "gibs, motion_regional 0.0400, 0.0600 in the worst frame; ambient is 7.5 times as far off."
    )
    assert "gibs is 2 times as far off as at rest (0.0200)" in said["Beside rest"]
    assert "ddgi is about as far off as at rest (0.0600)" in said["Beside rest"]
    assert "gibs 0.120 in frame 1, 0.0800 in frame 4 and 0.0400 in frame 16" in said["Jump"]
    assert said["Equal time"] == (
        "Given gibs’s 40 ms (0.0400), the path tracer with 7 paths a pixel (0.160) loses to it, with 7 paths a pixel "
        "and a history of 12 (0.0405) ties with it and with 7 paths a pixel, a history of 12 and oidn (0.0200) beats "
        "it."
    )


def test_who_is_nearer_in_motion_than_at_rest_is_said_to_be(make_flown: Flown, tmp_path: Path) -> None:
    results = make_flown()
    results["scenes"]["box"]["methods"]["gibs"]["regional"] = 0.2
    section = describe_motion(write(tmp_path, results), {})
    assert section is not None
    assert "gibs is 5 times nearer than at rest (0.200)" in dict(section["sentences"])["Beside rest"]


def test_the_headline_says_who_is_nearest_in_motion(make_flown: Flown, tmp_path: Path) -> None:
    assert dict(describe_all([write(tmp_path, make_flown())]))["Nearest in motion"] == "gibs, 0.0400"
    assert "Nearest in motion" not in dict(describe_all(read_results(tmp_path).scenes[1:]))


def test_an_error_in_motion_near_the_truths_noise_is_called_out(make_flown: Flown, tmp_path: Path) -> None:
    said = "The error of gibs in motion is less than three times the truth’s noise on box: a better truth needs more "
    scenes = [write(tmp_path, make_flown(noise=0.014))]  # gibs has 0.04, ddgi 0.06
    assert [text for text in warn_all(scenes) if "in motion" in text] == [f"{said}--motion-spp."]
    assert not [text for text in warn_all([write(tmp_path, make_flown())]) if "in motion" in text]


def test_peers_in_motion_have_no_part_in_what_is_judged_at_rest(make_flown: Flown, tmp_path: Path) -> None:
    scene = write(tmp_path, make_flown())
    assert len(scene.motion_peers) == 3
    assert [peer.data.get("run") for peer in scene.pick("peer")] == [None] * 3


def test_the_table_has_methods_baselines_and_peers(make_flown: Flown, tmp_path: Path) -> None:
    section = describe_motion(write(tmp_path, make_flown()), {})
    assert section is not None
    table = section["table"]
    titles = [column["title"] for column in table["columns"]]
    assert titles[0] == "Error in motion" and titles[-1] == "Time ratio"
    rows = {row["label"]: [cell["text"] for cell in row["cells"]] for row in table["rows"]}
    assert list(rows)[:4] == ["gibs", "ddgi", "none", "ambient"]
    assert rows["gibs"][0] == "0.0400" and rows["gibs"][-1] == ""
    assert rows["path:reproject in gibs’s time"][-1] == "0.90"
    notes = {row["label"]: row["note"] for row in table["rows"]}
    assert notes["path:reproject in gibs’s time"] == "7 paths a pixel and frame, history of 12"


def test_both_plots_are_drawn_with_every_frame(make_flown: Flown, tmp_path: Path) -> None:
    section = describe_motion(write(tmp_path, make_flown()), {})
    assert section is not None
    along, after = section["plots"]
    # Four methods and three peers, sixteen frames and three.
    assert along["svg"].count("<circle") == 7 * 16 and after["svg"].count("<circle") == 7 * 3


def test_a_straight_axis_has_whole_numbers() -> None:
    assert linear_ticks(1.5, 100.5) == [20.0, 40.0, 60.0, 80.0, 100.0]
    assert linear_ticks(5.5, 12.5) == [6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0]


def test_full_materials_are_told_apart_by_what_is_displayed(make_flown: Flown, tmp_path: Path) -> None:
    results = make_flown()
    scene = results["scenes"]["box"]
    scene["reference"]["kind"] = "full"
    for entry in (*scene["methods"].values(), *scene["peers"]):
        entry |= {"regional": None, "motion_regional": None, "motion_regional_worst": None, "cut_regional": None}
        if "motion" in entry:
            entry["motion"] = make_series(None)
    scene["methods"]["gibs"]["motion_flip"] = 0.01
    section = describe_motion(write(tmp_path, results), {})
    assert section is not None
    assert dict(section["sentences"])["Nearest"].startswith("gibs, motion_flip 0.0100")
    assert [plot["title"] for plot in section["plots"]] == ["Error along the flight"]


def test_a_comparison_without_a_flight_has_no_section(usual_results: dict[str, Any], tmp_path: Path) -> None:
    assert describe_motion(write(tmp_path, usual_results), {}) is None


@pytest.mark.parametrize("noisy", [False, True])
def test_strips_of_a_scene_stay_below_two_megabytes(make_flown: Flown, tmp_path: Path, noisy: bool) -> None:
    """Eight contenders of noise, which no code makes small."""
    results = make_flown()
    scene = results["scenes"]["box"]
    scene["peers"] += [{**make_flown_peer("ddgi", 0.1), "file": f"other-{number}"} for number in range(3)]
    read = write(tmp_path, results)
    paint_strips(tmp_path, read, noisy=noisy)
    strips, missing = read_strips(tmp_path, read)
    assert not missing and len(strips) == 9
    assert sum(map(len, strips.values())) <= STRIP_BUDGET == 2_000_000


def test_missing_strips_are_named_and_left_out(make_flown: Flown, tmp_path: Path) -> None:
    scene = write(tmp_path, make_flown())
    paint_strips(tmp_path, scene)
    (tmp_path / "box" / "gibs_motion.png").unlink()
    (tmp_path / "box" / "ddgi_motion.png").write_bytes(b"broken")
    strips, missing = read_strips(tmp_path, scene)
    assert missing == ["box/gibs_motion.png", "box/ddgi_motion.png"] and "truth" in strips
    sums = write(tmp_path, make_flown(kept="sums"))
    assert "truth" not in read_strips(tmp_path, sums)[0]


def test_the_page_shows_them(make_flown: Flown, comparison: Comparison) -> None:
    folder = comparison(make_flown())
    scene = read_results(folder).scenes[0]
    paint_strips(folder, scene)
    path, complaint = write_report(folder)
    page = path.read_text()
    assert complaint == ""
    # One of two scenes was flown through: the truth, two methods, three peers.
    assert page.count("<h3>In motion</h3>") == 1 and page.count('class="flight-row"') == 6
    assert "frame 96" in page and "<code>motion_flicker</code>" in page


@pytest.mark.parametrize("frames", [6, 96, 150, 1000, 20_000])
def test_flights_of_any_length_are_drawn(frames: int) -> None:
    points = tuple((float(frame), 0.1) for frame in range(6, frames + 1, 6))
    svg = plot_error([Line("gibs", "gibs", points)], "frame", "error (regional)", linear=True)
    places = [float(x) for x in re.findall(r'<text class="tick" x="([0-9.-]+)" y="[0-9.]+" text-anchor="middle">', svg)]
    words = re.findall(r'text-anchor="middle">([0-9,]+)</text>', svg)
    assert len(places) == len(words) >= 1 and places == sorted(places) and places[0] > 0.0
    numbers = [int(word.replace(",", "")) for word in words]
    assert numbers == sorted(set(numbers)) and numbers[-1] <= frames + max(6.0, 0.1 * frames)
