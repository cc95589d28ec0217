"""Methods beside the truth: figures, images, files."""

from __future__ import annotations

from luxel.report.compare import compare

__all__ = ["compare"]
