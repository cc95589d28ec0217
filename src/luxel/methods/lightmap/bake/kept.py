"""Files that a stopped bake goes on from: whole or not there, and damaged ones are as good as none."""

from __future__ import annotations

import os
import zipfile
from pathlib import Path

import numpy as np

from luxel.errors import LuxelError


def read_kept(file: Path | None, *names: str) -> list[np.ndarray] | None:
    """Return the arrays `names` of a file that an earlier bake left; None where there is none, or a damaged one."""
    if file is None or not file.exists():
        return None
    try:
        with np.load(file) as held:
            return [held[name] for name in names]
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
        return None


def write_kept(file: Path | None, **arrays: np.ndarray) -> None:
    """Write arrays to a file (.npz); None: nowhere. Raises LuxelError where that cannot be."""
    if file is None:
        return
    beside = file.with_name(f".{file.name}.{os.getpid()}.npz")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        np.savez(beside, **arrays)  # type: ignore[arg-type]
        os.replace(beside, file)
    except OSError as error:
        beside.unlink(missing_ok=True)
        raise LuxelError(f"'{file}' cannot be written: {error.strerror or error}") from None
