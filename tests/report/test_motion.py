"""Flights of a comparison: what is flown, what each contender gets, and what stands in the results."""

from __future__ import annotations

import json
import pickle
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from luxel.errors import LuxelError
from luxel.methods import find_method
from luxel.metrics.motion import MOTION_FIGURES
from luxel.render import denoise, motion_path
from luxel.render.denoise import Denoiser, Guides
from luxel.report import measure, motion_peers
from luxel.report.cluster import _portable, describe_job
from luxel.report.compare import compare
from luxel.report.jobs import MethodSetup, SceneCache, ViewJob
from luxel.report.motion import (
    FlightJob,
    FlightOutcome,
    MotionChoice,
    MotionJob,
    MotionView,
    average_series,
    run_flight,
    run_motion_truth,
)
from luxel.report.motion_peers import (
    MotionBudget,
    MotionPeerJob,
    keeps_history,
    lag_by_arithmetic,
    longest_history,
    paths_within,
    run_motion_peers,
)
from luxel.report.motion_runs import describe_motion_peers
from luxel.scene import load
from luxel.scene.choice import SceneChoice
from luxel.scene.model import Camera

SIZE = (32, 24)
DENOISE_MS = 4.0
FURNACE = ViewJob("a", "furnace", SceneChoice("furnace"), "diffuse", 4, SIZE, "auto")
CHOICE = MotionChoice(12, None, 64)
BENCH = SceneCache()


def quiet(text: str, share: float) -> None:
    pass


@pytest.fixture(scope="module", autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Any:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("LUXEL_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="module")
def view(own_cache: None) -> MotionView:
    return run_motion_truth(MotionJob(FURNACE, CHOICE), scenes=BENCH, report=quiet)


def flight(view: MotionView, method: str, job: ViewJob = FURNACE, pictured: bool = True) -> FlightOutcome:
    return run_flight(FlightJob(job, MethodSetup(method, method), 0, pictured), view, scenes=BENCH, report=quiet)


# ---------- What contenders get ----------


def test_without_indirect_light_all_of_it_is_missing(view: MotionView) -> None:
    """In a furnace indirect light is the same everywhere: without any, the error over its mean is one."""
    outcome = flight(view, "none")
    assert outcome.figures["motion_regional"] == pytest.approx(1.0, abs=0.01)
    assert outcome.figures["motion_regional_worst"] == pytest.approx(1.0, abs=0.01)
    assert outcome.figures["motion_bias"] == 1.0
    assert outcome.figures["cut_regional"] == pytest.approx(1.0, abs=0.01)
    assert outcome.figures["motion_flicker"] == 0.0
    assert outcome.figures["motion_flip"] > 0.1 and outcome.figures["motion_ms"] > 0.0
    assert outcome.series["frame"] == [6, 12] and outcome.series["bias"] == [-1.0, -1.0]
    assert outcome.series["cut"]["frame"] == [1, 4, 16]


def test_ambient_has_the_one_irradiance_of_the_flight(view: MotionView) -> None:
    outcome = flight(view, "ambient")
    # In a furnace that is right everywhere, but for the noise of 64 paths; E = pi (0.5 + 0.25 + ...) = pi.
    assert view.truth.irradiance == pytest.approx((np.pi / 2.0 / 0.5,) * 3, rel=0.02)
    assert outcome.figures["motion_regional"] < 0.03 and outcome.figures["motion_bias"] < 0.02
    assert outcome.figures["motion_flip"] < 0.05


def test_every_frame_of_a_path_tracer_has_its_own_noise(view: MotionView) -> None:
    figures = flight(view, "path").figures
    assert 0.0 < figures["motion_regional"] < 0.3 and figures["motion_flicker"] > 0.01
    # Its noise is that of one path a pixel, so the pictures differ though no light is missing.
    assert figures["motion_bias"] < 0.05


def test_strips_show_frames_side_by_side_with_the_truths_direct_light(view: MotionView) -> None:
    outcome = flight(view, "none")
    assert view.strip is not None and outcome.strip is not None
    assert view.strip.shape == outcome.strip.shape == (24, 2 * 32, 3)
    # Of the furnace's radiance of 2, emission is 1 and direct light 0.5: 0.18 and 0.135 of white, by the sRGB curve.
    levels = [255 * (1.055 * light ** (1 / 2.4) - 0.055) for light in (0.18, 0.135)]
    assert [view.strip.mean(), outcome.strip.mean()] == pytest.approx(levels, abs=4.0)
    assert flight(view, "none", pictured=False).strip is None


def test_strips_are_of_at_most_six_frames_and_320_pixels(view: MotionView) -> None:
    wide = replace(view, path=replace(view.path, views=view.path.views * 8))
    assert wide.choose_pictured() == [6, 24, 42, 60, 78, 96] or len(wide.choose_pictured()) == 6
    big = replace(FURNACE, key="b", size=(330, 6))
    found = run_motion_truth(MotionJob(big, MotionChoice(6, None, 2)), scenes=BENCH, report=quiet)
    assert found.strip is not None and found.strip.shape == (6, 320, 3)


def test_jobs_travel(view: MotionView) -> None:
    peers = MotionPeerJob(FURNACE, 0, 0.5, (MotionBudget("gibs", "gibs", 4.0, 30),), True)
    for job in (MotionJob(FURNACE, CHOICE), FlightJob(FURNACE, MethodSetup("path", "path"), 0, True), peers):
        assert pickle.loads(pickle.dumps(job)) == job and describe_job(job) == job.title
        assert job.title.startswith("furnace: ") and _portable(job).view.scene.name == "furnace"
    sent = pickle.loads(pickle.dumps(view))
    assert sent.path == view.path
    outcome = pickle.loads(pickle.dumps(flight(sent, "none")))
    assert outcome.figures["motion_bias"] == 1.0


def test_a_moving_scene_runs_on_and_stands_at_its_start_again(own_cache: None) -> None:
    job = replace(FURNACE, key="m", label="moving", scene=SceneChoice("moving"))
    found = run_motion_truth(MotionJob(job, MotionChoice(6, None, 16)), scenes=BENCH, report=quiet)
    outcome = flight(found, "path", job)
    assert BENCH.scene(job).host.time == 0.0
    # Held against a truth of another time, the moved things would be in other places, with other light.
    assert outcome.figures["motion_bias"] < 0.2


def test_full_materials_are_judged_as_displayed(own_cache: None) -> None:
    job = replace(FURNACE, key="f", label="glossy", scene=SceneChoice("glossy"), materials="full")
    found = run_motion_truth(MotionJob(job, MotionChoice(6, None, 16)), scenes=BENCH, report=quiet)
    for method in ("none", "path"):
        figures = flight(found, method, job).figures
        assert figures["motion_regional"] is None and figures["cut_regional"] is None
        assert 0.0 < figures["motion_flip"] < 1.0 and figures["motion_flicker"] is not None


# ---------- Peers ----------


def test_as_many_paths_as_the_time_allows() -> None:
    # max(1, floor((ms - ms_none) / (ms_path1 - ms_none)))
    assert paths_within(100.0, 10.0, 40.0) == 3
    assert paths_within(99.0, 10.0, 40.0) == 2
    assert paths_within(12.0, 10.0, 40.0) == 1
    assert paths_within(5.0, 10.0, 40.0) == 1
    # Times that waver leave no path a price.
    assert paths_within(100.0, 10.0, 10.0) == paths_within(100.0, 10.0, 9.0) == 1


@pytest.mark.parametrize(("history", "lag"), [(1, 1), (2, 4), (3, 6), (32, 53)])
def test_the_lag_of_a_history_is_that_of_its_mean(history: int, lag: int) -> None:
    """n frames of the new light stand beside history - 1 of the old, which fade out within two histories."""
    # 32: 31 (1 - 52 / 64) = 5.81 old ones beside 53 are 9.9 %, and 31 (1 - 51 / 64) = 6.30 beside 52 are 10.8 %.
    assert lag_by_arithmetic(history) == lag


def measured(factor: float) -> Callable[[int], float]:
    return lambda history: factor * lag_by_arithmetic(history)


def test_the_longest_history_lags_by_no_more_than_the_method() -> None:
    assert longest_history(lag_by_arithmetic(10), 64, measured(1.0)) == (10, lag_by_arithmetic(10))
    assert longest_history(1, 64, measured(1.0)) == (1, 1)
    assert longest_history(1e6, 64, measured(1.0)) == (64, lag_by_arithmetic(64))
    assert longest_history(None, 64, measured(1.0)) == (64, lag_by_arithmetic(64))


def test_what_is_measured_decides_over_arithmetic() -> None:
    history, lag = longest_history(40, 64, measured(2.0))
    assert lag is not None and lag <= 40 and 11 <= history <= 13
    assert longest_history(40, 64, lambda history: None) == (1, None)


@pytest.mark.parametrize("factor", [0.3, 0.45, 0.8, 1.3, 3.0])
@pytest.mark.parametrize("lag", [3, 17, 40, 60, 90])
def test_no_longer_history_would_do(factor: float, lag: int) -> None:
    """Whatever arithmetic expects: the one that is found does, and the next one does not, or there is none."""
    asked: list[int] = []

    def measure(history: int) -> float:
        asked.append(history)
        return factor * lag_by_arithmetic(history)

    history, found = longest_history(lag, 48, measure)
    assert found is not None and found == factor * lag_by_arithmetic(history) and (found <= lag or history == 1)
    assert history == 48 or factor * lag_by_arithmetic(history + 1) > lag
    assert len(asked) == len(set(asked)) <= 12, "each takes a run"


def test_peers_fly_the_same_frames_in_the_methods_time(view: MotionView, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    real = motion_peers.make_peer

    def watch(scene: Any, settings: dict[str, int], *others: Any) -> Any:
        asked.append(settings["samples"])
        return real(scene, settings, *others)

    monkeypatch.setattr(motion_peers, "make_peer", watch)
    monkeypatch.setattr(motion_peers, "keeps_history", lambda method: False)
    monkeypatch.setattr(motion_peers, "paths_within", lambda ms, none_ms, one_ms: int(ms))
    budgets = (MotionBudget("slow", "slow", 4.0, 30), MotionBudget("quick", "quick", 1.0, 1))
    outcome = run_motion_peers(MotionPeerJob(FURNACE, 0, 0.5, budgets, True), view, scenes=BENCH, report=quiet)
    assert [(peer.of.of, peer.samples, peer.history) for peer in outcome.peers] == [
        ("slow", 4, None),
        ("quick", 1, None),
    ]
    # One path a pixel has been flown to tell its time, and is not flown again.
    assert asked == [1, 4]
    noise = [peer.outcome.figures["motion_flicker"] for peer in outcome.peers]
    assert noise[0] < 0.75 * noise[1]  # four paths have half the noise of one
    rows = describe_motion_peers({0: outcome})
    assert [(row["label"], row["of"], row["run"], row["file"]) for row in rows] == [
        ("path", "slow", "motion", "path_at_slow"),
        ("path", "quick", "motion", "path_at_quick"),
    ]
    assert rows[1]["time_ratio"] == pytest.approx(rows[1]["ms"] / 1.0)
    assert rows[0]["motion_regional"] == outcome.peers[0].outcome.figures["motion_regional"]
    assert rows[0]["history"] is None and rows[0]["regional"] is None


def test_a_history_is_as_long_as_the_methods_lag_allows(view: MotionView, monkeypatch: pytest.MonkeyPatch) -> None:
    if not keeps_history(find_method("path")):
        pytest.skip("this luxel has no path:reproject")
    monkeypatch.setattr(denoise, "find_denoiser", lambda device: (known_denoiser(), "It knows."))
    budgets = (MotionBudget("soon", "soon", 30.0, 5), MotionBudget("at once", "at-once", 30.0, 1))
    job = MotionPeerJob(FURNACE, 0, 0.5, budgets, False)
    outcome = run_motion_peers(job, view, scenes=BENCH, report=quiet)
    rows = [(peer.of.of, peer.label, peer.history, peer.denoised) for peer in outcome.peers]
    # After 4 frames a mean of two is past 90 % of a step, one of three after 6.
    assert rows == [
        ("soon", "path", None, None),
        ("soon", "path:reproject", 2, None),
        ("soon", "path:reproject", 2, "oidn"),
        ("at once", "path", None, None),
        ("at once", "path:reproject", 1, None),
        ("at once", "path:reproject", 1, "oidn"),
    ]
    lags = [peer.lag for peer in outcome.peers if peer.history == 2]
    assert all(lag is not None and 2 <= lag <= 5 for lag in lags)
    # The denoiser gives each frame the furnace's own light: pi, which is right but for the truth's noise.
    denoised = outcome.peers[2].outcome.figures
    assert denoised["motion_regional"] < 0.03 and denoised["motion_flicker"] == pytest.approx(0.0, abs=1e-5)
    assert outcome.peers[2].ms >= DENOISE_MS
    # Every place that tells a frame's time tells the one of which the ratio is.
    for row in describe_motion_peers({0: outcome}):
        assert row["motion_ms"] == row["ms"] == pytest.approx(row["time_ratio"] * row["of_ms"])
    row = describe_motion_peers({0: outcome})[1]
    assert (row["label"], row["history"], row["of"]) == ("path:reproject", 2.0, "soon")
    assert row["motion_regional"] > 0.0 and row["lag_frames"] == lags[0]


def known_denoiser() -> Denoiser:
    def apply(noisy: np.ndarray, guides: Guides) -> tuple[np.ndarray, float]:
        assert noisy.shape == guides.normal.shape == (24, 32, 3)
        return np.full_like(noisy, np.pi), DENOISE_MS

    return Denoiser("oidn", "It knows.", apply)


def test_series_are_means_over_the_seeds() -> None:
    cut = {"frame": [1, 4], "regional": [0.5, None]}
    first = {"frame": [6, 12], "regional": [0.1, 0.2], "flip": [None, None], "cut": cut}
    second = {"frame": [6, 12], "regional": [0.3, 0.6], "flip": [None, None], "cut": cut}
    assert average_series([first, second]) == {
        "frame": [6, 12],
        "regional": pytest.approx([0.2, 0.4]),
        "flip": [None, None],
        "cut": cut,
    }


# ---------- The comparison ----------


def test_results_hold_motion_beside_rest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # What is measured at rest has its own tests, and a flight needs no long warm-up to be told apart.
    for name in ("FLICKER_FRAMES", "LAG_LIMIT"):
        monkeypatch.setattr(measure, name, 2)
    monkeypatch.setattr(motion_path, "STILL_FRAMES", 3)
    monkeypatch.setattr(denoise, "find_denoiser", lambda device: (None, "None: it would take long."))
    monkeypatch.setattr(motion_peers, "keeps_history", lambda method: False)
    choice = SceneChoice("furnace", flight_path="0,0,0;0.5,0,0;0,0,-1;1,0,-1;70")
    results = compare(
        [choice], ["ddgi"], reference_spp=4, size=SIZE, frames=1, seeds=(0, 1), motion=True, motion_frames=12,
        motion_spp=4, out=tmp_path,
    )  # fmt: skip
    scene = json.loads((tmp_path / "results.json").read_text())["scenes"]["furnace"]
    assert scene["peers"] and results["scenes"]["furnace"]["peers"]
    motion = scene["reference"]["motion"]
    assert (motion["frames"], motion["judged"], motion["spp"], motion["fov"]) == (12, [6, 12], 4, 70.0)
    assert motion["path"] == choice.flight_path and motion["kept"] == "layers"
    assert motion["first"]["eye"] == [0.0, 0.0, 0.0] and motion["last"]["eye"] == [0.5, 0.0, 0.0]
    for figures in scene["methods"].values():
        for name in MOTION_FIGURES:
            first, second = (figures["seeds"][seed][name] for seed in ("0", "1"))
            assert figures[name] == pytest.approx((first + second) / 2)
        assert figures["motion"]["frame"] == [6, 12] and len(figures["motion"]["flip"]) == 2
        with Image.open(tmp_path / "furnace" / f"{figures['file']}_motion.png") as strip:
            assert strip.size == (2 * 32, 24)
    flown = [peer for peer in scene["peers"] if peer["run"] == "motion"]
    assert flown and all(peer["of"] == "ddgi" and peer["motion_regional"] is not None for peer in flown)
    assert all(peer["motion_regional"] is None for peer in scene["peers"] if peer["run"] == "rest")
    page = (tmp_path / "report.html").read_text()
    assert "<h3>In motion</h3>" in page and "Error along the flight" in page


def test_without_the_flag_the_keys_are_null(tmp_path: Path) -> None:
    scene = compare(["furnace"], [], reference_spp=2, size=(16, 16), frames=1, peers=False, out=tmp_path)["scenes"][
        "furnace"
    ]
    assert scene["reference"]["motion"] is None
    for figures in scene["methods"].values():
        assert all(figures[name] is None for name in (*MOTION_FIGURES, "motion_ms")) and figures["motion"] is None
    assert "<h3>In motion</h3>" not in (tmp_path / "report.html").read_text()


@pytest.mark.parametrize(
    ("path", "frames", "words"),
    [("0,0,0;1,1,1", 12, "not a flight path"), (None, 5, "none to judge"), ("0,0,0;2,0,0;2,0,0;0,0,0", 7, "meets")],
)
def test_a_flight_that_cannot_be_is_refused_before_anything_is_rendered(
    path: str | None, frames: int, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = sys.modules["luxel.report.compare"]
    monkeypatch.setattr(module, "_open_runner", lambda *given: pytest.fail("it went to work"))
    with pytest.raises(LuxelError, match=words):
        compare([SceneChoice("furnace", flight_path=path)], [], motion=True, motion_frames=frames, out=tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_flight_path_without_a_flight_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = sys.modules["luxel.report.compare"]
    monkeypatch.setattr(module, "_open_runner", lambda *given: pytest.fail("it went to work"))
    with pytest.raises(LuxelError, match="set motion, or leave it out"):
        compare([SceneChoice("furnace", flight_path="0,0,0;1,0,0;0,0,1;1,0,1")], [], out=tmp_path)


def test_nothing_to_fly_through_is_told_before_the_work_at_rest(tmp_path: Path) -> None:
    data = load("furnace")
    data.flight = [Camera((0.0, 0.0, 0.0), (0.0, 0.0, -1.0))]
    with pytest.raises(LuxelError, match="only one key view"):
        compare([data], ["path"], reference_spp=2, size=(16, 16), frames=1, motion=True, peers=False, out=tmp_path)
    assert not list(tmp_path.rglob("*.png"))
