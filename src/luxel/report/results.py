"""results.json as the report reads it: checked once, so that drawing need not doubt it."""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from luxel.errors import LuxelError

BASELINES = ("none", "ambient")
"""The baselines that every comparison runs; others say of themselves that they are one."""
MOTION_END = "_motion"
"""How the stem of a strip of pictures of a flight ends."""
TABLES = ("seeds", "spread", "stages", "series", "rays_per_frame", "cache", "params", "motion")
"""Parts of an entry that hold names and values, where they are there."""


@dataclass(frozen=True)
class ResultEntry:
    """What stands in a row of a table: a method, a baseline, or the path tracer at equal time."""

    label: str
    """Unique in its scene; for people."""
    kind: str
    """`method`, `baseline` or `peer`."""
    colour: str
    """The method's name without its preset, fit for a style sheet: it names the colour on every page."""
    file: str
    """Stem of its pictures."""
    data: dict[str, Any] = field(repr=False)
    variant: int = 0
    """0 for a method as it is; 1, 2 … for its presets and settings, which share its colour."""

    def get(self, name: str) -> float | None:
        """Return a figure, or None where it is missing, null or not finite."""
        return as_number(self.data.get(name))

    def spread(self, name: str) -> float | None:
        """Return the standard deviation of a figure over the seeds; None with one seed."""
        return as_number((self.data.get("spread") or {}).get(name))

    @property
    def seed_count(self) -> int:
        return max(len(self.data.get("seeds") or {}), 1)


@dataclass(frozen=True)
class SceneResults:
    """One scene of a comparison."""

    name: str
    folder: str
    reference: dict[str, Any]
    entries: tuple[ResultEntry, ...]
    """Methods first, baselines after them, then peers."""
    path_series: dict[str, list[Any]] | None
    warnings: tuple[str, ...]
    """What loading the scene complained of."""
    motion_peers: tuple[ResultEntry, ...] = ()
    """The path tracer in motion, in each method's time: it has no part in what is judged at rest."""

    @property
    def motion(self) -> dict[str, Any]:
        """The record of the flight; empty where none was flown."""
        return self.reference.get("motion") or {}

    def pick(self, kind: str) -> list[ResultEntry]:
        return [entry for entry in self.entries if entry.kind == kind]

    def find(self, label: str) -> ResultEntry | None:
        return next((entry for entry in self.entries if entry.label == label), None)

    @property
    def noise(self) -> float:
        """The truth's own noise, in units of the main error; 0 where nothing says."""
        return next((noise for entry in self.entries if (noise := entry.get("truth_noise")) is not None), 0.0)


@dataclass(frozen=True)
class Results:
    """A comparison."""

    scenes: tuple[SceneResults, ...]
    about: dict[str, Any]
    """What stands beside the scenes: luxel, date, command, denoiser; any may be missing."""
    machines: tuple[dict[str, Any], ...]
    """Every machine that took part; at least one, empty where nothing is known of it."""


def read_results(folder: str | Path) -> Results:
    """Return the results of a comparison in `folder`.

    Raises LuxelError where there is no results.json, or where it is none of ours.
    """
    path = Path(folder) / "results.json"
    try:
        given = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise LuxelError(f"there is no {path}: name the folder that `luxel compare … -o DIR` wrote") from error
    except OSError as error:
        raise LuxelError(f"cannot read {path}: {error.strerror or error}") from error
    except ValueError as error:
        raise LuxelError(f"{path} is damaged, it is no JSON ({error}): run `luxel compare` again") from error
    try:
        scenes = tuple(_read_scene(name, scene) for name, scene in given["scenes"].items())
        _require_tables(given, ("machine", "denoiser"))
        machines = given.get("machines") or [given.get("machine") or {}]
        for machine in machines:
            _require_tables({"machine": machine}, ("machine",))
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise LuxelError(f"{path} does not hold the results of a comparison: run `luxel compare` again") from error
    if not scenes:
        raise LuxelError(f"{path} holds no scene: run `luxel compare` again")
    return Results(scenes, {name: value for name, value in given.items() if name != "scenes"}, tuple(machines))


def as_number(value: Any) -> float | None:
    """Return a finite number, or None for anything else."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return float(value) if is_number and math.isfinite(value) else None


def name_colour(method: str) -> str:
    """Return the name that a method's colour has in the style sheet, such as `gibs` for `gibs:ekberg`."""
    return re.sub(r"[^A-Za-z0-9_-]", "-", method.partition(":")[0]) or "other"


def _read_scene(name: str, scene: dict[str, Any]) -> SceneResults:
    methods = _number_variants([_read_method(label, data) for label, data in scene["methods"].items()])
    entries = [entry for kind in ("method", "baseline") for entry in methods if entry.kind == kind]
    peers = [(_read_peer(data), data.get("run")) for data in scene.get("peers") or []]
    entries += [peer for peer, run in peers if run != "motion"]
    _require_tables(scene, ("reference", "path_series"))
    _require_tables(scene["reference"], ("motion",))
    if not methods:
        raise ValueError(name)
    return SceneResults(
        name,
        str(scene.get("folder") or name),
        scene["reference"],
        tuple(entries),
        scene.get("path_series") or None,
        tuple(map(str, scene.get("warnings") or [])),
        tuple(peer for peer, run in peers if run == "motion"),
    )


def _read_method(label: str, data: dict[str, Any]) -> ResultEntry:
    _require_tables(data, TABLES)
    method = name_colour(str(data.get("method") or label))
    kind = "baseline" if data.get("baseline", label in BASELINES) else "method"
    return ResultEntry(label, kind, method, str(data.get("file") or label.replace(":", "-")), data)


def _number_variants(entries: list[ResultEntry]) -> list[ResultEntry]:
    """Return the entries with those numbered that are not called what their method is."""
    counts: Counter[str] = Counter()
    numbered = []
    for entry in entries:
        is_variant = entry.label != str(entry.data.get("method") or entry.label.partition(":")[0])
        counts[entry.colour] += is_variant
        numbered.append(replace(entry, variant=counts[entry.colour]) if is_variant else entry)
    return numbered


def _read_peer(data: dict[str, Any]) -> ResultEntry:
    _require_tables(data, TABLES)
    denoiser = data.get("denoised")
    tracer = str(data.get("label") or "path")
    label = f"{tracer} + {denoiser} in {data['of']}’s time" if denoiser else f"{tracer} in {data['of']}’s time"
    return ResultEntry(label, "peer", name_colour(tracer), str(data["file"]), data)


def _require_tables(data: dict[str, Any], names: tuple[str, ...]) -> None:
    """Raise TypeError where one of the parts that should be a JSON object is something else."""
    for name in names:
        if not isinstance(data.get(name) or {}, dict):
            raise TypeError(name)
