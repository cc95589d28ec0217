"""Counts a frame of `lightmap`: its rays, where they start, the bytes that it moves."""

from __future__ import annotations

import drjit as dr

from luxel.methods.lightmap.run.state import LightmapState, bake_of
from luxel.methods.workload import Workload


class LightmapWorkload(Workload):
    """Counts the work of `lightmap`."""

    def ray_counts(self, state: LightmapState) -> dict[str, int]:
        surfels = state.surfels
        return {"closest": 0, "shadow": surfels.count * surfels.samples * surfels.shadow_rays}

    def touched_bytes(self, state: LightmapState) -> int:
        bake = bake_of(state)
        words = int((bake.words != 0).sum())
        listed = sum(dr.width(step.item) for step in state.clusters.passes)
        return (
            4 * words
            + 16 * len(bake.words)
            + 8 * listed
            + 16 * len(bake.tree_low)
            + 60 * state.surfels.count * state.surfels.samples
        )
