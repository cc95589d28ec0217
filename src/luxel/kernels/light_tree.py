"""Descend the tree over light sources: choose one with a probability near what it would bring to a point.

At each node one of the two children is chosen in proportion to a bound of the irradiance that its sources could bring:
intensity over squared distance, the cosines at the receiver and at the sources, the window of the longest range. The
bound is zero only where none of them can light the point, so what is drawn is unbiased. One random number serves the
whole way down; what is left of it after a choice is uniform again. Source: Conty Estevez and Kulla 2018, "Importance
Sampling of Many Lights with Adaptive Tree Splitting".
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from luxel.scene.device import Scene

UNROLLED_DEPTH = 2
"""Trees up to so deep are descended without a loop, which costs more than it saves there."""
NEAREST_SHARE = 0.02
"""Share of a box's distance or size that the nearest source below it is taken to be away at least."""
BELOW_ONE = 1.0 - 2.0**-24


def choose_source(
    scene: Scene, p: mi.Point3f, n: mi.Normal3f, sample: mi.Float, active: mi.Bool
) -> tuple[mi.UInt32, mi.Float]:
    """Return an entry of `LightTables.entries` for the point `p` with unit normal `n`, and its probability.

    `sample` is uniform in [0, 1). The probability is 0 where no source that is sampled can light the point.
    """
    nodes, depth = scene.lights.nodes, scene.lights.entry_count.bit_length() - 1
    node, probability = mi.UInt32(1), mi.Float(1.0)
    if depth <= UNROLLED_DEPTH:
        sample = mi.Float(sample)
        for _ in range(depth):
            node, probability, sample = _choose_child(nodes, p, n, node, probability, sample, active)
    else:
        node, probability = _descend(nodes, depth, p, n, sample, active)
    chosen = active & (probability > 0.0)
    leaf = node - mi.UInt32(1 << depth)
    return dr.gather(mi.UInt32, scene.lights.entries, leaf, chosen), dr.select(chosen, probability, 0.0)


@dr.syntax
def _descend(
    nodes: mi.Float, depth: int, p: mi.Point3f, n: mi.Normal3f, sample: mi.Float, active: mi.Bool
) -> tuple[mi.UInt32, mi.Float]:
    """Return the leaf's node, and the product of the shares on the way there."""
    node, probability, rest = mi.UInt32(1), mi.Float(1.0), mi.Float(sample)
    level, going = mi.UInt32(0), mi.Bool(active)
    while going & (level < depth):
        node, probability, rest = _choose_child(nodes, p, n, node, probability, rest, going)
        going &= probability > 0.0
        level += 1
    return node, probability


def _choose_child(
    nodes: mi.Float,
    p: mi.Point3f,
    n: mi.Normal3f,
    node: mi.UInt32,
    probability: mi.Float,
    sample: mi.Float,
    active: mi.Bool,
) -> tuple[mi.UInt32, mi.Float, mi.Float]:
    """Return the child, its probability, and the random number that is left."""
    left, right = (_importance(nodes, 2 * node + side, p, n, active) for side in (0, 1))
    total = left + right
    share = dr.select(total > 0.0, left / total, 0.0)
    to_left = (sample < share) | ((right <= 0.0) & (left > 0.0))
    chosen = dr.select(to_left, share, 1.0 - share)
    rest = dr.select(to_left, sample, sample - share) / dr.fmax(chosen, 1e-20)
    chosen = dr.select(total > 0.0, chosen, 0.0)
    return (
        2 * node + dr.select(to_left, mi.UInt32(0), mi.UInt32(1)),
        probability * chosen,
        dr.clip(rest, 0.0, BELOW_ONE),
    )


def _importance(nodes: mi.Float, node: mi.UInt32, p: mi.Point3f, n: mi.Normal3f, active: mi.Bool) -> mi.Float:
    """Return about what the sources below `node` could bring; 0 only where they bring nothing."""
    box, extent, cone, more = (dr.gather(mi.Vector4f, nodes, 4 * node + i, active) for i in range(4))
    offset = mi.Vector3f(box.x, box.y, box.z) - p
    half = mi.Vector3f(extent.x, extent.y, extent.z)
    axis = mi.Vector3f(cone.x, cone.y, cone.z)

    # The box: how far above the receiver's plane it reaches, and how near it comes.
    middle = dr.norm(offset)
    radius = dr.norm(half)
    nearest = dr.norm(dr.fmax(dr.abs(offset) - half, 0.0))
    window = dr.square(dr.clip(1.0 - dr.square(dr.square(nearest / box.w)), 0.0, 1.0))
    # Cosines are bound by the nearest point of the box, as most of what a large node brings comes from near by.
    rise = dr.dot(n, offset) + dr.dot(dr.abs(n), half)
    at_receiver = dr.minimum(rise / dr.fmax(nearest, 1e-6), 1.0)

    # The cone: the least angle between any axis and any direction from the box to the point.
    along = -dr.dot(axis, offset)
    along = dr.select(more.w > 0.0, dr.abs(along), along) + dr.dot(dr.abs(axis), half)
    along = dr.clip(along / dr.fmax(dr.select(along > 0.0, nearest, middle + radius), 1e-6), -1.0, 1.0)
    at_source = _cosine_of_difference(along, cone.w, more.y)

    # By the distance of the middle, and more where the box comes near: one of its sources may be there.
    reached = dr.maximum(dr.maximum(middle, radius), 1e-6)
    closest = dr.maximum(nearest, NEAREST_SHARE * reached)
    near = extent.w * window * at_receiver * at_source / dr.square(reached) * dr.sqrt(reached / closest)
    shines = (extent.w > 0.0) & (rise > 0.0) & (at_source > 0.0) & (at_source >= more.x)
    near = dr.select(shines, near, 0.0)

    # What is infinitely far away: by the cosine of the nearest axis, unless sources with a place share the node.
    facing = dr.fmax(_cosine_of_difference(dr.clip(-dr.dot(axis, n), -1.0, 1.0), cone.w, more.y), 0.0)
    far = more.z * dr.select(extent.w > 0.0, 1.0, facing)
    return dr.select(active, near + far, 0.0)


def _cosine_of_difference(cosine: mi.Float, cos_less: mi.Float, sin_less: mi.Float) -> mi.Float:
    """Return the cosine of an angle less another one, or 1 where it is smaller than that."""
    sine = dr.safe_sqrt(1.0 - dr.square(cosine))
    return dr.select(cosine >= cos_less, 1.0, cosine * cos_less + sine * sin_less)
