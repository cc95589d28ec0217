"""A table with our figures beside the published ones, and a report of several with the machine named at its head."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from luxel.files import require_writable, to_json, write_text

MEASURED_MATERIALS = "diffuse"
"""What counts of the materials in every reproduction."""


@dataclass
class TableRow:
    """One line of a table."""

    labels: list[str]
    """What was set, one text for each of the table's keys."""
    ours: Sequence[float | int | None]
    """Our figures, one for each of the table's figures; None where there is none."""
    published: Sequence[float | int | None]
    """The source's, likewise."""


@dataclass
class Table:
    """Figures of ours beside published ones."""

    name: str
    """As the source numbers it, such as `4.2`; a word where the source has no such table."""
    title: str
    keys: list[str]
    figures: list[str]
    rows: list[TableRow] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    """What differs, and what is to be known about the figures: one sentence each."""

    @property
    def columns(self) -> list[str]:
        """Names of the columns: the keys, then each figure as ours and, where the source has any, as published."""
        return [*self.keys, *(f"{name} ({side})" for name, side, _ in self._pairs())]

    def cells(self, row: TableRow) -> list[Any]:
        """Return the values of `row` in the order of `columns`."""
        sides = {"ours": row.ours, "published": row.published}
        return [*row.labels, *(sides[side][index] for _, side, index in self._pairs())]

    def record(self) -> dict[str, Any]:
        """Return the table as plain data for JSON."""
        return {
            "name": self.name,
            "title": self.title,
            "columns": self.columns,
            "rows": [self.cells(row) for row in self.rows],
            "notes": self.notes,
        }

    def _pairs(self) -> list[tuple[str, str, int]]:
        pairs = []
        for index, name in enumerate(self.figures):
            pairs.append((name, "ours", index))
            if any(row.published[index] is not None for row in self.rows):
                pairs.append((name, "published", index))
        return pairs


@dataclass
class StudyReport:
    """All tables of one reproduction, and what they were made of."""

    title: str
    source: str
    """Whose figures stand under `published`."""
    scene: str
    settings: dict[str, Any]
    """Size, frames, samples of the truth and whatever else decides the figures."""
    differences: list[str]
    """How our conditions differ from the source's, one sentence each."""
    machine: dict[str, Any]
    """`luxel.bench.machine_record()`."""
    device: str
    tables: list[Table] = field(default_factory=list)
    date: str = field(default_factory=lambda: datetime.datetime.now(datetime.UTC).date().isoformat())

    def header(self) -> list[tuple[str, str]]:
        """Return label and text of each line above the tables."""
        gpu, cpu = self.machine.get("gpu"), self.machine.get("cpu")
        chip = gpu if self.device == "cuda" and gpu else f"{cpu}, {self.machine.get('cores')} cores"
        versions = self.machine.get("versions") or {}
        settings = ", ".join(f"{name} {value}" for name, value in self.settings.items())
        return [
            ("published", self.source),
            ("ours", f"luxel {versions.get('luxel')}, commit {self.machine.get('commit')}, {self.date}"),
            ("machine", f"{self.device}: {chip}"),
            ("scene", self.scene),
            ("settings", settings),
            ("materials", MEASURED_MATERIALS),
        ]

    def record(self) -> dict[str, Any]:
        """Return the report as plain data for JSON."""
        return {
            "title": self.title,
            "source": self.source,
            "scene": self.scene,
            "settings": self.settings,
            "materials": MEASURED_MATERIALS,
            "differences": self.differences,
            "device": self.device,
            "date": self.date,
            "machine": self.machine,
            "tables": [table.record() for table in self.tables],
        }

    def markdown(self) -> str:
        """Return the report as a Markdown page."""
        lines = [f"# {self.title}", ""]
        lines += [f"- **{label}**: {text}" for label, text in self.header()]
        lines += ["", "What differs from the source:", "", *(f"- {text}" for text in self.differences), ""]
        for table in self.tables:
            lines += [f"## {table.name}: {table.title}", ""]
            lines.append("| " + " | ".join(table.columns) + " |")
            rule = ["---"] * len(table.keys) + ["---:"] * (len(table.columns) - len(table.keys))
            lines.append("| " + " | ".join(rule) + " |")
            lines += ["| " + " | ".join(map(format_cell, table.cells(row))) + " |" for row in table.rows]
            lines += ["", *(f"- {note}" for note in table.notes), ""]
        return "\n".join(lines)

    def paths(self, folder: Path) -> list[Path]:
        """Return where `write` writes: the file for machines, then the page."""
        return [folder / "results.json", folder / "tables.md"]

    def write(self, folder: Path) -> list[Path]:
        """Write `results.json` and `tables.md` into `folder`; return their paths.

        Raises LuxelError where they cannot be written.
        """
        data, page = self.paths(folder)
        write_text(data, to_json(self.record(), indent=2) + "\n")
        write_text(page, self.markdown())
        return [data, page]


def require_folder(folder: Path) -> None:
    """Raise LuxelError unless results can be written into `folder`: asked before the work."""
    require_writable(folder / "results.json")


def format_cell(value: Any) -> str:
    """Return a cell for people: four digits, thousands by commas, `-` where there is none."""
    if isinstance(value, str):
        return value
    if value is None or value != value:
        return "-"
    if isinstance(value, int) or abs(value) >= 1000.0:
        return f"{value:,.0f}"
    return f"{value:.4g}"
