"""What the lightmap holds on the device: where light is looked up, what is lit, how it is summed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi

from luxel.methods.lightmap.faces import NONE
from luxel.methods.lightmap.split import SPLIT, SplitTables, face_at

if TYPE_CHECKING:
    from luxel.methods.lightmap.bake import Bake

HIT_BITS = 12
"""Low bits of a word that hold a cluster's hits; the others name the cluster."""

NODE_LIMIT = 1 << (32 - HIT_BITS)
"""Clusters that a word can tell apart."""

WORDS = 4
"""Words of a row that are read at once."""

BLOCK = 16
"""Rows that stand side by side: packets of lanes stream through memory, whole lines at a time."""


@dataclass
class AtlasTables:
    """From a point of a triangle to its place in the atlas."""

    face_of: mi.UInt32
    """(2 T,) face of each triangle's front and back; `NONE`: not in the atlas; with `SPLIT`: which row of `split`."""
    face_uv: mi.Float
    """(F, 8): coordinates in texels of the corners of the face's whole triangle, two words spare."""
    width: int
    height: int
    split: SplitTables | None
    """None: no triangle lies in several charts."""


@dataclass
class Probes:
    """Points in open space, six directions each: what lights moving objects and free points."""

    lower: mi.Point3f
    inverse_size: mi.Float
    size: mi.Float
    fine: mi.Float
    """(P,) 1 in the open, 0 inside geometry."""
    nx: int
    ny: int
    nz: int
    first: int
    """Row of `light` that the probes' rows start at."""


@dataclass
class LitSurfels:
    """S surfels of K sample points in each of several sets: what direct light falls on."""

    p: mi.Point3f
    """(S K sets,) sample points."""
    n_geometric: mi.Normal3f
    n_shading: mi.Normal3f
    albedo: mi.Color3f
    """(S,)."""
    count: int
    first: int
    """Row of `light` that the surfels' own rows start at."""
    samples: int
    sets: int
    shadow_rays: int
    """A sample and frame, at most."""


@dataclass
class Pass:
    """Clusters that are summed in one go, each over a list of smaller ones."""

    node: mi.UInt32
    starts: mi.UInt32
    """One more than `node`."""
    item: mi.UInt32
    share: mi.Float
    """The item's area over the cluster's."""


@dataclass
class Clusters:
    """The tree as sums. Rows of radiosity: leaves first (surfels, sky, the void), then clusters."""

    passes: list[Pass]
    node_count: int
    surfel_leaf: mi.UInt32
    """(S,) leaf of each surfel."""
    sky_leaf: mi.UInt32
    """(R R,) leaf of each sky cell."""
    sky_mean: mi.Color3f
    """(R R,) of the sky's image over each cell."""
    sky_resolution: int
    """0: the scene had no sky when it was baked."""


@dataclass
class Transport:
    """Texels and probe directions as sums of clusters. M rows of B words."""

    words: mi.UInt32
    """(M / `BLOCK`, B / `WORDS`, `BLOCK`, `WORDS`): cluster << `HIT_BITS` | hits; a word of 0 ends a row."""
    slot: mi.UInt32
    """(M,) row of `light` that each sum goes to."""
    inverse_rays: mi.Float
    row_count: int
    budget: int


@dataclass
class LightmapState:
    """Everything a frame reads and writes."""

    tables: AtlasTables
    probes: Probes
    surfels: LitSurfels
    clusters: Clusters
    transport: Transport
    light: mi.Float
    """(height * width + 6 P + S, 4): irradiance of texels, probe directions and surfels, and 1 where there is one."""
    radiosity: mi.Float
    """(nodes, 4) of the last frame."""
    direct: mi.Color3f
    """(S,) direct irradiance, averaged while nothing changes."""
    direct_count: mi.UInt32
    lights_seen: mi.UInt32
    """Fingerprint of what lights the scene, as of the last frame."""
    seed: mi.UInt32
    bake: object
    """The host's copy, a `Bake`; opaque to Dr.Jit."""


def find_face(
    tables: AtlasTables, prim_id: mi.UInt32, back: mi.Bool, barycentric: mi.Point2f, active: mi.Bool
) -> tuple[mi.UInt32, mi.Bool]:
    """Return the face that each point lies in, and whether there is one in the atlas."""
    active = active & (2 * prim_id < dr.width(tables.face_of))
    face = dr.gather(mi.UInt32, tables.face_of, 2 * prim_id + dr.select(back, mi.UInt32(1), 0), active)
    found = active & (face != NONE)
    if tables.split is not None:
        split = found & ((face & SPLIT) != 0)
        part = face_at(tables.split, face & (SPLIT - 1), barycentric, split)
        face = mi.UInt32(dr.select(split, part, face))
    return face, found


def locate(
    tables: AtlasTables, prim_id: mi.UInt32, back: mi.Bool, barycentric: mi.Point2f, active: mi.Bool
) -> tuple[mi.Point2f, mi.Bool]:
    """Return each point's place in the atlas, in texels, and whether it has one."""
    face, found = find_face(tables, prim_id, back, barycentric, active)
    first = dr.gather(mi.Vector4f, tables.face_uv, 2 * face, found)
    second = dr.gather(mi.Vector2f, tables.face_uv, 4 * face + 2, found)
    a = 1.0 - barycentric.x - barycentric.y
    u = a * first.x + barycentric.x * first.z + barycentric.y * second.x
    v = a * first.y + barycentric.x * first.w + barycentric.y * second.y
    return mi.Point2f(u, v), found


def read_lightmap(tables: AtlasTables, light: mi.Float, uv: mi.Point2f, active: mi.Bool) -> mi.Vector4f:
    """Return bilinearly filtered rows of `light` at places in the atlas; w is 1 where a texel answered."""
    base_x, base_y = dr.floor(uv.x), dr.floor(uv.y)
    fx, fy = uv.x - base_x, uv.y - base_y
    x0 = mi.UInt32(dr.clip(base_x, 0.0, tables.width - 2.0))
    y0 = mi.UInt32(dr.clip(base_y, 0.0, tables.height - 2.0))
    total = mi.Vector4f(0.0)
    for j in (0, 1):
        for i in (0, 1):
            weight = (fx if i else 1.0 - fx) * (fy if j else 1.0 - fy)
            total += weight * dr.gather(mi.Vector4f, light, (y0 + j) * tables.width + x0 + i, active)
    # Texels that hold nothing have a w of 0: the others stand in for them.
    answered = total.w > 1e-4
    scale = dr.select(answered, 1.0 / dr.fmax(total.w, 1e-4), 0.0)
    return mi.Vector4f(total.x * scale, total.y * scale, total.z * scale, dr.select(answered, 1.0, 0.0))


def bake_of(state: LightmapState) -> Bake:
    """Return the host's copy of the bake."""
    return state.bake.bake  # type: ignore[attr-defined]
