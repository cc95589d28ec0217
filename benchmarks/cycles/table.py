"""The lines that were recorded, as the tables of docs/bake.md."""

from __future__ import annotations

from typing import Any

SHOWN = (1, 16, 256)
"""Samples of Cycles that the tables show of those measured."""
HIDDEN = ("2 frames", "32 frames")
"""Rows of luxel that they leave out."""


def write_tables(lines: list[dict[str, Any]]) -> str:
    """Return what was run, the first bake and the image after the light has moved, a column a scene: its last line."""
    last = {line["scene"]: line for line in lines}
    about = [
        f"`{name}`: {line['texels']:,} texels, {line['compared']:,} of them compared "
        f"({_percent(line['compared_share'], 0)} of those in the open); the truth's noise is "
        f"{_percent(line['truth_noise'])}. Blender {line['blender']}, {line['cpu']}, {line['cores']} cores."
        for name, line in last.items()
    ]
    tables = [_table(title, last, part) for part, title in (("first", "first bake"), ("second", "the light has moved"))]
    return "\n\n".join(["\n".join(about), *tables])


def _table(title: str, lines: dict[str, dict[str, Any]], part: str) -> str:
    """Return rows by what was done, cells by scene: time, error, error by patches."""
    cells = {scene: {_name(row): _cell(row) for row in line[part] if _is_shown(row)} for scene, line in lines.items()}
    names = list(dict.fromkeys(name for of_scene in cells.values() for name in of_scene))
    head = [f"| {title} | " + " | ".join(f"`{scene}`" for scene in cells) + " |", "| --- " * (1 + len(cells)) + "|"]
    rows = [f"| {name} | " + " | ".join(found.get(name, "—") for found in cells.values()) + " |" for name in names]
    return "\n".join([*head, *rows])


def _is_shown(row: dict[str, Any]) -> bool:
    if row["by"] == "luxel":
        return row.get("how") not in HIDDEN
    return row["samples"] in SHOWN or not _is_plain(row)


def _is_plain(row: dict[str, Any]) -> bool:
    """Return whether a bake by Cycles is one of its ladder."""
    return not (row.get("equal_time") or row.get("denoised") or "wanted" in row)


def _name(row: dict[str, Any]) -> str:
    words = [
        "Cycles" if row["by"] == "cycles" else "luxel",
        "all light" if row["what"] == "total" else "indirect light",
    ]
    if row.get("equal_time"):
        words.append("in luxel's time")
    elif "wanted" in row:
        words.append("until luxel's error")
    elif "samples" in row and (_is_plain(row) or row["samples"] in SHOWN):
        words.append(f"{row['samples']} sample{'s' * (row['samples'] > 1)}")
    elif "samples" in row:
        words.append("in luxel's time")
    if row.get("denoised"):
        words.append("denoised")
    return ", ".join([*words, *([row["how"]] if "how" in row else [])])


def _cell(row: dict[str, Any]) -> str:
    # An error that the truth's noise hides is no figure.
    error, patches = (_percent(row[key]) if row[key] > 0.0 else "below noise" for key in ("rmse", "patch_rmse"))
    odd = "" if row["by"] == "luxel" or row["samples"] in SHOWN else f", {row['samples']:,} samples"
    return f"{_seconds(row['s'])}{odd}: {error} ({patches})"


def _percent(share: float, digits: int = 1) -> str:
    return f"{100.0 * share:.{digits}f} %"


def _seconds(value: float) -> str:
    return f"{1e3 * value:.3g} ms" if value < 1.0 else f"{value:.3g} s"
