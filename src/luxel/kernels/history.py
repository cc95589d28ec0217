"""The one running mean of all that is averaged over frames: direct light, whole pictures, paths."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi


def frames_kept(still: mi.Bool, count: mi.UInt32) -> mi.UInt32:
    """Return how many frames a mean of `count` may go on with: none where the view does not stand still."""
    return dr.select(still, count, 0)


def equal_share(count: mi.UInt32 | mi.Float) -> mi.Float:
    """Return what the next frame weighs in a mean of `count` frames that count the same."""
    return 1.0 / (mi.Float(count) + 1.0)


def running_mean(before: Any, fresh: Any, count: mi.UInt32 | mi.Float, share: mi.Float | None = None) -> Any:
    """Return the mean of `count` frames, `before`, taken on by the frame `fresh`; what it weighs is `share`.

    Both are arrays, or records of arrays, of one kind. None: all frames weigh the same. Where `count` is 0, the mean is
    `fresh`, whatever `before` holds.
    """
    share = equal_share(count) if share is None else share
    return _mix(before, fresh, share, count == 0)


def _mix(before: Any, fresh: Any, share: mi.Float, first: mi.Bool) -> Any:
    if is_dataclass(fresh):
        names = [item.name for item in fields(fresh)]
        mixed = {name: _mix(getattr(before, name), getattr(fresh, name), share, first) for name in names}
        return replace(fresh, **mixed)  # type: ignore[type-var]
    return dr.select(first, fresh, dr.lerp(before, fresh, share))
