"""What stands in the report's tables and bars: texts and sort keys, one scene at a time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from luxel.report.conclusions import Ranking, fastest, rank
from luxel.report.figures import FIGURES, MAIN, MISSING, MOTION, round_figure, write_figure, write_spread, write_time
from luxel.report.results import ResultEntry, SceneResults, as_number

SHARED_STAGES = ("gbuffer", "direct", "compose")
"""Stages of the frame that every method shares; all others are the method's own."""
SHADES = 4
"""Tints that a method's own stages alternate between."""
LETTERS_A_PERCENT = 1.2
"""Letters that fit into a hundredth of a bar on a wide screen."""
RUN_WORDS = "Time of the whole run, compilation apart: what the path tracer was given where it stands beside a method."
SHARE_WORDS = (
    "A peer’s time for a frame over that of the method whose time it was given: whole paths are all that fits."
)
RATIO_WORDS = "Frame over floor, in the same run: the figure that travels between machines."


# ---------- Figures ----------


def make_table(scene: SceneResults, main: bool) -> dict[str, Any]:
    """Return the columns and rows of a scene: of the main figures, or of all the others.

    Columns in which no entry has a figure are left out. A cell holds its text, its spread, what it sorts by and
    whether it is the best of the methods (`best`) or ties with it (`tie`).
    """
    names = [name for name in FIGURES if name not in MOTION and (name in MAIN) == main and _is_known(scene, name)]
    best = {name: rank(scene, name, scene.pick("method")) for name in names if FIGURES[name].better == "down"}
    if "frame_ms" in best:
        best["frame_ms"] = fastest(scene)
    columns = [_make_column(name) for name in names]
    rows = [
        _make_row(entry) | {"cells": [_make_cell(entry, name, best.get(name)) for name in names]}
        for entry in scene.entries
    ]
    if main and {"frame_ms", "floor_ms"} <= set(names):
        columns.append({"title": "Frame / floor", "unit": "×", "arrow": "↓", "words": RATIO_WORDS})
        for row, entry in zip(rows, scene.entries, strict=True):
            row["cells"].append(_make_ratio(entry))
    if main:
        columns.append({"title": "Run", "unit": "", "arrow": "", "words": RUN_WORDS})
        for row, entry in zip(rows, scene.entries, strict=True):
            time = run_ms(entry)
            row["cells"].append({"text": write_time(time), "spread": "", "key": time, "best": False, "tie": False})
    return {"columns": columns, "rows": rows}


def make_motion_table(scene: SceneResults) -> dict[str, Any]:
    """Return the columns and rows of a flight, as `make_table` those at rest; its peers have their share of time."""
    names = [name for name in MOTION if _is_known(scene, name)]
    best = {name: rank(scene, name, scene.pick("method")) for name in names}
    best["motion_ms"] = None  # who computes nothing of use is quick
    columns = [_make_column(name) for name in names]
    rows = [
        _make_row(entry) | {"cells": [_make_cell(entry, name, best.get(name)) for name in names]}
        for entry in (*scene.pick("method"), *scene.pick("baseline"), *scene.motion_peers)
    ]
    if scene.motion_peers:
        columns.append({"title": "Time ratio", "unit": "×", "arrow": "", "words": SHARE_WORDS})
        for row, entry in zip(rows, (*scene.pick("method"), *scene.pick("baseline"), *scene.motion_peers), strict=True):
            share = as_number(entry.data.get("time_ratio"))
            text = round_figure(share, 2) if share is not None else ""
            row["cells"].append({"text": text, "spread": "", "key": share, "best": False, "tie": False})
    return {"columns": columns, "rows": rows}


def run_ms(entry: ResultEntry) -> float | None:
    """Return how long the whole run of an entry took, in ms, or None where nothing says."""
    if entry.kind == "peer":
        return as_number(entry.data.get("ms"))
    times = (entry.data.get("series") or {}).get("ms") or []
    return as_number(times[-1]) if times else None


def describe_entry(entry: ResultEntry) -> str:
    """Return what stands in small print under an entry's name."""
    if entry.kind == "baseline":
        return "baseline"
    if entry.kind == "peer":
        samples, history = (as_number(entry.data.get(name)) for name in ("samples", "history"))
        flown = entry.data.get("run") == "motion"
        texts = [
            f"{round_figure(samples)} {'path' if samples == 1 else 'paths'} a pixel{' and frame' if flown else ''}"
            if samples is not None
            else "",
            f"history of {round_figure(history)}" if history is not None else "",
        ]
        return ", ".join(text for text in texts if text)
    preset = entry.data.get("preset")
    return f"preset {preset}" if preset and not entry.label.endswith(f":{preset}") else ""


def _make_column(name: str) -> dict[str, str]:
    figure = FIGURES[name]
    return {"title": figure.title, "unit": figure.unit, "arrow": figure.arrow, "words": figure.words}


def _make_row(entry: ResultEntry) -> dict[str, Any]:
    return name_entry(entry) | {"note": describe_entry(entry)}


def name_entry(entry: ResultEntry) -> dict[str, Any]:
    """Return what the page needs to write an entry's name with its colour."""
    return {"label": entry.label, "kind": entry.kind, "colour": entry.colour, "variant": entry.variant}


def _make_cell(entry: ResultEntry, name: str, ranking: Ranking | None) -> dict[str, Any]:
    value = entry.get(name)
    is_best = ranking is not None and entry in ranking.best
    return {
        "text": write_figure(name, value),
        "spread": write_spread(name, entry.spread(name)) if value is not None else "",
        "key": FIGURES[name].sort_key(value),
        "best": is_best,
        "tie": ranking is not None and ranking.is_tie and is_best,
    }


def _make_ratio(entry: ResultEntry) -> dict[str, Any]:
    frame, floor = entry.get("frame_ms"), entry.get("floor_ms")
    ratio = frame / floor if frame is not None and floor else None
    return {"text": round_figure(ratio, 2), "spread": "", "key": ratio, "best": False, "tie": False}


def _is_known(scene: SceneResults, name: str) -> bool:
    return any(entry.get(name) is not None for entry in scene.entries)


# ---------- Stages ----------


def make_bars(scene: SceneResults) -> list[dict[str, Any]]:
    """Return a bar a method: its stages, floor and frame, all as shares of the longest one, in percent."""
    entries = [entry for entry in scene.entries if entry.data.get("stages")]
    sums = [sum(_stages(entry).values()) for entry in entries]
    ends = [max(total, entry.get("frame_ms") or 0.0) for total, entry in zip(sums, entries, strict=True)]
    longest = max(ends, default=0.0)
    return [_make_bar(entry, total, longest) for entry, total in zip(entries, sums, strict=True)] if longest else []


def _make_bar(entry: ResultEntry, total: float, longest: float) -> dict[str, Any]:
    parts, own = [], 0
    for name, ms in _stages(entry).items():
        is_shared = name in SHARED_STAGES
        shade = 0 if is_shared else own % SHADES
        own += not is_shared
        share = 100.0 * ms / longest
        if share > 0.0:
            short, text = name.rpartition("/")[2], round_figure(ms)
            room = share * LETTERS_A_PERCENT - 2.0
            parts.append({"name": name, "short": short if len(short) <= room else "", "ms": text,
                          "wide": len(short) + 1 + len(text) <= room, "share": round(share, 3),
                          "shared": is_shared, "shade": shade})  # fmt: skip
    frame, floor = entry.get("frame_ms"), entry.get("floor_ms")
    ratio = f", {round_figure(frame / floor, 2)} × floor" if frame and floor else ""
    return name_entry(entry) | {
        "parts": parts,
        "total": round_figure(total),
        "frame": None if frame is None else {"ms": round_figure(frame), "share": round(100.0 * frame / longest, 3)},
        "floor": None if floor is None else {"ms": round_figure(floor), "share": round(100.0 * floor / longest, 3)},
        "ratio": ratio,
    }


def _stages(entry: ResultEntry) -> dict[str, float]:
    """Return the stages that took time, the shared ones first: they line up between the methods."""
    known = {name: ms for name, value in entry.data["stages"].items() if (ms := as_number(value))}
    order = [name for name in SHARED_STAGES if name in known]
    return {name: known[name] for name in [*order, *(name for name in known if name not in SHARED_STAGES)]}


# ---------- Rays, caches, parameters ----------


def make_counts(scene: SceneResults, key: str) -> dict[str, Any] | None:
    """Return a table of `rays_per_frame`, `cache` or `params`: a row a name, a column a method; None where empty.

    Names that only one method has follow those that several share.
    """
    entries = [entry for entry in scene.entries if isinstance(entry.data.get(key), dict) and entry.data[key]]
    names = list(dict.fromkeys(name for entry in entries for name in entry.data[key]))
    if not names:
        return None
    columns = [name_entry(entry) for entry in entries]
    rows = [{"name": name, "cells": [_write_value(entry.data[key].get(name)) for entry in entries]} for name in names]
    return {"columns": columns, "rows": rows}


def make_parameters(scene: SceneResults) -> list[dict[str, Any]]:
    """Return the parameters of each method that has any: label, colour and (name, value) pairs."""
    found = []
    for entry in scene.entries:
        params = entry.data.get("params")
        if isinstance(params, dict) and params:
            pairs = [(name, _write_value(value)) for name, value in params.items()]
            found.append(name_entry(entry) | {"pairs": pairs})
    return found


def _write_value(value: Any) -> str:
    if value is None:
        return MISSING
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list | tuple):
        return ", ".join(_write_value(one) for one in value)
    number = as_number(value)
    if number is None:
        return str(value)
    return f"{value:,}" if isinstance(value, int) else round_figure(number, 4)


def list_facts(pairs: Sequence[tuple[str, Any]]) -> list[tuple[str, str]]:
    """Return the (label, value) pairs that say something, as texts."""
    return [(label, str(value)) for label, value in pairs if value not in (None, "", [], {})]
