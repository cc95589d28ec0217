"""Measurements of the sources done again with luxel: their tables and figures, ours beside theirs."""

from __future__ import annotations

from luxel.bench.reproduce.tables import StudyReport, Table, TableRow

__all__ = ["StudyReport", "TableRow", "Table"]
