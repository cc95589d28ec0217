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

    # The box: how far above the receiver's plane it reaches, how near it comes, how large it looks.
    rise = dr.dot(n, offset) + dr.dot(dr.abs(n), half)
    nearest = dr.squared_norm(dr.fmax(dr.abs(offset) - half, 0.0))
    window = dr.square(dr.clip(1.0 - dr.square(nearest / dr.square(box.w)), 0.0, 1.0))
    squared = dr.fmax(dr.squared_norm(offset), 1e-12)
    radius = dr.squared_norm(half)
    distance = dr.sqrt(squared)
    seen = dr.select(squared > radius, dr.safe_sqrt(1.0 - radius / squared), -1.0)

    # The cone: the least angle to the point from any axis, less what the box covers.
    along = -dr.dot(axis, offset) / distance
    along = dr.clip(dr.select(more.w > 0.0, dr.abs(along), along), -1.0, 1.0)
    across = dr.safe_sqrt(1.0 - dr.square(along))
    inside = along >= cone.w
    cosine = dr.select(inside, 1.0, along * cone.w + across * more.y)
    sine = dr.select(inside, 0.0, across * cone.w - along * more.y)
    cosine = dr.select(cosine >= seen, 1.0, cosine * seen + sine * dr.safe_sqrt(1.0 - dr.square(seen)))
    shines = (cosine > 0.0) & (cosine >= more.x)

    reached = dr.fmax(squared, radius)
    near = extent.w * window * cosine * dr.fmax(rise, 0.0) / (reached * dr.sqrt(reached))
    near = dr.select(shines & (extent.w > 0.0), near, 0.0)

    # What is infinitely far away: by the cosine of the nearest axis, unless sources with a place share the node.
    facing = -dr.dot(axis, n)
    facing = dr.select(
        facing >= cone.w, 1.0, facing * cone.w + dr.safe_sqrt(1.0 - dr.square(facing)) * more.y
    )  # fmt: skip
    far = more.z * dr.select(extent.w > 0.0, 1.0, dr.fmax(facing, 0.0))
    return dr.select(active, near + far, 0.0)
