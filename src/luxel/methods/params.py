"""Make a method's parameters from text: presets and `key=value` settings."""

from __future__ import annotations

import difflib
from dataclasses import fields, replace
from typing import Any

import numpy as np

from luxel.errors import LuxelError
from luxel.methods.base import Method
from luxel.methods.own import installed_methods, is_file, list_names, load_installed, load_method
from luxel.methods.table import METHODS
from luxel.scene.rules import show

NUMBERS = int | float | np.integer | np.floating


def find_method(name: str) -> Method:
    """Return the method called `name`, which may be an installed package's, or a class as FILE.py:Class.

    Raises LuxelError with the nearest names, or with what is wrong with the package or the file.
    """
    if not isinstance(name, str):
        raise LuxelError(f"a method is named by a word, not by {show(name)}: choose one of {', '.join(list_names())}")
    if name in METHODS:
        return METHODS[name]
    if is_file(name):
        return load_method(name)
    if name in installed_methods():
        return load_installed(name)
    close = difflib.get_close_matches(name, list_names(), n=1)
    hint = f"; did you mean '{close[0]}'?" if close else ""
    raise LuxelError(
        f"unknown method '{name}': choose one of {', '.join(list_names())}, or give your own as FILE.py:Class{hint}"
    )


def make_params(name: str, preset: str | None = None, settings: dict[str, Any] | None = None) -> Any:
    """Return the `Params` of method `name`: its defaults, then `preset`, then `settings` (values may be text).

    Raises LuxelError for an unknown method, preset or parameter, or a value of the wrong kind.
    """
    method = find_method(name)
    params = method.Params()
    if preset is not None:
        if not isinstance(preset, str) or preset not in method.presets:
            known = ", ".join(method.presets) or "none"
            raise LuxelError(f"method '{name}' has no preset '{preset}' (it has: {known})")
        params = replace(params, **method.presets[preset])
    return change_params(name, params, settings or {})


def change_params(name: str, params: Any, settings: dict[str, Any]) -> Any:
    """Return `params` of method `name` with `settings` (values may be text). Raises LuxelError as `make_params`."""
    kinds = {item.name: item for item in fields(find_method(name).Params)}
    defaults = find_method(name).Params()
    for key, value in settings.items():
        if key not in kinds:
            known = ", ".join(kinds) or "none"
            raise LuxelError(f"method '{name}' has no parameter '{key}' (it has: {known})")
        params = replace(params, **{key: _convert(name, key, value, getattr(defaults, key))})
    return params


def _convert(name: str, key: str, value: Any, default: Any) -> Any:
    """Read `value` as the kind of `default`."""
    try:
        if not isinstance(value, str):
            return _take(value, default)
        if isinstance(default, bool):
            if value.lower() not in {"true", "false", "1", "0", "yes", "no", "on", "off"}:
                raise ValueError(value)
            return value.lower() in {"true", "1", "yes", "on"}
        if isinstance(default, int):
            return int(value)
        if isinstance(default, float):
            return float(value)
        if isinstance(default, str):
            return value
        numbers = tuple(float(part) for part in value.split(","))
        return numbers * 3 if len(numbers) == 1 else numbers
    except (TypeError, ValueError, OverflowError):
        kinds = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}
        kind = kinds.get(type(default), "numbers R,G,B")
        raise LuxelError(f"{name}: parameter '{key}' takes {kind}, not {show(value)}") from None


def _take(value: Any, default: Any) -> Any:
    """Return `value` (no text) as the kind of `default`; raises TypeError or ValueError for another kind."""
    if isinstance(default, bool):
        if not isinstance(value, bool | np.bool_):
            raise TypeError(value)
        return bool(value)
    if isinstance(default, int | float):
        if (
            isinstance(value, bool)
            or not isinstance(value, int | float | np.integer | np.floating)
            or type(default)(value) != value
        ):
            raise TypeError(value)
        return type(default)(value)
    if isinstance(default, str):
        raise TypeError(value)
    if value is None:
        return None
    numbers = tuple(float(part) for part in ([value] if isinstance(value, NUMBERS) else value))
    return numbers * 3 if len(numbers) == 1 else numbers


# --- held copies ---------------------------------------------------------------------------------------------------


def copy_params(name: str, params: Any) -> Any:
    """Return a copy of `params` that may be changed. Raises LuxelError where they are not those of method `name`."""
    kind = find_method(name).Params
    if not isinstance(params, kind):
        raise LuxelError(f"method '{name}' takes a dict or its own Params, not {type(params).__name__}")
    return kind(**_values(params))


def hold_params(params: Any) -> Any:
    """Return a copy of `params` that refuses assignments, and names the call that changes them instead."""
    kind = type(params)

    def refuse(held: Any, key: str, value: Any) -> None:
        raise LuxelError(f"a renderer's parameter '{key}' is not assigned: call set_params({key}={value!r})")

    def equal(held: Any, other: Any) -> bool:
        return isinstance(other, kind) and _values(held) == _values(other)

    def reduce(held: Any) -> tuple[Any, ...]:
        # A copy is a plain one.
        return kind, tuple(_values(held).values())

    body = {"__setattr__": refuse, "__eq__": equal, "__hash__": None, "__reduce__": reduce, "__doc__": kind.__doc__}
    body["__init__"] = lambda held, **values: held.__dict__.update(values)
    copy = object.__new__(type(kind.__name__, (kind,), body))
    copy.__dict__.update(_values(params))
    return copy


def _values(params: Any) -> dict[str, Any]:
    return {item.name: getattr(params, item.name) for item in fields(params)}
