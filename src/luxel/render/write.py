"""Files that appear whole or not at all: written beside the target, then renamed."""

from __future__ import annotations

import errno
import io
import json
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from luxel.errors import LuxelError


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Yield a fresh file beside `path` to write to; on success it takes the place of `path`, else it vanishes.

    Missing parent folders are made. An OSError inside becomes a LuxelError, and what stood at `path` stays whole.
    """
    path = Path(path)
    beside: Path | None = None
    try:
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, "it is a folder")
        path.parent.mkdir(parents=True, exist_ok=True)
        # The suffix stays, because writers choose the format by it.
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent)
        os.close(handle)
        beside = Path(name)
        yield beside
        _inherit_mode(beside, path)
        os.replace(beside, path)
    except OSError as error:
        raise LuxelError(f"cannot write {path}: {_reason(error)}") from error
    finally:
        if beside is not None:
            beside.unlink(missing_ok=True)


def write_bytes(path: str | Path, data: bytes) -> None:
    """Write `data` to `path`, whole or not at all; LuxelError where it cannot be written."""
    with replacing(path) as beside, beside.open("wb") as stream:
        stream.write(data)
        stream.flush()
        # A full disk may show only here; after the rename it would be too late.
        os.fsync(stream.fileno())


def write_text(path: str | Path, text: str) -> None:
    """Write UTF-8 text to `path`, whole or not at all; LuxelError where it cannot be written."""
    write_bytes(path, text.encode())


def write_png(path: str | Path, display: np.ndarray) -> None:
    """Write a displayed image, (H, W, 3) float in 0..1, as 8-bit PNG; LuxelError where it cannot be written."""
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(to_bytes(display)).save(stream, format="PNG")
    write_bytes(path, stream.getvalue())


def write_exr(path: str | Path, linear: np.ndarray) -> None:
    """Write a linear image, (H, W, 3), as 32-bit float EXR; LuxelError where it cannot be written."""
    # Bitmap works before a device is started, but Dr.Jit loads LLVM with this import: see `luxel.runtime`.
    from luxel.runtime import use_llvm

    use_llvm()
    import mitsuba as mi

    stream = mi.MemoryStream()
    mi.Bitmap(np.ascontiguousarray(linear, np.float32)).write(stream, mi.Bitmap.FileFormat.OpenEXR)
    write_bytes(path, stream.raw_buffer())


def to_bytes(display: np.ndarray) -> np.ndarray:
    """Return a displayed image, floats in 0..1, as uint8."""
    return np.rint(np.clip(display, 0.0, 1.0) * 255.0).astype(np.uint8)


def require_writable(path: str | Path) -> None:
    """Raise LuxelError unless a file can be made at `path`: asked before hours of work, not after them."""
    path = Path(path)
    try:
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, "it is a folder")
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise LuxelError(f"cannot write {path}: {_reason(error)}") from error


def _inherit_mode(beside: Path, path: Path) -> None:
    """Give the new file the permissions of the old one, or those that a plain `open` would have given."""
    if path.exists():
        beside.chmod(path.stat().st_mode & 0o7777)
        return
    mask = os.umask(0)
    os.umask(mask)
    beside.chmod(0o666 & ~mask)


def _reason(error: OSError) -> str:
    known = {
        errno.EACCES: "no permission; choose another place with -o",
        errno.EPERM: "no permission; choose another place with -o",
        errno.EROFS: "the file system is read-only; choose another place with -o",
        errno.ENOSPC: "the disk is full; free some space or choose another place with -o",
        errno.EDQUOT: "the disk quota is used up; free some space or choose another place with -o",
        errno.EISDIR: "it is a folder; name a file",
        errno.ENOTDIR: "a part of its path is a file, not a folder",
        errno.EEXIST: "a part of its path is a file, not a folder",
        errno.ENAMETOOLONG: "the name is too long",
    }
    return known.get(error.errno or 0, error.strerror or str(error))


def to_json(value: Any, indent: int | None = None) -> str:
    """Return `value` as strict JSON: NumPy numbers and arrays, paths and tuples are taken, NaN and Inf become null."""
    return json.dumps(_plain(value), indent=indent, allow_nan=False)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, Path):
        return str(value)
    return None if isinstance(value, float) and not np.isfinite(value) else value
