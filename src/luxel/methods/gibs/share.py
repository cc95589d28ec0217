"""Noisy surfels lean on their neighbours.

What a surfel shows is its own mean blended with the means around it, the more so the larger its standard error is
against its mean: much where a small bright patch lights a dark room, nothing where the means have settled. It blends
means, not what the neighbours show: a diffusion over the frames would be smoother still, but it lags, and under
feedback every bounce lags again. (The document leaves sharing out; Brinck et al. 2021 name it.)
"""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi

from luxel.kernels.mean_estimator import Estimate, relative_error
from luxel.methods.gibs.gather import gather_irradiance
from luxel.methods.gibs.surfels import GibsState, pack_light

QUIET_ERROR = 0.05
"""Relative standard error below which a surfel needs no help."""
NOISY_ERROR = 0.20
"""Relative standard error from which it takes all the help it is allowed."""


def share_irradiance(state: GibsState, estimate: Estimate) -> mi.Color3f:
    """Return the irradiance that each surfel shows: its own mean, or in part its neighbours'."""
    surfels = state.surfels
    own = pack_light(estimate.mean, surfels.ray_index, state.dials.fade_in, state.settings.capacity)
    dr.eval(own)
    state = replace(state, light=own)
    alive = surfels.object_id != 0
    noise = dr.clip((relative_error(estimate) - QUIET_ERROR) / (NOISY_ERROR - QUIET_ERROR), 0.0, 1.0)
    around = gather_irradiance(state, surfels.p, mi.Normal3f(surfels.n), alive & (noise > 0.0))
    help_taken = dr.select(around.say > 0.0, noise * state.dials.sharing, 0.0)
    return dr.lerp(estimate.mean, around.irradiance, help_taken)
