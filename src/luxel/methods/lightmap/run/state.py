"""What the lightmap holds on the device: where light is looked up, what is lit, how it is summed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi

from luxel.methods.lightmap.flatten.tables import AtlasTables

if TYPE_CHECKING:
    from luxel.methods.lightmap.bake.record import Bake

WORDS = 4
"""Words of a row that are read at once."""

BLOCK = 16
"""Rows that stand side by side: packets of lanes stream through memory, whole lines at a time."""


@dataclass
class ProbeTables:
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
    probes: ProbeTables
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
