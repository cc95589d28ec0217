"""Ekberg 2022, chapter 5: GIBS against DDGI in Crytek Sponza at equal rays a frame, then their times."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from luxel.bench.reproduce import published
from luxel.bench.reproduce.regions import region_mask
from luxel.bench.reproduce.run_store import RunStore, describe_making, digest_file
from luxel.bench.reproduce.runs import (
    AT,
    CHANGES,
    ERRORS,
    FLIP,
    STAGES,
    Figures,
    StudyBudget,
    StudyView,
    check_budget,
    label,
    short,
)
from luxel.bench.reproduce.sponza_views import FLIGHT, PILLARS, PLANT, VIEWS, SponzaView
from luxel.bench.reproduce.study import Progress, Study, StudyRunner, Tick, choose_tables
from luxel.bench.reproduce.tables import StudyReport, Table, TableRow

if TYPE_CHECKING:
    from luxel.scene.device import Scene
    from luxel.scene.model import Camera, SceneData

PROBES = {"num_probes_x": 20, "num_probes_y": 10, "num_probes_z": 10}
"""The thesis's grid: 2,000 probes."""
SURFELS = {"surfel_target": 50_000}
CLAMPED = {"far_depth": "clamp"}
"""NVIDIA's RTXGI, the thesis's DDGI, shortens depth to 1.5 diagonals of a cell; `clamp` does so at 1.45 of them."""
CONTENDERS: tuple[tuple[str, str | None, dict[str, Any]], ...] = (
    ("gibs", "ekberg", {}),
    ("gibs", None, {}),
    ("ddgi", "majercik", {}),
    ("ddgi", "majercik", CLAMPED),
    ("ddgi", None, {}),
)
"""Both methods as published, and as luxel sets them: method, preset, and what is set beside it."""
PUBLISHED_SETTINGS = (("gibs", "ekberg"), ("ddgi", "majercik"))
FULL_HD = (1920, 1080)
"""What the thesis measured its times at."""
FLOWN_AT_FULL_HD = (("gibs", "ekberg"), ("gibs", None))
COLUMNS = ("ray casting", "application", "rest", "in all")
FLOWN_RAYS = {"gibs": 4, "ddgi": 100}
"""Rays a surfel or a probe after the flight."""
RAY_STAGES = ("gibs/trace", "ddgi/trace")
APPLICATION_STAGES = ("gibs/gather", "ddgi/gather")
DIFFERENCES = [
    "The thesis measured on a GTX 1660 Super at 1920x1080 by Nsight; ours are device times of "
    "stages that are evaluated one by one.",
    "Its DDGI is NVIDIA's RTXGI sample application in a renderer of its own; ours is luxel's, preset majercik and "
    "luxel's defaults, on a grid of 20x10x10 fitted around the model. RTXGI shortens depth where preset majercik keeps "
    "it: a row with far_depth=clamp stands beside it.",
    "The thesis prints no cameras, light directions or strengths: ours are in bench/reproduce/sponza_views.py, one "
    "directional light, no sky.",
    "The thesis compares pictures by eye and prints no errors; all errors are ours, against a path-traced truth.",
    "Preset ekberg puts surfels where the camera looks and nowhere else, so it casts fewer rays than its budget until "
    "the camera has flown, and lacks light that arrives by surfaces out of sight.",
]


@dataclass
class Sponza:
    """The model's views, each under its own sun."""

    runner: StudyRunner
    budget: StudyBudget
    data: SceneData

    def view(self, name: str) -> StudyView:
        """Return the view called `name`."""
        return self._views[name]

    @cached_property
    def _views(self) -> dict[str, StudyView]:
        return {
            name: StudyView(name, self.budget, self.runner, partial(self._prepare, where), PLACES, len(FLIGHT))
            for name, where in VIEWS.items()
        }

    @cached_property
    def full_hd(self) -> StudyView:
        """The overview at the size of the thesis's times, for the flight; no truth is made of it."""
        size = self.budget.size if self.budget.quick else FULL_HD
        name = f"overview {_times(size)}"
        return StudyView(
            name,
            replace(self.budget, size=size),
            self.runner,
            partial(self._prepare, VIEWS["overview"]),
            {},
            len(FLIGHT),
        )

    def _prepare(self, where: SponzaView) -> tuple[Scene, Camera]:
        from luxel.scene.device import upload
        from luxel.scene.edit import apply_sky, apply_sun, parse_camera

        data = apply_sky(apply_sun(replace(self.data), where.sun), "none")
        data.mitsuba_full = None
        data.flight = [parse_camera(text, data) for text in FLIGHT]
        return upload(data), parse_camera(where.camera, data)


def start_ekberg(
    sponza: str | Path,
    budget: StudyBudget | None = None,
    *,
    tables: Sequence[str] | None = None,
    device: str = "auto",
    folder: Path | None = None,
    fresh: bool = False,
    progress: Progress | None = None,
) -> Study:
    """Return the study that compares GIBS and DDGI on the Crytek Sponza file `sponza`; nothing has run yet.

    `tables` None takes all. `folder` gets the results as they come and is asked for what it has already, unless
    `fresh`. Raises LuxelError for a file that cannot be read, a table that is not among them, a budget that measures
    nothing and an unknown device.
    """
    from luxel import runtime

    budget = budget or StudyBudget()
    check_budget(budget)
    wanted = choose_tables(tables, TABLES)
    chosen = runtime.start(device)
    from luxel.bench.machine import machine_record
    from luxel.render.loading import load

    data = load(sponza)
    machine = machine_record()
    made_with = describe_making(machine, chosen.name, asdict(budget), digest_file(Path(sponza)))
    runner = StudyRunner(RunStore(folder, made_with, fresh=fresh), progress)
    model = Sponza(runner, budget, data)
    report = StudyReport(
        title="Ekberg 2022, chapter 5, done again",
        source=published.EKBERG_SOURCE,
        scene=f"{Path(sponza).name}: Crytek Sponza, one directional light, no sky; views of ours",
        settings={
            **budget.describe(),
            "flight": f"{len(FLIGHT)} stops of {budget.flight_frames} frames",
            "probes": "20x10x10",
            "surfels": "50,000",
        },
        differences=DIFFERENCES,
        machine=machine,
        device=chosen.name,
    )
    return Study(report, runner, {name: partial(table, model) for name, table in TABLES.items()}, wanted, folder)


def ray_settings(method: str, rays: int) -> dict[str, Any]:
    """Return the settings of `method` for `rays` a frame: a key of `published.EKBERG_RAYS`."""
    surfel, probe = published.EKBERG_RAYS[rays]
    return {**SURFELS, "rays_per_surfel": surfel} if method == "gibs" else {**PROBES, "num_samples_per_probe": probe}


# ---------- Quality ----------


def quality(sponza: Sponza) -> list[Table]:
    """Return errors of every view, budget and contender."""
    budget = sponza.budget
    views = list(VIEWS)[:1] if budget.quick else list(VIEWS)
    rows = []
    for name in views:
        for rays in budget.thin(list(published.EKBERG_RAYS)):
            for method, preset, others in [(*pair, {}) for pair in PUBLISHED_SETTINGS] if budget.quick else CONTENDERS:
                settings = {**ray_settings(method, rays), **others}
                run = sponza.view(name).measure(method, preset, settings, ERRORS, FLIP, CHANGES)
                ours = [run.rays, run.regional, run.bias, run.flip, run.change_mean]
                rows.append(TableRow([name, f"{rays:,}", _name(method, preset, others)], ours, [None] * len(ours)))
    notes = [sponza.view(name).noise_note() for name in views]
    notes += [
        "The budget is what the items may cast together; rays are those that the cache cast at most in the frame that "
        "is judged, which for preset ekberg are far fewer.",
        "The thesis saw flicker with 25 rays a probe and none with more: compare the column change (mean over pixels "
        "and still frames, direct light held fixed).",
    ]
    figures = ["rays", "regional", "bias", "flip", "change"]
    keys = ["view", "budget", "method"]
    return [Table("5.1", "Quality at an equal budget of rays a frame (figures 5.2 to 5.4)", keys, figures, rows, notes)]


# ---------- Times ----------


def times(sponza: Sponza) -> list[Table]:
    """Return both timing tables: overview with a camera at rest, and after a flight."""
    view = sponza.view("overview")
    note = (
        "Ours: ray casting is the stage trace, application the stage gather, the rest every other stage of the method; "
        "first hits and direct light are left out. Theirs: the rest is the row that the thesis calls misc."
    )
    rows = []
    for (method, rays), theirs in sponza.budget.thin(list(published.TIMES_STILL.items())):
        preset = dict(PUBLISHED_SETTINGS)[method]
        run = view.measure(method, preset, _items(method, rays), STAGES)
        rows.append(TableRow([label(method, preset), str(rays)], split_stages(run.stages), [*theirs]))
    keys = ["method", "rays an item"]
    title = "Milliseconds in the overview, camera not yet moved"
    still = Table("5.2 at rest", title, keys, list(COLUMNS), rows, [note])
    return [still, _flown(sponza, note)]


def _flown(sponza: Sponza, note: str) -> Table:
    """Return the timing table after a flight, at the study's size and at the thesis's."""
    flights = [(sponza.view("overview"), pair) for pair in PUBLISHED_SETTINGS]
    flights += [(sponza.full_hd, pair) for pair in FLOWN_AT_FULL_HD]
    rows = []
    for view, (method, preset) in flights:
        rays, size = FLOWN_RAYS[method], view.budget.size
        run = view.measure(method, preset, _items(method, rays), STAGES, fly=True)
        theirs = published.TIMES_FLOWN.get((method, rays)) if preset else None
        items = run.cache.get("surfel_count", run.cache.get("probe_count"))
        ours = [items, run.rays, *split_stages(run.stages)]
        labels = [label(method, preset), str(rays), _times(size)]
        rows.append(TableRow(labels, ours, [None, None, *(theirs or (None,) * len(COLUMNS))]))
    figures, keys = ["surfels or probes", "rays", *COLUMNS], ["method", "rays an item", "size"]
    return Table("5.2 after a flight", "The same after a flight around the scene", keys, figures, rows, [note])


def split_stages(stages: dict[str, float]) -> list[float | int | None]:
    """Return ray casting, application, the rest and their sum, milliseconds, of `Renderer.staged()`."""
    own = {name: ms for name, ms in stages.items() if name.startswith(("gibs/", "ddgi/"))}
    casting = sum(own.get(name, 0.0) for name in RAY_STAGES)
    application = sum(own.get(name, 0.0) for name in APPLICATION_STAGES)
    total = sum(own.values())
    return [casting, application, total - casting - application, total]


def _name(method: str, preset: str | None, others: dict[str, Any]) -> str:
    """Return a contender's name, with what is set beside its preset."""
    return " ".join([label(method, preset), *(f"{key}={value}" for key, value in others.items())])


def _times(size: tuple[int, int]) -> str:
    width, height = size
    return f"{width}x{height}"


def _items(method: str, rays: int) -> dict[str, Any]:
    """Return the settings with `rays` a surfel or a probe."""
    key = "rays_per_surfel" if method == "gibs" else "num_samples_per_probe"
    return {**(SURFELS if method == "gibs" else PROBES), key: rays}


# ---------- Two places ----------


def _mask_pillars(view: StudyView) -> np.ndarray:
    masks = [region_mask(view.scene, view.camera, view.budget.size, region) for region in PILLARS]
    return np.logical_or.reduce(masks)


def _mask_plant(view: StudyView) -> np.ndarray:
    return region_mask(view.scene, view.camera, view.budget.size, PLANT.grown(0.35))


PLACES = {"pillars": _mask_pillars, "plant": _mask_plant}


def pillar(sponza: Sponza) -> list[Table]:
    """Return how much of the banners' colours the pillars of the hallway catch."""
    view = sponza.view("hallway")
    truth = view.truth_at("pillars")
    rows = [_pillar_row("truth", truth)]
    for method, preset, others in CONTENDERS:
        run = view.measure(method, preset, {**ray_settings(method, 200_000), **others}, AT + "pillars")
        rows.append(_pillar_row(_name(method, preset, others), run.places.get("pillars", {})))
    notes = [
        f"{truth.get('pixels', 0):,} pixels on pillars between banners of two colours, blocks of 8x8; 200,000 rays a "
        "frame.",
        "Chroma is each channel's share of the light; spread is how much it varies over the pillars (standard "
        "deviation): what a cache without items near the pillars cannot follow; distance is from the truth's.",
        _noise_there(truth),
    ]
    figures = ["red share", "green share", "blue share", "chroma spread", "chroma distance", "error", "bias"]
    return [Table("pillar", "The banners' colours on the pillars (hallway)", ["method"], figures, rows, notes)]


def _noise_there(truth: dict[str, Any]) -> str:
    """Return one sentence on the noise of the truth on a place."""
    noise, spp = short(truth.get("noise")), truth.get("spp")
    return f"The truth's noise on these pixels is {noise} of its mean there, at {spp} samples a pixel."


def _pillar_row(name: str, light: dict[str, Any]) -> TableRow:
    mean = np.array(light.get("mean") or [None] * 3, np.float64)
    shares = [float(value) for value in mean / max(float(mean.sum()), 1e-12)]
    ours = [*shares, *(light.get(key) for key in ("spread", "distance", "error", "bias"))]
    return TableRow([name], ours, [None] * len(ours))


def plant(sponza: Sponza) -> list[Table]:
    """Return the light around a plant with a probe inside it, dead probes detected or not."""
    view, budget = sponza.view("overview"), sponza.budget
    truth = view.truth_at("plant")
    shift = _shift_into_plant(view)
    grids: list[tuple[str, dict[str, Any]]] = [("as fitted", {}), ("shifted into the plant", {"world_offset": shift})]
    variants: list[tuple[str, str | None, dict[str, Any]]] = [
        ("ddgi:majercik", "majercik", {}),
        ("with detection", "majercik", {"detect_dead_probes": True}),
        ("with detection and offsets", "majercik", _MOVED),
        ("ddgi", None, {}),
    ]
    rows = []
    for grid, offset in grids[1:] if budget.quick else grids:
        for name, preset, settings in budget.thin(variants):
            run = view.measure("ddgi", preset, {**ray_settings("ddgi", 200_000), **offset, **settings}, AT + "plant")
            rows.append(_plant_row([grid, name], run))
    surfels = view.measure("gibs", "ekberg", ray_settings("gibs", 200_000), AT + "plant")
    rows.append(_plant_row(["-", "gibs:ekberg"], surfels))
    notes = [
        f"{truth.get('pixels', 0):,} pixels within 0.35 m of the plant at the left of the overview; 200,000 rays a "
        "frame.",
        f"The fitted grid's nearest probe stands {float(np.linalg.norm(shift)):.2f} m from the plant's middle; the "
        "second grid is moved by that much, so that a probe stands inside as in the thesis's grid.",
        "A bias below 0 is the darkening that the thesis saw.",
        "Detection is that of backface_rule=rohacek in the rows of preset majercik.",
        _noise_there(truth),
    ]
    return [Table("plant", "The probe inside the plant (overview)", ["grid", "method"], list(_PLANT), rows, notes)]


_MOVED = {"detect_dead_probes": True, "offset_dead_probes": True, "corrected_weights": True}
_PLANT = ("error", "bias", "dead probes", "moved probes")


def _plant_row(labels: list[str], run: Figures) -> TableRow:
    light = run.places.get("plant", {})
    ours = [light.get("error"), light.get("bias"), run.cache.get("dead_probes"), run.cache.get("moved_probes")]
    return TableRow(labels, ours, [None] * len(_PLANT))


def _shift_into_plant(view: StudyView) -> tuple[float, float, float]:
    """Return how far the grid has to move until its nearest probe stands in the plant's middle, world metres."""

    def make(wanted: frozenset[str], tick: Tick) -> dict[str, Any]:
        renderer = view.renderer("ddgi", "majercik", PROBES)
        places = np.array(renderer.state.probes.p).T
        away = np.array(PLANT.middle) - places
        return dict.fromkeys(wanted, away[np.argmin((away**2).sum(axis=1))])

    # While counting there is no grid yet; any shift stands for the one to come, as it makes runs of its own.
    x, y, z = view.runner.ask("overview grid", ["shift"], lambda wanted: 1, make).get("shift", (0.0, 0.0, 1.0))
    return x, y, z


TABLES: dict[str, Callable[[Sponza], list[Table]]] = {
    "quality": quality,
    "times": times,
    "pillar": pillar,
    "plant": plant,
}
"""What `--tables` chooses from."""
