"""What can be drawn of the surfels on the surfaces they lie on: which one is where, what each knows, what they cost."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from luxel.kernels.grid import finest_level, levels_at, slot_of_point
from luxel.kernels.records import Surface
from luxel.methods.gibs.gather import gather_irradiance, stretched_distance
from luxel.methods.gibs.sizes import radius_of_size
from luxel.methods.gibs.surfels import GibsState
from luxel.methods.inspect import Look, Reading

GIBS_LOOKS = (
    Look("surfels", "surfels as discs, each in a colour of its own", "item"),
    Look("surfel-irradiance", "surfels as discs, each by its irradiance", "light", "W/m²"),
    Look("coverage", "summed weights of the surfels; below 1, new ones are placed", "number", "", (0.0, 4.0)),
    Look("cell-occupancy", "surfels in the grid cells' slots: what a look-up reads at most", "cost", "surfels"),
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
        return Reading(listed_surfels(state, p, active), active)
    surfel, place, found = nearest_surfel(state, p, n, active)
    surfels = state.surfels
    value: mi.Float | mi.UInt32 | mi.Color3f
    if look == "surfels":
        # A surfel's seed is a hash of where it was placed: its colour does not depend on its slot.
        value = dr.gather(mi.UInt32, surfels.seed, surfel, found)
    elif look == "surfel-irradiance":
        value = dr.gather(mi.Color3f, surfels.estimate.mean, surfel, found)
    elif look == "rays":
        value = mi.Float(dr.gather(mi.UInt32, surfels.ray_index, surfel, found))
    else:
        held = surfels.estimate.count if look == "age" else surfels.estimate.inconsistency
        value = dr.gather(mi.Float, held, surfel, found)
    radius = radius_of_size(state, dr.gather(mi.UInt32, surfels.size, surfel, found))
    return Reading(value, found, place, radius)


@dr.syntax
def nearest_surfel(
    state: GibsState, p: mi.Point3f, n: mi.Normal3f, active: mi.Bool
) -> tuple[mi.UInt32, mi.Float, mi.Bool]:
    """Return the surfel whose middle is nearest to each point, how near in radii, and whether there is one.

    Distances are those of the look-up, so points off a surfel's plane count as farther; surfels that face away do not
    count. Where there are surfels on several levels of the grid, those of the finest that has one there are asked.
    """
    least, nearest = mi.Float(1.0), mi.UInt32(0)
    levels = levels_at(state.lattice, state.grid, p, active)
    looking = active & (levels != 0)
    while looking:
        level = finest_level(levels)
        slot = slot_of_point(state.lattice, p, level if state.lattice.levels > 1 else None)
        item = dr.gather(mi.UInt32, state.grid.starts, slot, looking)
        end = dr.gather(mi.UInt32, state.grid.starts, slot + 1, looking)
        going = looking & (item < end)
        while going:
            surfel = dr.gather(mi.UInt32, state.grid.items, item, going)
            d2, normal = stretched_distance(state, surfel, p, going)
            nearer = going & (d2 < least) & (dr.dot(normal, mi.Vector3f(n)) > 0.0)
            least = dr.select(nearer, d2, least)
            nearest = dr.select(nearer, surfel, nearest)
            item += 1
            going &= item < end
        levels = levels & ~(mi.UInt32(1) << level)
        looking = looking & (levels != 0) & (least >= 1.0)
    return nearest, dr.sqrt(least), active & (least < 1.0)


@dr.syntax
def listed_surfels(state: GibsState, p: mi.Point3f, active: mi.Bool) -> mi.Float:
    """Return how many entries the lists for each point have, of all levels."""
    count = mi.UInt32(0)
    levels = levels_at(state.lattice, state.grid, p, active)
    looking = active & (levels != 0)
    while looking:
        level = finest_level(levels)
        slot = slot_of_point(state.lattice, p, level if state.lattice.levels > 1 else None)
        starts = state.grid.starts
        count += dr.gather(mi.UInt32, starts, slot + 1, looking) - dr.gather(mi.UInt32, starts, slot, looking)
        levels = levels & ~(mi.UInt32(1) << level)
        looking = looking & (levels != 0)
    return mi.Float(count)
