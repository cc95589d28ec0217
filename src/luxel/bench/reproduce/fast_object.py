"""A fast object: moved at once between two differently lit places, error on it frame by frame, GIBS beside DDGI.

A cache that rides on the object brings the old place's light along; one that stands in the room answers for the new
place at once, as well as it can.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from luxel.bench.reproduce.regions import mean_error, mean_light, noise_on, object_mask
from luxel.bench.reproduce.run_store import RunStore, describe_making
from luxel.bench.reproduce.runs import SETUP_FRAMES, StudyBudget, check_budget, label, short
from luxel.bench.reproduce.study import Progress, Study, StudyRunner, Tick, choose_tables
from luxel.bench.reproduce.tables import StudyReport, Table, TableRow
from luxel.methods.params import find_method
from luxel.metrics.error import ambient_irradiance, truth_noise
from luxel.scene.library.shapes import box, translation
from luxel.scene.model import Camera, Light, Material, Object, SceneData

if TYPE_CHECKING:
    from luxel.render.renderer import Renderer
    from luxel.render.truth import Truth
    from luxel.scene.device import Scene

OBJECT_ID = 2
"""The crate, counted from 1."""
WARM, COLD = (-2.1, 0.0, -0.2), (2.1, 0.0, 0.2)
"""Where the crate stands: in the strong red light, in the weak blue one; metres."""
MOVED = 1.0
"""Seconds at which it is moved."""
CONTENDERS: tuple[tuple[str, str | None], ...] = (
    ("gibs", None),
    ("gibs", "ekberg"),
    ("ddgi", None),
    ("ddgi", "majercik"),
    ("ambient", None),
)
"""Ambient has no memory and no place: what a figure has to beat."""
SETTLED = 0.1
"""Share of the settled light within which the object's light counts as arrived."""


def two_places(back: bool = False) -> SceneData:
    """Return a room in two halves under a dividing wall, with a grey crate that changes halves at t = 1 s.

    The left half has red walls and a lamp some eight times as strong as the right half's, which has blue ones. The
    crate goes from left to right, with `back` from right to left.
    """
    grey, red, blue, crate = range(4)
    materials = [
        Material("grey", (0.6, 0.6, 0.6)),
        Material("red", (0.75, 0.25, 0.15)),
        Material("blue", (0.15, 0.3, 0.75)),
        Material("crate", (0.7, 0.7, 0.7)),
    ]
    sides = ("+y", "-z", "+z")
    room = [
        box((-4, 0, -2), (0, 3, 2), red, inward=True, sides=("-x", *sides)),
        box((0, 0, -2), (4, 3, 2), blue, inward=True, sides=("+x", *sides)),
        box((-4, 0, -2), (4, 3, 2), grey, inward=True, sides=("-y",)),
        box((-0.1, 0.0, -2.0), (0.1, 3.0, 0.6), grey),
    ]
    first, second = (COLD, WARM) if back else (WARM, COLD)

    def move(time: float) -> np.ndarray:
        return translation(*(first if time < MOVED else second))

    lamps = [
        Light("point", (16.0, 14.0, 12.0), position=(-2.4, 2.6, -0.9), name="strong"),
        Light("point", (1.6, 1.8, 2.0), position=(2.4, 2.6, -0.9), name="weak"),
    ]
    objects = [
        Object("room", room),
        Object("crate", [box((-0.45, 0.3, -0.45), (0.45, 1.2, 0.45), crate)], move(0.0), move),
    ]
    view = Camera(eye=(0.0, 1.9, 1.95), target=(0.0, 0.9, -0.6), fov=115.0)
    return SceneData("two-places", objects, materials, lamps, cameras=[view], duration=2.0 * MOVED)


@dataclass
class TimeSeries:
    """A method's light on the object, frame by frame after the move."""

    errors: list[float] = field(default_factory=list)
    """RMSE of the object's irradiance over 8x8 blocks, over the truth's mean on it."""
    biases: list[float] = field(default_factory=list)
    settled_error: float | None = None
    """That of a run in which the object stood at the new place from the first frame."""
    settled_bias: float | None = None

    def arrival(self) -> int | None:
        """Return the first frame from which the mean light stays within 10 % of the settled one; None: never."""
        arrived = None
        if self.settled_bias is None:
            return None
        for frame, value in enumerate(self.biases, start=1):
            near = abs(value - self.settled_bias) <= SETTLED * abs(1.0 + self.settled_bias)
            arrived = (arrived or frame) if near else None
        return arrived


class Direction:
    """One move of the crate, to the right or `back`, and the truth of where it then stands."""

    def __init__(self, runner: StudyRunner, budget: StudyBudget, back: bool) -> None:
        self.runner, self.budget, self.back = runner, budget, back
        self.name = "back" if back else "forth"

    @cached_property
    def scene(self) -> Scene:
        """The uploaded scene."""
        from luxel.scene.device import upload

        return upload(two_places(self.back))

    @cached_property
    def truth(self) -> Truth:
        """What is seen after the move."""
        from luxel.render.truth import render_truth

        def tell(share: float) -> None:
            self.runner.tell(round(share * budget.spp), f"{self.name}: truth of {budget.spp} samples")

        budget, camera = self.budget, self.scene.host.data.cameras[0]
        return render_truth(self.scene, camera=camera, size=budget.size, spp=budget.spp, time=MOVED, progress=tell)

    @cached_property
    def mask(self) -> np.ndarray:
        """(H, W) bool: the pixels that show the crate after the move."""
        return object_mask(self.scene, self.scene.host.data.cameras[0], self.budget.size, OBJECT_ID, MOVED)

    def about(self) -> dict[str, Any]:
        """Return the crate's pixels, the truth's mean (3) there, and its noise in the view and there."""

        def make(wanted: frozenset[str], tick: Tick) -> dict[str, Any]:
            layers, halves = self.truth.layers, self.truth.halves
            found = {
                "pixels": int(self.mask.sum()),
                "mean": mean_light(layers.indirect, self.mask),
                "noise": truth_noise(layers, halves),
                "noise there": noise_on(halves, self.mask),
            }
            return dict.fromkeys(wanted, found)

        return self.runner.ask(f"{self.name} truth", ["about"], lambda wanted: self.budget.spp, make).get("about", {})

    def series(self, method: str, preset: str | None) -> TimeSeries:
        """Return a method's light on the crate after the move, and that of a run without another place."""

        def make(wanted: frozenset[str], tick: Tick) -> dict[str, Any]:
            return dict.fromkeys(wanted, asdict(self._follow(method, preset, tick)))

        def cost(wanted: frozenset[str]) -> int:
            return 2 * SETUP_FRAMES + 4 * self.budget.frames

        run = f"{self.name} {label(method, preset)}"
        return TimeSeries(**self.runner.ask(run, ["course"], cost, make).get("course", {}))

    def _follow(self, method: str, preset: str | None, tick: Tick) -> TimeSeries:
        frames, wanted = self.budget.frames, self.truth.layers.indirect
        moved = self._renderer(method, preset)
        moved.run(frames, time_of=_always(0.0), progress=lambda frame: tick(SETUP_FRAMES + frame))
        series = TimeSeries()
        for frame in range(frames):
            moved.step(time=MOVED)
            error, bias = mean_error(moved.layers().indirect, wanted, self.mask)
            series.errors.append(error)
            series.biases.append(bias)
            tick(SETUP_FRAMES + frames + frame + 1)
        del moved
        settled = self._renderer(method, preset)
        begun = 2 * (SETUP_FRAMES + frames)
        settled.run(2 * frames, time_of=_always(MOVED), progress=lambda frame: tick(begun + frame))
        series.settled_error, series.settled_bias = mean_error(settled.layers().indirect, wanted, self.mask)
        return series

    def _renderer(self, method: str, preset: str | None) -> Renderer:
        from luxel.render.renderer import Renderer

        fitted = find_method(method).irradiance_param
        params = {fitted: ambient_irradiance(self.truth.layers)} if fitted else {}
        size, seed = self.budget.size, self.budget.seed
        return Renderer(self.scene, method=method, params=params, preset=preset, size=size, seed=seed)


def start_fast_object(
    budget: StudyBudget | None = None,
    *,
    tables: Sequence[str] | None = None,
    device: str = "auto",
    folder: Path | None = None,
    fresh: bool = False,
    progress: Progress | None = None,
) -> Study:
    """Return the study of how light follows an object that jumps between two places; nothing has run yet.

    `tables` None takes both directions. A run has `budget.frames` frames before the move and as many after it. `folder`
    gets the results as they come and is asked for what it has already, unless `fresh`. Raises LuxelError for a table
    that is not among them, for a budget that measures nothing and for an unknown device.
    """
    from luxel import runtime

    budget = budget or StudyBudget()
    check_budget(budget)
    wanted = choose_tables(tables, DIRECTIONS)
    chosen = runtime.start(device)
    from luxel.bench.machine import machine_record

    machine = machine_record()
    runner = StudyRunner(
        RunStore(folder, describe_making(machine, chosen.name, asdict(budget), "two-places"), fresh=fresh), progress
    )
    settings = {**budget.describe(), "frames after the move": budget.frames}
    del settings["still frames"]
    report = StudyReport(
        title="A fast object",
        source="none: no source measured this",
        scene="two-places: a room in two halves, made in luxel/bench/reproduce/fast_object.py",
        settings=settings,
        differences=["Not a table of any source: the measurement is ours, the same for all methods."],
        machine=machine,
        device=chosen.name,
    )
    moves = {name: partial(measure_direction, Direction(runner, budget, back)) for name, back in DIRECTIONS.items()}
    return Study(report, runner, moves, wanted, folder)


DIRECTIONS = {"forth": False, "back": True}
"""What `--tables` chooses from; whether the crate comes back into the strong light."""


def measure_direction(direction: Direction, contenders: Sequence[tuple[str, str | None]] = CONTENDERS) -> list[Table]:
    """Return the table of errors by frame and that of arrivals.

    `contenders` are methods and their presets; None takes a method's defaults.
    """
    about = direction.about()
    all_series = {label(method, preset): direction.series(method, preset) for method, preset in contenders}
    where = "from the weak light into the strong" if direction.back else "from the strong light into the weak"
    mean = ", ".join("-" if value is None else f"{value:.3g}" for value in about.get("mean", ()))
    notes = [
        f"{about.get('pixels', 0):,} pixels show the object; the truth's mean indirect irradiance there is {mean} "
        f"W/m^2, the truth's noise in the whole view {short(about.get('noise'))} of its mean, on the object "
        f"{short(about.get('noise there'))}.",
        "Error is the RMSE of the irradiance over 8x8 blocks of the object, over the truth's mean on it; frame 1 is "
        "the first that shows the object at its new place.",
        "Settled: a run of as many frames in all in which the object stood there from the start; one still "
        "on its way then has settled at nothing.",
    ]
    none = [None] * len(all_series)
    rows = []
    for frame in marks(direction.budget.frames):
        rows.append(TableRow([str(frame)], [_at(series.errors, frame - 1) for series in all_series.values()], none))
    rows.append(TableRow(["settled"], [series.settled_error for series in all_series.values()], none))
    title = f"Error on the object {where}"
    by_frame = Table(f"{direction.name}, error", title, ["frame"], list(all_series), rows, notes)
    rows = []
    for name, series in all_series.items():
        ours = [series.arrival(), _at(series.biases, 0), _at(series.biases, -1), series.settled_bias]
        rows.append(TableRow([name], ours, [None] * len(ours)))
    figures = ["arrived after frames", "bias at frame 1", "bias at the end", "settled bias"]
    note = "Arrived: the first frame from which the object's mean light stays within 10 % of the settled one."
    title = f"When the light has followed {where}"
    return [by_frame, Table(f"{direction.name}, arrival", title, ["method"], figures, rows, [note])]


def _at(values: Sequence[float], index: int) -> float | None:
    return values[index] if values else None


def marks(frames: int) -> list[int]:
    """Return the frames that the table shows: powers of two, and the last."""
    return sorted({2**power for power in range(frames.bit_length()) if 2**power < frames} | {frames})


def _always(time: float) -> Callable[[int], float]:
    return lambda frame: time
