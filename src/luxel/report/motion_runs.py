"""One scene's flights within a comparison: handed in, waited for, written, and put into its results."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from luxel.image.write import write_png
from luxel.report.collect import AVERAGED, average_peer, pick_averaged
from luxel.report.jobs import Handle, MethodSetup, Progress, Runner, ViewJob, nested
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
    MotionPeer,
    MotionPeerJob,
    MotionPeerOutcome,
    run_motion_peers,
)
from luxel.report.results import BASELINES, MOTION_END

if TYPE_CHECKING:
    import numpy as np

UNLIT = BASELINES[0]
"""The method without indirect light: what a frame takes before the first path."""
MEASURED = ("ms", "of_ms", "time_ratio", "samples", "history", "lag_frames")
"""Numbers of a peer that no frame is judged by."""


class MotionRuns:
    """The flights of one scene."""

    def __init__(
        self,
        job: ViewJob,
        setups: Sequence[MethodSetup],
        seeds: Sequence[int],
        choice: MotionChoice,
        runner: Runner,
        report: Progress,
    ) -> None:
        """Hand in the truth and every method's flight with every seed."""
        self._job, self._choice, self._runner, self._report = job, choice, runner, report
        self._parts = 2 + len(setups) * len(seeds)
        self._first_seed = seeds[0]
        self._view = runner.submit(run_motion_truth, MotionJob(job, choice), report=self._part(0), urgent=2)
        self._flights: deque[tuple[MethodSetup, int, Handle]] = deque()
        for setup in setups:
            for seed in seeds:
                flight = FlightJob(job, setup, seed, pictured=seed == seeds[0])
                told = self._part(1 + len(self._flights))
                self._flights.append((setup, seed, runner.submit(run_flight, flight, self._view, report=told)))
        self._flown: dict[str, dict[int, FlightOutcome]] = {setup.label: {} for setup in setups}
        self.machines: list[dict[str, Any]] = []
        """Of every job that has been waited for."""

    def _part(self, number: int) -> Progress:
        return nested(self._report, number / self._parts, 1.0 / self._parts)

    def find_flight(self) -> None:
        """Wait for the flight and its truth. Raises LuxelError where there is nothing to fly through."""
        self._view.result()

    def wait(self, folder: Path) -> None:
        """Wait for the flights and write their strips into `folder`."""
        view: MotionView = self._view.result()
        _write_strip(folder, "truth", view.strip)
        while self._flights:
            setup, seed, handle = self._flights.popleft()
            outcome: FlightOutcome = handle.result()
            _write_strip(folder, setup.file_name, outcome.strip)
            outcome.strip = None
            self.machines.append(outcome.machine)
            self._flown[setup.label][seed] = outcome

    def add_figures(self, label: str, figures: dict[int, dict[str, Any]]) -> None:
        """Put the flights' figures of a method into those that it has with each seed."""
        for seed, outcome in self._flown[label].items():
            figures[seed] |= outcome.figures

    def describe_series(self, label: str) -> dict[str, Any]:
        """Return a method's figures of each judged frame, mean over the seeds."""
        return average_series([outcome.series for outcome in self._flown[label].values()])

    def describe(self) -> dict[str, Any]:
        """Return the record of the flight and its truth."""
        view: MotionView = self._view.result()
        path, truth = view.path, view.truth
        return {
            "frames": len(path.views),
            "path": self._choice.line,
            "fov": path.views[0].fov,
            "first": {"eye": path.views[0].eye, "target": path.views[0].target},
            "last": {"eye": path.views[-1].eye, "target": path.views[-1].target},
            "cut": {"eye": path.cut.eye, "target": path.cut.target},
            "judged": list(path.judged),
            "pictured": view.choose_pictured(),
            "spp": truth.spp,
            "seconds": truth.seconds,
            "device": truth.device,
            "noise": truth.noise,
            "kept": "layers" if truth.frames[0].layers is not None else "sums",
            "exposure": truth.exposure,
            "ambient_irradiance": truth.irradiance,
        }

    def run_peers(
        self, setups: Sequence[MethodSetup], lags: Mapping[str, Mapping[int, float | None]], folder: Path
    ) -> list[dict[str, Any]]:
        """Fly the path tracer in the time of each of `setups`, whose `lag_frames` by label and seed are `lags`.

        Return the records of the peers.
        """
        handles: dict[int, Handle] = {}
        for seed in self._flown[UNLIT] if setups else ():
            ms = {label: seeds[seed].figures["motion_ms"] for label, seeds in self._flown.items()}
            budgets = tuple(
                MotionBudget(one.label, one.file_name, ms[one.label], lags[one.label].get(seed)) for one in setups
            )
            job = MotionPeerJob(self._job, seed, ms[UNLIT], budgets, pictured=seed == self._first_seed)
            told = self._part(self._parts - 1)
            handles[seed] = self._runner.submit(run_motion_peers, job, self._view, report=told, urgent=1)
        outcomes: dict[int, MotionPeerOutcome] = {seed: handle.result() for seed, handle in handles.items()}
        for outcome in outcomes.values():
            self.machines.append(outcome.machine)
            for peer in outcome.peers:
                _write_strip(folder, peer.file_name, peer.outcome.strip)
        return describe_motion_peers(outcomes)


def describe_motion_peers(outcomes: Mapping[int, MotionPeerOutcome]) -> list[dict[str, Any]]:
    """Return the records of the peers, in the order of the first seed's; one that a seed lacks is averaged without."""
    by_kind: dict[tuple[str, str, bool], dict[int, MotionPeer]] = {}
    for seed, outcome in outcomes.items():
        for peer in outcome.peers:
            by_kind.setdefault((peer.of.of, peer.label, peer.denoised is not None), {})[seed] = peer
    return [_describe(peers) for peers in by_kind.values()]


def _describe(peers: Mapping[int, MotionPeer]) -> dict[str, Any]:
    one = next(iter(peers.values()))
    own = {
        seed: {
            "ms": peer.ms,
            "of_ms": peer.of.ms,
            "time_ratio": peer.ms / peer.of.ms,
            "samples": peer.samples,
            "history": peer.history,
            **pick_averaged(peer.outcome.figures),
            "lag_frames": peer.lag,
        }
        for seed, peer in peers.items()
    }
    return {
        "label": one.label,
        "of": one.of.of,
        "run": "motion",
        "denoised": one.denoised,
        "file": one.file_name,
        **average_peer(own, dict.fromkeys((*MEASURED, *AVERAGED))),
        "motion": average_series([peer.outcome.series for peer in peers.values()]),
    }


def _write_strip(folder: Path, name: str, strip: np.ndarray | None) -> None:
    if strip is not None:
        write_png(folder / f"{name}{MOTION_END}.png", strip / 255.0)
