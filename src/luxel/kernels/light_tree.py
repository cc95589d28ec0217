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
from luxel.scene.lights import NO_ENTRY, LightTables

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
    lights, depth = scene.lights, scene.lights.entry_count.bit_length() - 1
    node, probability = mi.UInt32(1), mi.Float(1.0)
    if depth <= UNROLLED_DEPTH:
        sample = mi.Float(sample)
        for _ in range(depth):
            node, probability, sample = _choose_child(lights, p, n, node, probability, sample, active)
    else:
        node, probability = _descend(lights, depth, p, n, sample, active)
    chosen = active & (probability > 0.0)
    leaf = node - mi.UInt32(1 << depth)
    return dr.gather(mi.UInt32, lights.entries, leaf, chosen), dr.select(chosen, probability, 0.0)


@dr.syntax
def _descend(
    lights: LightTables, depth: int, p: mi.Point3f, n: mi.Normal3f, sample: mi.Float, active: mi.Bool
) -> tuple[mi.UInt32, mi.Float]:
    """Return the leaf's node, and the product of the shares on the way there."""
    node, probability, rest = mi.UInt32(1), mi.Float(1.0), mi.Float(sample)
    level, going = mi.UInt32(0), mi.Bool(active)
    while going & (level < depth):
        node, probability, rest = _choose_child(lights, p, n, node, probability, rest, going)
        going &= probability > 0.0
        level += 1
    return node, probability


def _choose_child(
    lights: LightTables,
    p: mi.Point3f,
    n: mi.Normal3f,
    node: mi.UInt32,
    probability: mi.Float,
    sample: mi.Float,
    active: mi.Bool,
) -> tuple[mi.UInt32, mi.Float, mi.Float]:
    """Return the child, its probability, and the random number that is left."""
    share, left, right = _weigh_children(lights, p, n, node, active)
    to_left = (sample < share) | ((right <= 0.0) & (left > 0.0))
    chosen = dr.select(to_left, share, 1.0 - share)
    rest = dr.select(to_left, sample, sample - share) / dr.fmax(chosen, 1e-20)
    chosen = dr.select(left + right > 0.0, chosen, 0.0)
    return (
        2 * node + dr.select(to_left, mi.UInt32(0), mi.UInt32(1)),
        probability * chosen,
        dr.clip(rest, 0.0, BELOW_ONE),
    )


def _weigh_children(
    lights: LightTables, p: mi.Point3f, n: mi.Normal3f, node: mi.UInt32, active: mi.Bool
) -> tuple[mi.Float, mi.Float, mi.Float]:
    """Return the left child's share, and the importance of the left and of the right one."""
    left, right = (_importance(lights, 2 * node + side, p, n, active) for side in (0, 1))
    total = left + right
    return dr.select(total > 0.0, left / total, 0.0), left, right


def source_probability(scene: Scene, p: mi.Point3f, n: mi.Normal3f, entry: mi.UInt32, active: mi.Bool) -> mi.Float:
    """Return the probability with which `choose_source` returns `entry` at the point `p`; 0 where it never does."""
    lights, depth = scene.lights, scene.lights.entry_count.bit_length() - 1
    if depth < 0:
        return mi.Float(0.0)
    leaf, found = _find_leaf(lights, depth, entry, active)
    return dr.select(found, _probability_of_leaf(lights, depth, p, n, leaf, found), 0.0)


def _find_leaf(lights: LightTables, depth: int, entry: mi.UInt32, active: mi.Bool) -> tuple[mi.UInt32, mi.Bool]:
    """Return the leaf that holds `entry`, and whether one does: `depth` steps of bisection."""
    place = mi.UInt32(0)
    for level in reversed(range(depth)):
        middle = place + mi.UInt32(1 << level)
        place = dr.select(dr.gather(mi.UInt32, lights.leaves, 2 * middle, active) <= entry, middle, place)
    row = dr.gather(mi.Vector2u, lights.leaves, place, active)
    return row.y, active & (row.x == entry) & (entry != NO_ENTRY)


@dr.syntax
def _probability_of_leaf(
    lights: LightTables, depth: int, p: mi.Point3f, n: mi.Normal3f, leaf: mi.UInt32, active: mi.Bool
) -> mi.Float:
    """Return the product of the shares on the way down to `leaf`."""
    node, probability = mi.UInt32(1), mi.Float(1.0)
    level, going = mi.UInt32(0), mi.Bool(active)
    while going & (level < depth):
        share, left, right = _weigh_children(lights, p, n, node, going)
        side = (leaf >> (depth - 1 - level)) & 1
        chosen = dr.select(side == 0, share, 1.0 - share)
        probability *= dr.select(left + right > 0.0, chosen, 0.0)
        node = 2 * node + side
        going &= probability > 0.0
        level += 1
    return probability


def _importance(
    lights: LightTables, node: mi.UInt32, p: mi.Point3f, n: mi.Normal3f, active: mi.Bool
) -> mi.Float:  # fmt: skip
    """Return about what the sources below `node` could bring; 0 only where they bring nothing."""
    box, extent = (dr.gather(mi.Vector4f, lights.nodes, 4 * node + i, active) for i in (0, 1))
    offset = mi.Vector3f(box.x, box.y, box.z) - p
    half = mi.Vector3f(extent.x, extent.y, extent.z)

    # How far above the receiver's plane the box reaches, and how near it comes, at least a micrometre.
    rise = dr.dot(n, offset) + dr.dot(dr.abs(n), half)
    nearest = dr.fmax(dr.squared_norm(dr.fmax(dr.abs(offset) - half, 0.0)), 1e-12)
    window = dr.square(dr.clip(1.0 - dr.square(nearest / dr.square(box.w)), 0.0, 1.0))
    # Cosines are bound by the nearest point of the box, as most of what a large node brings comes from near by.
    inverse = dr.rsqrt(nearest)
    at_receiver = dr.minimum(rise * inverse, 1.0)

    # By the distance of the middle, and more where the box comes near: one of its sources may be there.
    reached = dr.fmax(dr.fmax(dr.squared_norm(offset), dr.squared_norm(half)), 1e-12)
    closer = dr.sqrt(dr.sqrt(reached / dr.fmax(nearest, NEAREST_SHARE**2 * reached)))
    near = extent.w * window * at_receiver * closer / reached
    shines = rise > 0.0
    if not (lights.has_cones or lights.has_far):
        return dr.select(active & shines, near, 0.0)

    # The least angle between any axis of the cone and any direction from the box to the point.
    cone, more = (dr.gather(mi.Vector4f, lights.nodes, 4 * node + i, active) for i in (2, 3))
    axis = mi.Vector3f(cone.x, cone.y, cone.z)
    along = -dr.dot(axis, offset)
    along = dr.select(more.w > 0.0, dr.abs(along), along) + dr.dot(dr.abs(axis), half)
    along *= dr.select(along > 0.0, inverse, dr.rsqrt(dr.fmax(dr.squared_norm(dr.abs(offset) + half), 1e-12)))
    at_source = _cosine_of_difference(dr.clip(along, -1.0, 1.0), cone.w, more.y)
    shines &= (extent.w > 0.0) & (at_source > 0.0) & (at_source >= more.x)
    total = dr.select(shines, near * at_source, 0.0)

    if lights.has_far:
        # By the cosine of the nearest axis, unless sources with a place share the node.
        facing = dr.fmax(_cosine_of_difference(dr.clip(-dr.dot(axis, n), -1.0, 1.0), cone.w, more.y), 0.0)
        total += more.z * dr.select(extent.w > 0.0, 1.0, facing)
    return dr.select(active, total, 0.0)


def _cosine_of_difference(cosine: mi.Float, cos_less: mi.Float, sin_less: mi.Float) -> mi.Float:
    """Return the cosine of an angle less another one, or 1 where it is smaller than that."""
    sine = dr.safe_sqrt(1.0 - dr.square(cosine))
    return dr.select(cosine >= cos_less, 1.0, cosine * cos_less + sine * sin_less)
