"""What one texel's clusters are in the scene: which one each point belongs to, and their surfels as discs."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.kernels.records import Surface
from luxel.methods.inspect import Discs, Sources
from luxel.methods.lightmap.bake.record import Bake
from luxel.methods.lightmap.bake.sky import cell_of_direction
from luxel.methods.lightmap.bake.words import HIT_BITS
from luxel.methods.lightmap.flatten.faces import NONE
from luxel.methods.lightmap.inspect.explain import count_parts, explain_point, find_texels_around
from luxel.methods.lightmap.inspect.looks import surfel_of_point, texel_of_point
from luxel.methods.lightmap.run.state import LightmapState
from luxel.scene.arrays import from_numpy
from luxel.scene.device import Scene

NAMED = 8
"""Clusters that a legend names."""


@dataclass
class TexelRow:
    """The clusters of one texel: nodes that share no leaf, and their hits over all rays, heaviest first."""

    slot: int
    """The texel's place in the atlas."""
    nodes: np.ndarray
    shares: np.ndarray


def read_texel_row(state: LightmapState, point: Surface) -> TexelRow | None:
    """Return the row of the texel nearest to the first point of `point`; None where there is none."""
    bake: Bake = state.bake.bake  # type: ignore[attr-defined]
    around = find_texels_around(state, point)
    if not around:
        return None
    at, _ = max(around, key=lambda texel: texel[1])
    words = bake.words[at]
    words = words[words != 0]
    hits = (words & ((1 << HIT_BITS) - 1)).astype(np.int64)
    order = np.argsort(-hits, kind="stable")
    return TexelRow(int(bake.texel_slot[at]), (words >> HIT_BITS).astype(np.int64)[order], hits[order] / bake.rays)


def read_sources(state: LightmapState, point: Surface, surface: Surface) -> Sources:
    """Return through which cluster the texel at `point` sees each point of `surface`, or the sky past it."""
    bake: Bake = state.bake.bake  # type: ignore[attr-defined]
    row = read_texel_row(state, point)
    if row is None:
        nothing = mi.Bool(False) & surface.active
        on_surface = bool(np.array(point.active).reshape(-1)[0])
        words = "No texel is there: the probes light it." if on_surface else "No surface is there."
        return Sources(mi.UInt32(0), mi.Float(0.0), nothing, nothing, words)
    item_node = np.full(len(bake.tree_leaf), NONE, np.uint32)
    item_share = np.zeros(len(bake.tree_leaf), np.float32)
    for node, share in zip(row.nodes, row.shares, strict=True):
        items = bake.tree_leaf[bake.tree_low[node] : bake.tree_high[node]]
        item_node[items], item_share[items] = node, share

    # Surfaces are looked up by their surfel, what lies past them by the cell of the sky.
    surfel, found = surfel_of_point(state, surface)
    texel, _ = texel_of_point(state, surface)
    if bake.sky_resolution:
        past = ~surface.active
        cell = cell_of_direction(-surface.wo, bake.sky_resolution)
        surfel, found = dr.select(past, len(bake.surfel_p) + cell, surfel), found | past
    node = dr.gather(mi.UInt32, from_numpy(mi.UInt32, item_node), surfel, found)
    return Sources(
        item=node,
        share=dr.gather(mi.Float, from_numpy(mi.Float, item_share), surfel, found),
        answered=found & (node != NONE),
        marked=found & surface.active & (texel == row.slot),
        words=f"{len(row.nodes)} clusters light one texel, the ringed one; brighter is heavier. The heaviest:",
        heaviest=tuple(_name(bake, *pair) for pair in zip(row.nodes[:NAMED], row.shares[:NAMED], strict=True)),
    )


def read_discs(scene: Scene, state: LightmapState, point: Surface) -> Discs | None:
    """Return the surfels of all clusters that light the first point of `point`, each by the heaviest that holds it."""
    bake: Bake = state.bake.bake  # type: ignore[attr-defined]
    owner = np.full(len(bake.tree_leaf), -1, np.int64)
    for entry in reversed(explain_point(scene, state, point)):
        owner[bake.tree_leaf[bake.tree_low[entry.item] : bake.tree_high[entry.item]]] = entry.item
    owner = owner[: len(bake.surfel_p)]
    held = np.flatnonzero(owner >= 0)
    if not len(held):
        return None
    radius = np.sqrt(bake.surfel_area[held] / np.pi)
    return Discs(owner[held], bake.surfel_p[held], bake.surfel_normal[held], radius)


def _name(bake: Bake, node: np.int64, share: np.float64) -> tuple[str, int]:
    kind, count = count_parts(bake, int(node))
    plural = "s" * (count > 1)
    what = {"surfel": f"{count} surfel{plural}", "sky": f"{count} piece{plural} of sky", "void": "nothing"}[kind]
    return f"{what} {100.0 * share:.1f} %", int(node)
