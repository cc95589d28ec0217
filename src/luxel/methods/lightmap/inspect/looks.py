"""What can be drawn of the lightmap on the surfaces it lies on: charts, texels, surfels, levels of the tree."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.kernels.records import Surface
from luxel.methods.inspect import Look, Reading
from luxel.methods.lightmap.flatten.atlas import SUBTEXELS
from luxel.methods.lightmap.flatten.faces import NONE
from luxel.methods.lightmap.flatten.tables import find_face, locate
from luxel.methods.lightmap.run.state import LightmapState, read_lightmap
from luxel.scene.arrays import from_numpy

LEVELS = {"tree-coarse": 32, "tree-middle": 256}
"""Looks of the tree, and into how many clusters they cut it."""
LIGHTMAP_LOOKS = (
    Look("charts", "pieces of surface that were laid flat together", "item"),
    Look("texels", "the lightmap's texels, dark and light in turn, in the colour of their chart", "item"),
    Look("surfels", "surfels, each in a colour of its own", "item"),
    Look("tree-middle", "the tree cut into 256 clusters", "item"),
    Look("tree-coarse", "the tree cut into 32 clusters", "item"),
    Look("clusters", "through which clusters one texel is lit, each in a colour of its own", "source"),
    Look("lightmap", "the lightmap's irradiance", "light", "W/m²"),
    Look("texel-clusters", "clusters that each texel sums", "cost", "clusters"),
    Look("lightmap-sheet", "the lightmap laid flat", "sheet", "W/m²", view="lightmap"),
)


def read_look(state: LightmapState, surface: Surface, look: str) -> Reading:
    """Return what `look`, one of `LIGHTMAP_LOOKS`, shows at a surface."""
    bake = state.bake.bake  # type: ignore[attr-defined]
    tables = state.tables
    if look == "lightmap":
        uv, found = place_of_point(state, surface)
        row = read_lightmap(tables, state.light, uv, found)
        return Reading(mi.Color3f(row.x, row.y, row.z), found & (row.w > 0.0))
    texel, found = texel_of_point(state, surface)
    if look == "texel-clusters":
        amount = np.zeros(tables.width * tables.height, np.float32)
        amount[bake.texel_slot] = (bake.words[: len(bake.texel_slot)] != 0).sum(axis=1)
        return Reading(dr.gather(mi.Float, from_numpy(mi.Float, amount), texel, found), found)
    if look in ("charts", "texels"):
        face, found = find_face(tables, surface.prim_id, ~surface.front, surface.barycentric, found)
        chart = dr.gather(mi.UInt32, from_numpy(mi.UInt32, bake.face_chart), face, found)
        odd = (texel // tables.width + texel % tables.width) & 1 == 1
        return Reading(chart, found, dark=odd if look == "texels" else None)
    surfel, found = surfel_of_point(state, surface)
    if look in LEVELS:
        cut = from_numpy(mi.UInt32, cut_tree(bake, LEVELS[look]))
        return Reading(dr.gather(mi.UInt32, cut, surfel, found), found)
    return Reading(surfel, found)


def place_of_point(state: LightmapState, surface: Surface) -> tuple[mi.Point2f, mi.Bool]:
    """Return each point's place in the atlas, in texels, and whether it has one."""
    uv, found = locate(state.tables, surface.prim_id, ~surface.front, surface.barycentric, surface.active)
    return uv, found & (surface.object_id != 0)


def texel_of_point(state: LightmapState, surface: Surface) -> tuple[mi.UInt32, mi.Bool]:
    """Return the slot of the texel that each point lies on, and whether it lies on one."""
    uv, found = place_of_point(state, surface)
    x, y = (mi.UInt32(dr.fmax(dr.floor(c + 0.5), 0.0)) for c in (uv.x, uv.y))
    return y * state.tables.width + x, found


def surfel_of_point(state: LightmapState, surface: Surface) -> tuple[mi.UInt32, mi.Bool]:
    """Return the surfel that each point lies on, and whether it lies on one."""
    bake = state.bake.bake  # type: ignore[attr-defined]
    uv, found = place_of_point(state, surface)
    x, y = (mi.UInt32(dr.fmax(dr.floor((c + 0.5) * SUBTEXELS), 0.0)) for c in (uv.x, uv.y))
    surfels = from_numpy(mi.UInt32, bake.cell_surfel)
    surfel = dr.gather(mi.UInt32, surfels, y * (state.tables.width * SUBTEXELS) + x, found)
    return surfel, found & (surfel != NONE)


def cut_tree(bake, count: int) -> np.ndarray:  # noqa: ANN001
    """Return the cluster (S,) that each surfel of a `Bake` belongs to where the tree is cut into about `count`."""
    leaves, surfels = len(bake.tree_leaf), len(bake.surfel_p)
    chosen = [int(root) for root in bake.roots if bake.tree_leaf[bake.tree_low[root]] < surfels]
    while len(chosen) < count:
        size = [bake.tree_high[node] - bake.tree_low[node] for node in chosen]
        largest = int(np.argmax(size))
        if size[largest] < 2:
            break
        chosen += bake.tree_children[chosen.pop(largest) - leaves].tolist()
    of_surfel = np.zeros(surfels, np.int64)
    for node in chosen:
        of_surfel[bake.tree_leaf[bake.tree_low[node] : bake.tree_high[node]]] = node
    return of_surfel
