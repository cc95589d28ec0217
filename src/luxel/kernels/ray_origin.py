"""Where rays may start: points of surfaces, kept clear of their own triangle by what single precision may be wrong.

After Wächter and Binder (Ray Tracing Gems, chapter 6): a hit point is computed from its triangle's corners, in the
space in which they are stored, and moved along the geometric normal by a few units in the last place. How far a
computed point may lie off its plane, and how wrongly a ray may be tested against it, both grow with the largest
coordinate of the corners, not with the point's own: a point near the origin may lie on a large triangle. So the length
comes from there, and from nothing else: no metres, no size of the scene.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.scene.rounding import STEP

NO_TRIANGLE = 0xFFFFFFFF


def largest(v: mi.Point3f | mi.Vector3f | mi.Vector4f) -> mi.Float:
    """Return the largest of |x|, |y|, |z|."""
    return dr.fmax(dr.fmax(dr.abs(v.x), dr.abs(v.y)), dr.abs(v.z))


def clear_of_corners(corners: list[mi.Vector4f] | list[mi.Point3f]) -> mi.Float:
    """Return the distance, metres, that clears a triangle with these corners."""
    return STEP * dr.fmax(dr.fmax(largest(corners[0]), largest(corners[1])), largest(corners[2]))


def clear_point(
    position: mi.Point3f,
    corners: list[mi.Vector4f],
    barycentric: mi.Point2f,
    n: mi.Normal3f,
    area: mi.Float,
    clear: mi.Float,
) -> mi.Point3f:
    """Return a point of a triangle moved by `clear` to the side of `n`, and inwards as far where it lies on an edge.

    On an edge, rounding puts a point behind the neighbour that meets there, outside of a closed room. `n`: unit normal
    on the side that the rays start from; `area`: twice the triangle's; all in the space of the corners.
    """
    a, b, c = (mi.Vector3f(v.x, v.y, v.z) for v in corners)
    moved = mi.Point3f(position + mi.Vector3f(n) * clear)
    weights = (1.0 - barycentric.x - barycentric.y, barycentric.x, barycentric.y)
    for weight, edge, inner in ((weights[0], c - b, a - b), (weights[1], a - c, b - c), (weights[2], b - a, c - a)):
        across = dr.cross(mi.Vector3f(n), edge)
        inverse = dr.rsqrt(dr.fmax(dr.squared_norm(edge), 1e-36))
        missing = dr.fmax(clear - weight * area * inverse, 0.0) * inverse
        moved += dr.mulsign(across, dr.dot(across, inner)) * missing
    return mi.Point3f(moved)


def next_step(origin: mi.Point3f, direction: mi.Vector3f, t: mi.Float, before: mi.Float, again: mi.Bool) -> mi.Float:
    """Return how far behind the hit at `t` a ray goes on, in lengths of `direction`.

    `before`: the last step; `again`: the ray has met the triangle that it had just passed, so it takes twice as much.
    """
    # Little, so that sheets close to each other are met one by one.
    first = 0.25 * STEP * (dr.abs(t) + largest(origin) / dr.fmax(largest(direction), 1e-30))
    return dr.select(again, 2.0 * before, first)


def clear_points(p: np.ndarray, n: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return points p (N, 3) of triangles with corners (N, 3, 3) moved along unit normals n (N, 3), on the host."""
    return p + n * (STEP * np.abs(corners).max(axis=(1, 2)))[:, None]
