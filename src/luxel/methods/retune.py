"""New parameters for a cache that goes on."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from typing import Any

import drjit as dr
import numpy as np

DIALS = ("dials", "settings")
"""Fields of a state that hold its parameters; all others hold what it has learned."""


def carry_over(old: Any, new: Any, places: tuple[str, ...]) -> Any | None:
    """Return `old` with the parameters of `new`, a state built for them; None where its arrays do not serve on.

    `places` names the fields that say where things are (grids, boxes): they must hold the same values.
    """
    for item in fields(old):
        before, after = getattr(old, item.name), getattr(new, item.name)
        if item.name in DIALS:
            continue
        if not _alike(before, after, values=item.name in places):
            return None
    return replace(old, **{name: getattr(new, name) for name in DIALS})


def _alike(before: Any, after: Any, values: bool) -> bool:
    """Return whether two pytrees have arrays of the same kinds and widths, and, with `values`, the same content."""
    if type(before) is not type(after):
        return False
    if is_dataclass(before):
        return all(_alike(getattr(before, f.name), getattr(after, f.name), values) for f in fields(before))
    if isinstance(before, tuple | list):
        return len(before) == len(after) and all(_alike(a, b, values) for a, b in zip(before, after, strict=True))
    if dr.is_array_v(before):
        if dr.width(before) != dr.width(after):
            return False
        return not values or bool(np.array_equal(np.array(before), np.array(after)))
    return before == after
