"""Which control a parameter gets: read off its name, default and doc, as `Params` classes hold them."""

from __future__ import annotations

import re
import threading
from dataclasses import dataclass
from functools import cache
from typing import Any

from luxel.methods.base import describe_params
from luxel.methods.params import find_method

SLIDER_LIMIT = 64
"""Whole numbers up to this one get a slider; larger ones a field, as their useful range spans decades."""
SLIDER_ROOM = 4
"""A slider reaches so many times its default."""
_parsing = threading.Lock()


@dataclass(frozen=True)
class Dial:
    """A parameter and its control."""

    key: str
    label: str
    doc: str
    default: Any
    kind: str
    """`check`, `slider`, `number`, `choice`, `vector` or `text`."""
    low: float = 0.0
    high: float = 1.0
    step: float = 1.0
    options: tuple[Any, ...] = ()

    def to_control(self, value: Any) -> Any:
        """Return `value` as the control holds it."""
        if self.kind == "choice":
            return str(value)
        if self.kind == "text":
            return _as_text(value)
        if self.kind == "vector":
            return tuple(float(part) for part in value)
        if self.kind == "slider":
            return type(self.step)(value)
        return value

    def from_control(self, value: Any) -> Any:
        """Return what the control holds as the parameter's value; text is read by `make_params`."""
        if self.kind == "choice":
            return type(self.default)(value)
        if self.kind == "vector":
            return tuple(float(part) for part in value)
        return value


def list_dials(method: str) -> tuple[Dial, ...]:
    """Return the dials of a method in the order of its `Params`."""
    # Docs are read off the source, and CPython 3.11 cannot parse on several threads at once.
    with _parsing:
        return _dials_of(find_method(method).Params)


@cache
def _dials_of(params_type: type) -> tuple[Dial, ...]:
    return tuple(make_dial(key, default, doc) for key, default, doc in describe_params(params_type))


def make_dial(key: str, default: Any, doc: str) -> Dial:
    """Return the dial of one parameter."""
    label = key.replace("_", " ").removeprefix("num ")
    if isinstance(default, bool):
        return Dial(key, label, doc, default, "check")
    if isinstance(default, int | float):
        choices = _numbers_to_choose(doc) if isinstance(default, int) else ()
        if str(default) in choices:
            return Dial(key, label, doc, default, "choice", options=choices)
        return _number_dial(key, label, doc, default)
    if isinstance(default, str):
        words = tuple(dict.fromkeys(re.findall(r"`([a-z0-9_]+)`", doc)))
        if default in words:
            return Dial(key, label, doc, default, "choice", options=words)
    if isinstance(default, tuple) and len(default) == 3:
        return Dial(key, label, doc, default, "vector")
    return Dial(key, label, doc, default, "text")


def _number_dial(key: str, label: str, doc: str, default: int | float) -> Dial:
    """Return a slider where a default says enough of the range, else a field."""
    if isinstance(default, int):
        if 1 < default <= SLIDER_LIMIT:
            return Dial(key, label, doc, default, "slider", 0 if " 0" in doc else 1, SLIDER_ROOM * default, 1)
        return Dial(key, label, doc, default, "number", step=1)
    is_share = re.search(r"\b(chance|share)\b", doc, re.IGNORECASE) is not None
    if 0.0 <= default <= 1.0 and (is_share or default < 1.0) and not re.search(r"\bmetres\b", doc):
        # Shares of the past lie near one, and one itself would never forget.
        near_one = 0.9 < default < 1.0
        return Dial(key, label, doc, default, "slider", 0.0, 0.999 if near_one else 1.0, 0.001 if near_one else 0.01)
    if 1.0 <= default < 10.0:
        return Dial(key, label, doc, default, "slider", 1.0 if default > 1.0 else 0.25, SLIDER_ROOM * default, 0.05)
    return Dial(key, label, doc, default, "number", step=0.01)


def _numbers_to_choose(doc: str) -> tuple[str, ...]:
    """Return the numbers that a doc lists as "4, 8 or 16"; none where it lists none."""
    found = re.search(r":? ?((?:\d+, )+\d+ or \d+)", doc)
    return tuple(re.findall(r"\d+", found[1])) if found else ()


def _as_text(value: Any) -> str:
    if value is None:
        return ""
    return ",".join(f"{part:g}" for part in value) if isinstance(value, tuple | list) else str(value)
