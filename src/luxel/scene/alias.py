"""Walker's alias method: one of many by its probability, with one look-up."""

from __future__ import annotations

import numpy as np


def build_alias_table(probabilities: np.ndarray) -> np.ndarray:
    """Return (E, 2) thresholds and partners for `probabilities` (E,) that sum to one (Walker 1977, Vose 1991).

    Shares below the mean are filled, in order, by what is above it in shares that have more. Running sums of what
    lacks and of what is left over say who fills whom, so that no loop goes through the shares.
    """
    count = len(probabilities)
    scaled = np.asarray(probabilities, np.float64) * count
    table = np.stack([np.ones(count), np.arange(count, dtype=np.float64)], axis=1)
    small, large = np.flatnonzero(scaled < 1.0), np.flatnonzero(scaled >= 1.0)
    if not len(small) or not len(large):
        return table
    lack, left = np.cumsum(1.0 - scaled[small]), np.cumsum(scaled[large] - 1.0)

    # A small share takes from the first large one that still has something when its turn comes.
    before = np.concatenate([[0.0], lack[:-1]])
    giver = np.minimum(np.searchsorted(left, before, side="right"), len(large) - 1)
    table[small, 0], table[small, 1] = scaled[small], large[giver]

    # A large one that gave too much at last is filled by the next. One whose last gift was just what it had is not:
    # the small share after that began with the next one.
    emptied_by = np.searchsorted(lack, left, side="right")
    emptied = np.flatnonzero(emptied_by < len(small))
    emptied = emptied[emptied < len(large) - 1]
    emptied = emptied[before[emptied_by[emptied]] < left[emptied]]
    rest = 1.0 + left[emptied] - lack[emptied_by[emptied]]
    table[large[emptied], 0] = np.clip(rest, 0.0, 1.0)
    table[large[emptied], 1] = large[emptied + 1]
    return table
