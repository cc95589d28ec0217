"""Uniform directions towards a triangle, as seen from a point.

Source: Arvo 1995, "Stratified Sampling of Spherical Triangles".

Sampling a triangle by area has unbounded estimates where it is near, as in the corners of an emitting box; sampling it
by solid angle is bounded by its radiance.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


def solid_angle(a: mi.Vector3f, b: mi.Vector3f, c: mi.Vector3f) -> mi.Float:
    """Return the solid angle of the triangle with unit directions `a`, `b`, `c` to its corners (Van Oosterom 1983)."""
    volume = dr.abs(dr.dot(a, dr.cross(b, c)))
    return 2.0 * dr.atan2(volume, 1.0 + dr.dot(a, b) + dr.dot(b, c) + dr.dot(c, a))


def sample_direction(
    a: mi.Vector3f, b: mi.Vector3f, c: mi.Vector3f, omega: mi.Float, sample: mi.Point2f
) -> mi.Vector3f:
    """Return a unit direction, uniform over the spherical triangle of solid angle `omega`."""
    # The angle at corner a, between the great circles to b and to c.
    to_b, to_c = _orthogonal(b, a), _orthogonal(c, a)
    cos_alpha = dr.clip(dr.dot(to_b, to_c), -1.0, 1.0)
    sin_alpha = dr.fmax(dr.safe_sqrt(1.0 - dr.square(cos_alpha)), 1e-7)
    alpha = dr.atan2(sin_alpha, cos_alpha)

    # Find the point c' of the edge a-c that cuts off a share of the area.
    sin_phi, cos_phi = dr.sincos(sample.x * omega - alpha)
    u = cos_phi - cos_alpha
    v = sin_phi + sin_alpha * dr.dot(a, b)
    below = (v * sin_phi + u * cos_phi) * sin_alpha
    q = ((v * cos_phi - u * sin_phi) * cos_alpha - v) / dr.select(dr.abs(below) > 1e-12, below, 1e-12)
    q = dr.clip(q, -1.0, 1.0)
    cut = q * a + dr.safe_sqrt(1.0 - dr.square(q)) * to_c

    # Choose a point between b and c' so that area is uniform.
    z = 1.0 - sample.y * (1.0 - dr.dot(cut, b))
    return dr.normalize(z * b + dr.safe_sqrt(1.0 - dr.square(z)) * _orthogonal(cut, b))


def _orthogonal(v: mi.Vector3f, axis: mi.Vector3f) -> mi.Vector3f:
    """Return the unit part of `v` that is orthogonal to the unit vector `axis`."""
    rest = v - axis * dr.dot(v, axis)
    return rest * dr.rsqrt(dr.fmax(dr.squared_norm(rest), 1e-20))
