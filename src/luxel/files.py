"""Files that appear whole or not at all: written beside the target, then renamed."""

from __future__ import annotations

import errno
import json
import os
import secrets
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from luxel.errors import LuxelError


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Yield a fresh file beside `path` to write to; on success it takes the place of `path`, else it vanishes.

    It vanishes whatever goes wrong, an interrupt included, and what stood at `path` stays whole. A new file has the
    permissions that a plain `open` gives, and one that replaces another has the old one's. Missing parent folders are
    made. A link stays one: the file that it leads to is replaced. An OSError inside becomes a LuxelError.
    """
    path = Path(path)
    beside: Path | None = None
    try:
        path = _follow(path)
        beside = _make_beside(path)
        yield beside
        if path.exists():
            beside.chmod(path.stat().st_mode & 0o7777)
        os.replace(beside, path)
    except OSError as error:
        raise LuxelError(f"cannot write {path}: {_reason(error)}") from error
    finally:
        if beside is not None:
            with suppress(OSError):
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


def write_npz(path: str | Path, arrays: Mapping[str, Any], *, compress: bool = False) -> None:
    """Write named arrays to `path`, of any suffix, whole or not at all; LuxelError where it cannot be written."""
    import numpy as np

    save = np.savez_compressed if compress else np.savez
    # NumPy adds a suffix of its own to a name, but not to a stream.
    with replacing(path) as beside, beside.open("wb") as stream:
        save(stream, **arrays)
        stream.flush()
        os.fsync(stream.fileno())


def require_writable(path: str | Path) -> None:
    """Raise LuxelError unless a file can be made at `path`: asked before hours of work, not after them."""
    path = Path(path)
    try:
        path = _follow(path)
        _require_place(path)
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise LuxelError(f"cannot write {path}: {_reason(error)}") from error


def to_json(value: Any, indent: int | None = None) -> str:
    """Return `value` as strict JSON: NumPy numbers and arrays, paths and tuples are taken, NaN and Inf become null."""
    return json.dumps(_plain(value), indent=indent, allow_nan=False)


def _plain(value: Any) -> Any:
    import numpy as np

    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, Path):
        return str(value)
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _make_beside(path: Path) -> Path:
    """Make an empty file in the folder of `path`, under a name that nobody else has."""
    _require_place(path)
    # Short, as the target's name may be as long as names can be; the suffix stays, because writers choose by it.
    beside = path.with_name(f".luxel-{secrets.token_hex(8)}{path.suffix}")
    # `open` applies the user's mask by itself; `tempfile` makes files that nobody else can read.
    os.close(os.open(beside, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    return beside


def _follow(path: Path) -> Path:
    """Return where a symbolic link leads; a path that is none as it stands. OSError for links that go in a circle."""
    target = Path(os.path.realpath(path)) if path.is_symlink() else path
    if target.is_symlink():
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP))
    return target


def _require_place(path: Path) -> None:
    """Make the folder of `path`; OSError where that cannot be, or where `path` is a folder or a device itself."""
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, "it is a folder")
    if path.exists() and not path.is_file():
        # A rename would put a file in the place of /dev/null, for all programs.
        raise OSError(errno.ENODEV, "it is a device or a pipe")
    path.parent.mkdir(parents=True, exist_ok=True)


def _reason(error: OSError) -> str:
    known = {
        errno.EACCES: "no permission; choose another place",
        errno.EPERM: "no permission; choose another place",
        errno.EROFS: "the file system is read-only; choose another place",
        errno.ENOSPC: "the disk is full; free some space or choose another place",
        errno.EDQUOT: "the disk quota is used up; free some space or choose another place",
        errno.EISDIR: "it is a folder; name a file",
        errno.ENODEV: "it is a device or a pipe; name a file",
        errno.ELOOP: "its links lead in a circle",
        errno.ENOTDIR: "a part of its path is a file, not a folder",
        errno.EEXIST: "a part of its path is a file, not a folder",
        errno.ENAMETOOLONG: "the name is too long",
    }
    return known.get(error.errno or 0, error.strerror or str(error))
