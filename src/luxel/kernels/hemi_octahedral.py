"""The hemi-octahedral map: unit directions above a plane to the square and back (Cigolle et al. 2014).

A warp stretches directions along the plane's normal before they are mapped, so that most of the square lies near the
horizon: that is where a point of the same surface is seen.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


def hemisphere_to_square(d: mi.Vector3f, warp: float) -> mi.Point2f:
    """Return the point of [-1, 1]^2 for the direction `d`, of any length, about +Z; those below lie on the border."""
    up = warp * dr.fmax(d.z, 0.0)
    scale = dr.rcp(dr.fmax(dr.abs(d.x) + dr.abs(d.y) + up, 1e-20))
    return mi.Point2f((d.x + d.y) * scale, (d.x - d.y) * scale)


def square_to_hemisphere(p: mi.Point2f, warp: float) -> mi.Vector3f:
    """Return the unit direction about +Z that the point `p` of [-1, 1]^2 stands for."""
    x, y = 0.5 * (p.x + p.y), 0.5 * (p.x - p.y)
    up = dr.fmax(1.0 - dr.abs(x) - dr.abs(y), 0.0)
    return dr.normalize(mi.Vector3f(x, y, up / warp))


def texel_of(p: mi.Point2f, side: int) -> mi.UInt32:
    """Return the number of the texel that holds the point `p` of [-1, 1]^2, in a map of `side` x `side`, by rows."""
    column, row = (mi.UInt32(dr.clip((c * 0.5 + 0.5) * side, 0.0, side - 0.5)) for c in (p.x, p.y))
    return row * side + column


def point_in_texel(texel: mi.UInt32, side: int, place: mi.Point2f) -> mi.Point2f:
    """Return the point of [-1, 1]^2 at `place`, in [0, 1)^2, of a texel."""
    x, y = mi.Float(texel % side) + place.x, mi.Float(texel // side) + place.y
    return mi.Point2f(x * (2.0 / side) - 1.0, y * (2.0 / side) - 1.0)
