"""Measurements of the sources done again with luxel: their tables and figures, ours beside theirs."""

from __future__ import annotations

from luxel.bench.reproduce.tables import Report, Table, TableRow

__all__ = ["Report", "TableRow", "Table"]
