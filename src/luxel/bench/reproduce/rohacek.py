"""Roháček 2022, chapter 4, on the built-in scene `attic`: tables 4.1 to 4.7 and figure 4.8."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from luxel.bench.reproduce import published
from luxel.bench.reproduce.run_store import RunStore, describe_making
from luxel.bench.reproduce.runs import CHANGES, ERRORS, STAGES, Figures, StudyBudget, StudyView, check_budget
from luxel.bench.reproduce.study import Progress, Study, StudyRunner, choose_tables
from luxel.bench.reproduce.tables import StudyReport, Table, TableRow
from luxel.errors import LuxelError

if TYPE_CHECKING:
    from luxel.scene.device import Scene
    from luxel.scene.model import Camera

GRID = {"num_probes_x": 11, "num_probes_y": 10, "num_probes_z": 15}
"""The thesis's grid (its section 4.7)."""
VIEWS = {
    "roof": "1.2,1.1,1.6;-1.6,2.4,-0.6;75",
    "bleed": "0.2,1.3,-0.6;-2.2,1.5,-3.4;70",
    "room": "-1.6,1.5,3.6;0.4,1.15,-2.0;75",
}
"""The thesis chose a roof for dead probes, a close view for light bleeding, an interior for the rest; so do we."""
DIFFERENCES = [
    "The thesis's house is not public: ours are runs on the built-in scene 'attic', seen from three views of ours: "
    "figures may agree in order and direction, not in value.",
    "The thesis renders 1920x1080 with its own renderer and path tracer; sums over an image are ours as the mean times "
    "its 2,073,600 pixels.",
    "Images are displayed at the exposure that brings the truth's mean luminance to 0.18, with the sRGB curve; the "
    "thesis does not say how its images were displayed.",
    "The thesis does not name its GPU, nor the frames that it let pass before a picture; ours are in the settings.",
]
DEAD_VARIANTS: dict[str, dict[str, Any]] = {
    "simple DDGI": {"detect_dead_probes": False, "corrected_weights": False},
    "offset to the surface": {"dead_probe_threshold": 0.0, "corrected_weights": False},
    "offset 15 cm away": {"dead_probe_threshold": 0.15, "corrected_weights": False},
    "improved filtering": {"dead_probe_threshold": 0.15, "corrected_weights": True},
}
"""The thesis's treatments of dead probes (its table 4.2), each run under both back-face rules."""
THEIR_RULE, OUR_RULE = "rohacek", "luxel"
"""What back faces say: `backface_rule` of the thesis, and luxel's."""
NO_OFFSETS = {"detect_dead_probes": False, "offset_dead_probes": False, "corrected_weights": False}
COLUMNS = ("tracing", "integration", "detection and offset", "shading", "in all")
"""Table 4.6's stages; detection and offset are one stage of ours, so the thesis's two are added."""
STAGES_OF_OURS = {
    "tracing": ("ddgi/budget", "ddgi/trace"),
    "integration": ("ddgi/blend", "ddgi/pack"),
    "detection and offset": ("ddgi/relocate",),
    "shading": ("ddgi/gather", "ddgi/observe"),
}
STAGE_NOTE = (
    "Ours: tracing is ddgi/trace, integration ddgi/blend and ddgi/pack (atlas and gutter), detection and offset "
    "ddgi/relocate, shading ddgi/gather and ddgi/observe, each alone; published detection and offset are added."
)


@dataclass
class Attic:
    """The scene's views, and how probe rays go on."""

    runner: StudyRunner
    budget: StudyBudget
    bounces: str

    def view(self, name: str) -> StudyView:
        """Return the view called `name`."""
        return self._views[name]

    def run(self, view: str, params: dict[str, Any], *parts: str) -> Figures:
        """Return `parts` of a run of the thesis's preset on its grid with `params`."""
        return self.view(view).measure("ddgi", "rohacek", {**GRID, "bounces": self.bounces, **params}, *parts)

    @cached_property
    def _scene(self) -> Scene:
        from luxel.scene import load
        from luxel.scene.device import upload

        return upload(load("attic"))

    @cached_property
    def _views(self) -> dict[str, StudyView]:
        from luxel.scene.edit import parse_camera

        def prepare(text: str) -> tuple[Scene, Camera]:
            return self._scene, parse_camera(text, self._scene.host.data)

        return {name: StudyView(name, self.budget, self.runner, partial(prepare, text)) for name, text in VIEWS.items()}


def start_rohacek(
    budget: StudyBudget | None = None,
    *,
    tables: Sequence[str] | None = None,
    bounces: str = "path",
    device: str = "auto",
    folder: Path | None = None,
    fresh: bool = False,
    progress: Progress | None = None,
) -> Study:
    """Return the study of the thesis's tables with luxel's DDGI, preset `rohacek`, on `attic`; nothing has run yet.

    `tables` None takes all. `bounces` is how probe rays go on: `path`, as the thesis measured, or `feedback`. `folder`
    gets the results as they come and is asked for what it has already, unless `fresh`. Raises LuxelError for a table
    that is not among them, for a budget that measures nothing and for an unknown device.
    """
    from luxel import runtime

    budget = budget or StudyBudget()
    check_budget(budget)
    wanted = choose_tables(tables, TABLES)
    if bounces not in ("path", "feedback"):
        raise LuxelError(f"--bounces {bounces} is not known: write path or feedback")
    chosen = runtime.start(device)
    from luxel.bench.machine import machine_record

    machine = machine_record()
    made_with = describe_making(machine, chosen.name, {**asdict(budget), "bounces": bounces}, "attic")
    runner = StudyRunner(RunStore(folder, made_with, fresh=fresh), progress)
    attic = Attic(runner, budget, bounces)
    report = StudyReport(
        title="Roháček 2022, chapter 4, done again",
        source=published.ROHACEK_SOURCE,
        scene="attic (built in), not the thesis's house, which is not public",
        settings={**budget.describe(), "grid": "11x10x15", "preset": "ddgi:rohacek", "bounces": bounces},
        differences=DIFFERENCES,
        machine=machine,
        device=chosen.name,
    )
    return Study(
        report, runner, {name: partial(_listed, table, attic) for name, table in TABLES.items()}, wanted, folder
    )


def _listed(table: Callable[[Attic], Table], attic: Attic) -> list[Table]:
    return [table(attic)]


# ---------- Memory ----------


def table_memory() -> Table:
    """Return table 4.1: formula 4.1 for the settings that the thesis prints; nothing is rendered."""
    from luxel.methods.ddgi.memory import atlas_bytes
    from luxel.methods.params import make_params

    rows = []
    for light, depth, light_format, depth_format, theirs in published.MEMORY:
        params = make_params("ddgi", "rohacek", _resolutions(light, depth, light_format, depth_format))
        rows.append(TableRow([str(light), str(depth), light_format, depth_format], [atlas_bytes(params)], [theirs]))
    keys = ["irradiance texels", "depth texels", "irradiance format", "depth format"]
    unlike = [" / ".join(row.labels) for row in rows if row.ours != row.published]
    note = "All printed values follow the formula." if not unlike else f"Not the formula's: {'; '.join(unlike)}."
    return Table("4.1", "Atlas bytes a probe", keys, ["bytes"], rows, [note])


def _resolutions(light: int, depth: int, light_format: str, depth_format: str) -> dict[str, Any]:
    return {
        "irradiance_resolution": light,
        "depth_resolution": depth,
        "irradiance_format": light_format,
        "depth_format": depth_format,
        "depth_model": "moments",
    }


# ---------- Errors ----------


def table_dead_probes(attic: Attic) -> Table:
    """Return table 4.2: dead probes left alone, moved, and looked up with corrected weights."""
    runs: list[tuple[str, str, str, str | None, dict[str, Any]]] = [
        ("only direct light", "-", "none", None, {}),
        *((name, THEIR_RULE, "ddgi", "rohacek", params) for name, params in DEAD_VARIANTS.items()),
        ("preset majercik", THEIR_RULE, "ddgi", "majercik", {}),
        *((name, OUR_RULE, "ddgi", "rohacek", params) for name, params in DEAD_VARIANTS.items()),
    ]
    rows = []
    for name, rule, method, preset, params in attic.budget.thin(runs):
        settings = {**GRID, "bounces": attic.bounces, "backface_rule": rule, **params} if method == "ddgi" else params
        run = attic.view("roof").measure(method, preset, settings, ERRORS)
        ours = [full_hd_sum(run.abs_mean), run.abs_mean, run.abs_max, run.regional]
        theirs = published.DEAD_PROBES.get(name, ()) if rule != OUR_RULE else ()
        rows.append(TableRow([name, rule], ours, [*(theirs or (None, None, None)), None]))
    notes = [
        "Simple DDGI is preset rohacek without detection: its rays stop at backs by the same rule, so that only the "
        "dead probes' treatment differs between it and the rows below.",
        "Preset majercik, the method of 2019 on the same grid, and the rows of luxel's rule are ours alone.",
        "StudyView 'roof'. " + attic.view("roof").noise_note(),
    ]
    figures, keys = ["absolute error", "mean", "max", "regional"], ["variant", "backface_rule"]
    return Table("4.2", "Error against the truth by the treatment of dead probes", keys, figures, rows, notes)


def table_depth_error(attic: Attic) -> Table:
    """Return table 4.3: depth resolution and the rejection of far samples."""
    sweep = [*published.DEPTH_ERROR, (8, True), (32, True), (64, True)]
    runs = [(texels, rejects, THEIR_RULE) for texels, rejects in sweep]
    runs += [(16, rejects, OUR_RULE) for rejects in (False, True)]
    rows = []
    for texels, rejects, rule in attic.budget.thin(runs):
        run = attic.run("bleed", {**_depth(texels, rejects), "backface_rule": rule}, ERRORS)
        theirs = published.DEPTH_ERROR.get((texels, rejects)) if rule == THEIR_RULE else None
        ours = [run.abs_mean, run.abs_max, run.regional]
        rows.append(TableRow([str(texels), _yes(rejects), rule], ours, [*(theirs or (None, None)), None]))
    notes = [
        "Rejection: far_depth reject against keep; the rows below the thesis's are ours alone.",
        "StudyView 'bleed'. " + attic.view("bleed").noise_note(),
    ]
    keys = ["depth texels", "rejection", "backface_rule"]
    return Table("4.3", "Error by depth resolution and rejection", keys, ["mean", "max", "regional"], rows, notes)


def table_depth_detail(attic: Attic) -> Table:
    """Return table 4.4: the same over precision, error and frame-to-frame change side by side."""
    rows = []
    for texels, bits, rejects in attic.budget.thin(list(published.DEPTH_DETAIL)):
        precision = "float16" if bits == 8 else "float32"
        run = attic.run("bleed", {**_depth(texels, rejects), "depth_format": precision}, ERRORS, CHANGES)
        ours = [run.abs_mean, run.abs_max, run.abs_min, run.change_mean]
        theirs = [*published.DEPTH_DETAIL[texels, bits, rejects], None]
        rows.append(TableRow([str(texels), f"{precision} (theirs: {bits} bit)", _yes(rejects)], ours, theirs))
    notes = [
        "The caption calls it error, the text says that it was assembled from changes between frames; the published "
        "values are of the size of the errors of table 4.3 and some twenty times those of figure 4.8, so they stand "
        "beside our errors, and our change is given apart.",
        "The printed maximum 10.19333 exceeds the metric's largest value, 3: it can only be a misprint.",
        "StudyView 'bleed'. Their 8 and 16 bit components are our float16 and float32.",
    ]
    keys, figures = ["depth texels", "precision", "rejection"], ["mean", "max", "min", "change"]
    return Table("4.4", "Error and change by depth resolution, precision and rejection", keys, figures, rows, notes)


def table_map_resolution(attic: Attic) -> Table:
    """Return table 4.5: resolutions of both maps, with the memory of all probes."""
    from luxel.methods.ddgi.memory import atlas_bytes
    from luxel.methods.params import make_params

    probes = GRID["num_probes_x"] * GRID["num_probes_y"] * GRID["num_probes_z"]
    rows = []
    for depth, light in attic.budget.thin(list(published.MAP_RESOLUTION)):
        maps = {"depth_resolution": depth, "irradiance_resolution": light}
        run = attic.run("room", maps, ERRORS)
        memory = probes * atlas_bytes(make_params("ddgi", "rohacek", maps)) / 1024.0
        ours = [run.abs_mean, run.abs_max, round(memory, 1), run.regional]
        rows.append(TableRow([str(depth), str(light)], ours, [*published.MAP_RESOLUTION[depth, light], None]))
    notes = [
        "Memory is formula 4.1 times 1,650 probes in KiB, running means and rays not counted.",
        "The row 16, 8 is printed twice, the second time with a mean of 0.22225.",
        "StudyView 'room'. " + attic.view("room").noise_note(),
    ]
    keys, figures = ["depth texels", "irradiance texels"], ["mean", "max", "memory KiB", "regional"]
    return Table("4.5", "Error and memory by the maps' resolutions", keys, figures, rows, notes)


def _depth(texels: int, rejects: bool) -> dict[str, Any]:
    return {"depth_resolution": texels, "far_depth": "reject" if rejects else "keep"}


def full_hd_sum(mean: float | None) -> int | None:
    """Return the sum over an image of the sources' size whose mean over pixels is `mean`."""
    return None if mean is None else round(mean * published.FULL_HD)


def _yes(value: bool) -> str:
    return "yes" if value else "no"


# ---------- Times ----------


def table_times_over_rays(attic: Attic) -> Table:
    """Return table 4.6: milliseconds a stage over rays a probe."""
    rows = []
    for rays in attic.budget.thin(list(published.TIMES_OVER_RAYS)):
        run = attic.run("room", {"num_samples_per_probe": rays}, STAGES)
        rows.append(TableRow([str(rays)], split_stages(run.stages), _add_offset(published.TIMES_OVER_RAYS[rays])))
    notes = [STAGE_NOTE, "The published stages at 256 rays sum to 11.03, not to the 11.01 printed."]
    return Table("4.6", "Milliseconds a stage by rays a probe", ["rays a probe"], list(COLUMNS), rows, notes)


def table_times_over_depth(attic: Attic) -> Table:
    """Return table 4.7: milliseconds a stage over depth resolution."""
    rows = []
    for texels in attic.budget.thin(list(published.TIMES_OVER_DEPTH)):
        run = attic.run("room", {"depth_resolution": texels, "irradiance_resolution": 8}, STAGES)
        rows.append(TableRow([str(texels)], split_stages(run.stages), _add_offset(published.TIMES_OVER_DEPTH[texels])))
    notes = [STAGE_NOTE, "The published stages at 2 texels sum to 3.13, not to the 3.14 printed."]
    return Table("4.7", "Milliseconds a stage by depth resolution", ["depth texels"], list(COLUMNS), rows, notes)


def split_stages(stages: dict[str, float]) -> list[float | int | None]:
    """Return the thesis's stages and their sum, milliseconds, of `Renderer.staged()`."""
    parts = [sum(stages.get(name, 0.0) for name in names) for names in STAGES_OF_OURS.values()]
    return [*parts, sum(parts)]


def _add_offset(times: tuple[float, ...]) -> list[float | int | None]:
    tracing, integration, detection, offset, shading, total = times
    return [tracing, integration, round(detection + offset, 2), shading, total]


# ---------- Stability ----------


def figure_stability(attic: Attic) -> Table:
    """Return figure 4.8: change between still frames over rays a probe, without and with offsets."""
    rows = []
    for rays, offsets in attic.budget.thin(list(published.STABILITY)):
        params = {"num_samples_per_probe": rays} | ({} if offsets else NO_OFFSETS)
        run = attic.run("room", params, CHANGES)
        ours = [full_hd_sum(run.change_mean), run.change_mean, run.change_max]
        rows.append(TableRow([str(rays), _yes(offsets)], ours, [*published.STABILITY[rays, offsets]]))
    notes = [
        "Direct light is held fixed over the still frames; the maximum is the largest pixel's mean over them.",
        "StudyView 'room', after the frames of the settings.",
    ]
    figures = ["absolute change", "mean", "max"]
    return Table(
        "figure 4.8", "Change between frames by rays a probe", ["rays a probe", "offsets"], figures, rows, notes
    )


TABLES: dict[str, Callable[[Attic], Table]] = {
    "4.1": lambda attic: table_memory(),
    "4.2": table_dead_probes,
    "4.3": table_depth_error,
    "4.4": table_depth_detail,
    "4.5": table_map_resolution,
    "4.6": table_times_over_rays,
    "4.7": table_times_over_depth,
    "4.8": figure_stability,
}
"""What `--tables` chooses from."""
