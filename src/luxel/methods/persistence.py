"""Save and load any method's state: every array of its pytree, by its path, in one .npz file.

Arrays stand in dataclasses, lists, tuples and dictionaries, as deep as one likes. All that is no array (numbers, text,
functions) counts as a setting and is not kept: it comes from the state that is built for the same scene and parameters.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Collection
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.errors import LuxelError
from luxel.files import write_npz
from luxel.scene.arrays import from_numpy

FORMAT = 2
STRUCTURE = "luxel_structure"
"""Name of the array that tells how the others hang together; older files have none."""
SETTING, EMPTY = "setting", "empty"


def save_state(name: str, state: Any, path: Path, header: str = "") -> None:
    """Write `state` of method `name` to `path`, beside it first and then renamed.

    `header` is text for other readers (JSON), kept as the array `header`.
    Raises LuxelError, and writes nothing, where arrays stand in what cannot be taken apart.
    """
    arrays: dict[str, Any] = {}
    structure = _take_apart(state, "", arrays)
    arrays[STRUCTURE] = json.dumps(structure)
    if header:
        arrays["header"] = header
    write_arrays(name, arrays, path)


def write_arrays(name: str, arrays: dict[str, Any], path: Path) -> None:
    """Write named arrays of method `name` to `path`, beside it first and then renamed."""
    write_npz(path, {"luxel_format": FORMAT, "luxel_method": name, **arrays}, compress=True)


def load_state(name: str, blank: Any, path: Path) -> Any:
    """Return `blank` filled with what `path` holds. Raises LuxelError where file and state do not fit."""
    held = read_arrays(name, path)
    structure = json.loads(str(held[STRUCTURE])) if STRUCTURE in held else _take_apart(blank, "", {})
    state = _fill(blank, structure, "", held, path)
    dr.make_opaque(state)
    return state


def read_arrays(name: str, path: Path) -> dict[str, np.ndarray]:
    """Return the arrays that `write_arrays` left. Raises LuxelError for another method's file, or a damaged one."""
    try:
        with Path(path).open("rb") as stream, np.load(stream) as file:
            held = {key: file[key] for key in file.files}
    except (OSError, ValueError, EOFError, AttributeError, zipfile.BadZipFile):
        raise LuxelError(f"'{path}' is not a saved luxel state, or is damaged") from None
    if str(held.get("luxel_method")) != name or int(held.get("luxel_format", 0)) != FORMAT:
        raise LuxelError(f"'{path}' holds a state of another method or version than '{name}'")
    return held


# --- structure -----------------------------------------------------------------------------------------------------


def _take_apart(node: Any, prefix: str, arrays: dict[str, Any]) -> Any:
    """Put the arrays of `node` into `arrays`, and return what they hang on as plain values for JSON.

    That is {"array": type}, {"fields" | "list" | "tuple" | "dict": [[key, ...], ...]}, "empty" for what holds nothing
    (None, an empty list) and "setting" for what is no array.
    """
    if isinstance(node, dr.ArrayBase | np.ndarray):
        arrays[prefix[1:]] = np.array(node)
        return {"array": type(node).__name__ if isinstance(node, dr.ArrayBase) else "ndarray"}
    parts = _parts(node)
    if parts is None:
        _refuse_hidden_arrays(node, prefix)
        return EMPTY if node is None else SETTING
    kind, items = parts
    # A dictionary's keys may be any text: an array's name has its place instead.
    rows = [
        [key, _take_apart(item, f"{prefix}.{key if kind == 'fields' else place}", arrays)]
        for place, (key, item) in enumerate(items)
    ]
    if not rows:
        return EMPTY
    return {kind: rows} if any(row != SETTING for _, row in rows) else SETTING


def _parts(node: Any) -> tuple[str, list[tuple[Any, Any]]] | None:
    """Return the kind of a node that holds others, and those by field, place or key; None for any other node."""
    kind = type(node)
    if is_dataclass(kind):
        return "fields", [(item.name, getattr(node, item.name)) for item in fields(kind)]
    if kind in (list, tuple):
        return kind.__name__, list(enumerate(node))
    if kind is dict and all(isinstance(key, str | int) for key in node):
        return "dict", list(node.items())
    return None


def _refuse_hidden_arrays(node: Any, prefix: str) -> None:
    """Raise LuxelError where arrays may hide in a node that is not taken apart, as they would be lost."""
    if isinstance(node, str | bytes | range | type):
        return
    inside = list(node.values() if isinstance(node, dict) else node) if isinstance(node, Collection) else []
    lost = any(_has_arrays(item) for item in inside)
    # A plain object may hold NumPy arrays that were made from the scene; device arrays are what a frame has changed.
    held = () if callable(node) else getattr(node, "__dict__", {}).values()
    if lost or any(isinstance(item, dr.ArrayBase) for item in held):
        raise LuxelError(
            f"the state's '{prefix[1:]}' is a {type(node).__name__}, whose arrays cannot be saved; "
            "keep them in a list, a tuple, a dict with text as keys, or a dataclass"
        )


def _has_arrays(node: Any) -> bool:
    if isinstance(node, dr.ArrayBase | np.ndarray):
        return True
    parts = _parts(node)
    return parts is not None and any(_has_arrays(item) for _, item in parts[1])


def _fill(node: Any, structure: Any, prefix: str, held: dict[str, np.ndarray], path: Path) -> Any:
    """Return `node` of a blank state with the arrays that `structure` says the file has there."""
    if structure == SETTING:
        return node
    if structure == EMPTY:
        if not _has_arrays(node):
            return node
        parts = _parts(node)
        return type(node)() if parts is not None and parts[0] != "fields" else None
    ((kind, rows),) = structure.items()
    if kind == "array":
        return _make_array(node, rows, prefix[1:], held, path)
    parts: Any = _parts(node)
    if parts is not None and parts[0] != kind or node is None and kind == "fields":
        raise _misfit(path, prefix[1:])
    known = dict(parts[1]) if parts is not None else {}
    made: Any = node
    filled = {}
    for place, (key, row) in enumerate(rows):
        if key not in known and row == SETTING:
            raise _misfit(path, f"{prefix[1:]}.{key}")
        name = f"{prefix}.{key if kind == 'fields' else place}"
        filled[key] = _fill(known.get(key), row, name, held, path)
    if kind == "fields":
        if filled.keys() - known.keys():
            raise _misfit(path, prefix[1:])
        return replace(made, **filled)
    if kind == "dict":
        return filled
    return list(filled.values()) if kind == "list" else tuple(filled.values())


def _make_array(node: Any, kind: str, key: str, held: dict[str, np.ndarray], path: Path) -> Any:
    """Return the array `key` of the file, of the type that `node` has, or by name where the blank state has none."""
    if key not in held or (node is not None and held[key].shape != np.array(node).shape):
        raise _misfit(path, key)
    if kind == "ndarray":
        return held[key]
    make: Any = type(node) if isinstance(node, dr.ArrayBase) else getattr(mi, kind, None)
    if make is None:
        raise _misfit(path, key)
    return from_numpy(make, held[key])


def _misfit(path: Path, key: str) -> LuxelError:
    return LuxelError(f"'{path}' was saved for another scene or other parameters ('{key}' does not fit)")
