"""Which clusters light one point, with which weights."""

from __future__ import annotations

import numpy as np

from luxel.kernels.records import Surface
from luxel.methods.inspect import Contribution
from luxel.methods.lightmap.bake.passes import sum_over_nodes
from luxel.methods.lightmap.bake.words import HIT_BITS
from luxel.methods.lightmap.flatten.tables import locate
from luxel.methods.lightmap.run.state import LightmapState
from luxel.scene.device import Scene


def explain_point(scene: Scene, state: LightmapState, surface: Surface) -> list[Contribution]:
    """Return one entry a cluster of the texels around the first point of `surface`, heaviest first.

    Weights are hits over rays, blended as the look-up blends texels. Empty where the surface is not in the atlas:
    there the probes answer.
    """
    bake = state.bake.bake  # type: ignore[attr-defined]
    shares: dict[int, float] = {}
    total = 0.0
    for at, weight in find_texels_around(state, surface):
        words = bake.words[at]
        total += weight
        for word in words[words != 0].tolist():
            hits = (word & ((1 << HIT_BITS) - 1)) / bake.rays
            shares[word >> HIT_BITS] = shares.get(word >> HIT_BITS, 0.0) + weight * hits
    if total <= 0.0:
        return []
    radiosity = np.array(state.radiosity).reshape(-1, 4)[:, :3].astype(float)
    middle = cluster_middles(bake)
    found_items = [
        Contribution(
            item=node,
            weight=share / total,
            irradiance=(float(radiosity[node, 0]), float(radiosity[node, 1]), float(radiosity[node, 2])),
            reason=_describe_cluster(bake, node),
            p=None if middle[node] is None else middle[node],
        )
        for node, share in shares.items()
    ]
    return sorted(found_items, key=lambda item: -item.weight)


def find_texels_around(state: LightmapState, surface: Surface) -> list[tuple[int, float]]:
    """Return the texels that a look-up at the first point of `surface` blends, by row, with their weights.

    Texels that hold nothing are left out.
    """
    bake = state.bake.bake  # type: ignore[attr-defined]
    place, found = locate(state.tables, surface.prim_id, ~surface.front, surface.barycentric, surface.active)
    on_object = np.array(surface.object_id).reshape(-1)[0] != 0
    if not on_object or not np.array(found).reshape(-1)[0]:
        return []
    u, v = (float(np.array(axis).reshape(-1)[0]) for axis in (place.x, place.y))
    column, row = int(np.floor(u)), int(np.floor(v))
    around = []
    for j in (0, 1):
        for i in (0, 1):
            slot = (row + j) * bake.width + column + i
            at = int(np.searchsorted(bake.texel_slot, slot))
            if at < len(bake.texel_slot) and bake.texel_slot[at] == slot and bake.words[at].any():
                around.append((at, abs(1 - i - (u - column)) * abs(1 - j - (v - row))))
    return around


def cluster_middles(bake) -> list[tuple[float, float, float] | None]:  # noqa: ANN001
    """Return the middle of each node of a `Bake`'s surfels, by area; None for sky and void."""
    surfels = len(bake.surfel_p)
    weight = np.concatenate([bake.surfel_area, np.zeros(len(bake.tree_leaf) - surfels)])[bake.tree_leaf]
    place = np.zeros((len(bake.tree_leaf), 3))
    place[: len(place)] = np.concatenate([bake.surfel_p, np.zeros((len(place) - surfels, 3))])[bake.tree_leaf]
    area = sum_over_nodes(bake.tree, weight)
    sums = sum_over_nodes(bake.tree, place * weight[:, None])
    return [
        (float(s[0] / a), float(s[1] / a), float(s[2] / a)) if a > 1e-300 else None
        for s, a in zip(sums, area, strict=True)
    ]


def count_parts(bake, node: int) -> tuple[str, int]:  # noqa: ANN001
    """Return what a cluster is made of, `surfel`, `sky` or `void`, and how many leaves it has."""
    first = bake.tree_leaf[bake.tree_low[node]]
    if first == len(bake.tree_leaf) - 1:
        return "void", 1
    return "surfel" if first < len(bake.surfel_p) else "sky", int(bake.tree_high[node] - bake.tree_low[node])


def _describe_cluster(bake, node: int) -> str:  # noqa: ANN001
    """Return what a cluster is made of, in words."""
    kind, count = count_parts(bake, node)
    one, many = {
        "surfel": ("one surfel", f"{count} surfels"),
        "sky": ("one piece of sky", f"{count} pieces of sky"),
        "void": (f"the void: the inside of things{'' if bake.sky_resolution else ', and beyond the scene'}", ""),
    }[kind]
    return one if count == 1 else many
