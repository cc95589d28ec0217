"""Every dial of the lightmap, and what its ends cost."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from luxel.errors import LuxelError

SOURCE: dict[str, Any] = {
    "texel_target": 6453,
    "surfel_target": 1008,
    "points_per_surfel": 1,
    "refine": "heaviest",
    "tree_outlook": 0.0,
    "probe_target": 64,
    "cluster_mean": "area",
}
"""The document's sizes: 1,008 surfels, 6,453 texels, one shadow ray a surfel and light."""
TEXEL_LIMIT = 16_000_000
"""Texels that an atlas may need: 90 clusters of each take 5.8 GB."""


@dataclass
class LightmapParams:
    """Dials of the relightable surfel lightmap."""

    texel_target: int = 32768
    """Texels that the scene's surfaces get in all. More: sharper light and corners; bake, memory and step time grow in
    proportion."""
    texels_per_metre: float = 0.0
    """Texels along a metre of surface; 0 takes it from `texel_target`. Twice as many cost four times the time."""
    surfel_target: int = 4096
    """Surfels that carry light from frame to frame, shared out by area. More: finer bounce light and longer shadow-ray
    time; fewer: bounce light is a wash of colour."""
    points_per_surfel: int = 4
    """Points of each surfel that are lit a frame, one shadow ray a light each (the document: 1). More: shadows that
    fall within a surfel count by their share; time of the first stage grows in proportion."""
    clusters_per_texel: int = 90
    """Clusters that light a texel at most (the document: 90). More: less blur of far light; memory and the last stage's
    time grow in proportion."""
    rays_per_texel: int = 512
    """Rays a texel casts in the bake. More: less mottling, a longer bake; nothing changes at run time."""
    visibility: str = "rays"
    """`rays` counts hits; `form-factor` takes the analytic form factor of each cluster hit, which flares up where texel
    and surfel are close (why the document gave it up)."""
    refine: str = "uneven"
    """Which cluster is split next: `uneven`, the one whose halves the texel sees most unlike their areas; `heaviest`,
    the document's rule, which leaves light too dark where half of a cluster is hidden."""
    cluster_mean: str = "seen"
    """How a cluster's radiosity is made of its parts': `seen`, by the rays that its texels sent to each; `area`, flux
    over area, the document's rule: the Cornell box comes out 1.1 % too dark."""
    tree_normal: float = 2.0
    """What unlike normals cost when clusters merge, in surfel spacings. Higher: flatter clusters; lower: rounder."""
    tree_chart: float = 1.0
    """What a merge across two charts costs, in surfel spacings. Higher keeps surfaces apart for longer."""
    tree_outlook: float = 50.0
    """What it costs to merge surfels that see other things, such as both sides of a wall. 0 lets sunlight in along
    rafters that pass a roof; at very high values clusters are scattered."""
    tree_balance: float = 0.5
    """Exponent of the area in a merge's cost. 0 merges the nearest, which makes long chains; 1 keeps areas alike."""
    sky_resolution: int = 12
    """Sky surfels along each side of the octahedral sky. More: sharper skies, more leaves in the tree."""
    probe_target: int = 512
    """Points in open space that light moving objects and free points, 6 directions each. More: light follows moving
    things more finely; each costs as much as 6 texels."""

    def check(self) -> None:
        """Raise LuxelError for a value that the lightmap cannot be baked with."""
        rules = (
            ("texel_target", 64 <= self.texel_target <= TEXEL_LIMIT, f"from 64 to {TEXEL_LIMIT}"),
            ("texels_per_metre", 0.0 <= self.texels_per_metre <= 1e6, "from 0 to 1000000"),
            ("surfel_target", 1 <= self.surfel_target <= 500_000, "from 1 to 500000"),
            ("points_per_surfel", 1 <= self.points_per_surfel <= 64, "from 1 to 64"),
            ("clusters_per_texel", 8 <= self.clusters_per_texel <= 4096, "from 8 to 4096"),
            ("rays_per_texel", 16 <= self.rays_per_texel <= 4095, "from 16 to 4095"),
            ("visibility", self.visibility in ("rays", "form-factor"), "'rays' or 'form-factor'"),
            ("refine", self.refine in ("uneven", "heaviest"), "'uneven' or 'heaviest'"),
            ("cluster_mean", self.cluster_mean in ("seen", "area"), "'seen' or 'area'"),
            ("tree_normal", 0.0 <= self.tree_normal <= 1000.0, "from 0 to 1000"),
            ("tree_chart", 0.0 <= self.tree_chart <= 1000.0, "from 0 to 1000"),
            ("tree_outlook", 0.0 <= self.tree_outlook <= 10_000.0, "from 0 to 10000"),
            ("tree_balance", 0.0 <= self.tree_balance <= 2.0, "from 0 to 2"),
            ("sky_resolution", 2 <= self.sky_resolution <= 128, "from 2 to 128"),
            ("probe_target", 1 <= self.probe_target <= 100_000, "from 1 to 100000"),
        )
        for name, fine, allowed in rules:
            if not fine:
                raise LuxelError(f"lightmap: parameter '{name}' is {getattr(self, name)}, but must be {allowed}")
