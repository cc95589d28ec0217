"""Direct light at any point: the one light sampler of every method and of the truth.

Up to eight delta lights get a shadow ray each, of more only the suns. Emissive triangles and the rest share one more:
a few candidates are drawn from a tree by about what they would bring (`light_tree.py`), one is kept in proportion to
what it would bring unshadowed, and its estimate is weighted by the candidates' mean (resampled importance sampling,
Talbot et al. 2005).
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from luxel.kernels.light_tree import choose_source
from luxel.kernels.material import emitted_radiance, opacity
from luxel.kernels.ray_origin import clear_of_corners, clear_when_placed, largest
from luxel.kernels.records import Surface
from luxel.kernels.sampling import hash_pair, random_2d, sequence_3d, uniform_triangle
from luxel.kernels.spherical_triangle import sample_direction, solid_angle
from luxel.kernels.sun_disc import sample_disc
from luxel.kernels.trace import offset_origin, trace_occluded
from luxel.kernels.transform import determinant, transform_point
from luxel.kernels.triangle import face_vector, fetch_triangle, interpolate
from luxel.scene.colours import LUMINANCE
from luxel.scene.device import Scene
from luxel.scene.lights import ENTRY_IS_DELTA
from luxel.scene.rounding import STEP

FEW_CANDIDATES, MANY_CANDIDATES = 2, 4
"""Candidates a shadow ray, among few and among more than `FEW_ENTRIES` sources: more cost arithmetic, fewer cost
noise near large or many lights."""
FEW_ENTRIES = 4
SOLID_ANGLE_MIN = 0.02
"""Steradians below which a triangle is sampled by area: there the two are equal, and single precision suffers."""
SHORT_OF = 1.0 - 2.0 * STEP
"""Share of the way to a light that its shadow ray goes."""


def direct_irradiance(
    scene: Scene,
    surface: Surface,
    seed: mi.UInt32,
    lane: mi.UInt32,
    active: mi.Bool,
    turn: tuple[mi.UInt32, mi.UInt32] | None = None,
) -> mi.Color3f:
    """Return an unbiased estimate of the direct irradiance (W/m^2) on the side of `surface.wo`.

    `seed` and `lane` are the counters of this estimate's random numbers. Where estimates of one lane are averaged,
    `turn` is the number of this one and a seed that all share: they then go through a low-discrepancy sequence.
    """
    lights = scene.lights
    active = active & surface.active
    # Light is weighed at the surface itself; shadow rays go from just above it to the very point of the light.
    origin = offset_origin(scene, surface.p, surface.n_geometric)
    total = mi.Color3f(0.0)
    for index in range(lights.delta_each):
        on_disc = random_2d(seed + mi.UInt32(0x68BC21EB + index), lane) if lights.soft_suns else mi.Point2f(0.0)
        row = dr.gather(mi.UInt32, lights.each_rows, mi.UInt32(index), active)
        to_light, distance, value = _delta_light(scene, row, surface, origin, on_disc, active)
        lit = active & (luminance(value) > 0.0)
        visible = lit & ~trace_occluded(scene, origin, to_light, SHORT_OF * distance, lit)
        total += dr.select(visible, value, mi.Color3f(0.0))
    if lights.entry_count > 0:
        to_light, distance, value = _resample(scene, surface, origin, seed, lane, active, turn)
        lit = active & (luminance(value) > 0.0)
        visible = lit & ~trace_occluded(scene, origin, to_light, distance, lit)
        total += dr.select(visible, value, mi.Color3f(0.0))
    return total


def shadow_ray_count(scene: Scene) -> int:
    """Return the shadow rays that `direct_irradiance` casts at most a point."""
    return scene.lights.delta_each + (1 if scene.lights.entry_count else 0)


def luminance(color: mi.Color3f) -> mi.Float:
    """Return the Rec. 709 luminance of a colour."""
    return color.x * LUMINANCE[0] + color.y * LUMINANCE[1] + color.z * LUMINANCE[2]


def _delta_light(
    scene: Scene, index: mi.UInt32, surface: Surface, origin: mi.Point3f, on_disc: mi.Point2f, active: mi.Bool
) -> tuple[mi.Vector3f, mi.Float, mi.Color3f]:
    """Return the shadow ray's direction and length, and the unshadowed irradiance, of delta light `index`.

    `on_disc` are the random numbers that choose a direction where a sun is wider than one.
    """
    rows = scene.lights.delta
    position, axis, color, cone = (dr.gather(mi.Vector4f, rows, 4 * index + i, active) for i in range(4))
    direction = mi.Vector3f(axis.x, axis.y, axis.z)
    target = mi.Point3f(position.x, position.y, position.z)
    offset = target - surface.p
    squared = dr.fmax(dr.squared_norm(offset), 1e-24)
    distance = dr.sqrt(squared)
    is_far = position.w < 0.5
    to_sun, spread = -direction, mi.Float(1.0)
    if scene.lights.soft_suns:
        to_sun, spread = sample_disc(to_sun, dr.select(is_far, cone.x, 0.0), on_disc)
    to_light = dr.select(is_far, to_sun, offset / distance)
    # Fall-off of KHR_lights_punctual: inverse square, a window at the range, a squared ramp between the cone's cosines.
    window = dr.square(dr.clip(1.0 - dr.square(squared / dr.square(axis.w)), 0.0, 1.0))
    along = dr.dot(-to_light, direction)
    ramp = dr.square(dr.clip((along - cone.y) / dr.fmax(cone.x - cone.y, 1e-4), 0.0, 1.0))
    # Mitsuba's spot falls off with the angle itself.
    by_angle = dr.clip((cone.w - dr.safe_acos(along)) / dr.fmax(cone.w - cone.z, 1e-4), 0.0, 1.0)
    spot = dr.select(position.w > 1.5, dr.select(cone.w > 0.0, by_angle, ramp), 1.0)
    falloff = dr.select(is_far, spread, window * spot / squared)
    cosine = dr.fmax(dr.dot(surface.n_shading, to_light), 0.0)
    above = dr.dot(surface.n_geometric, to_light) > 0.0
    value = mi.Color3f(color.x, color.y, color.z) * (falloff * cosine * scene.lights.scale)
    ray, reach = _towards(origin, target)
    ray, reach = dr.select(is_far, to_sun, ray), dr.select(is_far, mi.Float(1e10), reach)
    return ray, reach, dr.select(above, value, mi.Color3f(0.0))


def _resample(
    scene: Scene,
    surface: Surface,
    origin: mi.Point3f,
    seed: mi.UInt32,
    lane: mi.UInt32,
    active: mi.Bool,
    turn: tuple[mi.UInt32, mi.UInt32] | None,
) -> tuple[mi.Vector3f, mi.Float, mi.Color3f]:
    """Return direction, distance and weighted unshadowed irradiance of the kept candidate."""
    count = FEW_CANDIDATES if scene.lights.entry_count <= FEW_ENTRIES else MANY_CANDIDATES
    best_direction, best_distance, best_value = mi.Vector3f(0.0, 1.0, 0.0), mi.Float(0.0), mi.Color3f(0.0)
    weight_sum = mi.Float(0.0)
    for candidate in range(count):
        pick, point, keep_below = _numbers(seed, lane, turn, candidate)
        direction, distance, value, density = _candidate(
            scene, surface, origin, (pick + candidate) / count, point, active
        )
        target = luminance(value)
        weight = dr.select(density > 0.0, target / density, 0.0)
        weight_sum += weight
        keep = keep_below * weight_sum < weight
        best_direction = dr.select(keep, direction, best_direction)
        best_distance = dr.select(keep, distance, best_distance)
        best_value = dr.select(keep, value / dr.fmax(target, 1e-30), best_value)
    return best_direction, best_distance, best_value * (weight_sum / count)


def _numbers(
    seed: mi.UInt32, lane: mi.UInt32, turn: tuple[mi.UInt32, mi.UInt32] | None, candidate: int
) -> tuple[mi.Float, mi.Point2f, mi.Float]:
    """Return the numbers in [0, 1) that choose a candidate's source, its point there, and whether it is kept.

    Sources are chosen by one number that the candidates share, each in its part of the unit interval, so that they
    are seldom the same one.
    """
    source, own = mi.UInt32(0x9E3779B8), mi.UInt32(0x9E3779B9 + 2 * candidate)
    if turn is None:
        point = random_2d(seed + (own + 1), lane)
        return random_2d(seed + source, lane).x, point, random_2d(seed + own, lane).y
    index, common = turn
    shift = hash_pair(common + source, lane)[0], *hash_pair(common + own, lane)
    pick, x, y = sequence_3d(index, shift)
    return pick, mi.Point2f(x, y), random_2d(seed + own, lane).y


def _candidate(
    scene: Scene, surface: Surface, origin: mi.Point3f, pick: mi.Float, point: mi.Point2f, active: mi.Bool
) -> tuple[mi.Vector3f, mi.Float, mi.Color3f, mi.Float]:
    """Return the shadow ray's direction and length, the unshadowed integrand, and its density.

    Both are by area or both by solid angle, as the point was sampled; for a delta light the density is a probability.
    """
    lights, geometry = scene.lights, scene.geometry
    source, probability = choose_source(scene, surface.p, surface.n_shading, pick, active)
    active = active & (probability > 0.0)
    if not lights.has_triangles:
        ray, reach, value = _delta_light(scene, source & 0x7FFFFFFF, surface, origin, point, active)
        return ray, SHORT_OF * reach, value, probability

    # Choose a point of the triangle: by solid angle where it looms large, by area where it is far.
    is_delta = (source & ENTRY_IS_DELTA) != 0
    on_triangle = active & ~is_delta
    triangle = fetch_triangle(scene, source, on_triangle)
    corners = triangle.positions
    clear = STEP * largest(surface.p)
    if scene.features.moving:
        placed = clear_when_placed(geometry.to_world, triangle.object_id, corners, on_triangle)
        clear = dr.fmax(clear, placed)
        corners = [transform_point(geometry.to_world, triangle.object_id, x, on_triangle) for x in corners]
    else:
        clear = dr.fmax(clear, clear_of_corners(corners))
    b, y, omega = _point_on_triangle(surface.p, corners, point)
    face = face_vector(corners)
    if scene.features.moving:
        # A mirror turns the order of the corners round, not the side that shines.
        face = mi.Vector3f(dr.mulsign(face, determinant(geometry.to_world, triangle.object_id, on_triangle)))
    double_area = dr.norm(face)

    # Evaluate what it would bring without shadow.
    offset = y - surface.p
    squared = dr.fmax(dr.squared_norm(offset), 1e-24)
    to_light = offset * dr.rsqrt(squared)
    # A point of the light's own plane sees nothing of it: there solid angle and cosine are rounding noise.
    height = dr.dot(face, surface.p - corners[0]) / dr.fmax(double_area, 1e-30)
    apart = dr.abs(height) > 4.0 * clear
    at_light = interpolate(scene, triangle, b, on_triangle)
    emission = emitted_radiance(scene, at_light, height > 0.0, on_triangle)
    if scene.features.cutout:
        emission *= opacity(scene, at_light, on_triangle)
    cos_light = dr.select(apart, dr.abs(dr.dot(face, to_light)) / dr.fmax(double_area, 1e-30), 0.0)
    cos_surface = dr.fmax(dr.dot(surface.n_shading, to_light), 0.0)
    above = dr.dot(surface.n_geometric, to_light) > 0.0
    by_angle = omega > 0.0
    geometric = dr.select(by_angle, dr.select(apart, mi.Float(1.0), 0.0), cos_light / squared)
    value = dr.select(above & on_triangle, emission * (cos_surface * geometric), mi.Color3f(0.0))
    by_area = dr.select(double_area > 0.0, 2.0 * probability / double_area, 0.0)
    density = dr.select(by_angle, probability / dr.fmax(omega, 1e-20), by_area)
    # End before the light, on the side that the ray comes from, or its own triangle would shadow it.
    toward = mi.Vector3f(face) * (clear * dr.mulsign(dr.rcp(dr.fmax(double_area, 1e-30)), height))
    ray, reach = _towards(origin, y + toward)
    reach *= SHORT_OF
    if lights.delta_count > lights.delta_each:
        chosen = active & is_delta
        delta_to, delta_distance, delta_value = _delta_light(scene, source & 0x7FFFFFFF, surface, origin, point, chosen)
        ray = dr.select(chosen, delta_to, ray)
        reach = dr.select(chosen, SHORT_OF * delta_distance, reach)
        value = dr.select(chosen, delta_value, value)
        density = dr.select(chosen, probability, density)
    return ray, reach, value, density


def _point_on_triangle(
    p: mi.Point3f, corners: list[mi.Point3f], sample: mi.Point2f
) -> tuple[mi.Point2f, mi.Point3f, mi.Float]:
    """Return barycentric weights, the point, and the solid angle it was sampled by (0: sampled by area)."""
    a, b, c = (corner - p for corner in corners)
    unit = [dr.normalize(mi.Vector3f(x)) for x in (a, b, c)]
    omega = solid_angle(unit[0], unit[1], unit[2])
    direction = sample_direction(unit[0], unit[1], unit[2], omega, sample)
    # Where the direction meets the triangle's plane, in barycentric weights (Cramer's rule on p + t d = corners).
    edge_1, edge_2 = corners[1] - corners[0], corners[2] - corners[0]
    across = dr.cross(direction, edge_2)
    determinant = dr.dot(edge_1, across)
    from_corner = p - corners[0]
    inverse = 1.0 / dr.select(dr.abs(determinant) > 1e-20, determinant, 1e-20)
    weight_1 = dr.dot(from_corner, across) * inverse
    weight_2 = dr.dot(direction, dr.cross(from_corner, edge_1)) * inverse
    # Rounding may leave the triangle by a little; the point goes back to its border.
    weight_1 = dr.clip(weight_1, 0.0, 1.0)
    weight_2 = dr.clip(weight_2, 0.0, 1.0 - weight_1)
    by_angle = omega > SOLID_ANGLE_MIN
    by_area = uniform_triangle(sample)
    weights = mi.Point2f(dr.select(by_angle, weight_1, by_area.x), dr.select(by_angle, weight_2, by_area.y))
    point = corners[0] + edge_1 * weights.x + edge_2 * weights.y
    return weights, point, dr.select(by_angle, omega, 0.0)


def _towards(origin: mi.Point3f, target: mi.Point3f) -> tuple[mi.Vector3f, mi.Float]:
    """Return unit direction and distance from `origin` to `target`."""
    offset = target - origin
    distance = dr.sqrt(dr.fmax(dr.squared_norm(offset), 1e-24))
    return offset / distance, distance
