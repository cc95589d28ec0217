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
    """Return the depth of the smallest tree of at least two leaves that holds `count` sources."""
    return max(int(count - 1).bit_length(), 1)


def order_leaves(bounds: LightBounds, depth: int) -> np.ndarray:
    """Return which source each of the 2^`depth` leaves holds, -1 for none.

    Each node's sources are halved along the longest side of the box around their centres. Every level halves all of
    its nodes at once: 100,000 sources take a third of a second.
    """
    count = len(bounds.intensity)
    centres = 0.5 * (bounds.lower + bounds.upper)
    centres[bounds.intensity <= 0.0] = _beside(centres)
    order = np.arange(count)
    for level in range(depth):
        if 1 << level >= count:
            break
        edges = _edges(count, level)
        points = centres[order]
        low, high = (extreme.reduceat(points, edges[:-1]) for extreme in (np.minimum, np.maximum))
        owner = np.repeat(np.arange(1 << level), np.diff(edges))
        axis = (high - low).argmax(axis=1)[owner]
        start, size = low[owner, axis], (high - low)[owner, axis]
        along = (points[np.arange(count), axis] - start) / np.where(size > 0.0, size, 1.0)
        # One key sorts all nodes at once: the node, and how far along its longest side. Ties keep their order, on any
        # machine.
        order = order[np.argsort(owner + 0.5 * along, kind="stable")]
    edges = _edges(count, depth)
    leaves = np.full(1 << depth, -1)
    leaves[edges[1:] > edges[:-1]] = order
    return leaves


def _beside(centres: np.ndarray) -> np.ndarray:
    """Return a place (3,) beside all centres, where sources without a place stay together."""
    if not len(centres):
        return np.zeros(3)
    low, high = centres.min(axis=0), centres.max(axis=0)
    return low - (high - low + 1.0)


def _edges(count: int, level: int) -> np.ndarray:
    """Return where the nodes of a level begin and end among the ordered sources: (2^level + 1,)."""
    return -((-np.arange((1 << level) + 1) * count) >> level)


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
