"""A method of our own: paths traced from the pixels fill voxels with irradiance. Arguments: [output folder] [size]."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from itertools import product

import drjit as dr
import mitsuba as mi

import luxel
from luxel.methods import CHECKS, Light, Method
from luxel.methods.path_tracer import trace_indirect
from luxel.metrics import ambient_irradiance, regional


@dataclass
class State:
    sums: mi.Float  # for each voxel and side (+x -x +y -y +z -z): red, green, blue and number of samples, fading
    lower: mi.Point3f
    cell: mi.Float  # metres
    keep: mi.Float
    side: int = 24  # voxels an axis; a plain number is a constant of the kernels


class Voxels(Method):
    @dataclass
    class Params:
        keep: float = 0.97
        """Share of the past that a frame keeps. Higher: calmer. Lower: follows changes sooner."""

    name = "voxels"
    claims = CHECKS - {"sealed", "furnace"}  # thin walls leak; some 30 frames of single paths are noisier than 0.5 %

    def build(self, scene, params, seed, *, workdir=None, progress=None):
        cell = float(max(scene.host.upper - scene.host.lower)) / (State.side - 2)
        lower = mi.Point3f(*(float(value) - cell for value in scene.host.lower))
        state = State(dr.zeros(mi.Float, 4 * 6 * State.side**3), lower, mi.Float(cell), mi.Float(params.keep))
        dr.make_opaque(state)  # from here on data, which no kernel has built in
        return state

    def query(self, scene, state, surface):
        total = mi.Vector4f(0.0)
        for index, weight in around(state, surface):
            total += weight * dr.gather(mi.Vector4f, state.sums, index, surface.active)
        return Light(mi.Color3f(total.x, total.y, total.z) / dr.fmax(total.w, 1e-3), mi.Color3f(0.0), total.w)

    def observe(self, scene, state, frame, gbuffer, light):
        seen, sums = gbuffer.surface, state.sums * state.keep
        sample = trace_indirect(scene, seen, frame.seed + frame.index * 4099, gbuffer.lane, seen.active)
        for index, weight in around(state, seen):
            dr.scatter_add(sums, weight * mi.Vector4f(*sample, 1.0), index, seen.active)
        return replace(state, sums=sums)


def around(state, surface):
    """Yield the entries of the 8 voxels around points, on the side that they face, and their trilinear weights."""
    n, a = surface.n_geometric, dr.abs(surface.n_geometric)
    y_or_z = dr.select(a.y > a.z, dr.select(n.y > 0, mi.UInt32(2), 3), dr.select(n.z > 0, mi.UInt32(4), 5))
    side = dr.select((a.x > a.y) & (a.x > a.z), dr.select(n.x > 0, mi.UInt32(0), 1), y_or_z)
    q = (surface.p - state.lower) / state.cell + 0.5 * n
    for corner in product((0, 1), repeat=3):
        v = dr.clip(dr.floor(q) + mi.Vector3f(*corner), 0, state.side - 1)
        w = dr.fmax(1 - dr.abs(q - v), 0)
        yield mi.UInt32((v.z * state.side + v.y) * state.side + v.x) * 6 + side, w.x * w.y * w.z


if __name__ == "__main__":
    out = sys.argv[1] if len(sys.argv) > 1 else "out"
    size = int(sys.argv[2]) if len(sys.argv) > 2 else 256
    luxel.METHODS["voxels"] = Voxels()
    truth = luxel.render_truth("cornell-box", size=(size, size), spp=256)
    for method, params in (("ambient", {"irradiance": ambient_irradiance(truth.layers)}), ("voxels", None)):
        renderer = luxel.Renderer("cornell-box", method, params, size=(size, size))
        renderer.run(64)
        print(f"{method}: regional error {regional(renderer.layers(), truth.layers):.3f}")
        luxel.write_image(f"{out}/{method}.png", renderer.image())
