"""From the jobs' outcomes to what `results.json` holds: means and spreads over the seeds, and records."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np

from luxel.metrics.motion import MOTION_FIGURES
from luxel.report.jobs import MethodSetup, Outcome, ReferenceView, ViewJob
from luxel.report.peers import PEER, Peer, PeerOutcome

if TYPE_CHECKING:
    from luxel.scene.host import Looks

AVERAGED = (
    "regional", "bias", "relmse", "rmse_tonemapped", "rmse_gi_tonemapped", "abs_error_mean", "abs_error_max",
    "block_error_max", "flip", "flicker", "flicker_absolute", "lag_frames", "leak", "truth_noise", "frame_ms",
    "floor_ms", *MOTION_FIGURES, "motion_ms",
)  # fmt: skip
"""Figures that are one number: their mean over the seeds is reported, their spread, and each seed's own."""


def make_header(command: str | None, materials: str) -> dict[str, Any]:
    """Return what stands above the scenes; machine and denoiser are filled in by the jobs that ran."""
    from luxel import __version__

    now = datetime.now(UTC).isoformat(timespec="seconds")
    return {
        "luxel": __version__, "date": now, "command": command, "materials": materials, "machine": None,
        "denoiser": None, "scenes": {},
    }  # fmt: skip


def add_machine(results: dict[str, Any], machine: dict[str, Any]) -> None:
    """Note a machine that a job ran on: `machine` is the first, `machines` lists all where they differ."""
    if results["machine"] is None:
        results["machine"] = machine
    known = results.get("machines", [results["machine"]])
    if machine not in known:
        results["machines"] = [*known, machine]


def describe_reference(
    job: ViewJob, view: ReferenceView, frames: int, flight: bool, motion: dict[str, Any] | None = None
) -> dict[str, Any]:
    """Return the record of a scene's truth, and of what all its methods share; `motion` is that of its flight."""
    return {
        "kind": job.materials,
        "spp": view.truth.spp,
        "seconds": view.truth.seconds,
        "size": list(job.size),
        "frames": frames,
        "flight": flight,
        "motion": motion,
        "camera": view.camera,
        "exposure": view.exposure,
        "ambient_irradiance": view.irradiance,
    }


def describe_method(
    setup: MethodSetup, outcomes: Mapping[int, Outcome], wanted: Looks, motion: dict[str, Any] | None = None
) -> dict[str, Any]:
    """Return the record of a method: figures over the seeds, and what it was set to, where `wanted` materials count.

    `motion` is what it gave in each judged frame of a flight.
    """
    return {
        **average_seeds({seed: outcome.figures for seed, outcome in outcomes.items()}),
        "method": setup.method,
        "preset": setup.preset,
        "baseline": setup.baseline,
        "materials": setup.shown_materials(wanted),
        "params": next(iter(outcomes.values())).params,
        "file": setup.file_name,
        "warnings": list(dict.fromkeys(text for one in outcomes.values() for text in one.figures["warnings"])),
        "motion": motion,
    }


def describe_peers(outcomes: Mapping[int, PeerOutcome]) -> list[dict[str, Any]]:
    """Return the records of the peers, in the order of the first seed's; one that a seed lacks is averaged without."""
    by_kind: dict[tuple[str, str | None], dict[int, Peer]] = {}
    for seed, outcome in outcomes.items():
        for peer in outcome.peers:
            by_kind.setdefault((peer.of.of, peer.denoised), {})[seed] = peer
    return [_describe_peer(peers) for peers in by_kind.values()]


def _describe_peer(peers: Mapping[int, Peer]) -> dict[str, Any]:
    one = next(iter(peers.values()))
    own = {
        seed: {"ms": peer.ms, "of_ms": peer.of.ms, "samples": peer.samples, **pick_averaged(peer.figures)}
        for seed, peer in peers.items()
    }
    return {
        "label": PEER,
        "of": one.of.of,
        "run": "rest",
        "denoised": one.denoised,
        "file": one.file_name,
        **average_peer(own, ("ms", "of_ms", "samples", *AVERAGED)),
    }


def average_peer(own: Mapping[int, Mapping[str, Any]], names: Iterable[str]) -> dict[str, Any]:
    """Return a peer's figures `names` as means over the seeds, their spread, and each seed's own under "seeds"."""
    every = list(own.values())
    return {
        **{name: mean_of([figures[name] for figures in every]) for name in names},
        "spread": {name: spread_of([figures[name] for figures in every]) for name in AVERAGED},
        "seeds": {str(seed): dict(figures) for seed, figures in own.items()},
    }


def describe_series(outcomes: Mapping[int, PeerOutcome]) -> dict[str, list[Any]] | None:
    """Return the path tracer's series, mean over the seeds as far as all of them ran; None where none did."""
    runs = [outcome.series for outcome in outcomes.values()]
    if not runs:
        return None
    length = min(len(run["samples"]) for run in runs)
    means = {
        name: [mean_of([run[name][place] for run in runs]) for place in range(length)] for name in ("ms", "regional")
    }
    return {**means, "samples": runs[0]["samples"][:length]}


def average_seeds(runs: Mapping[int, dict[str, Any]]) -> dict[str, Any]:
    """Return the means of the figures over the seeds, under `spread` their sample standard deviations, and under
    `seeds` each seed's own.

    A seed for which a figure does not apply (None or NaN) is left out of its mean. Stages and series are averaged
    entry by entry; rays and cache are the first seed's.
    """
    every = list(runs.values())
    result: dict[str, Any] = {name: mean_of([figures.get(name) for figures in every]) for name in AVERAGED}
    stages = every[0]["stages"]
    result["stages"] = {name: mean_of([figures["stages"].get(name) for figures in every]) for name in stages}
    result["rays_per_frame"] = every[0]["rays_per_frame"]
    result["cache"] = every[0]["cache"]
    series = [figures["series"] for figures in every]
    result["series"] = {
        "frame": series[0]["frame"],
        **{
            name: [mean_of(values) for values in zip(*(one[name] for one in series), strict=True)]
            for name in ("ms", "regional")
        },
    }
    result["spread"] = {name: spread_of([figures.get(name) for figures in every]) for name in AVERAGED}
    result["seeds"] = {str(seed): pick_averaged(figures) for seed, figures in runs.items()}
    return result


def mean_of(values: Sequence[Any]) -> float | None:
    """Return the mean of the numbers that are finite; None where there is none."""
    known = _finite(values)
    return statistics.fmean(known) if known else None


def spread_of(values: Sequence[Any]) -> float | None:
    """Return the sample standard deviation of the numbers that are finite; None where there are fewer than two."""
    known = _finite(values)
    return statistics.stdev(known) if len(known) > 1 else None


def _finite(values: Sequence[Any]) -> list[float]:
    return [float(value) for value in values if value is not None and np.isfinite(value)]


def pick_averaged(figures: Mapping[str, Any]) -> dict[str, Any]:
    """Return the figures that are averaged over the seeds, None where one is missing."""
    return {name: figures.get(name) for name in AVERAGED}
