"""Where the buffers and images of a glTF file lie: the bytes behind a URI.

Exporters write names as they like: percent-encoded or not, with backslashes, with a query, in another letter case.
Whatever a file says, only files in its own folder and below are read.
"""

from __future__ import annotations

import base64
import binascii
import os
import re
import unicodedata
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from urllib.parse import unquote, unquote_to_bytes

from luxel.errors import LuxelError

ABSOLUTE = re.compile(r"/|[A-Za-z]:/|[A-Za-z][A-Za-z0-9+.-]*://")


class OutsideError(OSError):
    """A URI that names nothing inside the file's folder."""


def is_embedded(uri: str) -> bool:
    """Return whether the URI holds its data itself."""
    return uri[:5].lower() == "data:"


def read_embedded(uri: str) -> bytes:
    """Return the bytes of a `data:` URI. Raises `ValueError` where it is damaged."""
    header, comma, body = uri.partition(",")
    if not comma:
        raise ValueError("its data URI has no comma")
    if not header.lower().rstrip().endswith(";base64"):
        return unquote_to_bytes(body)
    text = unquote(body).translate(str.maketrans("-_", "+/", " \t\r\n")).rstrip("=")
    try:
        return base64.b64decode(text + "=" * (-len(text) % 4))
    except (binascii.Error, ValueError) as error:
        raise ValueError("its base64 data is damaged") from error


def find_file(gltf: Path, uri: str) -> Path:
    """Return the file that `uri` names beside the glTF file `gltf`.

    In this order: percent-decoded, literally, both without a query or fragment; then the same in another letter case,
    where exactly one file fits. Raises `FileNotFoundError` where there is none, and for a remote address (nothing is
    downloaded), `OutsideError` for a name outside the folder, `LuxelError` where several files fit alike, `ValueError`
    for a name that no file can have.
    """
    if "\0" in uri or "%00" in uri:
        raise ValueError("its file name holds a zero byte")
    if "://" in uri and not uri.lower().startswith("file:"):
        raise FileNotFoundError(f"{uri} is remote")
    names = list(dict.fromkeys(_readings(uri)))
    inside = [parts for parts in map(_split, names) if parts is not None]
    for parts in inside:
        path = gltf.parent.joinpath(*parts)
        if path.is_file():
            return _check_inside(gltf, path)
    for parts in inside:
        fitting = _find_folded(gltf.parent, parts)
        if len(fitting) > 1:
            listed = " and ".join(f"'{path.relative_to(gltf.parent).as_posix()}'" for path in fitting[:3])
            raise LuxelError(
                f"cannot load {gltf}: '{uri}' fits {listed}, which differ only in letter case; "
                "rename one to what the file says."
            )
        if fitting:
            return _check_inside(gltf, fitting[0])
    if len(inside) < len(names):
        raise OutsideError(f"{uri} lies outside the file's folder, where luxel reads nothing")
    raise FileNotFoundError(uri)


def _readings(uri: str) -> Iterator[str]:
    for text in (uri, re.split(r"[?#]", uri, maxsplit=1)[0]):
        for name in (unquote(text), text):
            if name:
                yield name.replace("\\", "/")


def _split(name: str) -> tuple[str, ...] | None:
    """The parts of a relative path with `.` and `..` resolved; None where it leaves its folder or is absolute."""
    if ABSOLUTE.match(name):
        return None
    parts: list[str] = []
    for part in PurePosixPath(name).parts:
        if part == ".." and not parts:
            return None
        if part == "..":
            parts.pop()
        else:
            parts.append(part)
    return tuple(parts) or None


def _find_folded(folder: Path, parts: tuple[str, ...]) -> list[Path]:
    """All files below `folder` whose path is `parts` but for letter case (and how its accents are composed)."""
    found = [folder]
    for part in parts:
        wanted = _fold(part)
        found = [entry for place in found for entry in _entries(place) if _fold(entry.name) == wanted]
    return sorted(path for path in found if path.is_file())


def _entries(folder: Path) -> list[Path]:
    try:
        return [folder / name for name in os.listdir(folder)]
    except OSError:
        return []


def _fold(name: str) -> str:
    return unicodedata.normalize("NFC", name).casefold()


def _check_inside(gltf: Path, path: Path) -> Path:
    """Refuse a link that leads out of the folder: of the file as named, or of the file that this name links to."""
    real = path.resolve()
    if not any(real.is_relative_to(folder) for folder in (gltf.parent.resolve(), gltf.resolve().parent)):
        raise OutsideError(f"{path.name} is a link out of the file's folder, where luxel reads nothing")
    return path
