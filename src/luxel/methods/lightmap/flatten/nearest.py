"""The nearest in the atlas, but of the same chart: neighbours in the atlas may be strangers on the surface."""

from __future__ import annotations

import numpy as np
import scipy


def find_nearest(
    places: np.ndarray, chart: np.ndarray, at: np.ndarray, at_chart: np.ndarray, reach: float = np.inf, count: int = 1
) -> np.ndarray:
    """Return which of `places` (n, 2) are the nearest to each of `at` (m, 2) among those of its chart, (m, `count`).

    `chart` (n,) and `at_chart` (m,) are integers. -1 where there is none within `reach`.
    """
    if not len(places) or not len(at):
        return np.full((len(at), count), -1)
    # Charts lie apart in a third coordinate, farther than any two places of one chart.
    apart = 4.0 * float(np.abs(np.concatenate([places, at])).max()) + 4.0
    tree = scipy.spatial.KDTree(np.column_stack([places, chart * apart]))
    distance, index = tree.query(
        np.column_stack([at, at_chart * apart]), k=count, distance_upper_bound=min(reach, 0.99 * apart), workers=-1
    )
    return np.where(np.isfinite(distance), index, -1).reshape(len(at), count)
