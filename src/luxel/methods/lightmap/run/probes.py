"""Light from the probes: in open space, for what moves and for free points.

A probe is six texels that look along the axes. Between them irradiance is the polynomial through the six values that is
exact for light of the first order: E(n) = sum over axes of n_i^2 (E+ + E-) / 2 + n_i (E+ - E-) / 2.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from luxel.kernels.trace import offset_origin, trace_occluded
from luxel.methods.lightmap.run.state import LightmapState
from luxel.scene.device import Scene


@dr.syntax
def read_probes(
    scene: Scene, state: LightmapState, p: mi.Point3f, n_geometric: mi.Normal3f, n: mi.Normal3f, active: mi.Bool
) -> tuple[mi.Color3f, mi.Bool]:
    """Return irradiance at points `p` facing `n` from the up to eight probes around that see them; False: none does."""
    probes = state.probes
    origin = offset_origin(scene, p, n_geometric)
    at = (mi.Vector3f(p) - mi.Vector3f(probes.lower)) * probes.inverse_size - 0.5
    base = dr.floor(at)
    part = at - base
    total, weight_sum = mi.Color3f(0.0), mi.Float(0.0)
    corner = mi.UInt32(0)
    while active & (corner < 8):
        step = mi.Vector3f(mi.Float(corner & 1), mi.Float((corner >> 1) & 1), mi.Float(corner >> 2))
        x = mi.UInt32(dr.clip(base.x + step.x, 0.0, probes.nx - 1.0))
        y = mi.UInt32(dr.clip(base.y + step.y, 0.0, probes.ny - 1.0))
        z = mi.UInt32(dr.clip(base.z + step.z, 0.0, probes.nz - 1.0))
        probe = x + probes.nx * (y + probes.ny * z)
        share = dr.abs(1.0 - step - part)
        weight = (
            (share.x + 1e-3) * (share.y + 1e-3) * (share.z + 1e-3) * dr.gather(mi.Float, probes.fine, probe, active)
        )
        place = probes.lower + probes.size * mi.Vector3f(mi.Float(x) + 0.5, mi.Float(y) + 0.5, mi.Float(z) + 0.5)
        way = place - origin
        distance = dr.norm(way)
        wanted = active & (weight > 0.0)
        hidden = trace_occluded(scene, origin, way / dr.fmax(distance, 1e-12), distance, wanted, still=True)
        weight = dr.select(wanted & ~hidden, weight, 0.0)
        total += weight * _read_one(state, probe, n, active & (weight > 0.0))
        weight_sum += weight
        corner += 1
    seen = weight_sum > 0.0
    return dr.select(seen, total / dr.fmax(weight_sum, 1e-12), mi.Color3f(0.0)), seen


def _read_one(state: LightmapState, probe: mi.UInt32, n: mi.Normal3f, active: mi.Bool) -> mi.Color3f:
    """Return one probe's irradiance on a surface that faces `n`."""
    first = state.probes.first + 6 * probe
    total = mi.Color3f(0.0)
    for axis, component in enumerate((n.x, n.y, n.z)):
        plus = dr.gather(mi.Vector4f, state.light, first + 2 * axis, active)
        minus = dr.gather(mi.Vector4f, state.light, first + 2 * axis + 1, active)
        even, odd = 0.5 * (component * component + component), 0.5 * (component * component - component)
        total += even * mi.Color3f(plus.x, plus.y, plus.z) + odd * mi.Color3f(minus.x, minus.y, minus.z)
    return mi.Color3f(dr.fmax(total.x, 0.0), dr.fmax(total.y, 0.0), dr.fmax(total.z, 0.0))
