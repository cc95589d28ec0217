"""Methods beside the truth on any number of scenes: `results.json`, EXR and PNG images, FLIP maps."""

from __future__ import annotations

import re
import uuid
import warnings
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from luxel import runtime
from luxel.errors import LuxelError
from luxel.files import require_writable, to_json, write_text
from luxel.render.loading import load_choice
from luxel.render.motion_path import MOTION_FRAMES, check_motion
from luxel.report.collect import (
    add_machine,
    describe_method,
    describe_peers,
    describe_reference,
    describe_series,
    make_header,
)
from luxel.report.images import folder_names, write_pictures, write_truth
from luxel.report.jobs import (
    Handle,
    LocalRunner,
    MethodSetup,
    Outcome,
    Progress,
    ReferenceView,
    RunJob,
    Runner,
    SceneCache,
    ViewJob,
    make_setup,
    nested,
    run_method,
    run_view,
)
from luxel.report.motion import MotionChoice
from luxel.report.motion_runs import MotionRuns
from luxel.report.page import write_report
from luxel.report.peers import PEER, PeerJob, PeerOutcome, TimeBudget, run_peer
from luxel.report.results import BASELINES
from luxel.scene.choice import SceneChoice, check_materials
from luxel.scene.model import SceneData

if TYPE_CHECKING:
    from luxel.scene.host import Looks

REFERENCE_SPP = 512
"""Samples a pixel of the truth unless told otherwise."""
RENAMED = "'{old}' is the old name of '{new}' and will be dropped: write '{new}'"
"""The deprecation sentence of a word."""
NO_PEERS = {"used": None, "reason": "None: no peer was run."}
TAKEN_FILES = re.compile(rf"truth|truth_.*|{PEER}_at_.*|.*_(indirect|flip|motion)")
"""Stems of files that a method's label may not lead to."""

SceneLike = str | Path | SceneData | SceneChoice


def compare(
    scenes: Sequence[SceneLike],
    methods: Sequence[str | MethodSetup],
    *,
    materials: str = "diffuse",
    reference_spp: int | None = None,
    seeds: Sequence[int] = (0,),
    size: tuple[int, int] = (512, 512),
    frames: int = 64,
    flight: bool = False,
    peers: bool = True,
    motion: bool = False,
    motion_frames: int | None = None,
    motion_spp: int | None = None,
    device: str = "auto",
    scheduler: str | None = None,
    command: str | None = None,
    out: Path,
    progress: Progress | None = None,
    reference: str | None = None,
) -> dict[str, Any]:
    """Run every method on every scene and write `out`; return what `results.json` holds.

    `none` and `ambient` always run too, `ambient` with the irradiance of the truth. A method may carry a preset
    (`gibs:ekberg`) or be a class of a file (`FILE.py:Class[:PRESET]`), as a `MethodSetup` also have parameters; a scene
    as a `SceneChoice` has its options. `size` is (width, height); `progress` gets what runs and the share done, 0..1.
    `peers` adds the progressive path tracer at each method's time. `motion` flies every method along a curve through
    the scene's key views, or its `SceneChoice.flight_path`, for `motion_frames` (None: 96), and holds every sixth frame
    against a truth of `motion_spp` paths (None: 512, or on a CPU committed sums). `scheduler` is the address of a Dask
    cluster that shall do the work, `device` then each worker's; `command` is noted as the line that repeats it all.
    `materials` is `diffuse`, or `full`: then the truth has all that the scene's materials do, methods that can show it
    do so, and displayed images are judged. `reference` is the old name of `materials`.
    Raises LuxelError for an unknown scene, method or preset, a flight that cannot be, and where `out` cannot be
    written, before any rendering.
    """
    if reference is not None:
        warnings.warn(RENAMED.format(old="reference", new="materials"), FutureWarning, stacklevel=2)
        materials = reference
    check_materials(materials)
    looks = cast("Looks", materials)
    out = Path(out)
    require_writable(out / "results.json")
    if not scenes or not seeds:
        raise LuxelError("compare needs at least one scene and one seed")
    if scheduler is None:
        # A method's file may use Mitsuba's types while it is imported.
        runtime.start(device)
    motion_frames = MOTION_FRAMES if motion_frames is None else motion_frames
    plan = _Plan(
        _list_setups(methods),
        tuple(dict.fromkeys(seeds)),
        frames,
        flight,
        peers,
        motion,
        motion_frames,
        motion_spp,
        out,
    )
    jobs = [
        ViewJob(uuid.uuid4().hex, label, scene, looks, reference_spp or REFERENCE_SPP, size, device)
        for label, scene in _label_scenes(scenes).items()
    ]
    for job in jobs:
        if motion:
            check_motion(motion_frames, flight_path(job))
        elif flight_path(job) is not None:
            raise LuxelError(f"{job.label}: 'flight_path' is about the flight of 'motion': set motion, or leave it out")
    results = make_header(command, materials)
    with _open_runner(jobs, scheduler) as runner:
        share = 1.0 / len(jobs)
        waiting = deque(_schedule(plan, job, runner, nested(progress, n * share, share)) for n, job in enumerate(jobs))
        folders = folder_names([job.label for job in jobs])
        while waiting:
            scene = waiting.popleft()
            results["scenes"][scene.job.label] = _collect(plan, scene, runner, folders[scene.job.label], results)
            # After each scene, so that an interrupted comparison keeps what it has.
            write_text(out / "results.json", to_json(results, indent=2) + "\n")
        write_report(out)
    return results


@dataclass(frozen=True)
class _Plan:
    """What is the same for all scenes."""

    setups: list[MethodSetup]
    seeds: tuple[int, ...]
    frames: int
    flight: bool
    peers: bool
    motion: bool
    motion_frames: int
    motion_spp: int | None
    out: Path

    @property
    def timed(self) -> list[MethodSetup]:
        """The setups that get a peer."""
        return [one for one in self.setups if self.peers and one.method != PEER and not one.baseline]


@dataclass
class _Scene:
    """A scene whose jobs have been handed in."""

    job: ViewJob
    view: Handle
    runs: deque[tuple[MethodSetup, int, Handle]]
    report: Progress
    parts: int
    """Into how many equal parts its progress is cut."""
    motion: MotionRuns | None = None


@contextmanager
def _open_runner(jobs: list[ViewJob], scheduler: str | None) -> Iterator[Runner]:
    """Yield what runs the jobs. In this process the scenes are read first, so that a bad one stops all at once."""
    if scheduler is not None:
        from luxel.report.cluster import open_cluster

        with open_cluster(scheduler) as runner:
            yield runner
        return
    yield LocalRunner(SceneCache({job.key: _load(job.scene) for job in jobs}))


def _schedule(plan: _Plan, job: ViewJob, runner: Runner, report: Progress) -> _Scene:
    """Hand in the truth of a scene and all runs against it; flights take half of the time, where there are any."""
    flights = nested(report, 0.5, 0.5)
    report = nested(report, 0.0, 0.5) if plan.motion else report
    parts = 1 + len(plan.setups) * len(plan.seeds) + (len(plan.seeds) if plan.timed else 0)
    view = runner.submit(run_view, job, report=nested(report, 0.0, 1.0 / parts), urgent=2)
    runs: deque[tuple[MethodSetup, int, Handle]] = deque()
    for setup in plan.setups:
        for seed in plan.seeds:
            run = RunJob(job, setup, seed, plan.frames, plan.flight, pictured=seed == plan.seeds[0])
            told = nested(report, (1 + len(runs)) / parts, 1.0 / parts)
            runs.append((setup, seed, runner.submit(run_method, run, view, report=told)))
    motion = None
    if plan.motion:
        choice = MotionChoice(plan.motion_frames, flight_path(job), plan.motion_spp)
        motion = MotionRuns(job, plan.setups, plan.seeds, choice, runner, flights)
    return _Scene(job, view, runs, report, parts, motion)


def _collect(plan: _Plan, scene: _Scene, runner: Runner, folder: str, results: dict[str, Any]) -> dict[str, Any]:
    """Wait for a scene's jobs in order, write the images, run the peers; return the scene's results."""
    if scene.motion is not None:
        # What cannot be flown through is told before the work at rest.
        scene.motion.find_flight()
    view: ReferenceView = scene.view.result()
    write_truth(plan.out / folder, view)
    outcomes: dict[str, dict[int, Outcome]] = {setup.label: {} for setup in plan.setups}
    while scene.runs:
        setup, seed, handle = scene.runs.popleft()
        outcome: Outcome = handle.result()
        if outcome.pictures is not None:
            write_pictures(plan.out / folder, setup.file_name, outcome.pictures, view)
            outcome.pictures = None  # written: only one run's need room at a time
        add_machine(results, outcome.machine)
        outcomes[setup.label][seed] = outcome
    peers = _collect_peers(plan, scene, runner, outcomes, view, plan.out / folder)
    for peer in peers.values():
        add_machine(results, peer.machine)
    results["denoiser"] = results["denoiser"] or next((one.denoiser for one in peers.values()), None) or NO_PEERS
    motion = scene.motion
    in_motion = _collect_motion(plan, motion, outcomes, plan.out / folder, results) if motion is not None else []
    return {
        "folder": folder,
        "reference": describe_reference(
            scene.job, view, plan.frames, plan.flight, motion.describe() if motion is not None else None
        ),
        "methods": {
            one.label: describe_method(
                one,
                outcomes[one.label],
                scene.job.materials,
                motion.describe_series(one.label) if motion is not None else None,
            )
            for one in plan.setups
        },
        "peers": [*describe_peers(peers), *in_motion],
        "path_series": describe_series(peers),
        "warnings": view.warnings,
    }


def _collect_peers(
    plan: _Plan,
    scene: _Scene,
    runner: Runner,
    outcomes: dict[str, dict[int, Outcome]],
    view: ReferenceView,
    folder: Path,
) -> dict[int, PeerOutcome]:
    """Run the peers with each method's own time of that seed; write those of the first seed as images."""
    handles: deque[tuple[int, Handle]] = deque()
    for number, seed in enumerate(plan.seeds if plan.timed else ()):
        budgets = tuple(
            TimeBudget(one.label, one.file_name, outcomes[one.label][seed].figures["series"]["ms"][-1])
            for one in plan.timed
        )
        job = PeerJob(scene.job, seed, budgets, pictured=seed == plan.seeds[0])
        told = nested(scene.report, 1.0 - (len(plan.seeds) - number) / scene.parts, 1.0 / scene.parts)
        handles.append((seed, runner.submit(run_peer, job, scene.view, report=told, urgent=1)))
    peers: dict[int, PeerOutcome] = {}
    while handles:
        seed, handle = handles.popleft()
        peers[seed] = handle.result()
        for peer in peers[seed].peers:
            if peer.pictures is not None:
                write_pictures(folder, peer.file_name, peer.pictures, view)
                peer.pictures = None
    return peers


def _collect_motion(
    plan: _Plan, motion: MotionRuns, outcomes: dict[str, dict[int, Outcome]], folder: Path, results: dict[str, Any]
) -> list[dict[str, Any]]:
    """Wait for a scene's flights, put their figures into `outcomes`, run the peers in motion; return their records."""
    motion.wait(folder)
    lags = {
        label: {seed: outcome.figures["lag_frames"] for seed, outcome in seeds.items()}
        for label, seeds in outcomes.items()
    }
    for label, seeds in outcomes.items():
        motion.add_figures(label, {seed: outcome.figures for seed, outcome in seeds.items()})
    peers = motion.run_peers(plan.timed, lags, folder)
    for machine in motion.machines:
        add_machine(results, machine)
    return peers


# ---------- Names ----------


def _list_setups(methods: Sequence[str | MethodSetup]) -> list[MethodSetup]:
    """Return the trivial methods and then the others, each once; LuxelError for unknown ones and for labels that
    would share a file."""
    found = {name: MethodSetup(name, name) for name in BASELINES}
    for one in methods:
        if isinstance(one, str):
            one = make_setup(one)
        if one.label:
            found[one.label] = one
    stems: dict[str, str] = {}
    for one in found.values():
        one.params()
        if TAKEN_FILES.fullmatch(one.file_name) or one.file_name in stems:
            raise LuxelError(f"a method cannot be called '{one.label}': another file of the report has that name")
        stems[one.file_name] = one.label
    return list(found.values())


def _label_scenes(scenes: Sequence[SceneLike]) -> dict[str, SceneChoice | SceneData]:
    """Return the scenes by the names they have in the report, in order; a name that comes again gets a number."""
    labelled: dict[str, SceneChoice | SceneData] = {}
    for scene in scenes:
        made = SceneChoice(str(scene)) if isinstance(scene, str | Path) else scene
        plain = name = made.name if isinstance(made, SceneData) else made.label
        number = 2
        while name in labelled:
            name, number = f"{plain}-{number}", number + 1
        labelled[name] = made
    return labelled


def flight_path(job: ViewJob) -> str | None:
    """Return the straight line that a scene's choice wants flown; None for the curve through its key views."""
    return job.scene.flight_path if isinstance(job.scene, SceneChoice) else None


def _load(scene: SceneChoice | SceneData) -> SceneData:
    return scene if isinstance(scene, SceneData) else load_choice(scene)
