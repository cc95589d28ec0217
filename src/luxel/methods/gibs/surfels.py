"""The surfels: what one is, and how they follow the objects they lie on (Ekberg 2022, section 4.1)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.kernels.grid import Grid, Lattice
from luxel.kernels.mean_estimator import Estimate, EstimatorDials, new_estimate
from luxel.kernels.packing import pack_normal
from luxel.kernels.square_maps import SquareMaps
from luxel.kernels.transform import transform_normal, transform_point
from luxel.kernels.triangle import face_vector, fetch_triangle
from luxel.methods.gibs.depth_maps import DepthFormat, DepthMaps
from luxel.methods.gibs.normal_light import NormalLight, new_normal_light, turn_normal_light
from luxel.scene.device import Scene

RADII_A_TURN = 4.0
"""Radii of travel that a turn by one radian is worth."""


@dataclass
class Sight:
    """What views left with each surfel."""

    seen: mi.UInt32
    """The frame in which a view last saw it; that of its birth where none has."""
    wanted: mi.UInt32
    """1 + the smallest size that views have asked for since the last update; 0: none has seen it."""
    patience: mi.UInt32
    """Frames in which it was seen and was too small, in a row: the low 16 bits; and too large: the high ones."""
    near: mi.Float | None = None
    """Metres to the nearest view, infinite where none has looked; None: nobody asks."""


@dataclass
class Surfels:
    """The pool, arrays of its capacity."""

    object_id: mi.UInt32
    """0: not placed."""
    prim_id: mi.UInt32
    barycentric: mi.Point2f
    """With `prim_id`: where it lies on a deforming object."""
    p_object: mi.Point3f
    n_object: mi.Normal3f
    p: mi.Point3f
    """World space, recomputed each frame."""
    n: mi.Normal3f
    seed: mi.UInt32
    """Of its ray directions: a hash of where it was placed, not of its slot."""
    ray_index: mi.UInt32
    """Rays that it has cast."""
    estimate: Estimate
    """Its irradiance, W/m^2."""
    size: mi.UInt32
    """Its radius is that of the largest over sqrt(2)^size."""
    sight: Sight
    normal_light: NormalLight | None = None
    """Where light is kept for other normals than its own."""


@dataclass
class Eyes:
    """What views ask for: those that have looked since the last update, and the smoothed sum of all before."""

    looks: mi.Float
    """How many have looked; who looks every other frame counts as two."""
    asked: mi.Float
    """Surfels that they ask for together."""
    pixels: mi.Float
    """The smallest radius in pixels that one of them asks for; that of the last frame until one has looked."""
    views: mi.Float
    """How many look at the cache, smoothed."""
    taken: mi.Float
    """Surfels that they take, smoothed."""
    ray_size: mi.UInt32
    """Size of the surfels that rays place."""


@dataclass
class FreeList:
    """A stack of the ids that are not in use: the top is ids[count - 1]."""

    ids: mi.UInt32
    count: mi.UInt32


@dataclass
class GibsDials:
    """Parameters that may change while it runs, as opaque values."""

    radius: mi.Float
    """Of the largest surfels, metres."""
    flatness: mi.Float
    """1 / plane_scale: how far off its plane a surfel still answers, in radii."""
    plane_stretch: mi.Float
    """plane_scale^2 - 1."""
    spawn_threshold: mi.Float
    spawn_chance: mi.Float
    hit_spawn_threshold: mi.Float
    fade_in: mi.Float
    birth_samples: mi.Float
    memory_radii: mi.Float
    sky_share: mi.Float
    even_share: mi.Float
    guide_share: mi.Float
    radius_pixels: mi.Float
    """Radius on the screen that is asked for; 0: the one that fills the view."""
    surfel_limit: mi.Float
    """Living surfels beyond which those that no view sees are given back."""
    view_surfels: mi.Float
    """Surfels that a view may take."""
    ray_surfels: mi.Float
    """Surfels that are kept for what only rays see, however many views take."""
    estimator: EstimatorDials


@dataclass
class GibsSettings:
    """Parameters that shape the kernels: constants of a state."""

    rays_per_surfel: int
    ray_lanes: int
    """Rays a frame at most: the width of their launch."""
    share_rays: bool
    """Surfels get as many rays as they need, not all the same."""
    recycle: bool
    """Surfels are given back by need."""
    spawn_by_size: bool
    """Tiles that show less than a surfel spawn the more seldom."""
    capacity: int
    item_capacity: int
    tile_size: int
    normal_power: int
    spawn_once_a_cell: bool
    spawn_at_hits: bool
    low_discrepancy: bool
    fill_bare: bool
    looks_for_sky: bool
    """Some rays look for the sky's bright places."""
    cell_surfels: int
    """Entries of a list at most; 0: all."""
    normal_light: bool
    """Surfels keep the light for other normals than their own."""
    depth: DepthFormat | None
    """How depth maps lie in memory; None: there are none."""
    by_view: bool
    """Surfels are as large as views ask for."""


@dataclass
class GibsState:
    """Everything that GIBS knows of a world."""

    surfels: Surfels
    free: FreeList
    lattice: Lattice
    grid: Grid
    geometry: mi.Float
    """(capacity, 4): world position and packed normal of each surfel: what a look-up reads first."""
    light: mi.Float
    """(capacity, 4): irradiance and confidence: what it reads where the weight is not zero."""
    normal_light: mi.UInt32 | None
    """(capacity, 4): their `Surfels.normal_light`, read beside `light`; None: all normals get the same."""
    luminance: mi.Float
    """Running mean luminance of the cache: the estimator's unit."""
    eyes: Eyes
    drift: mi.Float
    """By which share the cache's short and long means differ, beyond chance: the estimators' common alarm."""
    cast: mi.UInt32
    """Rays that each surfel cast in the last frame."""
    seed: mi.UInt32
    dials: GibsDials
    settings: GibsSettings
    depth: DepthMaps | None = None
    guide: SquareMaps | None = None
    """Where surfels' rays found light; None: rays do not go by it."""


def count_surfels(state: GibsState) -> int:
    """Return how many surfels live; read back from the device."""
    return state.settings.capacity - int(np.array(state.free.count)[0])


def count_items(state: GibsState) -> int:
    """Return how many entries the grid's lists hold; read back from the device."""
    return int(np.array(state.grid.starts)[-1])


def new_surfels(capacity: int, normal_light: bool, recycle: bool = False) -> Surfels:
    """Return a pool of unplaced surfels."""
    return Surfels(
        object_id=dr.zeros(mi.UInt32, capacity),
        prim_id=dr.zeros(mi.UInt32, capacity),
        barycentric=dr.zeros(mi.Point2f, capacity),
        p_object=dr.zeros(mi.Point3f, capacity),
        n_object=dr.zeros(mi.Normal3f, capacity),
        p=dr.zeros(mi.Point3f, capacity),
        n=dr.zeros(mi.Normal3f, capacity),
        seed=dr.zeros(mi.UInt32, capacity),
        ray_index=dr.zeros(mi.UInt32, capacity),
        estimate=new_estimate(capacity),
        size=dr.zeros(mi.UInt32, capacity),
        sight=Sight(
            *(dr.zeros(mi.UInt32, capacity) for _ in range(3)),
            near=dr.full(mi.Float, dr.inf, capacity) if recycle else None,
        ),
        normal_light=new_normal_light(capacity) if normal_light else None,
    )


def new_free_list(capacity: int) -> FreeList:
    """Return the full stack; low ids come first, so that the living stay together."""
    return FreeList(capacity - 1 - dr.arange(mi.UInt32, capacity), dr.opaque(mi.UInt32, capacity))


def follow_objects(scene: Scene, surfels: Surfels) -> tuple[mi.Point3f, mi.Normal3f]:
    """Return the surfels' world positions and normals for this frame."""
    alive = surfels.object_id != 0
    p, n = mi.Point3f(surfels.p_object), mi.Normal3f(surfels.n_object)
    if scene.features.deforming:
        p, n = _on_triangles(scene, surfels, alive)
    if scene.features.moving:
        n = transform_normal(scene.geometry.to_object, surfels.object_id, n, alive)
        p = transform_point(scene.geometry.to_world, surfels.object_id, p, alive)
    return p, n


def forget_by_travel(state: GibsState, p: mi.Point3f, n: mi.Normal3f, radius: mi.Float) -> Estimate:
    """Return the estimates as young as the way from the last frame to `p`, `n` makes them; a far jump starts them anew.

    Light that is known for one place is worth the fewer samples elsewhere, the farther that is. The estimator alone
    would notice by the samples, which takes it some hundred frames where they are noisy.
    """
    surfels, dials = state.surfels, state.dials
    travel = dr.norm(p - surfels.p) / radius + RADII_A_TURN * dr.norm(mi.Vector3f(n - surfels.n))
    told = (surfels.ray_index > 0) & (travel > 1e-3) & (dials.memory_radii > 0.0)
    worth = dials.memory_radii / dr.fmax(travel, 1e-3)
    count = surfels.estimate.count
    return replace(surfels.estimate, count=dr.select(told, dr.fmin(count, worth), count))


def turn_with_objects(surfels: Surfels, n: mi.Normal3f) -> NormalLight | None:
    """Return the surfels' `normal_light` along the axes of their new normals `n`."""
    if surfels.normal_light is None:
        return None
    # What is not placed has no normal, and must not get a light that is no number: its row is read once it is placed.
    turned = turn_normal_light(surfels.normal_light, surfels.n, n)
    return dr.select(surfels.object_id != 0, turned, surfels.normal_light)


def _on_triangles(scene: Scene, surfels: Surfels, alive: mi.Bool) -> tuple[mi.Point3f, mi.Normal3f]:
    """Return object-space position and normal from triangle and weights, on the side where the surfel was placed."""
    a, b, c = corners = fetch_triangle(scene, surfels.prim_id, alive).positions
    w = surfels.barycentric
    face = face_vector(corners)
    normal = mi.Normal3f(face * dr.rsqrt(dr.fmax(dr.squared_norm(face), 1e-36)))
    # `n_object` is the normal at placement; a deformation never turns a triangle over within a frame.
    side = dr.select(_placed_on_back(surfels), -1.0, 1.0)
    return a + (b - a) * w.x + (c - a) * w.y, normal * side


def _placed_on_back(surfels: Surfels) -> mi.Bool:
    return (surfels.seed & 1) != 0


def pack_geometry(p: mi.Point3f, n: mi.Normal3f, size: mi.UInt32, capacity: int) -> mi.Float:
    """Return (capacity, 4) rows of position and packed normal, with the lowest bit of the size."""
    rows = dr.empty(mi.Float, 4 * capacity)
    word = pack_normal(n, (size & 1) == 1)
    dr.scatter(rows, mi.Vector4f(p.x, p.y, p.z, word), dr.arange(mi.UInt32, capacity))
    return rows


def pack_light(
    irradiance: mi.Color3f, ray_index: mi.UInt32, fade_in: mi.Float, capacity: int, near: mi.Bool | None = None
) -> mi.Float:
    """Return (capacity, 4) rows of irradiance and confidence: surfels without a ray have none, young ones little.

    `fade_in` counts rays.

    The confidence is negative where something is `near`, so that the depth around the surfel has a say.
    """
    confidence = dr.clip(mi.Float(ray_index) / dr.fmax(fade_in, 1.0), 0.0, 1.0)
    if near is not None:
        confidence = dr.select(near, -confidence, confidence)
    rows = dr.empty(mi.Float, 4 * capacity)
    # Under a sky image a mean of few samples may fall short of zero (`integrate`). Only what is read is clipped: the
    # mean itself, clipped, would be too bright for good.
    light = dr.fmax(irradiance, 0.0)
    row = mi.Vector4f(light.x, light.y, light.z, confidence)
    dr.scatter(rows, row, dr.arange(mi.UInt32, capacity))
    return rows
