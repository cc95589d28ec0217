"""What a bake is: transport and all that it is between, as NumPy arrays."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from luxel.methods.lightmap.bake.tree import Tree
from luxel.methods.lightmap.flatten.split import Split


@dataclass
class Bake:
    """Everything the bake knows, as NumPy arrays; written to and read from one file."""

    fingerprint: str
    """Of what the transport is made from: `fingerprint_scene`."""
    width: int
    height: int
    texel_size: float
    face_of: np.ndarray
    """(2 T,) uint32."""
    face_uv: np.ndarray
    """(F, 3, 2) float32, of whole triangles."""
    split_face: np.ndarray
    """(S, K) uint32; `Split` has the others too."""
    split_corners: np.ndarray
    split_bounds: np.ndarray
    face_chart: np.ndarray
    """(F,) int32."""
    texel_slot: np.ndarray
    """(M,) place of each texel."""
    texel_chart: np.ndarray
    texel_fine: np.ndarray
    """(M,) bool: it lies in the open; the others are filled from these."""
    cell_surfel: np.ndarray
    """(16 width height,) uint32 surfel of each fine cell."""
    surfel_p: np.ndarray
    surfel_normal: np.ndarray
    surfel_area: np.ndarray
    surfel_albedo: np.ndarray
    surfel_chart: np.ndarray
    sample_p: np.ndarray
    """(S K sets, 3)."""
    sample_n_geometric: np.ndarray
    sample_n_shading: np.ndarray
    sky_resolution: int
    sky_direction: np.ndarray
    """(R R, 3)."""
    sky_angle: np.ndarray
    tree_leaf: np.ndarray
    tree_children: np.ndarray
    tree_low: np.ndarray
    tree_high: np.ndarray
    roots: np.ndarray
    words: np.ndarray
    """(M + 6 P + S, budget) uint32: texels, probe directions, surfels."""
    seen: np.ndarray
    """Rays that each item of the clusters' lists was seen by; empty: clusters are means by area."""
    rays: int
    probe_lower: np.ndarray
    probe_size: float
    probe_counts: np.ndarray
    """(3,)."""
    probe_fine: np.ndarray
    """(P,) bool."""
    notes: np.ndarray
    """Sentences for the user."""

    @property
    def split(self) -> Split:
        """Triangles in several parts."""
        return Split(self.split_face, self.split_corners, self.split_bounds)

    @property
    def tree(self) -> Tree:
        """The trees side by side: each region's surfels, sky, the void."""
        return Tree(self.tree_leaf, self.tree_children, self.tree_low, self.tree_high)


def bake_arrays(bake: Bake) -> dict[str, Any]:
    """Return the bake's fields by name, for a file."""
    return {item.name: getattr(bake, item.name) for item in fields(bake)}
