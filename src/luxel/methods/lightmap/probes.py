"""The probe grid: light in open space, from the same clusters, for what moves and for free points.

A probe is six texels that look along the axes. Between them irradiance is the polynomial through the six values that is
exact for light of the first order: E(n) = sum over axes of n_i^2 (E+ + E-) / 2 + n_i (E+ - E-) / 2.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.kernels.trace import offset_origin, trace_occluded
from luxel.methods.lightmap.state import LightmapState, Probes
from luxel.scene.device import Scene

AXES = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], np.float64)
"""Directions of a probe's six rows."""
INSIDE = 0.25
"""Share of rays that meet the inside of things from which a probe does not count."""


@dataclass
class ProbeGrid:
    """Where the probes stand: in the middles of cubes."""

    lower: np.ndarray
    size: float
    counts: tuple[int, int, int]

    @property
    def total(self) -> int:
        """Number of probes."""
        return int(np.prod(self.counts))

    def positions(self) -> np.ndarray:
        """Return (P, 3), x fastest."""
        z, y, x = np.meshgrid(*(np.arange(n) for n in reversed(self.counts)), indexing="ij")
        index = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
        return self.lower + (index + 0.5) * self.size


def make_probe_grid(scene: Scene, target: int) -> ProbeGrid:
    """Return a grid of at most about `target` probes over the scene's bounds."""
    extent = np.maximum(scene.host.upper - scene.host.lower, 1e-6)
    size = float((np.prod(extent) / target) ** (1.0 / 3.0))
    while np.prod(np.maximum(np.round(extent / size), 1)) > target:
        size *= 1.05
    counts = np.maximum(np.round(extent / size), 1).astype(int)
    size = float((extent / counts).max())
    lower = 0.5 * (scene.host.lower + scene.host.upper) - 0.5 * counts * size
    return ProbeGrid(lower, size, (int(counts[0]), int(counts[1]), int(counts[2])))


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


__all__ = ["AXES", "ProbeGrid", "Probes", "make_probe_grid", "read_probes"]
