"""The path tracer at equal time: when it stops, what it counts, what a denoiser does to it."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from luxel.render import denoise
from luxel.render.denoise import Denoiser, Guides
from luxel.report import compare, peers
from luxel.report.collect import describe_peers, describe_series
from luxel.report.jobs import MethodSetup, ReferenceView, SceneCache, ViewJob, run_view
from luxel.report.peers import Peer, PeerJob, PeerOutcome, TimeBudget, run_peer
from luxel.scene.choice import SceneChoice

JOB = ViewJob("a", "cornell-box", SceneChoice("cornell-box"), "diffuse", 256, (32, 32), "auto")
BENCH = SceneCache()
DENOISE_MS = 4.0


def quiet(text: str, share: float) -> None:
    pass


@pytest.fixture(scope="module")
def view(tmp_path_factory: pytest.TempPathFactory) -> ReferenceView:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("LUXEL_CACHE", str(tmp_path_factory.mktemp("cache")))
        return run_view(JOB, scenes=BENCH, report=quiet)


class Clockwork:
    """A renderer whose frames take 10 ms each."""

    def __init__(self) -> None:
        self.restarts = 0

    def run(self, frames: int) -> list[float]:
        return [10.0] * frames

    def set_light_scale(self, factor: float) -> None:
        assert factor == 1.0
        self.restarts += 1


def test_stops_are_due_when_another_frame_would_be_too_much() -> None:
    budgets = (35.0, 4.0, 99.0, 100.0, 20.0, -3.0)
    stops = [peers._Stop(ms, TimeBudget(f"{ms}", f"{ms}", ms), None) for ms in budgets]
    renderer: Any = Clockwork()
    found = {}
    for samples, spent, due in peers._progress(renderer, stops):
        assert spent == 10.0 * samples
        found |= {stop.budget.ms: samples for stop in due}
    # At least one path a pixel, however short the budget.
    assert found == {-3.0: 1, 4.0: 1, 20.0: 2, 35.0: 3, 99.0: 9, 100.0: 10}
    assert renderer.restarts == 1


def make_denoiser(view: ReferenceView) -> Denoiser:
    """Return one that knows the answer."""

    def apply(noisy: np.ndarray, guides: Guides) -> tuple[np.ndarray, float]:
        assert noisy.shape == guides.albedo.shape == guides.normal.shape == (32, 32, 3)
        return view.truth.layers.indirect, DENOISE_MS

    return Denoiser("oidn", "It knows.", apply)


def run(
    view: ReferenceView, monkeypatch: pytest.MonkeyPatch, denoiser: Denoiser | None, budgets: dict[str, float]
) -> PeerOutcome:
    reason = denoiser.reason if denoiser else "None: there is none."
    monkeypatch.setattr(denoise, "find_denoiser", lambda device: (denoiser, reason))
    given = tuple(TimeBudget(name, name, ms) for name, ms in budgets.items())
    return run_peer(PeerJob(JOB, 0, given, pictured=True), view, scenes=BENCH, report=quiet)


def test_more_time_gives_more_paths_and_less_error(view: ReferenceView, monkeypatch: pytest.MonkeyPatch) -> None:
    outcome = run(view, monkeypatch, None, {"slow": 300.0, "quick": 0.001})
    slow, quick = outcome.peers
    assert (slow.of.of, quick.of.of) == ("slow", "quick")
    assert quick.samples == 1 < slow.samples and quick.ms < slow.ms
    assert slow.figures["regional"] < quick.figures["regional"]
    assert slow.denoised is None and outcome.denoiser == {"used": None, "reason": "None: there is none."}
    assert slow.pictures is not None and slow.pictures.image.shape == (32, 32, 3)
    assert slow.file_name == "path_at_slow"


def test_the_warm_up_is_not_in_the_mean(view: ReferenceView, monkeypatch: pytest.MonkeyPatch) -> None:
    series = run(view, monkeypatch, None, {"long": 1500.0}).series
    assert series["samples"][:5] == [1, 2, 4, 8, 16]
    assert series["ms"] == sorted(series["ms"])
    # Noise falls with the root of the paths: to a quarter after 16. With the warm-up's eight in the mean it would
    # fall to sqrt(9 / 24) = 0.6 only.
    assert series["regional"][4] < 0.45 * series["regional"][0]


def test_denoising_takes_its_time_from_the_paths(view: ReferenceView, monkeypatch: pytest.MonkeyPatch) -> None:
    outcome = run(view, monkeypatch, make_denoiser(view), {"short": 0.5 * DENOISE_MS, "long": 200.0})
    assert [(peer.of.of, peer.denoised) for peer in outcome.peers] == [
        ("short", None), ("short", "oidn"), ("long", None), ("long", "oidn"),
    ]  # fmt: skip
    _, short, bare, clean = outcome.peers
    assert short.samples == 1 and short.ms > DENOISE_MS
    assert clean.samples <= bare.samples
    assert clean.figures["regional"] == pytest.approx(0.0, abs=1e-6)
    assert bare.figures["regional"] > 1e-4, "noise is left"
    assert clean.file_name == "path_at_long_denoised"
    # The direct light and the albedo are not denoised.
    assert clean.pictures is not None and bare.pictures is not None
    np.testing.assert_allclose(clean.pictures.indirect, view.truth.layers.indirect_radiance(), rtol=1e-5)
    assert not np.array_equal(clean.pictures.image, view.truth.layers.image())
    assert outcome.denoiser == {"used": "oidn", "reason": "It knows."}


def test_full_materials_judge_the_displayed_image_alone(view: ReferenceView, monkeypatch: pytest.MonkeyPatch) -> None:
    full = ReferenceView(view.truth, "full", view.exposure, view.irradiance, view.camera, [])
    outcome = run(full, monkeypatch, None, {"some": 50.0})
    assert outcome.peers[0].figures["regional"] is None and outcome.peers[0].figures["flip"] > 0.0
    assert set(outcome.series["regional"]) == {None}


def test_glossy_light_is_denoised_with_the_rest(view: ReferenceView) -> None:
    noisy = replace(view.truth.layers, glossy=np.full((32, 32, 3), 0.25, np.float32))
    given: list[np.ndarray] = []

    def apply(light: np.ndarray, guides: Guides) -> tuple[np.ndarray, float]:
        given.append(light)
        return np.full_like(light, 2.0), DENOISE_MS

    clean, _ = peers.denoise_layers(noisy, Denoiser("oidn", "", apply), Guides(noisy.albedo, noisy.albedo))
    radiance = noisy.albedo / np.pi * noisy.indirect + 0.25
    np.testing.assert_allclose(given[0], radiance, rtol=1e-5)
    np.testing.assert_allclose(clean.image(), noisy.image() - radiance + 2.0, rtol=1e-4, atol=1e-5)


def test_records_over_the_seeds() -> None:
    def outcome(regional: float, samples: int, marks: int) -> PeerOutcome:
        budget = TimeBudget("gibs", "gibs", 10.0 * samples)
        figures = {"regional": regional, "leak": None}
        series = {"samples": [2**n for n in range(marks)], "ms": [1.0] * marks, "regional": [regional] * marks}
        return PeerOutcome([Peer(budget, None, 9.0 * samples, samples, figures, None)], series, {}, {})

    outcomes = {0: outcome(0.25, 3, 3), 7: outcome(0.75, 5, 4)}
    (record,) = describe_peers(outcomes)
    assert record["label"] == "path" and record["of"] == "gibs" and record["denoised"] is None
    assert (record["ms"], record["of_ms"], record["samples"]) == (36.0, 40.0, 4.0)
    assert record["regional"] == 0.5 and record["leak"] is None
    assert record["spread"]["regional"] == pytest.approx(0.125**0.5)
    assert record["seeds"]["7"]["samples"] == 5 and record["seeds"]["7"]["regional"] == 0.75
    assert describe_series(outcomes) == {"samples": [1, 2, 4], "ms": [1.0] * 3, "regional": [0.5] * 3}
    assert describe_series({}) is None


def test_peers_can_be_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # The package's attribute of that name is the function.
    module = sys.modules["luxel.report.compare"]
    monkeypatch.setattr(module, "run_peer", lambda *given, **named: pytest.fail("a peer ran"))
    few = MethodSetup("few", "gibs", None, {"surfel_target": "100"})
    results = compare(["furnace"], [few], reference_spp=2, size=(8, 8), frames=1, peers=False, out=tmp_path)
    assert results["scenes"]["furnace"]["peers"] == [] and results["scenes"]["furnace"]["path_series"] is None
