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
    TEXELS_A_WORD,
    DepthFormat,
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
LIFT = 0.01
"""Radii that a point is lifted along its normal before it is looked for: on its own plane it is on the horizon."""
LANES = 24576
"""Words that get rays in a frame at most."""
SHORT_RAYS = LANES * TEXELS_A_WORD
"""Short rays a frame at most."""
STILL_SAMPLES = 8
"""Samples of each texel after which a map is done where nothing moves."""
FIRST_DEVIATION, BLOCK_DEVIATION = 0.05, 0.25
"""Shares of its depth that a texel with one sample may deviate by, and one that shares its block's."""
SLACK = 2.0
"""How many times smaller than at its map's making a surfel's radius may be until it gets a new map."""


def maps_of(state: GibsState) -> tuple[DepthMaps, DepthFormat]:
    """Return the maps of a state that has them, and how they lie."""
    assert state.depth is not None and state.settings.depth is not None
    return state.depth, state.settings.depth


def radius_of(state: GibsState, surfel: mi.UInt32) -> mi.Float:
    """Return the surfels' radius in metres."""
    return radius_of_size(state, dr.gather(mi.UInt32, state.surfels.size, surfel))


@dataclass
class Births:
    """Which surfels get a new map in this frame."""

    served: mi.Bool
    """One entry a surfel."""
    queue: mi.UInt32
    """Their ids."""
    count: mi.UInt32
    coarse: mi.Bool
    """Many are born: one ray serves for a block of 2 x 2 texels, as each must have a map before it lights anything."""


@dataclass
class Work:
    """What each lane does: refresh a word of a map, or make one or a block of 2 x 2 texels of a new map."""

    surfel: mi.UInt32
    word: mi.UInt32
    """The block's upper word."""
    active: mi.Bool
    refreshes: mi.Bool
    block: mi.Bool
    """One ray serves all texels of the block."""
    first: mi.Bool
    """The texels have no rays of their own yet."""
    count: mi.Float
    """Rays that they have had."""


def update_depth(scene: Scene, state: GibsState, frame: Frame) -> DepthMaps:
    """Cast the short rays of this frame: maps for newborn surfels, one word each for the others by turns."""
    (maps, layout), surfels = maps_of(state), state.surfels
    index = dr.arange(mi.UInt32, state.settings.capacity)
    row = dr.gather(mi.Vector4f, maps.rows, index)
    alive = surfels.object_id != 0
    reach = DIAMETER * radius_of(state, index)
    mapped = alive & (surfels.ray_index > 0) & (row.y >= 0.999 * reach) & (row.y <= 1.001 * SLACK * reach)
    births = _choose_births(layout, alive & ~mapped)
    # Where nothing moves, a map is done some day.
    moves = scene.features.moving or scene.features.deforming
    open_ended = mapped if moves else mapped & (row.w < STILL_SAMPLES * layout.words_a_map)
    extent = dr.maximum(dr.max(dr.select(alive, index + 1, 0)), 1)
    work, left = _share_out(maps, layout, births, open_ended, row.w, extent)

    held = dr.select(births.served, reach, dr.select(mapped, row.y, 0.0))
    tangent = pack_normal(mi.Normal3f(world_tangent(scene, state)))
    words, least = _cast(scene, state, frame, work, held, tangent)
    # As whole numbers, whose minimum every device has: floats of 0 and more have the order of their bits.
    nearest = dr.reinterpret_array(mi.UInt32, dr.select(births.served, dr.inf, row.x))
    dr.scatter_reduce(dr.ReduceOp.Min, nearest, dr.reinterpret_array(mi.UInt32, least), work.surfel, work.active)
    turns = dr.select(births.served, dr.select(births.coarse, 0.0, float(layout.words_a_map)), row.w)
    dr.scatter_add(turns, mi.Float(1.0), work.surfel, work.refreshes)
    # Gathers, since what has been scattered to is not read in the same kernel.
    nearest = dr.reinterpret_array(mi.Float, dr.gather(mi.UInt32, nearest, index))
    turns = dr.gather(mi.Float, turns, index)
    rows = dr.empty(mi.Float, 4 * state.settings.capacity)
    dr.scatter(rows, mi.Vector4f(nearest, held, tangent, turns), index)
    return DepthMaps(words, rows, maps.cursor + left)


def _choose_births(layout: DepthFormat, wanting: mi.Bool) -> Births:
    """Return which of the surfels that need a map get one now, by rank."""
    one = dr.select(wanting, mi.UInt32(1), 0)
    count, rank = dr.sum(one), dr.prefix_reduce(dr.ReduceOp.Add, one)
    most = LANES // layout.blocks
    served = wanting & (rank < most)
    queue = dr.zeros(mi.UInt32, most)
    dr.scatter(queue, dr.arange(mi.UInt32, dr.width(wanting)), rank, served)
    return Births(served, queue, dr.minimum(count, most), count * layout.words_a_map > LANES)


def _share_out(
    maps: DepthMaps, layout: DepthFormat, births: Births, open_ended: mi.Bool, turns: mi.Float, extent: mi.UInt32
) -> tuple[Work, mi.UInt32]:
    """Return each lane's work, and how many lanes births leave: there the surfels before `extent` take turns."""
    words = layout.words_a_map
    lanes_each = dr.select(births.coarse, mi.UInt32(layout.blocks), words)
    lane, used = dr.arange(mi.UInt32, LANES), births.count * lanes_each
    born, turn = lane < used, lane - used
    part = lane % lanes_each
    upper = (part // layout.words_a_row) * (2 * layout.words_a_row) + part % layout.words_a_row
    number = maps.cursor + turn
    refreshed = number % extent
    refreshes = ~born & (turn < extent) & dr.gather(mi.Bool, open_ended, refreshed)
    surfel = dr.select(born, dr.gather(mi.UInt32, births.queue, lane // lanes_each, born), refreshed)
    word = dr.select(born, dr.select(births.coarse, upper, part), (number // extent + mix(surfel)) % words)
    rounds = dr.floor(dr.gather(mi.Float, turns, surfel, refreshes) * (1.0 / words))
    first = born | (rounds < 1.0)
    return Work(
        surfel, word, born | refreshes, refreshes, born & births.coarse, first, dr.fmax(rounds, 1.0)
    ), LANES - used


def _cast(
    scene: Scene, state: GibsState, frame: Frame, work: Work, reach: mi.Float, tangent: mi.Float
) -> tuple[mi.UInt32, mi.Float]:
    """Cast the rays of each lane; return all words, and the nearest depth of each lane, metres."""
    (maps, layout), surfels = maps_of(state), state.surfels
    active, surfel = work.active, work.surfel
    far = dr.gather(mi.Float, reach, surfel, active)
    depths = _trace_texels(scene, state, frame, work, reach, tangent)
    lane = dr.arange(mi.UInt32, LANES) * TEXELS_A_WORD
    place = surfel * layout.words_a_map + work.word
    before = dr.gather(mi.UInt32, maps.words, place, active)
    seed = dr.gather(mi.UInt32, surfels.seed, surfel, active)
    after, least = mi.UInt32(0), mi.Float(dr.inf)
    for part in range(TEXELS_A_WORD):
        seed_a, seed_b = hash_pair(seed + work.word * TEXELS_A_WORD + part, frame.index)
        found = dr.gather(mi.Float, depths, lane + dr.select(work.block, mi.UInt32(0), part), active)
        unsure = dr.select(found < 1.0, found, 0.0) * dr.select(work.block, BLOCK_DEVIATION, FIRST_DEVIATION)
        mean, deviation = blend_depth(*unpack_texel(before, part), found, work.count)
        mean, deviation = dr.select(work.first, found, mean), dr.select(work.first, unsure, deviation)
        dither = mi.Point2f(to_unit(mix(seed_a + 1)), to_unit(mix(seed_b + 1)))
        after |= pack_texel(mean, deviation, part, dither)
        least = dr.fmin(least, dr.fmax(mean - dr.fmax(deviation, LEAST_DEVIATION), 0.0) * far)
    words = mi.UInt32(maps.words)
    _write(words, after, place, layout.words_a_row, active, work.block)
    return words, least


def _trace_texels(
    scene: Scene, state: GibsState, frame: Frame, work: Work, reach: mi.Float, tangent: mi.Float
) -> mi.Float:
    """Return what a ray in each texel of the lanes' words met, in shares of the reach: the four of a word in a row.

    Of a block only the first has a ray. A lane for each ray, not four in turn for each word: a GPU has the room.
    """
    layout, surfels = maps_of(state)[1], state.surfels
    dr.eval(work, reach, tangent)
    ray = dr.arange(mi.UInt32, SHORT_RAYS)
    lane, part = ray // TEXELS_A_WORD, ray % TEXELS_A_WORD
    block = dr.gather(mi.Bool, work.block, lane)
    active = dr.gather(mi.Bool, work.active, lane) & ((part == 0) | ~block)
    surfel = dr.gather(mi.UInt32, work.surfel, lane, active)
    texel = dr.gather(mi.UInt32, work.word, lane, active) * TEXELS_A_WORD + part
    first = dr.gather(mi.Bool, work.first, lane, active)
    p, n = dr.gather(mi.Point3f, surfels.p, surfel, active), dr.gather(mi.Normal3f, surfels.n, surfel, active)
    seed = dr.gather(mi.UInt32, surfels.seed, surfel, active)
    far = dr.gather(mi.Float, reach, surfel, active)
    s, t = frame_of(mi.Vector3f(n), dr.gather(mi.Float, tangent, surfel, active))
    # Of a first sample the middle stands best for all of the texel, or of the block.
    seed_a, seed_b = hash_pair(seed + texel, frame.index)
    jitter = dr.select(first, mi.Point2f(0.5), mi.Point2f(to_unit(seed_a), to_unit(seed_b)))
    jitter = dr.select(block, mi.Point2f(1.0), jitter)
    local = square_to_hemisphere(point_in_texel(texel, layout.side, jitter), WARP)
    direction = dr.normalize(s * local.x + t * local.y + mi.Vector3f(n) * local.z)
    hit = trace_closest(scene, offset_origin(scene, p, n), direction, active, limit=far)
    found = dr.select(hit.valid, dr.fmin(hit.t / dr.fmax(far, 1e-20), 1.0), 1.0)
    dr.eval(found)
    return found


@dr.syntax
def _write(words: mi.UInt32, value: mi.UInt32, place: mi.UInt32, below: int, active: mi.Bool, block: mi.Bool) -> None:
    """Write each lane's word, and that of a block into the row below as well."""
    going = mi.Bool(active)
    turn = mi.UInt32(0)
    # A loop, since two scatters into one array would be two kernels, and all rays cast twice.
    while going:
        dr.scatter(words, value, place + turn * below, going)
        going &= block & (turn == 0)
        turn += 1


@dr.syntax
def visibility(
    state: GibsState, surfel: mi.UInt32, p: mi.Point3f, n: mi.Normal3f, active: mi.Bool | bool = True
) -> tuple[mi.Float, mi.Float]:
    """Return the share, 0..1, of a surfel's light that reaches points `p` with normals `n`, and of its coverage there.

    Both are 1 where the surfel has no map yet. The coverage is whole while the map is coarse: what that hides too much
    must not have surfels placed for good.
    """
    maps, layout = maps_of(state)
    row = dr.gather(mi.Vector4f, maps.rows, surfel, active)
    place = dr.gather(mi.Vector4f, state.geometry, surfel, active)
    # The reach is the diameter, but for sizes that have changed since: near enough for a lift.
    away = p - mi.Point3f(place.x, place.y, place.z) + mi.Vector3f(n) * (LIFT / DIAMETER * row.y)
    squared = dr.squared_norm(away)
    share, covered = mi.Float(1.0), mi.Float(1.0)
    # A branch, unlike a mask, leaves out the work where no lane asks: nearer than all that is around, all is seen.
    if active & (row.y > 0.0) & (squared > dr.square(row.x)):
        normal = mi.Vector3f(unpack_normal(place.w))
        s, t = frame_of(normal, row.z)
        local = mi.Vector3f(dr.dot(away, s), dr.dot(away, t), dr.dot(away, normal))
        texel = texel_of(hemisphere_to_square(local, WARP), layout.side)
        word = dr.gather(mi.UInt32, maps.words, surfel * layout.words_a_map + texel // TEXELS_A_WORD)
        mean, deviation = unpack_texel(word, texel % TEXELS_A_WORD)
        share = chebyshev(dr.sqrt(squared) / row.y, mean, deviation)
        covered = dr.select(row.w < layout.words_a_map, 1.0, share)
    return share, covered


def read_maps(state: GibsState) -> tuple[mi.Bool, mi.Bool]:
    """Return which surfels have a map, and in which of them something lies where their light would reach."""
    index = dr.arange(mi.UInt32, state.settings.capacity)
    row = dr.gather(mi.Vector4f, maps_of(state)[0].rows, index)
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
