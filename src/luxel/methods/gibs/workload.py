"""Counts a frame of `gibs`: its rays, where they start, the bytes that it moves."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.methods.gibs.budget import owners, plan_of
from luxel.methods.gibs.depth import SHORT_RAYS
from luxel.methods.gibs.depth_maps import TEXELS_A_WORD
from luxel.methods.gibs.surfels import GibsState, count_items, count_surfels
from luxel.methods.workload import Workload
from luxel.scene.device import Scene


class GibsWorkload(Workload):
    """Counts the work of `gibs`."""

    def ray_counts(self, state: GibsState) -> dict[str, int]:
        count = count_surfels(state)
        rays = {"closest": int(np.array(state.cast).sum())}
        if state.depth is not None:
            rays["short"] = min(count * TEXELS_A_WORD, SHORT_RAYS)
        return rays

    def ray_origins(self, scene: Scene, state: GibsState) -> tuple[mi.Point3f, mi.Normal3f, mi.Bool]:
        surfels = state.surfels
        surfel, _, active = owners(plan_of(state.cast), state.settings.ray_lanes)
        p, n = dr.gather(mi.Point3f, surfels.p, surfel), dr.gather(mi.Normal3f, surfels.n, surfel)
        dr.eval(p, n, active)
        return p, n, active

    def touched_bytes(self, state: GibsState) -> int:
        surfel_words = 40  # placement, world space, estimate; each read and written
        if state.settings.normal_light:
            surfel_words += 11  # seven that are kept, four that look-ups read
        if state.depth is not None:
            surfel_words += 5  # a row, and a word of the map
        map_words = 0
        if state.guide is not None:
            map_words = sum(dr.width(part) for part in (state.guide.sums, state.guide.fresh, state.guide.densities))
        return (count_surfels(state) * surfel_words + count_items(state) + map_words) * 4 * 2
