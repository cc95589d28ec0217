"""Radial depth: what each surfel sees around it, so that its light stays on this side of walls.

After Ekberg 2022, section 3.1.4 (GIBS): a small map of the hemisphere above each surfel keeps the mean distance of what
lies there and its deviation, and Chebyshev's inequality bounds the share of light that reaches farther (Donnelly and
Lauritzen 2006). A newborn surfel casts one short ray a texel before it lights anything; from then on its texels take
turns. The rays are its own: they spread over the map, and the light's are too few near the horizon, where the other
points of a floor are seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from luxel.kernels.hemi_octahedral import hemisphere_to_square, point_in_texel, square_to_hemisphere, texel_of
from luxel.kernels.packing import pack_normal, unpack_normal
from luxel.kernels.sampling import hash_pair, mix, to_unit
from luxel.kernels.trace import offset_origin, trace_closest
from luxel.kernels.transform import transform_vector
from luxel.methods.base import Frame
from luxel.methods.gibs.depth_maps import (
    LEAST_DEVIATION,
    DepthMaps,
    blend_depth,
    chebyshev,
    pack_texel,
    unpack_texel,
)
from luxel.methods.gibs.sizes import radius_of_size
from luxel.methods.gibs.surfels import GibsState
from luxel.scene.device import Scene

WARP = 4.0
"""How much the map stretches directions along the normal."""
DIAMETER = 2.0
"""Radii that the short rays are long, and depths are kept up to."""
LIFT = 0.03
"""Radii that a point is lifted along its normal before it is looked for: on its own plane it is on the horizon."""
SHORT_RAYS = 49152
"""Short rays a frame at most."""
STILL_SAMPLES = 16
"""Samples of each texel after which a map is done where nothing moves."""
SLACK = 2.0
"""How many times smaller than at its map's making a surfel's radius may be until it gets a new map."""


def radius_of(state: GibsState, surfel: mi.UInt32) -> mi.Float:
    """Return the surfels' radius in metres."""
    if state.lattice.levels == 1:
        return mi.Float(state.dials.radius)
    return radius_of_size(state, dr.gather(mi.UInt32, state.surfels.size, surfel))


@dataclass
class _Work:
    """What each lane does: one word of one surfel's map."""

    surfel: mi.UInt32
    word: mi.UInt32
    active: mi.Bool
    born: mi.Bool
    """The whole map is new."""


def update_depth(scene: Scene, state: GibsState, frame: Frame) -> DepthMaps:
    """Cast the short rays of this frame: whole maps for newborn surfels, one word each for the others by turns."""
    maps, layout = state.depth, state.settings.depth
    capacity, words = state.settings.capacity, layout.words_a_map
    surfels = state.surfels
    index = dr.arange(mi.UInt32, capacity)
    row = dr.gather(mi.Vector4f, maps.rows, index)
    alive = surfels.object_id != 0

    # Who has a map, who needs one, and who gets one now.
    reach = DIAMETER * radius_of(state, index)
    mapped = alive & (surfels.ray_index > 0) & (row.y >= 0.999 * reach) & (row.y <= 1.001 * SLACK * reach)
    wanting = alive & ~mapped
    moves = scene.features.moving or scene.features.deforming
    settled = mi.Bool(False) if moves else row.w >= STILL_SAMPLES * words
    rank = dr.prefix_reduce(dr.ReduceOp.Add, dr.select(wanting, mi.UInt32(1), 0))
    births = SHORT_RAYS // (layout.side * layout.side)
    served = wanting & (rank < births)
    queue = dr.zeros(mi.UInt32, births)
    dr.scatter(queue, index, rank, served)
    count = dr.minimum(dr.sum(dr.select(wanting, mi.UInt32(1), 0)), births)

    # All others take turns with what rays are left.
    lane = dr.arange(mi.UInt32, births * words)
    born = lane < count * words
    turn = lane - count * words
    extent = dr.maximum(dr.max(dr.select(alive, index + 1, 0)), 1)
    number = maps.cursor + turn
    surfel = dr.select(born, dr.gather(mi.UInt32, queue, lane // words, born), number % extent)
    word = dr.select(born, lane % words, (number // extent + mix(surfel)) % words)
    active = born | ((turn < extent) & dr.gather(mi.Bool, mapped & ~settled, surfel))
    held = dr.select(mapped, row.y, 0.0)
    held = dr.select(served, reach, held)
    tangent = pack_normal(mi.Normal3f(world_tangent(scene, state)))
    work = _Work(surfel, word, active, born)
    words_now, least = _cast(scene, state, frame, work, held, tangent)

    # The nearest depth of each map, which spares most look-ups in it.
    nearest = dr.select(mapped, row.x, 0.0)
    of_newborn = dr.block_reduce(dr.ReduceOp.Min, least, words)
    nearest = dr.select(served, dr.gather(mi.Float, of_newborn, rank, served), nearest)
    dr.scatter_reduce(dr.ReduceOp.Min, nearest, least, surfel, active & ~born)
    rows = dr.empty(mi.Float, 4 * capacity)
    # A gather, since what has been scattered to is not read in the same kernel.
    nearest = dr.gather(mi.Float, nearest, index)
    turns = dr.select(served, 0.0, row.w)
    dr.scatter_add(turns, mi.Float(1.0), surfel, active & ~born)
    turns = dr.gather(mi.Float, turns, index)
    dr.scatter(rows, mi.Vector4f(nearest, held, tangent, turns), index)
    return DepthMaps(words_now, rows, maps.cursor + births * words - count * words)


def _cast(
    scene: Scene, state: GibsState, frame: Frame, work: _Work, reach: mi.Float, tangent: mi.Float
) -> tuple[mi.UInt32, mi.Float]:
    """Cast the rays of each lane's word; return all words, and the nearest depth of each lane, metres."""
    maps, layout, surfels = state.depth, state.settings.depth, state.surfels
    active, surfel = work.active, work.surfel
    p = dr.gather(mi.Point3f, surfels.p, surfel, active)
    n = dr.gather(mi.Normal3f, surfels.n, surfel, active)
    far = dr.gather(mi.Float, reach, surfel, active)
    s, t = frame_of(mi.Vector3f(n), dr.gather(mi.Float, tangent, surfel, active))
    origin = offset_origin(scene, p, n)
    place = surfel * layout.words_a_map + work.word
    before = dr.gather(mi.UInt32, maps.words, place, active)
    after, least = mi.UInt32(0), mi.Float(dr.inf)
    for part in range(layout.texels_a_word):
        texel = work.word * layout.texels_a_word + part
        seed_a, seed_b = hash_pair(dr.gather(mi.UInt32, surfels.seed, surfel, active) + texel, frame.index)
        # A newborn map has one sample a texel: the middle stands best for all of it.
        jitter = dr.select(work.born, mi.Point2f(0.5), mi.Point2f(to_unit(seed_a), to_unit(seed_b)))
        local = square_to_hemisphere(point_in_texel(texel, layout.side, jitter), WARP)
        direction = dr.normalize(s * local.x + t * local.y + mi.Vector3f(n) * local.z)
        hit = trace_closest(scene, origin, direction, active, limit=far)
        found = dr.select(hit.valid, dr.fmin(hit.t / dr.fmax(far, 1e-20), 1.0), 1.0)
        mean, deviation = unpack_texel(before, part, layout)
        mean, deviation = blend_depth(mean, deviation, found)
        mean, deviation = dr.select(work.born, found, mean), dr.select(work.born, 0.0, deviation)
        dither = mi.Point2f(to_unit(mix(seed_a + 1)), to_unit(mix(seed_b + 1)))
        after |= pack_texel(mean, deviation, part, layout, dither)
        least = dr.fmin(least, (mean - dr.fmax(deviation, LEAST_DEVIATION)) * far)
    words = mi.UInt32(maps.words)
    dr.scatter(words, after, place, active)
    return words, least


@dr.syntax
def visibility(state: GibsState, surfel: mi.UInt32, p: mi.Point3f, n: mi.Normal3f, active: mi.Bool) -> mi.Float:
    """Return the share, 0..1, of a surfel's light that reaches the points `p` with normals `n`.

    1 where it is not asked for, and where the surfel has no map yet.
    """
    maps, layout = state.depth, state.settings.depth
    share = mi.Float(1.0)
    # Branches, unlike masks, leave out the work where no lane asks.
    if active:
        row = dr.gather(mi.Vector4f, maps.rows, surfel)
        place = dr.gather(mi.Vector4f, state.geometry, surfel)
        away = p - mi.Point3f(place.x, place.y, place.z) + mi.Vector3f(n) * (LIFT * radius_of(state, surfel))
        squared = dr.squared_norm(away)
        if (row.y > 0.0) & (squared > row.x * dr.abs(row.x)):
            normal = mi.Vector3f(unpack_normal(place.w))
            s, t = frame_of(normal, row.z)
            local = mi.Vector3f(dr.dot(away, s), dr.dot(away, t), dr.dot(away, normal))
            texel = texel_of(hemisphere_to_square(local, WARP), layout.side)
            index = surfel * layout.words_a_map + texel // layout.texels_a_word
            word = dr.gather(mi.UInt32, maps.words, index)
            mean, deviation = unpack_texel(word, texel % layout.texels_a_word, layout)
            share = chebyshev(dr.sqrt(squared) / row.y, mean, deviation)
    return share


def read_maps(state: GibsState) -> tuple[mi.Bool, mi.Bool]:
    """Return which surfels have a map, and in which of them something lies where their light would reach."""
    index = dr.arange(mi.UInt32, state.settings.capacity)
    row = dr.gather(mi.Vector4f, state.depth.rows, index)
    return row.y > 0.0, row.x < (1.0 + LIFT) * radius_of(state, index)


def world_tangent(scene: Scene, state: GibsState) -> mi.Vector3f:
    """Return each surfel's tangent in the world, which turns with its object."""
    surfels = state.surfels
    if not scene.features.moving:
        return tangent_of(mi.Vector3f(surfels.n))
    local = tangent_of(mi.Vector3f(surfels.n_object))
    moved = transform_vector(scene.geometry.to_world, surfels.object_id, local, surfels.object_id != 0)
    n = mi.Vector3f(surfels.n)
    flat = moved - n * dr.dot(moved, n)
    length = dr.squared_norm(flat)
    return dr.select(length > 1e-12, flat * dr.rsqrt(dr.fmax(length, 1e-12)), tangent_of(n))


def tangent_of(n: mi.Vector3f) -> mi.Vector3f:
    """Return a unit vector across the unit normal `n`; it jumps only near one direction that walls hardly have."""
    across = dr.cross(n, mi.Vector3f(0.2672612, 0.5345225, 0.8017837))
    other = dr.cross(n, mi.Vector3f(0.8017837, -0.5345225, 0.2672612))
    across = dr.select(dr.squared_norm(across) > 1e-4, across, other)
    return dr.normalize(across)


def frame_of(n: mi.Vector3f, tangent: mi.Float) -> tuple[mi.Vector3f, mi.Vector3f]:
    """Return the two axes of a map beside the normal `n`, from the packed tangent."""
    s = unpack_normal(tangent)
    return s, dr.cross(n, s)
