"""What the camera sees first: one ray through each pixel, by its centre unless told otherwise."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from luxel.kernels.camera import Pinhole, camera_ray, project
from luxel.kernels.film import Film
from luxel.kernels.material import emits_light
from luxel.kernels.ray_origin import next_step
from luxel.kernels.records import Surface
from luxel.kernels.reproject import Taps
from luxel.kernels.sky import sky_radiance
from luxel.kernels.sun_disc import disc_radiance
from luxel.kernels.surface import previous_position, surface_at_hit
from luxel.kernels.trace import Hit, trace_closest
from luxel.kernels.triangle import fetch_triangle
from luxel.scene.device import Scene


@dataclass
class GBuffer:
    """Surfaces at the pixels, in tile order."""

    surface: Surface
    background: mi.Color3f
    """The sky's radiance where nothing was hit, with its suns; black elsewhere."""
    depth: mi.Float
    """Distance from the eye, metres; infinite for a miss."""
    motion: mi.Vector2f
    """Pixels from where the point was one frame ago to where it is now; of a miss, how far its direction has turned."""
    tracked: mi.Bool
    """Whether it was before the camera one frame ago; elsewhere there is no motion to tell."""
    pixel: mi.Point2f
    """Where the ray goes through the image, pixels to the right and down from its upper left corner."""
    lane: mi.UInt32
    """0 .. lane_count - 1."""
    eye: mi.Point3f
    """Where the camera is, world."""
    camera: Pinhole
    """What it looks through: with it a point's size on the screen is known, and its place."""
    film: Film
    """Its size, and where a pixel's lane is."""
    taps: Taps | None = None
    """Where last frame's pixels show the same; None unless the method reprojects (`Method.reprojects`)."""


def trace_gbuffer(
    scene: Scene, film: Film, camera: Pinhole, camera_before: Pinhole, offset: mi.Vector2f | None = None
) -> GBuffer:
    """Return the g-buffer of `camera`; `camera_before` is the last frame's, for motion vectors.

    `offset` is how far from the pixels' centres the rays go, pixels to the right and down; None: through the centres.
    """
    lane = dr.arange(mi.UInt32, film.lane_count)
    column, row, inside = film.pixel_of_lane(lane)
    right, down = (0.5, 0.5) if offset is None else (0.5 + offset.x, 0.5 + offset.y)
    pixel = mi.Point2f(mi.Float(column) + right, mi.Float(row) + down)
    x, y = film.image_coordinates(pixel)
    origin, direction = camera_ray(camera, x, y)
    hit = trace_closest(scene, origin, direction, inside, coherent=True)
    if scene.features.hide_emitters:
        hit = _behind_emitters(scene, origin, direction, hit)
    surface = surface_at_hit(scene, hit, direction)
    # What is infinitely far away moves as its direction turns.
    far = camera_before.eye + x * camera_before.across + y * camera_before.upwards + direction
    before = dr.select(hit.valid, previous_position(scene, surface), far)
    old_x, old_y, in_front = project(camera_before, before)
    motion = mi.Vector2f((x - old_x) * (film.width / 2.0), (old_y - y) * (film.height / 2.0))
    sees_sky = inside & ~hit.valid & (not scene.features.hide_emitters)
    background = sky_radiance(scene, direction, sees_sky) + disc_radiance(scene, direction, sees_sky)
    return GBuffer(
        surface=surface,
        background=background,
        depth=hit.t,
        motion=dr.select(in_front, motion, mi.Vector2f(0.0)),
        tracked=in_front,
        pixel=pixel,
        lane=lane,
        eye=mi.Point3f(camera.eye),
        camera=camera,
        film=film,
    )


@dr.syntax
def _behind_emitters(scene: Scene, origin: mi.Point3f, direction: mi.Vector3f, first: Hit) -> Hit:
    """Return the nearest hit that does not emit, from the nearest hit at all."""
    t, prim_id, barycentric = mi.Float(first.t), mi.UInt32(first.prim_id), mi.Point2f(first.barycentric)
    valid = mi.Bool(first.valid)
    step = mi.Float(0.0)
    again = mi.Bool(False)
    going = valid & emits_light(scene, fetch_triangle(scene, prim_id, valid).material, valid)
    while going:
        step = next_step(origin, direction, t, step, again)
        start = t + step
        hit = trace_closest(scene, origin + start * direction, direction, going)
        t = dr.select(going, start + hit.t, t)
        again = hit.prim_id == prim_id
        prim_id = dr.select(going, hit.prim_id, prim_id)
        barycentric = dr.select(going, hit.barycentric, barycentric)
        valid = dr.select(going, hit.valid, valid)
        going &= hit.valid & emits_light(scene, fetch_triangle(scene, hit.prim_id, hit.valid).material, hit.valid)
    return Hit(t, prim_id, barycentric, valid)
