"""A fast object: moved at once between two differently lit places, error on it frame by frame, GIBS beside DDGI.

A cache that rides on the object brings the old place's light along; one that stands in the room answers for the new
place at once, as well as it can.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from luxel.bench.reproduce.regions import mean_error, mean_light, noise_on, object_mask
from luxel.bench.reproduce.runs import Budget, Progress, check_budget
from luxel.bench.reproduce.tables import Report, Row, Table
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
class Course:
    """A method's light on the object, frame by frame after the move."""

    errors: list[float]
    """RMSE of the object's irradiance over 8x8 blocks, over the truth's mean on it."""
    biases: list[float]
    settled_error: float
    """That of a run in which the object stood at the new place from the first frame."""
    settled_bias: float

    def arrival(self) -> int | None:
        """Return the first frame from which the mean light stays within 10 % of the settled one; None: never."""
        arrived = None
        for frame, value in enumerate(self.biases, start=1):
            near = abs(value - self.settled_bias) <= SETTLED * abs(1.0 + self.settled_bias)
            arrived = (arrived or frame) if near else None
        return arrived


def reproduce_fast_object(
    budget: Budget | None = None, *, device: str = "auto", progress: Progress | None = None
) -> Report:
    """Measure how light follows an object that jumps between two places, in both directions, for every contender.

    A run has `budget.frames` frames before the move and as many after it. Raises LuxelError for a budget that measures
    nothing and for an unknown device.
    """
    from luxel import runtime

    budget = budget or Budget()
    check_budget(budget)
    tell = progress or (lambda text, share: None)
    chosen = runtime.start(device)
    from luxel.bench.machine import machine_record

    tables = []
    for number, back in enumerate((False, True)):
        tables += measure_direction(budget, back, lambda text, share, n=number: tell(text, 0.5 * (n + share)))
    settings = {**budget.describe(), "frames after the move": budget.frames}
    del settings["still frames"]
    return Report(
        title="A fast object",
        source="none: no source measured this",
        scene="two-places: a room in two halves, made in luxel/bench/reproduce/fast_object.py",
        settings=settings,
        differences=["Not a table of any source: the measurement is ours, the same for all methods."],
        machine=machine_record(),
        device=chosen.name,
        tables=tables,
    )


def measure_direction(
    budget: Budget, back: bool, progress: Progress, contenders: Sequence[tuple[str, str | None]] = CONTENDERS
) -> list[Table]:
    """Return the table of errors by frame and that of arrivals, for the move to the right or `back`.

    `contenders` are methods and their presets; None takes a method's defaults.
    """
    from luxel.render.truth import render_truth
    from luxel.scene.device import upload

    data = two_places(back)
    scene, camera = upload(data), data.cameras[0]
    truth = render_truth(scene, camera=camera, size=budget.size, spp=budget.spp, time=MOVED)
    mask = object_mask(scene, camera, budget.size, OBJECT_ID, MOVED)
    courses: dict[str, Course] = {}
    for number, (method, preset) in enumerate(contenders):
        name = f"{method}:{preset}" if preset else method
        progress(f"fast object: {name}", number / len(contenders))
        courses[name] = follow(budget, scene, truth, mask, method, preset)
    where = "from the weak light into the strong" if back else "from the strong light into the weak"
    name = "back" if back else "forth"
    mean = mean_light(truth.layers.indirect, mask)
    notes = [
        f"{int(mask.sum()):,} pixels show the object; the truth's mean indirect irradiance there is "
        f"{mean[0]:.3g}, {mean[1]:.3g}, {mean[2]:.3g} W/m^2, the truth's noise in the whole view "
        f"{truth_noise(truth.layers, truth.halves):.2g} of its mean, on the object {noise_on(truth.halves, mask):.2g}.",
        "Error is the RMSE of the irradiance over 8x8 blocks of the object, over the truth's mean on it; frame 1 is "
        "the first that shows the object at its new place.",
        "Settled: a run of as many frames in all in which the object stood there from the start; one still "
        "on its way then has settled at nothing.",
    ]
    rows = []
    for frame in marks(budget.frames):
        rows.append(Row([str(frame)], [course.errors[frame - 1] for course in courses.values()], [None] * len(courses)))
    rows.append(Row(["settled"], [course.settled_error for course in courses.values()], [None] * len(courses)))
    by_frame = Table(f"{name}, error", f"Error on the object {where}", ["frame"], list(courses), rows, notes)
    rows = []
    for label, course in courses.items():
        ours = [course.arrival(), course.biases[0], course.biases[-1], course.settled_bias]
        rows.append(Row([label], ours, [None] * len(ours)))
    figures = ["arrived after frames", "bias at frame 1", "bias at the end", "settled bias"]
    note = "Arrived: the first frame from which the object's mean light stays within 10 % of the settled one."
    return [
        by_frame,
        Table(f"{name}, arrival", f"When the light has followed {where}", ["method"], figures, rows, [note]),
    ]


def follow(budget: Budget, scene: Scene, truth: Truth, mask: np.ndarray, method: str, preset: str | None) -> Course:
    """Return the light on the object (`mask`, (H, W)) after the move, and that of a run without another place."""
    params: dict[str, Any] = {}
    if method == "ambient":
        params["irradiance"] = ambient_irradiance(truth.layers)
    wanted = truth.layers.indirect

    def make() -> Renderer:
        from luxel.render.renderer import Renderer

        return Renderer(scene, method=method, params=dict(params), preset=preset, size=budget.size, seed=budget.seed)

    moved = make()
    moved.run(budget.frames, time_of=_always(0.0))
    errors, biases = [], []
    for _ in range(budget.frames):
        moved.step(time=MOVED)
        error, bias = mean_error(moved.layers().indirect, wanted, mask)
        errors.append(error)
        biases.append(bias)
    settled = make()
    settled.run(2 * budget.frames, time_of=_always(MOVED))
    return Course(errors, biases, *mean_error(settled.layers().indirect, wanted, mask))


def marks(frames: int) -> list[int]:
    """Return the frames that the table shows: powers of two, and the last."""
    return sorted({2**power for power in range(frames.bit_length()) if 2**power < frames} | {frames})


def _always(time: float) -> Callable[[int], float]:
    return lambda frame: time
