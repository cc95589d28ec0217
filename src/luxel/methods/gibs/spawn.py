"""Where surfels are placed: on screen tiles that lack coverage, and where rays hit uncovered ground.

Ekberg 2022, section 4.5, for the screen. Ids come from the free list by a prefix sum over the accepted candidates, so
the order, and with it the image, does not depend on which thread came first.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from luxel.kernels.camera import pixel_width
from luxel.kernels.gbuffer import GBuffer
from luxel.kernels.grid import list_length, slot_of_point
from luxel.kernels.mean_estimator import Estimate
from luxel.kernels.records import Light, Surface
from luxel.kernels.sampling import hash_pair, to_unit
from luxel.kernels.surface import surface_at
from luxel.kernels.transform import transform_normal
from luxel.methods.base import Frame
from luxel.methods.gibs.budget import RayPlan
from luxel.methods.gibs.eyes import SeenLight
from luxel.methods.gibs.normal_light import copy_normal_light
from luxel.methods.gibs.recycle import rays_lack
from luxel.methods.gibs.sizes import level_of_size, radius_of_size
from luxel.methods.gibs.surfels import FreeList, GibsState, Sight, Surfels
from luxel.methods.gibs.trace import SurfelRayResults
from luxel.methods.gibs.view import pixel_sizes
from luxel.scene.device import Scene

NO_CANDIDATE = 0xFFFFFFFF
KNOWN = 0.5
"""Coverage by surfels of any size from which on the light at a pixel is worth handing down."""


@dataclass
class SpawnCandidates:
    """Where a surfel may be put."""

    prim_id: mi.UInt32
    barycentric: mi.Point2f
    on_back: mi.Bool
    wanted: mi.Bool
    size: mi.UInt32
    """Of the surfel."""
    light: mi.Color3f
    """Irradiance that is known there already; 0 where nothing is."""
    kept: mi.UInt32 | int = 0
    """Free surfels that are not for them."""


def candidates_on_screen(state: GibsState, frame: Frame, gbuffer: GBuffer, light: Light) -> SpawnCandidates:
    """Return each tile's least covered pixel, where its coverage is under the threshold and the dice allow it."""
    tile = state.settings.tile_size
    pixels = tile * tile
    surface = gbuffer.surface
    size = dr.zeros(mi.UInt32, dr.width(gbuffer.lane))
    if isinstance(light, SeenLight) and light.wish is not None:
        size = pixel_sizes(state, gbuffer, light.wish.pixels)
    weight = light.fine if isinstance(light, SeenLight) and light.fine is not None else light.weight
    # Coverage in the high bits and the pixel in the low ones: one minimum finds both, as the document does.
    coverage = dr.select(surface.active, dr.clip(weight, 0.0, 15.0), 15.0)
    key = (mi.UInt32(coverage * 1048576.0) << 8) | (gbuffer.lane % pixels)
    least = dr.block_reduce(dr.ReduceOp.Min, key, pixels)
    count = dr.width(gbuffer.lane) // pixels
    index = dr.arange(mi.UInt32, count)
    pixel = index * pixels + (least & 0xFF)
    found = dr.gather(mi.Bool, surface.active, pixel)
    under = mi.Float(least >> 8) * (1.0 / 1048576.0) < state.dials.spawn_threshold
    dice, _ = hash_pair(index + state.seed, frame.index)
    chance = state.dials.spawn_chance
    if state.settings.spawn_by_size:
        chance = chance * dr.gather(mi.Float, _share_of_surfel(state, gbuffer, size), pixel)
    return SpawnCandidates(
        prim_id=dr.gather(mi.UInt32, surface.prim_id, pixel),
        barycentric=dr.gather(mi.Point2f, surface.barycentric, pixel),
        on_back=~dr.gather(mi.Bool, surface.front, pixel),
        wanted=found & under & (to_unit(dice) < chance),
        size=dr.gather(mi.UInt32, size, pixel),
        light=dr.gather(mi.Color3f, dr.select(light.weight > KNOWN, light.irradiance, 0.0), pixel),
        kept=mi.UInt32(rays_lack(state)) if state.settings.by_view else mi.UInt32(0),
    )


def _share_of_surfel(state: GibsState, gbuffer: GBuffer, size: mi.UInt32) -> mi.Float:
    """Return how much of a surfel of a size the tile of each pixel shows, at most 1: the square of their widths."""
    x, y = gbuffer.film.image_coordinates(gbuffer.pixel)
    film = gbuffer.film.width, gbuffer.film.height
    tile = state.settings.tile_size * pixel_width(gbuffer.camera, film, x, y, gbuffer.depth)
    return dr.fmin(dr.square(tile / (2.0 * radius_of_size(state, size))), 1.0)


def candidates_at_hits(state: GibsState, plan: RayPlan, frame: Frame, results: SurfelRayResults) -> SpawnCandidates:
    """Return one ray's hit a surfel and frame, where next to nothing covers it."""
    alive = plan.count > 0
    lane = dr.select(alive, plan.first + frame.index % dr.maximum(plan.count, 1), 0)
    coverage = dr.gather(mi.Float, results.coverage, lane)
    if state.settings.by_view or state.settings.recycle:
        # The rest of the pool is the views', but for a share that rays always have. Where maps of depth cut coverage
        # short, rays would never have enough.
        room = mi.Float(state.settings.capacity - state.free.count) < state.dials.surfel_limit
        if state.settings.by_view:
            room |= rays_lack(state) > 0.0
        alive &= room
    return SpawnCandidates(
        prim_id=dr.gather(mi.UInt32, results.prim_id, lane),
        barycentric=dr.gather(mi.Point2f, results.barycentric, lane),
        on_back=dr.gather(mi.Bool, results.on_back, lane),
        wanted=alive & (coverage < state.dials.hit_spawn_threshold),
        size=mi.UInt32(state.eyes.ray_size),
        light=mi.Color3f(0.0),
    )


def spawn(
    scene: Scene, state: GibsState, candidates: SpawnCandidates, index: mi.UInt32
) -> tuple[Surfels, FreeList]:  # fmt: skip
    """Place surfels where wanted, as far as the pool allows; `index` is the frame's."""
    width = dr.width(candidates.prim_id)
    lane = dr.arange(mi.UInt32, width)
    wanted = candidates.wanted
    surface = surface_at(scene, candidates.prim_id, candidates.barycentric, wanted, back=candidates.on_back)

    # A cell whose list is full has no place for one more: it would be left out of the list, and never cover what it is
    # meant for.
    slot = slot_of_point(state.lattice, surface.p, level_of_size(state, candidates.size))
    if state.settings.cell_surfels > 0:
        wanted &= list_length(state.grid, slot, wanted) < state.settings.cell_surfels

    # Keep one place a grid cell: the lowest lane wins, whatever the order of threads. Where two cells share a slot, one
    # waits until the other is covered.
    if state.settings.spawn_once_a_cell:
        winners = dr.full(mi.UInt32, NO_CANDIDATE, state.lattice.slot_count)
        dr.scatter_reduce(dr.ReduceOp.Min, winners, lane, slot, wanted)
        wanted &= dr.gather(mi.UInt32, winners, slot, wanted) == lane

    # Take ids from the stack, by rank.
    rank = dr.prefix_reduce(dr.ReduceOp.Add, dr.select(wanted, mi.UInt32(1), 0))
    wanted &= rank + candidates.kept < state.free.count
    target = dr.gather(mi.UInt32, state.free.ids, state.free.count - 1 - rank, wanted)
    taken = dr.sum(dr.select(wanted, mi.UInt32(1), 0))
    surfels = _write(state, scene, surface, candidates, index, target, wanted)
    return surfels, FreeList(state.free.ids, state.free.count - taken)


def _write(
    state: GibsState, scene: Scene, surface: Surface, candidates: SpawnCandidates, index: mi.UInt32, target: mi.UInt32,
    wanted: mi.Bool,
) -> Surfels:  # fmt: skip
    """Fill the slots `target` with newborn surfels."""
    n = surface.n_geometric
    n_object = mi.Normal3f(n)
    if scene.features.moving:
        n_object = transform_normal(scene.geometry.to_world, surface.object_id, n, wanted)
    q = surface.p_object
    word_a, word_b = hash_pair(dr.reinterpret_array(mi.UInt32, q.x), dr.reinterpret_array(mi.UInt32, q.y))
    word_a, _ = hash_pair(word_a ^ dr.reinterpret_array(mi.UInt32, q.z), word_b)
    seed = (word_a & 0xFFFFFFFE) | dr.select(candidates.on_back, mi.UInt32(1), 0)
    # What is known of the place already counts as so many samples; nothing, where no surfel answers.
    old, known = state.surfels, dr.any(candidates.light > 0.0) & (state.dials.birth_samples > 0.0)
    light = dr.select(known, candidates.light, 0.0)
    count = dr.select(known, state.dials.birth_samples, 0.0)
    surfels = Surfels(
        mi.UInt32(old.object_id), mi.UInt32(old.prim_id), mi.Point2f(old.barycentric), mi.Point3f(old.p_object),
        mi.Normal3f(old.n_object), mi.Point3f(old.p), mi.Normal3f(old.n), mi.UInt32(old.seed),
        mi.UInt32(old.ray_index), _copy(old.estimate), mi.UInt32(old.size),
        Sight(
            mi.UInt32(old.sight.seen), mi.UInt32(old.sight.wanted), mi.UInt32(old.sight.patience),
            None if old.sight.near is None else mi.Float(old.sight.near),
        ),
        None if old.normal_light is None else copy_normal_light(old.normal_light),
    )  # fmt: skip
    values = (
        (surfels.object_id, surface.object_id), (surfels.prim_id, candidates.prim_id), (surfels.p_object, q),
        (surfels.barycentric, candidates.barycentric), (surfels.n_object, n_object), (surfels.p, surface.p),
        (surfels.n, n), (surfels.seed, seed), (surfels.ray_index, mi.UInt32(0)),
        (surfels.estimate.mean, light), (surfels.estimate.short, light),
        (surfels.estimate.variance, mi.Color3f(0.0)), (surfels.estimate.reduction, mi.Float(0.0)),
        (surfels.estimate.inconsistency, mi.Float(1.0)), (surfels.estimate.count, count),
        (surfels.size, candidates.size), (surfels.sight.seen, index), (surfels.sight.wanted, mi.UInt32(0)),
        (surfels.sight.patience, mi.UInt32(0)),
    )  # fmt: skip
    beside = surfels.normal_light
    if beside is not None:
        values += (
            (beside.along_s, mi.Color3f(0.0)),
            (beside.along_t, mi.Color3f(0.0)),
            (beside.horizon, mi.Float(0.0)),
        )
    if surfels.sight.near is not None:
        values += ((surfels.sight.near, mi.Float(dr.inf)),)
    for array, value in values:
        dr.scatter(array, value, target, wanted)
    return surfels


def _copy(old: Estimate) -> Estimate:
    return Estimate(
        mi.Color3f(old.mean), mi.Color3f(old.short), mi.Color3f(old.variance),
        mi.Float(old.reduction), mi.Float(old.inconsistency), mi.Float(old.count),
    )  # fmt: skip
