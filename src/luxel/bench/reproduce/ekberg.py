"""Ekberg 2022, chapter 5: GIBS against DDGI in Crytek Sponza at equal rays a frame, then their times."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from luxel.bench.reproduce import published
from luxel.bench.reproduce.regions import chroma_distance, chroma_spread, mean_error, mean_light, noise_on, region_mask
from luxel.bench.reproduce.rohacek import choose_tables
from luxel.bench.reproduce.runs import Budget, Progress, View, check_budget, make_view, noise_note
from luxel.bench.reproduce.sponza_views import FLIGHT, PILLARS, PLANT, VIEWS
from luxel.bench.reproduce.tables import Report, Row, Table

if TYPE_CHECKING:
    from luxel.scene.model import SceneData

PROBES = {"num_probes_x": 20, "num_probes_y": 10, "num_probes_z": 10}
"""The thesis's grid: 2,000 probes."""
SURFELS = {"surfel_target": 50_000}
CONTENDERS: tuple[tuple[str, str | None], ...] = (
    ("gibs", "ekberg"),
    ("gibs", None),
    ("ddgi", "majercik"),
    ("ddgi", None),
)
"""Both methods as published, and as luxel sets them."""
PUBLISHED_SETTINGS = (("gibs", "ekberg"), ("ddgi", "majercik"))
STAGES = ("ray casting", "application", "rest", "in all")
RAY_STAGES = ("gibs/trace", "ddgi/trace")
APPLICATION_STAGES = ("gibs/gather", "ddgi/gather")
DIFFERENCES = [
    "The thesis measured on a GTX 1660 Super at 1920x1080 by Nsight; ours are device times of "
    "stages that are evaluated one by one.",
    "Its DDGI is NVIDIA's RTXGI sample application in a renderer of its own; ours is luxel's, preset majercik and "
    "luxel's defaults, on a grid of 20x10x10 fitted around the model.",
    "The thesis prints no cameras, light directions or strengths: ours are in bench/reproduce/sponza_views.py, one "
    "directional light, no sky.",
    "The thesis compares pictures by eye and prints no errors; all errors are ours, against a path-traced truth.",
    "Preset ekberg puts surfels where the camera looks and nowhere else, so it casts fewer rays than its budget until "
    "the camera has flown, and lacks light that arrives by surfaces out of sight.",
]


@dataclass
class Lab:
    """The model, and its views as they are needed."""

    data: SceneData
    budget: Budget
    progress: Progress
    views: dict[str, View]

    def view(self, name: str) -> View:
        """Return the view called `name` under its own sun, its truth rendered once."""
        if name not in self.views:
            from luxel.scene.device import upload
            from luxel.scene.edit import apply_sky, apply_sun, parse_camera

            where = VIEWS[name]
            data = apply_sky(apply_sun(replace(self.data), where.sun), "none")
            data.mitsuba_full = None
            data.flight = [parse_camera(text, data) for text in FLIGHT]
            camera = parse_camera(where.camera, data)
            self.views[name] = make_view(name, upload(data), camera, self.budget, self.progress)
        return self.views[name]


def reproduce_ekberg(
    sponza: str | Path,
    budget: Budget | None = None,
    *,
    tables: Sequence[str] | None = None,
    device: str = "auto",
    progress: Progress | None = None,
) -> Report:
    """Compare GIBS and DDGI on the Crytek Sponza file `sponza` as the thesis did; `tables` None takes all.

    Raises LuxelError for a file that cannot be read, a table that is not among them, a budget that measures nothing
    and an unknown device.
    """
    from luxel import runtime

    budget = budget or Budget()
    check_budget(budget)
    wanted = choose_tables(tables, TABLES)
    tell = progress or (lambda text, share: None)
    chosen = runtime.start(device)
    from luxel.bench.machine import machine_record
    from luxel.scene import load

    lab = Lab(load(sponza), budget, tell, {})
    made = []
    for number, name in enumerate(wanted):
        tell(f"ekberg {name}", number / len(wanted))
        made += TABLES[name](lab)
    return Report(
        title="Ekberg 2022, chapter 5, done again",
        source=published.EKBERG_SOURCE,
        scene=f"{Path(sponza).name}: Crytek Sponza, one directional light, no sky; views of ours",
        settings={**budget.describe(), "probes": "20x10x10", "surfels": "50,000"},
        differences=DIFFERENCES,
        machine=machine_record(),
        device=chosen.name,
        tables=made,
    )


def ray_settings(method: str, rays: int) -> dict[str, Any]:
    """Return the settings of `method` for `rays` a frame: a key of `published.EKBERG_RAYS`."""
    surfel, probe = published.EKBERG_RAYS[rays]
    return {**SURFELS, "rays_per_surfel": surfel} if method == "gibs" else {**PROBES, "num_samples_per_probe": probe}


# ---------- Quality ----------


def quality(lab: Lab) -> list[Table]:
    """Return errors of every view, budget and contender."""
    rows = []
    for name in lab.budget.thin(list(VIEWS))[:1] if lab.budget.quick else VIEWS:
        for rays in lab.budget.thin(list(published.EKBERG_RAYS)):
            for method, preset in PUBLISHED_SETTINGS if lab.budget.quick else CONTENDERS:
                run = lab.view(name).measure(method, preset, ray_settings(method, rays))
                ours = [run.rays, run.regional, run.bias, run.flip, run.change_mean]
                rows.append(Row([name, f"{rays:,}", label(method, preset)], ours, [None] * len(ours)))
    notes = [noise_note(view) for view in lab.views.values()]
    notes.append(
        "Rays are those that the cache cast at most in its last frame; the thesis saw flicker with 25 rays a probe and "
        "none with more: compare the column change (mean over pixels and still frames, direct light held fixed)."
    )
    figures = ["rays", "regional", "bias", "flip", "change"]
    keys = ["view", "rays a frame", "method"]
    return [Table("5.1", "Quality at equal rays a frame (figures 5.2 to 5.4)", keys, figures, rows, notes)]


def label(method: str, preset: str | None) -> str:
    """Return `gibs:ekberg`, or the bare name for a method's defaults."""
    return f"{method}:{preset}" if preset else method


# ---------- Times ----------


def times(lab: Lab) -> list[Table]:
    """Return both timing tables: overview with a camera at rest, and after a flight."""
    view = lab.view("overview")
    note = (
        "Ours: ray casting is the stage trace, application the stage gather, the rest every other stage of the method; "
        "first hits and direct light are left out. Theirs: the rest is the row that the thesis calls misc."
    )
    rows = []
    for (method, rays), theirs in lab.budget.thin(list(published.TIMES_STILL.items())):
        for chosen, preset in PUBLISHED_SETTINGS:
            if chosen == method:
                run = view.measure(method, preset, _items(method, rays))
                rows.append(Row([label(method, preset), str(rays)], split_stages(run.stages), [*theirs]))
    keys = ["method", "rays an item"]
    still = Table("5.2 at rest", "Milliseconds in the overview, camera not yet moved", keys, list(STAGES), rows, [note])
    if lab.budget.quick:
        return [still]
    rows = []
    for method, preset in PUBLISHED_SETTINGS:
        run = view.measure(method, preset, _items(method, 4 if method == "gibs" else 100), fly=True)
        theirs = published.TIMES_FLOWN.get((method, 4), (None,) * len(STAGES))
        items = run.cache.get("surfel_count", run.cache.get("probe_count"))
        ours = [items, run.rays, *split_stages(run.stages)]
        rows.append(Row([label(method, preset), "4" if method == "gibs" else "100"], ours, [None, None, *theirs]))
    figures = ["surfels or probes", "rays", *STAGES]
    flown = Table("5.2 after a flight", "The same after a flight around the scene", keys, figures, rows, [note])
    return [still, flown]


def split_stages(stages: dict[str, float]) -> list[float | int | None]:
    """Return ray casting, application, the rest and their sum, milliseconds, of `Renderer.staged()`."""
    own = {name: ms for name, ms in stages.items() if name.startswith(("gibs/", "ddgi/"))}
    casting = sum(own.get(name, 0.0) for name in RAY_STAGES)
    application = sum(own.get(name, 0.0) for name in APPLICATION_STAGES)
    total = sum(own.values())
    return [casting, application, total - casting - application, total]


def _items(method: str, rays: int) -> dict[str, Any]:
    """Return the settings with `rays` a surfel or a probe."""
    key = "rays_per_surfel" if method == "gibs" else "num_samples_per_probe"
    return {**(SURFELS if method == "gibs" else PROBES), key: rays}


# ---------- Two places ----------


def pillar(lab: Lab) -> list[Table]:
    """Return how much of the banners' colours the pillars of the hallway catch."""
    view = lab.view("hallway")
    mask = np.zeros(view.truth.layers.hit.shape, bool)
    for region in PILLARS:
        mask |= region_mask(view.scene, view.camera, lab.budget.size, region)
    rows = [_pillar_row("truth", view.truth.layers.indirect, view, mask)]
    for method, preset in CONTENDERS:
        renderer = view.renderer(method, preset, ray_settings(method, 200_000))
        renderer.run(lab.budget.frames)
        rows.append(_pillar_row(label(method, preset), renderer.layers().indirect, view, mask))
    notes = [
        f"{int(mask.sum()):,} pixels on pillars between banners of two colours, blocks of 8x8; 200,000 rays a frame.",
        "Chroma is each channel's share of the light; spread is how much it varies over the pillars (standard "
        "deviation): what a cache without items near the pillars cannot follow; distance is from the truth's.",
        _noise_there(view, mask),
    ]
    figures = ["red share", "green share", "blue share", "chroma spread", "chroma distance", "error", "bias"]
    return [Table("pillar", "The banners' colours on the pillars (hallway)", ["method"], figures, rows, notes)]


def _noise_there(view: View, mask: np.ndarray) -> str:
    """Return one sentence on the noise of the truth on `mask`, (H, W)."""
    noise = noise_on(view.truth.halves, mask)
    return f"The truth's noise on these pixels is {noise:.2g} of its mean there, at {view.truth.spp} samples a pixel."


def _pillar_row(name: str, light: np.ndarray, view: View, mask: np.ndarray) -> Row:
    truth = view.truth.layers.indirect
    mean = mean_light(light, mask)
    shares = [float(value) for value in mean / max(float(mean.sum()), 1e-12)]
    error, bias = mean_error(light, truth, mask)
    ours = [*shares, chroma_spread(light, mask), chroma_distance(light, truth, mask), error, bias]
    return Row([name], ours, [None] * len(ours))


def plant(lab: Lab) -> list[Table]:
    """Return the light around a plant with a probe inside it, dead probes detected or not."""
    view = lab.view("overview")
    mask = region_mask(view.scene, view.camera, lab.budget.size, PLANT.grown(0.35))
    middle = np.array(PLANT.middle)
    fitted = _nearest_probe(view, middle, {})
    shift = tuple(float(v) for v in middle - fitted)
    grids: list[tuple[str, dict[str, Any]]] = [("as fitted", {}), ("shifted into the plant", {"world_offset": shift})]
    variants: list[tuple[str, str | None, dict[str, Any]]] = [
        ("ddgi:majercik", "majercik", {}),
        ("with detection", "majercik", {"detect_dead_probes": True}),
        ("with detection and offsets", "majercik", _MOVED),
        ("ddgi", None, {}),
    ]
    rows = []
    for grid, offset in grids[1:] if lab.budget.quick else grids:
        for name, preset, settings in lab.budget.thin(variants):
            renderer = view.renderer("ddgi", preset, {**ray_settings("ddgi", 200_000), **offset, **settings})
            renderer.run(lab.budget.frames)
            rows.append(_plant_row([grid, name], renderer, view, mask))
    surfels = view.renderer("gibs", "ekberg", ray_settings("gibs", 200_000))
    surfels.run(lab.budget.frames)
    rows.append(_plant_row(["-", "gibs:ekberg"], surfels, view, mask))
    distance = float(np.linalg.norm(middle - fitted))
    notes = [
        f"{int(mask.sum()):,} pixels within 0.35 m of the plant at the left of the overview; 200,000 rays a frame.",
        f"The fitted grid's nearest probe stands {distance:.2f} m from the plant's middle; the second grid is moved by "
        "that much, so that a probe stands inside as in the thesis's grid.",
        "A bias below 0 is the darkening that the thesis saw.",
        _noise_there(view, mask),
    ]
    return [Table("plant", "The probe inside the plant (overview)", ["grid", "method"], list(_PLANT), rows, notes)]


_MOVED = {"detect_dead_probes": True, "offset_dead_probes": True, "corrected_weights": True}
_PLANT = ("error", "bias", "dead probes", "moved probes")


def _plant_row(labels: list[str], renderer: Any, view: View, mask: np.ndarray) -> Row:
    error, bias = mean_error(renderer.layers().indirect, view.truth.layers.indirect, mask)
    cache = renderer.cache()
    return Row(labels, [error, bias, cache.get("dead_probes"), cache.get("moved_probes")], [None] * len(_PLANT))


def _nearest_probe(view: View, point: np.ndarray, settings: dict[str, Any]) -> np.ndarray:
    """Return where the probe nearest to `point` stands before the first frame, world metres."""
    renderer = view.renderer("ddgi", "majercik", {**ray_settings("ddgi", 50_000), **settings})
    places = np.array(renderer.state.probes.p).T
    return places[np.argmin(((places - point) ** 2).sum(axis=1))]


TABLES: dict[str, Callable[[Lab], list[Table]]] = {"quality": quality, "times": times, "pillar": pillar, "plant": plant}
"""What `--tables` chooses from."""
