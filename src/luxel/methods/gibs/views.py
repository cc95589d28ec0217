"""What can be shown of the surfels."""

from __future__ import annotations

import numpy as np

from luxel.methods.gibs.sizes import radius_of_size
from luxel.methods.gibs.surfels import GibsState
from luxel.methods.inspect import CacheView


def surfel_views(state: GibsState) -> dict[str, CacheView]:
    """Return the living surfels as discs by irradiance, age and inconsistency, and the grid's occupancy."""
    surfels = state.surfels
    alive = np.array(surfels.object_id) != 0
    base = {
        "p": np.array(surfels.p).T[alive],
        "n": np.array(surfels.n).T[alive],
        "radius": np.broadcast_to(np.array(radius_of_size(state, surfels.size)), alive.shape)[alive],
    }
    count = np.array(surfels.estimate.count)[alive]
    lengths = np.diff(np.array(state.grid.starts).astype(np.int64))
    return {
        "irradiance": CacheView(
            "points", {**base, "color": np.array(surfels.estimate.mean).T[alive]}, "E of each surfel"
        ),
        "age": CacheView("points", {**base, "value": count}, "samples since birth or the last change"),
        "inconsistency": CacheView(
            "points",
            {**base, "value": np.array(surfels.estimate.inconsistency)[alive]},
            "how far short and long mean are apart",
        ),
        "cell_occupancy": CacheView(
            "number",
            {"value": float(lengths[lengths > 0].mean()) if lengths.any() else 0.0},
            "surfels a used slot",
        ),
    }
