"""Where rays may start: points of surfaces, kept clear of their own triangle by what single precision may be wrong.

After Wächter and Binder (Ray Tracing Gems, chapter 6): a hit point is computed from its triangle's corners, in the
space in which they are stored, and moved along the geometric normal by a few units in the last place. How far a
computed point may lie off its plane, and how wrongly a ray may be tested against it, both grow with the largest
coordinate of the corners, not with the point's own: a point near the origin may lie on a large triangle. So the length
comes from there, and from nothing else: no metres, no size of the scene. What moves is rounded by its matrix as well,
and kept clear in the world, where lengths and angles are those that rays see: its own space may be stretched.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.kernels.transform import fetch_matrix
from luxel.scene.rounding import STEP

NO_TRIANGLE = 0xFFFFFFFF


def largest(v: mi.Point3f | mi.Vector3f) -> mi.Float:
    """Return the largest of |x|, |y|, |z|."""
    return dr.fmax(dr.fmax(dr.abs(v.x), dr.abs(v.y)), dr.abs(v.z))


def clear_of_corners(corners: list[mi.Point3f]) -> mi.Float:
    """Return the distance, metres, that clears a triangle with these corners."""
    return STEP * largest(_farthest(corners))


def clear_when_placed(
    to_world: mi.Float, index: mi.UInt32, corners: list[mi.Point3f], active: mi.Bool | bool = True
) -> mi.Float:
    """Return the distance, metres of the world, that clears a triangle with these corners in its object's space.

    `to_world` is a (K, 12) row table, of which matrix `index` places the object: what it adds up may cancel, and is
    rounded all the same.
    """
    far = _farthest(corners)
    sums = []
    for row in map(dr.abs, fetch_matrix(to_world, index, active)):
        sums.append(row.x * far.x + row.y * far.y + row.z * far.z + row.w)
    return STEP * largest(mi.Vector3f(*sums))


def _farthest(corners: list[mi.Point3f]) -> mi.Vector3f:
    """Return the largest |x|, |y| and |z| of a triangle's corners."""
    a, b, c = (dr.abs(mi.Vector3f(v.x, v.y, v.z)) for v in corners)
    return mi.Vector3f(dr.maximum(dr.maximum(a, b), c))


def find_way_clear(
    corners: list[mi.Point3f],
    barycentric: mi.Point2f,
    n: mi.Normal3f,
    area: mi.Float,
    clear: mi.Float,
) -> mi.Vector3f:
    """Return the way from a point of a triangle to `clear` off it on the side of `n`, and as far inwards from an edge.

    On an edge, rounding puts a point behind the neighbour that meets there, outside of a closed room. `n`: unit normal
    on the side that the rays start from; `area`: twice the triangle's; all in the space of the corners.
    """
    a, b, c = (mi.Vector3f(v.x, v.y, v.z) for v in corners)
    way = mi.Vector3f(n) * clear
    weights = (1.0 - barycentric.x - barycentric.y, barycentric.x, barycentric.y)
    for weight, edge, inner in ((weights[0], c - b, a - b), (weights[1], a - c, b - c), (weights[2], b - a, c - a)):
        across = dr.cross(mi.Vector3f(n), edge)
        inverse = dr.rsqrt(dr.fmax(dr.squared_norm(edge), 1e-36))
        missing = dr.fmax(clear - weight * area * inverse, 0.0) * inverse
        way += dr.mulsign(across, dr.dot(across, inner)) * missing
    return way


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
