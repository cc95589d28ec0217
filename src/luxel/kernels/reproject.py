"""Where last frame's pixels show what this frame's pixels see: four taps each, and none that shows something else.

A motion vector leads between four pixels of the last frame. Each of them is asked whether it lies on the same object,
faces the same way, and is as far away as the surface, continued as a plane, would be behind that very pixel: so that a
floor that falls away is taken as it is, and the step in depth beside an edge is not. What is left of the bilinear
weights is scaled up to one. A disoccluded pixel keeps none (Nehab et al. 2007, the reverse reprojection cache).
"""

from __future__ import annotations

from dataclasses import dataclass, fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi

from luxel.kernels.camera import Pinhole, camera_ray
from luxel.kernels.film import Film
from luxel.kernels.surface import previous_normal, previous_position
from luxel.scene.device import Scene

if TYPE_CHECKING:
    from luxel.kernels.gbuffer import GBuffer

DEPTH_TOLERANCE = 0.01
"""Share of the expected depth that a tap may be off: rounding and curvature stay far below."""
NORMAL_TOLERANCE = 0.9
"""Cosine between the normals, at the least: 26 degrees."""
LEAST_WEIGHT = 0.01
"""Bilinear weight of accepted taps below which there is no history."""


@dataclass
class LastView:
    """What a camera's pixels saw one frame ago, in tile order."""

    depth: mi.Float
    """Distance from the eye, metres; infinite for a miss, 0 where nothing has been seen yet."""
    normal: mi.Normal3f
    """World unit shading normal, on the viewer's side."""
    object_id: mi.UInt32
    """From 1; 0 for a miss."""
    offset: mi.Vector2f
    """How far from the pixels' centres its rays went, pixels to the right and down."""


@dataclass
class Taps:
    """Four of last frame's pixels for each of this frame's, and what each of them weighs."""

    lanes: list[mi.UInt32]
    weights: list[mi.Float]
    """They add up to one, or all are 0: then nothing of last frame's is the same."""
    found: mi.Bool
    """Whether any tap was accepted."""

    def among(self, usable: mi.Bool) -> Taps:
        """Return those taps of which last frame's pixels are `usable`, scaled up to one again."""
        kept = [
            dr.select(dr.gather(mi.Bool, usable, lane, weight > 0.0), weight, 0.0)
            for lane, weight in zip(self.lanes, self.weights, strict=True)
        ]
        return scale_up(self.lanes, kept)

    def gather(self, values: Any) -> Any:
        """Return `values` of last frame's pixels at this frame's, 0 without a tap: floats or colours, or a record."""
        if is_dataclass(values):
            gathered = {item.name: self.gather(getattr(values, item.name)) for item in fields(values)}
            return replace(values, **gathered)  # type: ignore[type-var]
        total = type(values)(0.0)
        for lane, weight in zip(self.lanes, self.weights, strict=True):
            # What a rejected tap holds may be anything, so it is not read at all.
            total += weight * dr.gather(type(values), values, lane, weight > 0.0)
        return total


def remember(gbuffer: GBuffer, offset: mi.Vector2f | None = None) -> LastView:
    """Return what the next frame needs of this one's pixels; `offset` as `trace_gbuffer` had it."""
    surface = gbuffer.surface
    offset = mi.Vector2f(0.0) if offset is None else offset
    return LastView(gbuffer.depth, mi.Normal3f(surface.n_shading), mi.UInt32(surface.object_id), offset)


def forget(film: Film) -> LastView:
    """Return the memory of nothing: no tap is accepted."""
    lanes = film.lane_count
    last = LastView(
        dr.zeros(mi.Float, lanes), dr.zeros(mi.Normal3f, lanes), dr.zeros(mi.UInt32, lanes), mi.Vector2f(0.0)
    )
    dr.make_opaque(last)
    return last


def find_taps(scene: Scene, film: Film, gbuffer: GBuffer, camera_before: Pinhole, last: LastView) -> Taps:
    """Return the taps of `gbuffer`'s pixels in `last`, which `camera_before` saw through the same film."""
    surface = gbuffer.surface
    p = previous_position(scene, surface)
    n_plane = previous_normal(scene, surface, surface.n_geometric)
    n_expected = previous_normal(scene, surface, surface.n_shading)
    usable = gbuffer.tracked & film.pixel_of_lane(gbuffer.lane)[2]

    # Find the four pixels around the place; far outside of the image a whole number could not hold it.
    was = gbuffer.pixel - gbuffer.motion - 0.5 - last.offset
    x, y = dr.clip(was.x, -2.0, film.width + 2.0), dr.clip(was.y, -2.0, film.height + 2.0)
    column, row = mi.Int32(dr.floor(x)), mi.Int32(dr.floor(y))
    right, down = x - mi.Float(column), y - mi.Float(row)

    lanes, weights = [], []
    for step_down in (0, 1):
        for step_right in (0, 1):
            at_x, at_y = column + step_right, row + step_down
            lane, accepted = film.lane_of_pixel(at_x, at_y)
            accepted &= usable
            # Ask for the same object, the same normal, and the depth of the surface's plane behind that pixel.
            accepted &= dr.gather(mi.UInt32, last.object_id, lane, accepted) == surface.object_id
            through = mi.Point2f(mi.Float(at_x), mi.Float(at_y)) + 0.5 + last.offset
            origin, direction = camera_ray(camera_before, *film.image_coordinates(through))
            expected = dr.dot(p - origin, n_plane) / dr.dot(direction, n_plane)
            depth = dr.gather(mi.Float, last.depth, lane, accepted)
            near = dr.abs(depth - expected) <= DEPTH_TOLERANCE * expected
            alike = dr.dot(dr.gather(mi.Normal3f, last.normal, lane, accepted), n_expected) >= NORMAL_TOLERANCE
            accepted &= dr.select(surface.active, near & alike, dr.isinf(depth))
            bilinear = (right if step_right else 1.0 - right) * (down if step_down else 1.0 - down)
            lanes.append(lane)
            weights.append(dr.select(accepted, bilinear, 0.0))

    return scale_up(lanes, weights)


def scale_up(lanes: list[mi.UInt32], weights: list[mi.Float]) -> Taps:
    """Return taps whose weights add up to one, or to nothing where hardly any are left."""
    total = weights[0] + weights[1] + weights[2] + weights[3]
    found = total >= LEAST_WEIGHT
    scale = dr.select(found, 1.0 / dr.fmax(total, LEAST_WEIGHT), 0.0)
    return Taps(lanes, [weight * scale for weight in weights], found)
