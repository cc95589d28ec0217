"""What can be drawn of the surfels on the surfaces they lie on: which one is where, what each knows, what they cost."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from luxel.kernels.grid import slot_of_point
from luxel.kernels.packing import unpack_normal
from luxel.kernels.records import Surface
from luxel.methods.gibs.gather import gather_irradiance
from luxel.methods.gibs.surfels import GibsState
from luxel.methods.inspect import Look, Reading

GIBS_LOOKS = (
    Look("surfels", "surfels as discs, each in a colour of its own", "item"),
    Look("surfel-irradiance", "surfels as discs, each by its irradiance", "light", "W/m²"),
    Look("coverage", "summed weights of the surfels; below 1, new ones are placed", "number", "", (0.0, 4.0)),
    Look("cell-occupancy", "surfels in the grid cell's slot: what a look-up reads", "cost", "surfels"),
    Look("rays", "rays that each surfel has cast", "number", "rays", logarithmic=True),
    Look("age", "samples in each surfel's mean", "number", "samples", logarithmic=True),
    Look("inconsistency", "how far short and long mean are apart, over the noise", "cost"),
)


def read_surfels(state: GibsState, surface: Surface, look: str) -> Reading:
    """Return what `look`, one of `GIBS_LOOKS`, shows at a surface."""
    p, n, active = surface.p, surface.n_geometric, surface.active
    if look == "coverage":
        return Reading(gather_irradiance(state, p, n, active).coverage, active)
    if look == "cell-occupancy":
        slot = slot_of_point(state.lattice, p)
        starts = state.grid.starts
        count = dr.gather(mi.UInt32, starts, slot + 1, active) - dr.gather(mi.UInt32, starts, slot, active)
        return Reading(mi.Float(count), active)
    surfel, place, found = nearest_surfel(state, p, n, active)
    surfels = state.surfels
    value: mi.Float | mi.UInt32 | mi.Color3f
    if look == "surfels":
        # A surfel's seed is a hash of where it was placed: its colour does not depend on its slot.
        value = dr.gather(mi.UInt32, surfels.seed, surfel, found)
    elif look == "surfel-irradiance":
        value = dr.gather(mi.Color3f, surfels.estimate.mean, surfel, found)
    elif look == "rays":
        value = mi.Float(dr.gather(mi.UInt32, surfels.ray_index, surfel, found) * state.settings.rays_per_surfel)
    else:
        held = surfels.estimate.count if look == "age" else surfels.estimate.inconsistency
        value = dr.gather(mi.Float, held, surfel, found)
    return Reading(value, found, place, mi.Float(state.dials.radius))


@dr.syntax
def nearest_surfel(
    state: GibsState, p: mi.Point3f, n: mi.Normal3f, active: mi.Bool
) -> tuple[mi.UInt32, mi.Float, mi.Bool]:
    """Return the surfel whose middle is nearest to each point, how near in radii, and whether there is one.

    Distances are those of the look-up, so points off a surfel's plane count as farther; surfels that face away do not
    count.
    """
    slot = slot_of_point(state.lattice, p)
    item = dr.gather(mi.UInt32, state.grid.starts, slot, active)
    end = dr.gather(mi.UInt32, state.grid.starts, slot + 1, active)
    least, nearest = mi.Float(1.0), mi.UInt32(0)
    going = active & (item < end)
    while going:
        surfel = dr.gather(mi.UInt32, state.grid.items, item, going)
        row = dr.gather(mi.Vector4f, state.geometry, surfel, going)
        normal = mi.Vector3f(unpack_normal(row.w))
        offset = p - mi.Point3f(row.x, row.y, row.z)
        squared = dr.squared_norm(offset) + state.dials.plane_stretch * dr.square(dr.dot(offset, normal))
        d2 = squared / dr.square(state.dials.radius)
        nearer = going & (d2 < least) & (dr.dot(normal, mi.Vector3f(n)) > 0.0)
        least = dr.select(nearer, d2, least)
        nearest = dr.select(nearer, surfel, nearest)
        item += 1
        going &= item < end
    return nearest, dr.sqrt(least), active & (least < 1.0)
