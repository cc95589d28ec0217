"""What single precision rounds off places, and so how close two surfaces may come.

Every such length follows from the largest coordinate of the triangle in question; none from the scene's size.
"""

from __future__ import annotations

import numpy as np

from luxel.scene.accel import place

STEP = 8.0 * 2.0**-24
"""How far a ray starts off a triangle, as a share of the triangle's largest coordinate: eight roundings of it (2^-24
each). At two, rays no longer meet the triangle that they leave; at four, they no longer slip through the edges of
closed boxes."""
TWIN = 64.0
"""How far two sheets stand apart that are meant as one, in such steps: a ray that passes a hole of one, from as far
away as 200 times their coordinates, goes on before the other."""


def twin_gaps(positions: np.ndarray, faces: np.ndarray, edge_share: float = 0.0) -> np.ndarray:
    """Return at each vertex how far the other side of a sheet must stand off to count as a surface of its own.

    Positions (V, 3) in world space, metres; faces (F, 3). At least `edge_share` of the longest edge that meets there.
    """
    corners = positions[faces].astype(np.float64)
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1, initial=0.0)
    least = np.maximum(TWIN * STEP * np.abs(corners).max(axis=(1, 2), initial=0.0), edge_share * edges)
    gaps = np.zeros(len(positions))
    np.maximum.at(gaps, faces.ravel().astype(np.int64), np.repeat(least, 3))
    return gaps


def twin_gaps_in_places(
    positions: np.ndarray, faces: np.ndarray, normals: np.ndarray, places: list[np.ndarray]
) -> np.ndarray:
    """Return `twin_gaps` of a mesh in its own space that matrices (4, 4) put into the world: wide enough at all.

    The gaps are lengths of the mesh's own space along its unit normals (V, 3).
    """
    gaps = np.zeros(len(positions))
    for matrix in places:
        # Planes part by a length along the normal over what the normal becomes; one flattened to nothing never does.
        shrinkage = np.linalg.norm(normals @ np.linalg.pinv(matrix[:3, :3]), axis=1)
        gaps = np.maximum(gaps, twin_gaps(place(positions, matrix), faces) * shrinkage)
    return gaps
