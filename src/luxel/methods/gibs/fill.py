"""Light for pixels that no surfel answers yet: never black, and never through a wall.

Small images have pixels farther apart than a surfel's radius, and a first frame has no surfel at all. Such a pixel
casts a ray of its own, as a surfel would, and takes the mean of what its tile knows: the rays of the uncovered pixels
and the light of those that surfels answer, weighted by how much they look like neighbours on one surface. Where the
tile knows next to nothing, the image does. Only what the camera sees counts, so no light comes through walls. The
cache learns nothing of it, and once surfels answer everywhere it costs next to nothing.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from luxel.kernels.direct import direct_irradiance
from luxel.kernels.gbuffer import GBuffer
from luxel.kernels.packing import pack_normal, unpack_normal
from luxel.kernels.sampling import hash_pair
from luxel.kernels.sky import sky_radiance
from luxel.kernels.surface import surface_at_hit
from luxel.kernels.trace import offset_origin, trace_closest
from luxel.methods.base import Frame
from luxel.methods.gibs.directions import choose_direction
from luxel.methods.gibs.gather import Gathered, gather_irradiance
from luxel.methods.gibs.surfels import GibsState
from luxel.scene.device import Scene

TILE_LANES = 64
"""Lanes of a tile of 8 x 8 pixels: they lie side by side."""
ANSWERED_WEIGHT = 16.0
"""What a pixel that surfels answer counts for, in pixels with a ray."""
OTHER_SURFACE_WEIGHT = 1e-3
"""Weight of a pixel of the tile that lies on another surface."""
SALT = 0xB10B
"""Keeps the pixels' rays apart from the surfels'."""
IMAGE_WEIGHT = 1.0
"""Weight of the whole image's mean, in rays: it counts where the tile is dark or empty."""


def fill_uncovered(scene: Scene, state: GibsState, frame: Frame, gbuffer: GBuffer, found: Gathered) -> mi.Color3f:
    """Return the irradiance of the pixels, with what `found` lacks filled in."""
    surface, lane = gbuffer.surface, gbuffer.lane
    # From the coverage on at which spawning ends, the surfels' answer stands alone; below it, the fill has the rest.
    enough = dr.clip(state.dials.spawn_threshold, 1e-3, 1.0)
    confidence = dr.clip(found.confidence / enough, 0.0, 1.0)
    uncovered = surface.active & (confidence < 1.0)
    fresh = _cast(scene, state, frame, gbuffer, uncovered)

    # What each pixel knows, and what that is worth.
    own = dr.select(surface.active, ANSWERED_WEIGHT * confidence, 0.0)
    sample_weight = own + dr.select(uncovered, mi.Float(1.0), 0.0)
    light = found.irradiance * own + dr.select(uncovered, fresh, 0.0)
    width = dr.width(lane)
    places, lights = dr.empty(mi.Float, 4 * width), dr.empty(mi.Float, 4 * width)
    p = surface.p
    dr.scatter(places, mi.Vector4f(p.x, p.y, p.z, pack_normal(surface.n_geometric)), lane)
    dr.scatter(lights, mi.Vector4f(light.x, light.y, light.z, sample_weight), lane)

    around = _mean_around(places, lights, p, surface.n_geometric, lane, uncovered, width)
    return dr.select(uncovered, dr.lerp(around, found.irradiance, confidence), found.irradiance)


@dr.syntax
def _cast(scene: Scene, state: GibsState, frame: Frame, gbuffer: GBuffer, uncovered: mi.Bool) -> mi.Color3f:
    """Return pi times the radiance along one ray of each uncovered pixel, times the ray's weight."""
    surface, lane = gbuffer.surface, gbuffer.lane
    p, n = mi.Point3f(surface.p), mi.Normal3f(surface.n_geometric)
    seed, _ = hash_pair(state.seed ^ SALT, frame.index)
    brought = mi.Color3f(0.0)
    going = mi.Bool(uncovered)
    # One turn of a loop: unlike a mask, it leaves out the work where no pixel asks.
    while going:
        chosen = choose_direction(scene, state, n, *hash_pair(seed, lane), going)
        direction, weight = chosen.direction, chosen.weight
        hit = trace_closest(scene, offset_origin(scene, p, n), direction, going & (weight > 0.0))
        there = surface_at_hit(scene, hit, direction)
        direct = direct_irradiance(scene, there, seed + 1, lane, hit.valid)
        known = gather_irradiance(state, there.p, there.n_geometric, hit.valid, there.n_shading)
        sky = dr.pi * sky_radiance(scene, direction, going & ~hit.valid)
        brought = dr.select(hit.valid, there.albedo * (direct + known.irradiance), sky) * weight
        going = mi.Bool(False)
    return brought


@dr.syntax
def _mean_around(
    places: mi.Float, lights: mi.Float, p: mi.Point3f, n: mi.Normal3f, lane: mi.UInt32, uncovered: mi.Bool, width: int
) -> mi.Color3f:
    """Return the mean light around each uncovered pixel.

    The pixels of its tile count by how much they seem to lie on its own surface; a few from all over the image, which
    has `width` lanes, count next to nothing.
    """
    total, weights = mi.Color3f(0.0), mi.Float(0.0)
    image, image_weight = mi.Color3f(0.0), mi.Float(0.0)
    first = lane - lane % TILE_LANES
    index = mi.UInt32(0)
    going = mi.Bool(uncovered)
    while going:
        other = first + index
        place = dr.gather(mi.Vector4f, places, other, going)
        light = dr.gather(mi.Vector4f, lights, other, going)
        offset = mi.Vector3f(place.x, place.y, place.z) - mi.Vector3f(p)
        facing = dr.fmax(dr.dot(mi.Vector3f(unpack_normal(place.w)), mi.Vector3f(n)), 0.0)
        # The squared sine of the angle by which the other one is off the plane: it knows no scale.
        off = dr.square(dr.dot(offset, mi.Vector3f(n))) / dr.fmax(dr.squared_norm(offset), 1e-20)
        weight = OTHER_SURFACE_WEIGHT + dr.square(dr.square(facing)) * dr.square(1.0 - dr.fmin(off, 1.0))
        weight = dr.select(light.w > 0.0, weight, 0.0)
        total += mi.Color3f(light.x, light.y, light.z) * weight
        weights += light.w * weight
        far = dr.gather(mi.Vector4f, lights, index * (width // TILE_LANES), going)
        image += mi.Color3f(far.x, far.y, far.z)
        image_weight += far.w
        index += 1
        going &= index < TILE_LANES
    total += image * (IMAGE_WEIGHT / dr.fmax(image_weight, 1e-20))
    return total / (weights + IMAGE_WEIGHT)
