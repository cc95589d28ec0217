"""Files that a stopped bake goes on from: whole or not there, and damaged ones are as good as none."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from luxel.files import write_npz


def read_checkpoint(file: Path | None, *names: str) -> list[np.ndarray] | None:
    """Return the arrays `names` of a file that an earlier bake left; None where there is none, or a damaged one."""
    if file is None or not file.exists():
        return None
    try:
        with np.load(file) as held:
            return [held[name] for name in names]
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
        return None


def write_checkpoint(file: Path | None, **arrays: np.ndarray) -> None:
    """Write arrays to a file (.npz); None: nowhere. Raises LuxelError where that cannot be."""
    if file is not None:
        write_npz(file, arrays)
