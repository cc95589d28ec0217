"""Light for pixels that no surfel answers yet: never black, and hardly any through a wall.

Small images have pixels farther apart than a surfel's radius, and a first frame has no surfel at all. Such a pixel
casts a ray of its own, as a surfel would, and takes the mean of what its tile knows: the rays of the uncovered pixels
and the light of those that surfels answer, weighted by how much they look like neighbours on one surface. Where the
tile knows next to nothing, the image does. Only what the camera sees counts, so no light comes from closed rooms; and
where surfels keep depth, a pixel takes nothing from the side on which a wall hides what is bright. The cache learns
nothing of it, and once surfels answer everywhere it costs next to nothing.

Where surfels keep light for other normals than their own, a ray is known by its direction, and counts for each pixel
by the cosine to that pixel's own normal: smooth normals and normal maps are lit here too.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from luxel.kernels.direct import direct_irradiance, luminance
from luxel.kernels.gbuffer import GBuffer
from luxel.kernels.lane_pack import pack_lanes
from luxel.kernels.packing import pack_normal, unpack_normal
from luxel.kernels.sampling import hash_pair, to_unit
from luxel.kernels.sky import sky_radiance
from luxel.kernels.surface import surface_at_hit
from luxel.kernels.trace import offset_origin, trace_closest, trace_occluded
from luxel.methods.base import Frame
from luxel.methods.gibs.gather import Gathered, gather_irradiance
from luxel.methods.gibs.surfels import GibsState
from luxel.methods.gibs.trace import choose_direction
from luxel.scene.device import Scene

TILE_LANES = 64
"""Lanes of a tile of 8 x 8 pixels: they lie side by side."""
ANSWERED_WEIGHT = 16.0
"""What a pixel that surfels answer counts for, in pixels with a ray."""
OTHER_SURFACE_WEIGHT = 1e-3
"""Weight of a pixel of the tile that lies on another surface."""
LIT_POWER = 3
"""How often the cosine between the normals of two pixels is squared, for what the one's surfels answer to count at the
other."""
SALT = 0xB10B
"""Keeps the pixels' rays apart from the surfels'."""
PICK_SALT = 0xF111
"""Keeps the choice of whom a pixel looks for apart from both."""
LIFT = 0.05
"""Share of the way to another pixel by which both are lifted along the normal."""
IMAGE_WEIGHT, HIDDEN_IMAGE_WEIGHT = 1.0, 0.01
"""Weight of the whole image's mean, in rays: it counts where the tile is dark or empty, hardly beside a wall."""


@dataclass
class Known:
    """What the pixels know, side by side in the order of their lanes."""

    places: mi.Float
    """(W, 4): position and packed geometric normal."""
    lights: mi.Float
    """(W, 4): irradiance times its weight, and that weight."""
    rays: mi.Float | None
    """(W, 4): what a pixel's ray brought, over its cosine, and its packed direction; None where `lights` has it."""
    normals: mi.Float | None
    """(W, 2), beside `rays`: the packed normal that is lit, and 1 where there is a ray."""


@dataclass
class Spot:
    """An uncovered pixel: its lane, and the surface that it sees."""

    lane: mi.UInt32
    p: mi.Point3f
    n_geometric: mi.Normal3f
    n_shading: mi.Normal3f


def fill_uncovered(scene: Scene, state: GibsState, frame: Frame, gbuffer: GBuffer, found: Gathered) -> mi.Color3f:
    """Return the irradiance of the pixels, with what `found` lacks filled in."""
    surface, lane = gbuffer.surface, gbuffer.lane
    # From the coverage on at which spawning ends, the surfels' answer stands alone; below it, the fill has the rest.
    enough = dr.clip(state.dials.spawn_threshold, 1e-3, 1.0)
    confidence = dr.clip(found.confidence / enough, 0.0, 1.0)
    uncovered = surface.active & (confidence < 1.0)
    # Those few pixels lie all over the image: side by side they fill whole warps.
    lanes, asked = pack_lanes(uncovered)
    spot = Spot(
        lanes,
        dr.gather(mi.Point3f, surface.p, lanes, asked),
        dr.gather(mi.Normal3f, surface.n_geometric, lanes, asked),
        dr.gather(mi.Normal3f, surface.n_shading, lanes, asked),
    )
    fresh, direction = _cast(scene, state, frame, spot, asked)

    # What each pixel knows, and what that is worth.
    weight = dr.select(surface.active, ANSWERED_WEIGHT * confidence, 0.0)
    lights = _rows(found.irradiance * weight, weight, lane)
    rays = normals = None
    width = dr.width(lane)
    if state.settings.normal_light:
        cosine = dr.dot(direction, mi.Vector3f(spot.n_geometric))
        brought = dr.select(cosine > 0.0, fresh / dr.fmax(cosine, 1e-6), 0.0)
        rays = dr.zeros(mi.Float, 4 * width)
        dr.scatter(rays, _row(brought, pack_normal(mi.Normal3f(direction))), lanes, asked)
        normals = dr.empty(mi.Float, 2 * width)
        one = dr.select(uncovered, mi.Float(1.0), 0.0)
        dr.scatter(normals, mi.Vector2f(pack_normal(surface.n_shading), one), lane)
    else:
        # Each of these entries is of one lane alone, so the order of adding is no matter.
        dr.eval(lights)
        before = dr.gather(mi.Vector4f, lights, lanes, asked)
        lights = mi.Float(lights)
        dr.scatter(lights, before + _row(fresh, mi.Float(1.0)), lanes, asked)
    known = Known(_rows(surface.p, pack_normal(surface.n_geometric), lane), lights, rays, normals)

    seed, _ = hash_pair(state.seed ^ PICK_SALT, frame.index)
    around = _mean_around(scene, state, known, spot, seed, asked)
    dr.eval(found.irradiance)
    own = dr.gather(mi.Color3f, found.irradiance, lanes, asked)
    filled = mi.Color3f(found.irradiance)
    dr.scatter(filled, dr.lerp(around, own, dr.gather(mi.Float, confidence, lanes, asked)), lanes, asked)
    return filled


def _row(three: mi.Color3f | mi.Point3f, fourth: mi.Float) -> mi.Vector4f:
    return mi.Vector4f(three.x, three.y, three.z, fourth)


def _rows(three: mi.Color3f | mi.Point3f, fourth: mi.Float, lane: mi.UInt32) -> mi.Float:
    rows = dr.empty(mi.Float, 4 * dr.width(lane))
    dr.scatter(rows, _row(three, fourth), lane)
    return rows


@dr.syntax
def _cast(
    scene: Scene, state: GibsState, frame: Frame, spot: Spot, uncovered: mi.Bool
) -> tuple[mi.Color3f, mi.Vector3f]:
    """Return pi times the radiance along one ray of each uncovered pixel, times its weight, and its direction."""
    p, n, lane = spot.p, spot.n_geometric, spot.lane
    seed, _ = hash_pair(state.seed ^ SALT, frame.index)
    brought, taken = mi.Color3f(0.0), mi.Vector3f(0.0, 0.0, 1.0)
    going = mi.Bool(uncovered)
    # One turn of a loop: unlike a mask, it leaves out the work where no pixel asks.
    while going:
        direction, weight = choose_direction(scene, state, n, *hash_pair(seed, lane), going)
        hit = trace_closest(scene, offset_origin(scene, p, n), direction, going & (weight > 0.0))
        there = surface_at_hit(scene, hit, direction)
        direct = direct_irradiance(scene, there, seed + 1, lane, hit.valid)
        known = gather_irradiance(state, there.p, there.n_geometric, hit.valid, there.n_shading)
        sky = dr.pi * sky_radiance(scene, direction, going & ~hit.valid)
        brought = dr.select(hit.valid, there.albedo * (direct + known.irradiance), sky) * weight
        taken = mi.Vector3f(direction)
        going = mi.Bool(False)
    return brought, taken


@dataclass
class TileSum:
    """What the pixels of a tile, and a few from all over the image, add up to at one of them."""

    light: mi.Color3f
    weight: mi.Float
    image: mi.Color3f
    image_weight: mi.Float
    picked: mi.Point3f
    """Where one of the tile's pixels lies, chosen by the light that it brings; itself where none brings any."""


def _mean_around(
    scene: Scene, state: GibsState, known: Known, spot: Spot, seed: mi.UInt32, uncovered: mi.Bool
) -> mi.Color3f:
    """Return the mean light around each uncovered pixel.

    The pixels of its tile count by how much they seem to lie on its own surface; a few from all over the image count
    next to nothing. A floor may run on behind a thin wall, so one of those that bring the light is looked for: where
    something hides it, all that lie that way count for nothing.
    """
    tile = _sum_tile(known, spot, seed, mi.Vector3f(0.0), uncovered)
    image_weight = mi.Float(IMAGE_WEIGHT)
    if state.settings.depth is not None:
        towards = tile.picked - spot.p
        hidden = _is_hidden(scene, spot, towards, uncovered)
        tile = dr.select(hidden, _sum_tile(known, spot, seed, towards, hidden), tile)
        image_weight = dr.select(hidden, HIDDEN_IMAGE_WEIGHT, IMAGE_WEIGHT)
    image = tile.image * (image_weight / dr.fmax(tile.image_weight, 1e-20))
    return (tile.light + image) / (tile.weight + image_weight)


@dr.syntax
def _sum_tile(known: Known, spot: Spot, seed: mi.UInt32, away: mi.Vector3f, active: mi.Bool) -> TileSum:
    """Return the sums at each pixel; of its tile without those that lie in the direction `away`, zero: with all."""
    p, n, n_light, lane = mi.Point3f(spot.p), mi.Vector3f(spot.n_geometric), mi.Vector3f(spot.n_shading), spot.lane
    found = TileSum(mi.Color3f(0.0), mi.Float(0.0), mi.Color3f(0.0), mi.Float(0.0), mi.Point3f(p))
    brightness = mi.Float(0.0)
    first, stride = lane - lane % TILE_LANES, dr.width(lane) // TILE_LANES
    index = mi.UInt32(0)
    going = mi.Bool(active)
    while going:
        other = first + index
        place = dr.gather(mi.Vector4f, known.places, other, going)
        offset = mi.Vector3f(place.x, place.y, place.z) - p
        facing = dr.fmax(dr.dot(mi.Vector3f(unpack_normal(place.w)), n), 0.0)
        # The squared sine of the angle by which the other one is off the plane: it knows no scale.
        off = dr.square(dr.dot(offset, n)) / dr.fmax(dr.squared_norm(offset), 1e-20)
        share = OTHER_SURFACE_WEIGHT + dr.square(dr.square(facing)) * dr.square(1.0 - dr.fmin(off, 1.0))
        light, weight = _light_at(known, other, n_light, going)
        share = dr.select((weight > 0.0) & (dr.dot(offset, away) <= 0.0), share, 0.0)
        found.light += light * share
        found.weight += weight * share
        bright = luminance(light) * share
        brightness += bright
        word, _ = hash_pair(seed + index, lane)
        found.picked = dr.select(to_unit(word) * brightness < bright, p + offset, found.picked)
        light, weight = _light_at(known, index * stride, None, going)
        found.image += light
        found.image_weight += weight
        index += 1
        going &= index < TILE_LANES
    return found


@dr.syntax
def _is_hidden(scene: Scene, spot: Spot, towards: mi.Vector3f, active: mi.Bool) -> mi.Bool:
    """Return whether something lies between each point and the one that is `towards` away on its surface.

    Both are lifted by a share of the way, so that no bend of their own surface stands between them.
    """
    p, n = spot.p, spot.n_geometric
    distance = dr.norm(towards)
    hidden = mi.Bool(False)
    going = active & (distance > 0.0)
    # One turn of a loop, as in `_cast`.
    while going:
        origin = offset_origin(scene, p + mi.Vector3f(n) * (LIFT * distance), n)
        hidden = trace_occluded(scene, origin, towards / distance, distance, going)
        going = mi.Bool(False)
    return hidden


def _light_at(
    known: Known, other: mi.UInt32, n_light: mi.Vector3f | None, active: mi.Bool
) -> tuple[mi.Color3f, mi.Float]:
    """Return what a pixel knows of the light under `n_light`, None for its own normals, times what it is worth."""
    row = dr.gather(mi.Vector4f, known.lights, other, active)
    light, weight = mi.Color3f(row.x, row.y, row.z), row.w
    if known.rays is None or known.normals is None:
        return light, weight
    ray = dr.gather(mi.Vector4f, known.rays, other, active)
    lit = dr.gather(mi.Vector2f, known.normals, other, active)
    if n_light is None:
        n_ray = unpack_normal(dr.gather(mi.Vector4f, known.places, other, active).w)
    else:
        # What its surfels answer is light for its own normal alone.
        n_ray, alike = n_light, dr.fmax(dr.dot(unpack_normal(lit.x), n_light), 0.0)
        for _ in range(LIT_POWER):
            alike = dr.square(alike)
        light, weight = light * alike, weight * alike
    cosine = dr.fmax(dr.dot(unpack_normal(ray.w), n_ray), 0.0)
    return light + mi.Color3f(ray.x, ray.y, ray.z) * cosine, weight + lit.y
