"""Dials of the built-in scenes: read from text, checked against the scene's own signature and range."""

from __future__ import annotations

import difflib
import inspect
import math
from collections.abc import Callable
from typing import Any

from luxel.errors import LuxelError
from luxel.scene.model import SceneData

SceneMaker = Callable[..., SceneData]


def read_dials(maker: SceneMaker) -> dict[str, float | int]:
    """Return the dials of a built-in scene with their defaults, in the order of its signature."""
    return {name: parameter.default for name, parameter in inspect.signature(maker).parameters.items()}


def parse_dials(text: str) -> dict[str, str]:
    """Split "wall=0.05,lamp=2" into names and texts. Raises `LuxelError` where a part is not name=value."""
    dials = {}
    for part in text.split(","):
        name, equals, value = part.partition("=")
        if not equals or not name.strip() or not value.strip():
            raise LuxelError(f"'{part.strip()}' is not a dial; write name=value, and a comma between two dials.")
        dials[name.strip()] = value.strip()
    return dials


def convert_dials(scene: str, maker: SceneMaker, given: dict[str, Any]) -> dict[str, float | int]:
    """Return `given` as numbers of the types that the scene's defaults have. Raises `LuxelError`."""
    known = read_dials(maker)
    converted: dict[str, float | int] = {}
    for name, value in given.items():
        if name not in known:
            close = difflib.get_close_matches(name, known, n=1)
            hint = f" Did you mean '{close[0]}'?" if close else ""
            has = f"its dials are {', '.join(known)}" if known else "it has none"
            raise LuxelError(f"Scene '{scene}' has no dial '{name}'; {has}.{hint}")
        whole = isinstance(known[name], int)
        try:
            number = float(value)
            if not math.isfinite(number) or (whole and number != round(number)):
                raise ValueError
        except (TypeError, ValueError):
            kind = "a whole number" if whole else "a number"
            raise LuxelError(f"Dial '{name}' of scene '{scene}' must be {kind}, not '{value}'.") from None
        converted[name] = int(number) if whole else number
    return converted


def require_range(name: str, value: float, low: float, high: float) -> None:
    """Raise `LuxelError` where a dial is outside of low..high."""
    if not low <= value <= high:
        raise LuxelError(f"Dial '{name}' must lie between {low:g} and {high:g}, not {value:g}.")
