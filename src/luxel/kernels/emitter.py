"""Triangles that emit, as the light sampler sees them: a point of one, and the density of such a point.

A triangle that looms large is sampled by solid angle, a far one by area (`spherical_triangle.py` says why).
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from luxel.kernels.light_sample import LightSample
from luxel.kernels.material import emitted_radiance, opacity
from luxel.kernels.ray_origin import clear_of_corners, clear_when_placed, largest
from luxel.kernels.sampling import uniform_triangle
from luxel.kernels.spherical_triangle import sample_direction, solid_angle
from luxel.kernels.transform import determinant, transform_point
from luxel.kernels.triangle import Triangle, face_vector, fetch_triangle, interpolate
from luxel.scene.device import Scene
from luxel.scene.rounding import STEP

SOLID_ANGLE_MIN = 0.02
"""Steradians below which a triangle is sampled by area: there the two are equal, and single precision suffers."""


@dataclass
class Emitter:
    """A triangle in the world, seen from a point."""

    triangle: Triangle
    corners: list[mi.Point3f]
    """World space."""
    units: list[mi.Vector3f]
    """Unit directions from the point to the corners."""
    face: mi.Vector3f
    """Normal of the front, as long as twice the area."""
    double_area: mi.Float
    height: mi.Float
    """Metres of the point above the triangle's plane, on the side of its front."""
    clear: mi.Float
    """Metres that keep a ray's end clear of the triangle."""
    omega: mi.Float
    """Solid angle, steradians."""


def fetch_emitter(scene: Scene, prim_id: mi.UInt32, p: mi.Point3f, active: mi.Bool) -> Emitter:
    """Return triangle `prim_id` as it is seen from the world point `p`."""
    geometry = scene.geometry
    triangle = fetch_triangle(scene, prim_id, active)
    corners, owner = triangle.positions, triangle.object_id
    clear = STEP * largest(p)
    if scene.features.moving:
        clear = dr.fmax(clear, clear_when_placed(geometry.to_world, owner, corners, active))
        corners = [transform_point(geometry.to_world, owner, corner, active) for corner in corners]
    else:
        clear = dr.fmax(clear, clear_of_corners(corners))
    units = [dr.normalize(mi.Vector3f(corner - p)) for corner in corners]
    face = face_vector(corners)
    if scene.features.moving:
        # A mirror turns the order of the corners round, not the side that shines.
        face = mi.Vector3f(dr.mulsign(face, determinant(geometry.to_world, owner, active)))
    double_area = dr.norm(face)
    height = dr.dot(face, p - corners[0]) / dr.fmax(double_area, 1e-30)
    return Emitter(triangle, corners, units, face, double_area, height, clear, solid_angle(*units))


def sample_emitter(scene: Scene, prim_id: mi.UInt32, p: mi.Point3f, sample: mi.Point2f, active: mi.Bool) -> LightSample:
    """Return a point of triangle `prim_id`, with what it sends to `p`."""
    emitter = fetch_emitter(scene, prim_id, p, active)
    barycentric, y = _choose_point(emitter, p, sample)
    offset = y - p
    squared = dr.fmax(dr.squared_norm(offset), 1e-24)
    direction = mi.Vector3f(offset * dr.rsqrt(squared))
    at_light = interpolate(scene, emitter.triangle, barycentric, active)
    radiance = emitted_radiance(scene, at_light, emitter.height > 0.0, active)
    if scene.features.cutout:
        radiance *= opacity(scene, at_light, active)
    # End before the light, on the side that the ray comes from, or its own triangle would shadow it.
    toward = emitter.face * (emitter.clear * dr.mulsign(dr.rcp(dr.fmax(emitter.double_area, 1e-30)), emitter.height))
    extent = _extent(emitter, direction, squared)
    return LightSample(
        source=prim_id,
        point=mi.Point3f(y + toward),
        direction=direction,
        is_far=mi.Bool(False),
        radiance=radiance,
        density=_reciprocal(extent),
        weight=extent,
    )


def point_density(scene: Scene, prim_id: mi.UInt32, p: mi.Point3f, y: mi.Point3f, active: mi.Bool) -> mi.Float:
    """Return the density per steradian with which `sample_emitter` at `p` takes the point `y` of its triangle."""
    offset = mi.Vector3f(y - p)
    squared = dr.fmax(dr.squared_norm(offset), 1e-24)
    emitter = fetch_emitter(scene, prim_id, p, active)
    return _reciprocal(_extent(emitter, offset * dr.rsqrt(squared), squared))


def _reciprocal(extent: mi.Float) -> mi.Float:
    return dr.select(extent > 0.0, 1.0 / dr.fmax(extent, 1e-30), 0.0)


def _extent(emitter: Emitter, direction: mi.Vector3f, squared: mi.Float) -> mi.Float:
    """Return one over the density, steradians, at the point in unit `direction` and at squared distance `squared`.

    0: the point of view lies in the triangle's own plane, where solid angle and cosine are rounding noise.
    """
    by_area = 0.5 * dr.abs(dr.dot(emitter.face, direction)) / squared
    extent = dr.select(emitter.omega > SOLID_ANGLE_MIN, emitter.omega, by_area)
    return dr.select(dr.abs(emitter.height) > 4.0 * emitter.clear, extent, 0.0)


def _choose_point(emitter: Emitter, p: mi.Point3f, sample: mi.Point2f) -> tuple[mi.Point2f, mi.Point3f]:
    """Return barycentric weights of a point, and the point: by solid angle where the triangle looms large."""
    corners, (to_a, to_b, to_c) = emitter.corners, emitter.units
    direction = sample_direction(to_a, to_b, to_c, emitter.omega, sample)
    # Where the direction meets the triangle's plane, in barycentric weights (Cramer's rule on p + t d = corners).
    edge_1, edge_2 = corners[1] - corners[0], corners[2] - corners[0]
    across = dr.cross(direction, edge_2)
    volume = dr.dot(edge_1, across)
    from_corner = p - corners[0]
    inverse = 1.0 / dr.select(dr.abs(volume) > 1e-20, volume, 1e-20)
    weight_1 = dr.dot(from_corner, across) * inverse
    weight_2 = dr.dot(direction, dr.cross(from_corner, edge_1)) * inverse
    # Rounding may leave the triangle by a little; the point goes back to its border.
    weight_1 = dr.clip(weight_1, 0.0, 1.0)
    weight_2 = dr.clip(weight_2, 0.0, 1.0 - weight_1)
    by_angle = emitter.omega > SOLID_ANGLE_MIN
    by_area = uniform_triangle(sample)
    weights = mi.Point2f(dr.select(by_angle, weight_1, by_area.x), dr.select(by_angle, weight_2, by_area.y))
    return weights, mi.Point3f(corners[0] + edge_1 * weights.x + edge_2 * weights.y)
