"""Is a class a method that can run? Asked of classes from outside the package, before anything is built."""

from __future__ import annotations

import inspect
import re
from dataclasses import fields, is_dataclass
from typing import Any

from luxel.errors import LuxelError
from luxel.methods.base import Method

NAME_FORM = re.compile(r"[A-Za-z][\w-]*")
"""A word: it stands on command lines, in lists, in file names and in style sheets."""

VALUES: dict[type, tuple[Any, str]] = {
    bool: (bool, "True or False"),
    int: (int, "a whole number"),
    float: (int | float, "a number"),
    str: (str, "text"),
}
"""What a preset may set, by the kind of the parameter's default; other kinds are the method's own affair."""
CALLS = (
    "plan",
    "build",
    "retune",
    "fits",
    "update",
    "query",
    "screen",
    "reprojects",
    "shade",
    "observe",
    "texels",
    "cache",
    "warnings",
)
"""The functions of a method that luxel calls."""


def check_method(kind: object, where: str) -> Method:
    """Return an instance of class `kind`. Raises LuxelError, which says `where`, for a class that cannot run."""
    if not (isinstance(kind, type) and issubclass(kind, Method)):
        raise LuxelError(f"{where} is no method: derive a class from luxel.methods.Method")
    if inspect.isabstract(kind):
        raise LuxelError(f"{where} lacks {', '.join(sorted(kind.__abstractmethods__))}, which a method must have")
    _check_calls(kind, where)
    name = getattr(kind, "name", None)
    if not isinstance(name, str) or NAME_FORM.fullmatch(name) is None:
        raise LuxelError(f"{where} needs a `name` that is one word of letters, digits, _ and -, such as 'voxels'")
    _check_params(kind, where)
    try:
        return kind()
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        text = " ".join(f"{type(error).__name__}: {error}".split())
        raise LuxelError(f"{where} cannot be made without arguments: {text}") from error


def _check_calls(kind: type[Method], where: str) -> None:
    """Raise LuxelError for a function of the contract that cannot be called as the frame calls it."""
    for name in CALLS:
        asked = inspect.signature(getattr(Method, name))
        given = [each for each in asked.parameters.values() if each.kind is each.POSITIONAL_OR_KEYWORD]
        named = [each.name for each in asked.parameters.values() if each.kind is each.KEYWORD_ONLY]
        try:
            inspect.signature(getattr(kind, name)).bind(*given, **dict.fromkeys(named))
        except TypeError as error:
            words = ", ".join([*(each.name for each in given), *(["*"] if named else []), *named])
            raise LuxelError(f"{where}: `{name}` must take ({words}): {error}") from error


def _check_params(kind: type[Method], where: str) -> None:
    params = getattr(kind, "Params", None)
    if not (isinstance(params, type) and is_dataclass(params)):
        raise LuxelError(f"{where} needs `Params`, a dataclass of its parameters; it may be empty")
    try:
        defaults = params()
    except Exception as error:
        raise LuxelError(f"{where}: each parameter of `Params` needs a default ({error})") from error
    if not (isinstance(kind.presets, dict) and all(isinstance(one, dict) for one in kind.presets.values())):
        raise LuxelError(f"{where} needs `presets` that is a dict of dicts, each of parameters and their values")
    known = {item.name for item in fields(params)}
    for preset, settings in kind.presets.items():
        unknown = sorted(set(settings) - known)
        if unknown:
            raise LuxelError(f"{where}: preset '{preset}' sets '{unknown[0]}', which is no parameter of it")
        for key, value in settings.items():
            wanted = VALUES.get(type(getattr(defaults, key)))
            if wanted is not None and not (
                isinstance(value, wanted[0]) and isinstance(value, bool) == (wanted[0] is bool)
            ):
                raise LuxelError(f"{where}: preset '{preset}' sets '{key}' to {value!r}, not to {wanted[1]}")
