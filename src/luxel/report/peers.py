"""The peer: the progressive path tracer given the time that each method took, bare and denoised.

It runs once, as long as the slowest method took, and is looked at on the way whenever a method's time is up. Neither
side's compilation counts, nor does the looking. The denoised peer stops earlier by the time that denoising takes.
"""

from __future__ import annotations

import statistics
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from luxel.metrics.error import regional
from luxel.report.jobs import Pictures, Progress, ReferenceView, SceneCache, ViewJob, take_pictures, this_machine
from luxel.report.measure import judge

if TYPE_CHECKING:
    from luxel.image.layers import Layers
    from luxel.render.denoise import Denoiser, Guides
    from luxel.render.renderer import Renderer
    from luxel.scene.device import Scene

PEER = "path"
"""The method that peers are made by; it needs none itself."""

DENOISE_TRIALS = 5
"""Calls that tell beforehand how long denoising will take; the first also loads weights and makes kernels."""


@dataclass(frozen=True)
class TimeBudget:
    """The time that a method took."""

    of: str
    """The method's label."""
    file_name: str
    """The stem of its files."""
    ms: float
    """Milliseconds of its frames, compilation left out."""


@dataclass(frozen=True)
class PeerJob:
    """The peers of one scene's methods with one seed."""

    view: ViewJob
    seed: int
    budgets: tuple[TimeBudget, ...]
    pictured: bool
    """Whether the images are wanted, and not the figures alone."""


@dataclass
class Peer:
    """The path tracer when a method's time was up."""

    of: TimeBudget
    denoised: str | None
    """`optix` or `oidn`; None: bare."""
    ms: float
    """Time spent, denoising included: the budget, up to the last frame that fits; more where a first one did not."""
    samples: int
    """Paths a pixel."""
    figures: dict[str, Any]
    pictures: Pictures | None

    @property
    def file_name(self) -> str:
        """The stem of its files."""
        return f"{PEER}_at_{self.of.file_name}" + ("_denoised" if self.denoised else "")


@dataclass
class PeerOutcome:
    """What a `PeerJob` gave."""

    peers: list[Peer]
    """By method in the order of the budgets, the bare one first."""
    series: dict[str, list[Any]]
    """`samples`, `ms` and `regional` along the run, at powers of two."""
    denoiser: dict[str, str | None]
    """`used` and `reason`."""
    machine: dict[str, Any]


@dataclass(frozen=True)
class _Stop:
    """When to look: `until` is the milliseconds that the path tracer itself may spend."""

    until: float
    budget: TimeBudget
    denoiser: Denoiser | None


def run_peer(job: PeerJob, view: ReferenceView, *, scenes: SceneCache, report: Progress) -> PeerOutcome:
    """Run the progressive path tracer on the scene and measure it against `view` at each budget."""
    from luxel import runtime
    from luxel.methods import find_method
    from luxel.render.denoise import find_denoiser
    from luxel.render.renderer import WARM_UP_FRAMES, Renderer

    scene = scenes.scene(job.view, find_method(PEER).shown_materials(job.view.materials))
    renderer = Renderer(scene, PEER, size=job.view.size, seed=job.seed)
    renderer.run(WARM_UP_FRAMES)
    denoiser, reason = find_denoiser(runtime.start(job.view.device).name)
    stops = [_Stop(budget.ms, budget, None) for budget in job.budgets]
    guides = None
    if denoiser is not None:
        guides = _trace_guides(scene, job)
        noisy = renderer.layers()
        denoise_ms = statistics.median(denoise_layers(noisy, denoiser, guides)[1] for _ in range(DENOISE_TRIALS))
        stops += [_Stop(budget.ms - denoise_ms, budget, denoiser) for budget in job.budgets]

    longest = max(budget.ms for budget in job.budgets)
    series: dict[str, list[Any]] = {"samples": [], "ms": [], "regional": []}
    found: dict[tuple[str, bool], Peer] = {}
    for samples, spent, due in _progress(renderer, stops):
        report(f"{job.view.label}: {PEER} at equal time, seed {job.seed}", min(spent / longest, 1.0))
        looked = samples & (samples - 1) == 0
        layers = renderer.layers() if due or looked else None
        if layers is not None and looked:
            error = regional(layers, view.truth.layers) if view.split else None
            for name, value in (("samples", samples), ("ms", spent), ("regional", error)):
                series[name].append(value)
        for stop in due:
            assert layers is not None
            peer = _look(job, view, stop, layers, guides, samples, spent)
            found[stop.budget.of, stop.denoiser is not None] = peer
    kinds = (False, True) if denoiser is not None else (False,)
    peers = [found[budget.of, kind] for budget in job.budgets for kind in kinds]
    used = {"used": denoiser.used if denoiser is not None else None, "reason": reason}
    return PeerOutcome(peers, series, used, this_machine())


def _progress(renderer: Renderer, stops: list[_Stop]) -> Iterator[tuple[int, float, list[_Stop]]]:
    """Render frame by frame until every stop was due; yield samples, milliseconds spent and the stops due now.

    A stop is due when one more frame, as long as the mean so far, would go beyond it.
    """
    waiting = sorted(stops, key=lambda stop: stop.until)
    # As after a change of the lights, the running means begin anew: the warm-up's samples are not counted.
    renderer.set_light_scale(1.0)
    samples, spent = 0, 0.0
    while waiting:
        spent += renderer.run(1)[0]
        samples += 1
        due = [stop for stop in waiting if spent + spent / samples > stop.until]
        waiting = waiting[len(due) :]
        yield samples, spent, due


def _look(
    job: PeerJob, view: ReferenceView, stop: _Stop, layers: Layers, guides: Guides | None, samples: int, spent: float
) -> Peer:
    """Return the peer as it is now, denoised where the stop says so."""
    if stop.denoiser is not None:
        assert guides is not None
        layers, denoise_ms = denoise_layers(layers, stop.denoiser, guides)
        spent += denoise_ms
    figures = judge(layers, view.truth, view.split)
    used = stop.denoiser.used if stop.denoiser is not None else None
    return Peer(stop.budget, used, spent, samples, figures, take_pictures(layers, job.pictured))


def denoise_layers(layers: Layers, denoiser: Denoiser, guides: Guides) -> tuple[Layers, float]:
    """Return the layers with their indirect light denoised, and the milliseconds that it took.

    Irradiance where all light of the image that is not direct comes by it, else radiance: what mirrors and gloss bring
    is noise, too.
    """
    if not layers.glossy.any():
        clean, ms = denoiser.apply(layers.indirect, guides)
        return replace(layers, indirect=clean), ms
    clean, ms = denoiser.apply(layers.indirect_radiance(), guides)
    return replace(layers, indirect=np.zeros_like(clean), glossy=clean), ms


def _trace_guides(scene: Scene, job: PeerJob) -> Guides:
    from luxel.render.denoise import trace_guides
    from luxel.scene.edit import default_camera

    width, height = job.view.size
    return trace_guides(scene, default_camera(scene.host.data, width / height), (width, height), scene.host.time)
