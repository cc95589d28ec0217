"""A tree over light sources, made on the host: what each node bounds, which leaf holds which source, and refitting.

A node bounds the sources below it by a box, a cone of directions, the longest range and their summed intensity; the
kernels descend by what these can bring to a point (`kernels/light_tree.py`). Sources: Conty Estevez and Kulla 2018,
"Importance Sampling of Many Lights with Adaptive Tree Splitting"; the cones of directions are theirs.

The tree is complete: node k has the children 2k and 2k + 1, and all leaves lie at one depth, so that neither pointers
nor a stack are needed and each level is made at once.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

NODE_FLOATS = 16
ANGLE_SLACK = 1e-3
"""Radians added to each cone, so that rounding never leaves out a source that lights a point."""
SPARE_LEAVES = 1.25
"""Leaves for each source."""
BOX_SLACK = 1e-6
"""Share of its coordinates by which a box grows, for the same reason."""


@dataclass
class LightBounds:
    """What bounds some sources, a row a node. Rows of neither intensity nor irradiance are empty."""

    lower: np.ndarray
    """(N, 3) of the box around the sources that have a place."""
    upper: np.ndarray
    intensity: np.ndarray
    """(N,) summed luminous intensity along the axes, W/sr, of the sources that have a place."""
    far: np.ndarray
    """(N,) summed luminance of the irradiance, W/m^2, of the sources infinitely far away."""
    axis: np.ndarray
    """(N, 3) unit axis of the cone that holds all directions along which the sources shine most."""
    spread: np.ndarray
    """(N,) half angle of that cone, radians."""
    reach: np.ndarray
    """(N,) how far beyond that cone light still goes, radians: pi / 2 for a surface."""
    two_sided: np.ndarray
    """(N,) bool: the cone opens both ways."""
    range: np.ndarray
    """(N,) the longest range, metres."""

    def take(self, rows: np.ndarray | slice) -> LightBounds:
        """Return some of the rows."""
        return LightBounds(*(getattr(self, item.name)[rows] for item in fields(self)))


def empty_bounds(count: int) -> LightBounds:
    """Return `count` rows that bound nothing."""
    zeros, up = np.zeros(count), np.tile((0.0, 1.0, 0.0), (count, 1))
    places = np.zeros((count, 3)), np.zeros((count, 3))
    return LightBounds(*places, zeros, zeros.copy(), up, zeros.copy(), zeros.copy(), zeros.astype(bool), zeros.copy())


def join_bounds(first: LightBounds, second: LightBounds) -> LightBounds:
    """Return the rows of both, one after the other."""
    return LightBounds(
        *(np.concatenate([getattr(first, item.name), getattr(second, item.name)]) for item in fields(first))
    )


def tree_depth(count: int) -> int:
    """Return the depth of a tree of at least two leaves for `count` sources, with some room for uneven halves."""
    return max(int(count - 1).bit_length(), int(SPARE_LEAVES * count - 1).bit_length() if count > 4 else 1)


def order_leaves(bounds: LightBounds, depth: int) -> np.ndarray:
    """Return which source each of the 2^`depth` leaves holds, -1 for none.

    Each node's sources are sorted along the longest side of the box around their centres and parted where intensity
    times squared diagonal, summed over both parts, is least: lamps of many triangles stay whole. All nodes of a level
    are parted at once: 100,000 sources take a second.
    """
    count = len(bounds.intensity)
    lower, upper, weight = bounds.lower.copy(), bounds.upper.copy(), bounds.intensity + bounds.far
    nowhere = bounds.intensity <= 0.0
    lower[nowhere] = upper[nowhere] = _beside(lower)
    order, nodes = np.arange(count), np.zeros(min(count, 1), np.int64)
    starts = np.zeros(min(count, 1), np.int64)
    for level in range(depth):
        sizes = np.diff(np.append(starts, count))
        if (sizes <= 1).all():
            nodes = nodes << (depth - level)
            break
        owner = np.repeat(np.arange(len(starts)), sizes)
        order = order[_sort_nodes(0.5 * (lower + upper)[order], starts, owner)]
        room = 1 << (depth - level - 1)
        left = _part(lower[order], upper[order], weight[order], starts, owner, room)
        # A single source stays on the left.
        whole = left == sizes
        begins = np.stack([starts, starts + left], axis=1)
        nodes = np.stack([2 * nodes, 2 * nodes + 1], axis=1)
        filled = np.stack([np.ones_like(whole), ~whole], axis=1)
        starts, nodes = begins[filled], nodes[filled]
    leaves = np.full(1 << depth, -1)
    leaves[nodes] = order
    return leaves


def _sort_nodes(centres: np.ndarray, starts: np.ndarray, owner: np.ndarray) -> np.ndarray:
    """Return the order (N,) that sorts `centres` (N, 3) within each node along its longest side."""
    low, high = (extreme.reduceat(centres, starts) for extreme in (np.minimum, np.maximum))
    axis = (high - low).argmax(axis=1)[owner]
    start, size = low[owner, axis], (high - low)[owner, axis]
    along = (centres[np.arange(len(centres)), axis] - start) / np.where(size > 0.0, size, 1.0)
    # One key sorts all nodes at once: the node, and how far along. Ties keep their order, on any machine.
    return np.argsort(owner + 0.5 * along, kind="stable")


def _part(
    lower: np.ndarray, upper: np.ndarray, weight: np.ndarray, starts: np.ndarray, owner: np.ndarray, room: int
) -> np.ndarray:
    """Return how many of each node's sorted sources go to the left, (nodes,); each side has `room` for so many."""
    count = len(weight)
    sizes = np.diff(np.append(starts, count))
    place = np.arange(count) - starts[owner] + 1
    right = sizes[owner] - place
    before = _boxes_so_far(lower, upper, owner)
    after = _boxes_so_far(lower[::-1], upper[::-1], owner[-1] - owner[::-1])[::-1]
    total = np.cumsum(weight)
    base = total[starts] - weight[starts]
    in_left = total - base[owner]
    in_right = np.add.reduceat(weight, starts)[owner] - in_left
    # Sources after this one begin with the next.
    cost = in_left * before + in_right * np.append(after[1:], 0.0)
    # Where costs are alike, halves are best.
    uneven = np.abs(2 * place - sizes[owner])
    cost = cost * (1.0 + 1e-3 * uneven / sizes[owner])
    cost[(place > room) | (right > room) | ((right == 0) & (sizes[owner] > 1))] = np.inf
    best = np.minimum.reduceat(cost, starts)
    first = np.where(cost == best[owner], place, count + 1)
    return np.minimum.reduceat(first, starts)


def _boxes_so_far(lower: np.ndarray, upper: np.ndarray, owner: np.ndarray) -> np.ndarray:
    """Return the squared diagonal (N,) of the box around each source and those of its node that come before it."""
    # Shifted by more than the whole extent from node to node, so that a running extreme begins anew at each.
    corner = lower.min(axis=0)
    shift = owner[:, None] * (1.0 + 2.0 * (upper.max(axis=0) - corner))
    low = np.minimum.accumulate(lower - corner - shift) + shift
    high = np.maximum.accumulate(upper - corner + shift) - shift
    return ((high - low) ** 2).sum(axis=1)


def _beside(centres: np.ndarray) -> np.ndarray:
    """Return a place (3,) beside all centres, where sources without a place stay together."""
    if not len(centres):
        return np.zeros(3)
    low, high = centres.min(axis=0), centres.max(axis=0)
    return low - (high - low + 1.0)


def fit_nodes(bounds: LightBounds, leaves: np.ndarray) -> np.ndarray:
    """Return the nodes (2^(depth + 1), 16) float32 over `leaves`, bottom up; node 0 is not used.

    Rows: centre, longest range | half size, intensity | axis, cosine of the spread | cosine of the reach, sine of
    the spread, irradiance from far away, 1 where two-sided. Intensities are shares of the brightest node's.
    """
    level = join_bounds(bounds, empty_bounds(1)).take(leaves)
    # A leaf on one point keeps it exactly, so that its range and its horizon are those of the light itself.
    levels = [_pack(level, is_leaf=True)]
    while len(level.intensity) > 1:
        level = _merge(level.take(slice(0, None, 2)), level.take(slice(1, None, 2)))
        levels.append(_pack(level, is_leaf=False))
    nodes = np.concatenate([np.zeros((1, NODE_FLOATS)), *reversed(levels)])
    brightest = max(nodes[:, 7].max(), nodes[:, 14].max())
    nodes[:, (7, 14)] /= brightest if brightest > 0.0 else 1.0
    return nodes.astype(np.float32)


def _pack(bounds: LightBounds, is_leaf: bool) -> np.ndarray:
    nodes = np.zeros((len(bounds.intensity), NODE_FLOATS))
    nodes[:, :3] = (0.5 * (bounds.lower + bounds.upper)).astype(np.float32)
    half = np.maximum(bounds.upper - nodes[:, :3], nodes[:, :3] - bounds.lower)
    is_point = is_leaf & (bounds.lower == bounds.upper).all(axis=1, keepdims=True)
    nodes[:, 4:7] = np.where(is_point, 0.0, half + BOX_SLACK * (np.abs(nodes[:, :3]) + half))
    nodes[:, 3] = np.minimum(bounds.range, 1e18)
    nodes[:, 7] = bounds.intensity
    spread = np.minimum(bounds.spread + ANGLE_SLACK, np.pi)
    nodes[:, 8:11] = bounds.axis
    nodes[:, 11], nodes[:, 13] = np.cos(spread), np.sin(spread)
    nodes[:, 12] = np.cos(bounds.reach)
    nodes[:, 14] = bounds.far
    nodes[:, 15] = bounds.two_sided
    return nodes


def _merge(a: LightBounds, b: LightBounds) -> LightBounds:
    """Return what bounds both, row by row."""
    # A node with sources that have a place is bound by those alone: the others are counted as if they shone anywhere.
    use_a, use_b = a.intensity > 0.0, b.intensity > 0.0
    neither = ~use_a & ~use_b
    use_a, use_b = use_a | (neither & (a.far > 0.0)), use_b | (neither & (b.far > 0.0))
    both, only_b = use_a & use_b, use_b & ~use_a
    axis, spread = _merge_cones(a, b)

    def pick(name: str, merged: np.ndarray) -> np.ndarray:
        one, other = getattr(a, name), getattr(b, name)
        shape = (-1,) + (1,) * (one.ndim - 1)
        return np.where(both.reshape(shape), merged, np.where(only_b.reshape(shape), other, one))

    return LightBounds(
        lower=pick("lower", np.minimum(a.lower, b.lower)),
        upper=pick("upper", np.maximum(a.upper, b.upper)),
        intensity=a.intensity + b.intensity,
        far=a.far + b.far,
        axis=pick("axis", axis),
        spread=pick("spread", spread),
        reach=pick("reach", np.maximum(a.reach, b.reach)),
        two_sided=pick("two_sided", a.two_sided | b.two_sided),
        range=pick("range", np.maximum(a.range, b.range)),
    )


def _merge_cones(a: LightBounds, b: LightBounds) -> tuple[np.ndarray, np.ndarray]:
    """Return axis (N, 3) and half angle (N,) of the smallest cones around two each."""
    cosine = np.clip((a.axis * b.axis).sum(axis=1), -1.0, 1.0)
    # The axis of a cone that opens both ways may be turned round.
    flip = np.where(a.two_sided & b.two_sided & (cosine < 0.0), -1.0, 1.0)
    other = b.axis * flip[:, None]
    between = np.arccos(np.clip(cosine * flip, -1.0, 1.0))
    spread = 0.5 * (a.spread + between + b.spread)
    turn = spread - a.spread
    sine = np.sin(between)
    steep = sine < 1e-6
    safe = np.where(steep, 1.0, sine)
    mixed = (np.sin(between - turn) / safe)[:, None] * a.axis + (np.sin(turn) / safe)[:, None] * other
    length = np.linalg.norm(mixed, axis=1)
    # Axes that are opposite have no plane to turn in.
    whole = (spread >= np.pi) | (steep & (between > 1.0)) | (length < 1e-6)
    holds_b, holds_a = between + b.spread <= a.spread, between + a.spread <= b.spread
    axis = np.where((whole | holds_b | steep)[:, None], a.axis, mixed / np.where(length > 0.0, length, 1.0)[:, None])
    axis = np.where(holds_a[:, None] & ~holds_b[:, None], other, axis)
    spread = np.where(holds_b, a.spread, np.where(holds_a, b.spread, np.where(whole, np.pi, spread)))
    return axis, spread
