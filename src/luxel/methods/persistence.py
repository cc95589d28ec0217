"""Save and load any method's state: every array of its pytree, by its path, in one .npz file."""

from __future__ import annotations

import os
import zipfile
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np

from luxel.errors import LuxelError

FORMAT = 2


def save_state(name: str, state: Any, path: Path, header: str = "") -> None:
    """Write `state` of method `name` to `path`, beside it first and then renamed.

    `header` is text for other readers (JSON), kept as the array `header`.
    """
    arrays: dict[str, Any] = {key: np.array(value) for key, value in _leaves(state, "")}
    if header:
        arrays["header"] = header
    write_arrays(name, arrays, path)


def write_arrays(name: str, arrays: dict[str, Any], path: Path) -> None:
    """Write named arrays of method `name` to `path`, beside it first and then renamed."""
    path = Path(path)
    beside = path.with_name(f".{path.name}.{os.getpid()}.npz")
    try:
        np.savez_compressed(beside, luxel_format=FORMAT, luxel_method=name, **arrays)
        os.replace(beside, path)
    except OSError as error:
        beside.unlink(missing_ok=True)
        raise LuxelError(f"'{path}' cannot be written: {error.strerror or error}") from None


def load_state(name: str, blank: Any, path: Path) -> Any:
    """Return `blank` filled with what `path` holds. Raises LuxelError where file and state do not fit."""
    state = _fill(blank, "", read_arrays(name, path), path)
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


def _leaves(node: Any, prefix: str) -> list[tuple[str, Any]]:
    if is_dataclass(node):
        return [leaf for item in fields(node) for leaf in _leaves(getattr(node, item.name), f"{prefix}.{item.name}")]
    if isinstance(node, tuple):
        return [leaf for index, item in enumerate(node) for leaf in _leaves(item, f"{prefix}.{index}")]
    return [(prefix[1:], node)] if isinstance(node, dr.ArrayBase) else []


def _fill(node: Any, prefix: str, held: dict[str, np.ndarray], path: Path) -> Any:
    if is_dataclass(node) and not isinstance(node, type):
        filled = {
            item.name: _fill(getattr(node, item.name), f"{prefix}.{item.name}", held, path) for item in fields(node)
        }
        return replace(node, **filled)
    if isinstance(node, tuple):
        return tuple(_fill(item, f"{prefix}.{index}", held, path) for index, item in enumerate(node))
    if not isinstance(node, dr.ArrayBase):
        return node
    key = prefix[1:]
    if key not in held or held[key].shape != np.array(node).shape:
        raise LuxelError(f"'{path}' was saved for another scene or other parameters ('{key}' does not fit)")
    make: Any = type(node)
    return make(held[key])
