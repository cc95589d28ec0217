"""The octahedral map: unit directions to the square and back (Cigolle et al. 2014)."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


def direction_to_square(d: mi.Vector3f) -> mi.Point2f:
    """Return the point of [-1, 1]^2 that stands for the direction `d`, of any length; its middle where that is 0."""
    d = d * dr.rcp(dr.fmax(dr.abs(d.x) + dr.abs(d.y) + dr.abs(d.z), 1e-20))
    folded = mi.Point2f(
        (1.0 - dr.abs(d.y)) * dr.mulsign(mi.Float(1.0), d.x), (1.0 - dr.abs(d.x)) * dr.mulsign(mi.Float(1.0), d.y)
    )
    return dr.select(d.z >= 0.0, mi.Point2f(d.x, d.y), folded)


def square_to_direction(p: mi.Point2f) -> mi.Vector3f:
    """Return the unit direction that the point `p` of [-1, 1]^2 stands for."""
    z = 1.0 - dr.abs(p.x) - dr.abs(p.y)
    fold = dr.fmax(-z, 0.0)
    return dr.normalize(mi.Vector3f(p.x - dr.mulsign(fold, p.x), p.y - dr.mulsign(fold, p.y), z))
