"""What each surfel sees, roughly: what the tree needs to know before it is grown.

Neighbours in space may be strangers in light: the two sides of a wall, the parts of a rafter in the room and in the
sun. A cluster of both would bring the light of the one to whoever sees the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import mitsuba as mi
import numpy as np
import scipy

from luxel.methods.lightmap.bake.surfels import BakedSurfels
from luxel.methods.lightmap.bake.visibility import Leaves, cast_rows
from luxel.methods.lightmap.flatten.origins import Origins
from luxel.methods.lightmap.flatten.tables import AtlasTables
from luxel.scene.arrays import from_numpy
from luxel.scene.device import Scene
from luxel.scene.triangles import Box

RAYS = 4
"""Rays a sample point."""
REGION_LIMIT, REGION_SHARE = 12, 0.005
"""Regions with a tree of their own, at most, and the share of the surfels that such a one must have."""


@dataclass
class MutualVisibility:
    """What S surfels see."""

    region: np.ndarray
    """(S,) surfels that see one another, directly or over others, share one."""
    view: np.ndarray
    """(S, 4) where their rays end, as shares of the bounds' diagonal, and the share that leaves the scene."""


def estimate_mutual_visibility(
    still: Scene,
    tables: AtlasTables,
    origins: Origins,
    surfels: BakedSurfels,
    labels: np.ndarray,
    bounds: Box,
    seed: int,
) -> MutualVisibility:
    """Cast a few rays from each surfel; `labels` names the surfel of each fine cell, `bounds` are the scene's.

    No cluster may reach from a region into another, so no light leaks into a closed room. Regions that are
    mere specks, and those beyond the `REGION_LIMIT` largest, share a tree: they see next to nothing.
    """
    count, samples = surfels.samples.shape
    starts = np.arange(count + 1) * samples
    leaves = Leaves(from_numpy(mi.UInt32, labels), mi.UInt32([count + 1]), 1, count)
    rays = RAYS * samples
    met = cast_rows(still, tables, leaves, origins, starts, surfels.samples.ravel(), (0, count), rays, seed + 31)
    hit = met < count
    row = np.repeat(np.arange(count), rays).reshape(met.shape)[hit]
    other = met[hit].astype(np.int64)
    graph = scipy.sparse.coo_array((np.ones(len(row)), (row, other)), shape=(count, count))
    _, region = scipy.sparse.csgraph.connected_components(graph, directed=False)
    size = np.bincount(region)
    rank = np.empty(len(size), np.int64)
    rank[np.argsort(-size, kind="stable")] = np.arange(len(size))
    amount = np.maximum(np.bincount(row, minlength=count), 1)[:, None]
    end = np.stack([np.bincount(row, weights=axis, minlength=count) for axis in surfels.p[other].T], axis=1) / amount
    end = np.where(hit.any(axis=1)[:, None], end, surfels.p)
    specks = size[region] < REGION_SHARE * count
    # Far surroundings count as if they lay on the bounds' sphere: how far off does not matter, which way does.
    diagonal = max(float(np.linalg.norm(bounds.upper - bounds.lower)), 1e-9)
    away = end - 0.5 * (bounds.lower + bounds.upper)
    end = end - away + away * np.minimum(diagonal / np.maximum(np.linalg.norm(away, axis=1), 1e-300), 1.0)[:, None]
    view = np.column_stack([end / diagonal, (met == count + 1).mean(axis=1)])
    return MutualVisibility(np.where(specks, REGION_LIMIT, np.minimum(rank[region], REGION_LIMIT)), view)
