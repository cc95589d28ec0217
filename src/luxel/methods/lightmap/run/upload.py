"""From a bake to the state that frames run on."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.errors import LuxelError
from luxel.kernels.direct import shadow_ray_count
from luxel.methods.lightmap.bake.passes import plan_lists, weigh_items
from luxel.methods.lightmap.bake.record import Bake
from luxel.methods.lightmap.bake.surfels import SETS
from luxel.methods.lightmap.bake.words import HIT_BITS
from luxel.methods.lightmap.flatten.flat_scene import pack_tables
from luxel.methods.lightmap.run.sky import average_sky
from luxel.methods.lightmap.run.state import (
    BLOCK,
    WORDS,
    Clusters,
    LightmapState,
    LitSurfels,
    Pass,
    ProbeTables,
    Transport,
)
from luxel.scene.arrays import from_numpy, vectors_from_numpy
from luxel.scene.device import Scene


class HostBake:
    """A bake inside a state: opaque to Dr.Jit, which would walk a dataclass."""

    def __init__(self, bake: Bake) -> None:
        self.bake = bake


def upload_bake(scene: Scene, bake: Bake, seed: int) -> LightmapState:
    """Return the first state of a bake: no light yet. Raises LuxelError where its bounces would not settle."""
    gain = bounce_gain(bake)
    if not gain < 1.0:
        raise LuxelError(f"the bake's bounces grow by {gain:.3f} from frame to frame, so light would never settle")
    pixels = bake.width * bake.height
    # Rows of light: the atlas, then probe directions, then surfels.
    count, beyond = len(bake.surfel_p), len(bake.words) - len(bake.texel_slot)
    state = LightmapState(
        tables=pack_tables(bake.face_of, bake.face_uv, bake.width, bake.height, bake.split),
        probes=_upload_probes(bake, pixels),
        surfels=_upload_surfels(bake, pixels + beyond - count, shadow_ray_count(scene)),
        clusters=_upload_clusters(scene, bake),
        transport=_upload_transport(bake, np.concatenate([bake.texel_slot, pixels + np.arange(beyond)])),
        light=dr.zeros(mi.Float, 4 * (pixels + beyond)),
        radiosity=dr.zeros(mi.Float, 4 * len(bake.tree_low)),
        direct=dr.zeros(mi.Color3f, count),
        direct_count=dr.opaque(mi.UInt32, 0),
        lights_seen=dr.opaque(mi.UInt32, 0),
        seed=dr.opaque(mi.UInt32, (seed * 0x85EBCA6B + 13) & 0xFFFFFFFF),
        bake=HostBake(bake),
    )
    dr.make_opaque(state.tables, state.probes, state.surfels, state.clusters, state.transport)
    dr.make_opaque(state.light, state.radiosity, state.direct)
    return state


def bounce_gain(bake: Bake) -> float:
    """Return a bound on how much a frame's bounce multiplies light: the largest albedo times the largest weight sum.

    A surfel's row is a weighted sum of clusters, a cluster a mean of surfels: means never grow. Texels show light, but
    send none on.
    """
    hits = (bake.words[-len(bake.surfel_p) :] & ((1 << HIT_BITS) - 1)).sum(axis=1)
    return float(bake.surfel_albedo.max() * hits.max() / bake.rays)


def _upload_surfels(bake: Bake, first: int, shadow_rays: int) -> LitSurfels:
    count = len(bake.surfel_p)
    return LitSurfels(
        p=vectors_from_numpy(mi.Point3f, bake.sample_p),
        n_geometric=vectors_from_numpy(mi.Normal3f, bake.sample_n_geometric),
        n_shading=vectors_from_numpy(mi.Normal3f, bake.sample_n_shading),
        albedo=vectors_from_numpy(mi.Color3f, bake.surfel_albedo),
        count=count,
        first=first,
        samples=len(bake.sample_p) // (count * SETS),
        sets=SETS,
        shadow_rays=shadow_rays,
    )


def _upload_clusters(scene: Scene, bake: Bake) -> Clusters:
    count = len(bake.surfel_p)
    leaf_of = bake.tree.leaf_of
    area = np.concatenate([bake.surfel_area, bake.sky_angle, [0.0]])[bake.tree_leaf]
    return Clusters(
        passes=_upload_passes(bake, area),
        node_count=len(bake.tree_low),
        surfel_leaf=from_numpy(mi.UInt32, leaf_of[:count]),
        sky_leaf=from_numpy(mi.UInt32, leaf_of[count:-1] if bake.sky_resolution else np.zeros(1)),
        sky_mean=average_sky(scene, bake.sky_resolution) if bake.sky_resolution else dr.zeros(mi.Color3f),
        sky_resolution=bake.sky_resolution,
    )


def _upload_transport(bake: Bake, slot: np.ndarray) -> Transport:
    """Return the rows of words; `slot` (rows,) is the row of light that each sum goes to."""
    rows, length = len(bake.words), (bake.words != 0).sum(axis=1)
    # Rows of alike lengths side by side: lanes of one packet end together.
    order = np.argsort(-length, kind="stable")
    longest = -(-max(int(length.max()), 1) // WORDS) * WORDS
    padded = np.zeros((-(-rows // BLOCK) * BLOCK, longest), np.uint32)
    padded[:rows, : bake.words.shape[1]] = bake.words[order, :longest]
    return Transport(
        words=from_numpy(mi.UInt32, padded.reshape(-1, BLOCK, longest // WORDS, WORDS).transpose(0, 2, 1, 3)),
        slot=from_numpy(mi.UInt32, slot[order]),
        inverse_rays=dr.opaque(mi.Float, 1.0 / bake.rays),
        row_count=rows,
        budget=longest,
    )


def _upload_passes(bake: Bake, area: np.ndarray) -> list[Pass]:
    """Return the passes over the tree, small clusters first."""
    lists = plan_lists(bake.tree, area)
    share = weigh_items(lists, bake.seen) if len(bake.seen) else lists.share
    length = np.diff(lists.starts)
    passes = []
    for level in range(1, int(lists.level.max(initial=0)) + 1):
        # Long sums first: lanes that run side by side are alike.
        chosen = np.flatnonzero(lists.level == level)
        chosen = chosen[np.argsort(-length[chosen], kind="stable")]
        starts = np.concatenate([[0], np.cumsum(length[chosen])])
        place = np.arange(starts[-1]) - np.repeat(starts[:-1] - lists.starts[chosen], length[chosen])
        words = lists.nodes[chosen], starts, lists.items[place]
        nodes, firsts, items = (from_numpy(mi.UInt32, each) for each in words)
        passes.append(Pass(nodes, firsts, items, from_numpy(mi.Float, share[place])))
    return passes


def _upload_probes(bake: Bake, first: int) -> ProbeTables:
    nx, ny, nz = (int(count) for count in bake.probe_counts)
    return ProbeTables(
        lower=mi.Point3f(*(dr.opaque(mi.Float, float(value)) for value in bake.probe_lower)),
        inverse_size=dr.opaque(mi.Float, 1.0 / float(bake.probe_size)),
        size=dr.opaque(mi.Float, float(bake.probe_size)),
        fine=from_numpy(mi.Float, bake.probe_fine),
        nx=nx,
        ny=ny,
        nz=nz,
        first=first,
    )
