"""The lines that `peer_cycles.py` recorded, as Markdown."""

from __future__ import annotations

from typing import Any

HEAD = "| {scene}: {title} | time | error | of patches | bias |\n| --- | --- | --- | --- | --- |"


def write_tables(lines: list[dict[str, Any]]) -> str:
    """Return two tables a line: the first bake, and the image after the light has moved."""
    parts = []
    for line in lines:
        parts.append(
            f"`{line['scene']}`, {line['texels']:,} texels, {line['compared']:,} of them compared "
            f"({_percent(line['compared_share'], 0)} of those in the open); Blender {line['blender']}, {line['cpu']}, "
            f"{line['cores']} cores."
        )
        for part, title in (("first", "first bake"), ("second", "light moved")):
            rows = [_row(row) for row in line[part]]
            parts.append("\n".join([HEAD.format(scene=line["scene"], title=title), *rows]))
    return "\n\n".join(parts)


def _row(row: dict[str, Any]) -> str:
    # An error that the truth's noise hides is no figure.
    errors = [_percent(row[key]) if row[key] > 0.0 else "below noise" for key in ("rmse", "patch_rmse")]
    return f"| {_name(row)} | {_seconds(row['s'])} | {errors[0]} | {errors[1]} | {100.0 * row['bias']:+.1f} % |"


def _name(row: dict[str, Any]) -> str:
    by = "Cycles" if row["by"] == "cycles" else "luxel"
    words = [f"{by}, {'all light' if row['what'] == 'total' else 'indirect light'}"]
    if "samples" in row:
        words.append(f"{row['samples']} sample{'s' * (row['samples'] > 1)}")
    if "how" in row:
        words.append(row["how"])
    words += [text for key, text in (("denoised", "denoised"), ("equal_time", "at luxel's time")) if row.get(key)]
    if "wanted" in row:
        words.append(f"for luxel's {_percent(row['wanted'])}")
    return ", ".join(words)


def _percent(share: float, digits: int = 1) -> str:
    return f"{100.0 * share:.{digits}f} %"


def _seconds(value: float) -> str:
    return f"{1e3 * value:.3g} ms" if value < 1.0 else f"{value:.3g} s"
