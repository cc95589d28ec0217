"""The lines that `peer_cycles.py` recorded, as Markdown."""

from __future__ import annotations

from typing import Any

HEAD = "| {scene}: {title} | time | error | of patches | bias |\n| --- | --- | --- | --- | --- |"


def write_tables(lines: list[dict[str, Any]]) -> str:
    """Return two tables a line: the first bake, and the second image."""
    parts = []
    for line in lines:
        parts.append(
            f"`{line['scene']}`, {line['texels']:,} texels, {line['compared']:,} compared "
            f"({line['compared_share']:.0%} of those in the open); Blender {line['blender']}, {line['cpu']}, "
            f"{line['cores']} cores."
        )
        for part, title in (("first", "first bake"), ("second", "light moved")):
            rows = [_row(row) for row in line[part]]
            parts.append("\n".join([HEAD.format(scene=line["scene"], title=title), *rows]))
    return "\n\n".join(parts)


def _row(row: dict[str, Any]) -> str:
    return f"| {_name(row)} | {_seconds(row['s'])} | {row['rmse']:.1%} | {row['patch_rmse']:.1%} | {row['bias']:+.1%} |"


def _name(row: dict[str, Any]) -> str:
    words = [f"{row['by']}, {'all light' if row['what'] == 'total' else 'indirect light'}"]
    if row["by"] == "cycles":
        words.append(f"{row['samples']} sample{'s' * (row['samples'] > 1)}")
    if row.get("how"):
        words.append(row["how"])
    words += [text for key, text in (("denoised", "denoised"), ("equal_time", "at luxel's time")) if row.get(key)]
    if "wanted" in row:
        words.append(f"for luxel's {row['wanted']:.1%}")
    return ", ".join(words)


def _seconds(value: float) -> str:
    return f"{1e3 * value:.3g} ms" if value < 1.0 else f"{value:.3g} s"
