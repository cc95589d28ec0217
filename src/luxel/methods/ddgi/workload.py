"""Counts a frame of `ddgi`: its rays, where they start, the bytes that it moves."""

from __future__ import annotations

from dataclasses import fields

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.kernels.fibonacci import fibonacci_direction, random_rotation, rotate
from luxel.methods.ddgi.memory import ESTIMATE_FLOATS
from luxel.methods.ddgi.state import AWAKE, DdgiState
from luxel.methods.ddgi.trace import ray_owner
from luxel.methods.workload import Workload
from luxel.scene.device import Scene


class DdgiWorkload(Workload):
    """Counts the work of `ddgi`."""

    def ray_counts(self, state: DdgiState) -> dict[str, int]:
        status = np.array(state.probes.status)
        casting = int((status == AWAKE).sum())
        sky = casting * int(np.array(state.rays.sky)[0])
        counts = {"sky": sky} if sky else {}
        if state.settings.variance_budget:
            return {"closest": int(np.array(state.rays.count).sum()), **counts}
        return {"closest": casting * state.settings.rays_per_probe, **counts}

    def ray_origins(self, scene: Scene, state: DdgiState) -> tuple[mi.Point3f, mi.Normal3f, mi.Bool]:
        probe, number, _, owned = _lanes(state)
        active = owned & (dr.gather(mi.UInt32, state.probes.status, probe, owned) == AWAKE)
        p = dr.gather(mi.Point3f, state.probes.p, probe, active)
        n = mi.Normal3f(0.0, dr.select(number & 1 == 0, mi.Float(1.0), -1.0), 0.0)
        dr.eval(p, n, active)
        return p, n, active

    def ray_directions(self, scene: Scene, state: DdgiState) -> mi.Vector3f:
        probe, number, count, _ = _lanes(state)
        direction = rotate(random_rotation(probe, state.seed), fibonacci_direction(number, count))
        dr.eval(direction)
        return direction

    def touched_bytes(self, state: DdgiState) -> int:
        s = state.settings
        means = ESTIMATE_FLOATS * s.irradiance_resolution**2 + len(fields(state.depth)) * s.depth_resolution**2
        texels = 2 * 4 * means  # read and written
        return s.total * texels + 32 * s.total * s.rays_per_probe + atlas_bytes(state)


def _lanes(state: DdgiState) -> tuple[mi.UInt32, mi.UInt32, mi.UInt32, mi.Bool]:
    return ray_owner(state, dr.arange(mi.UInt32, state.settings.total * state.settings.rays_per_probe))


def atlas_bytes(state: DdgiState) -> int:
    """Return the bytes that the atlases take."""
    settings = state.settings
    light = dr.width(state.irradiance_atlas) * (2 if settings.half_irradiance else 4)
    return light + dr.width(state.depth_atlas) * (2 if settings.half_depth else 4)
