"""Several samples of each lane side by side: a lane for each, and the mean over those that belong together.

In a loop around the loop over bounces, a warp of a GPU waits for the longest of its paths once a sample, and all that
the samples add up to stays alive across every ray. Side by side a launch ends with its longest path.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import drjit as dr
import mitsuba as mi

T = TypeVar("T")

LANE_LIMIT = 1 << 20
"""Lanes of a launch, enough to fill a GPU: of the samples of large pictures as many go side by side as fit, the others
in further launches, so that memory stays bounded (256 MB at 64 floats a sample)."""


def sum_samples(zero: T, width: int, samples: int, trace: Callable[[mi.UInt32, mi.UInt32], T]) -> T:
    """Return the sum over `samples` samples for each of `width` lanes; `zero` is the sum of none (a Dr.Jit pytree).

    `trace` is given arrays of equal width, lanes and numbers of samples from 1, and returns the sample of each.
    """
    at_once = max(1, min(samples, LANE_LIMIT // max(width, 1)))
    total = zero
    for done in range(0, samples, at_once):
        count = min(at_once, samples - done)
        place = dr.arange(mi.UInt32, width * count)
        # The samples of a lane are neighbours: their rays begin together.
        found = trace(place // count, place % count + dr.opaque(mi.UInt32, done + 1))
        dr.eval(found)
        total = _add_neighbours(total, found, width, count)
    return total


@dr.syntax
def _add_neighbours(total: T, found: T, width: int, count: int) -> T:
    """Add runs of `count` neighbours, from the first to the last: the same sum as one after the other."""
    first, number = dr.arange(mi.UInt32, width) * count, mi.UInt32(0)
    while number < count:
        total = total + dr.gather(type(found), found, first + number)
        number += 1
    return total


def take_lanes(source: T, lanes: mi.UInt32) -> T:
    """Return the rows `lanes` of an array; one that has a single row for all stays as it is."""
    return source if dr.width(source) == 1 else dr.gather(type(source), source, lanes)
