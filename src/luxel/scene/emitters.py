"""Triangles that emit: which they are, how strongly, and what bounds them for the light tree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from luxel.scene.emission_maps import VertexLooks, emitted_luminance
from luxel.scene.light_tree import LightBounds, empty_bounds
from luxel.scene.model import Material, SceneData


@dataclass
class Emitters:
    """The triangles that emit, kept on the host so that the tree can follow what moves."""

    triangles: np.ndarray
    """(E,) numbers over the whole scene."""
    vertices: np.ndarray
    """(E, 3) vertex numbers."""
    corners: np.ndarray
    """(E, 3, 3) float64, in the space of the object."""
    object_ids: np.ndarray
    """(E,) rows of the object-to-world matrices."""
    radiance: np.ndarray
    """(E,) mean luminance, W/(m^2 sr), of a side that emits."""
    two_sided: np.ndarray
    """(E,) bool."""


def collect_emitters(
    data: SceneData,
    triangles: np.ndarray,
    positions: np.ndarray,
    looks: VertexLooks,
    movable: np.ndarray,
    before: tuple[list[Material], Emitters] | None = None,
) -> Emitters:
    """Return what emits of `triangles` (F, 4), as in `Geometry`, with vertices at `positions` (V, 3).

    Triangles that are black all over are left out, and those without area, unless they belong to an object id that is
    `movable` (ids,) bool: it may give them one. `before`: the materials and what was returned for them; those that are
    still the same are not read again, as their images may be large.
    """
    glows = np.array([max(item.emission) > 0.0 for item in data.materials], bool)
    chosen = np.flatnonzero(glows[triangles[:, 3] & 0xFFFF]) if glows.any() else np.zeros(0, np.int64)
    vertices = triangles[chosen, :3].astype(np.int64)
    material = triangles[chosen, 3] & 0xFFFF
    known = np.zeros(len(triangles))
    if before is not None:
        known[before[1].triangles] = before[1].radiance
    radiance = known[chosen]
    order = np.argsort(material, kind="stable")
    # Sorted, so that thousands of materials cost no more than one.
    for own in np.split(order, np.flatnonzero(np.diff(material[order])) + 1) if len(order) else []:
        index = material[own[0]]
        if before is None or data.materials[index] is not before[0][index]:
            radiance[own] = emitted_luminance(data.materials[index], looks, vertices[own])
    corners = positions[vertices].astype(np.float64).reshape(-1, 3, 3)
    object_ids = (triangles[chosen, 3] >> 16).astype(np.int64)
    keep = (radiance > 0.0) & ((_face_vectors(corners) != 0.0).any(axis=1) | movable[object_ids])
    two_sided = np.array([item.emit_back for item in data.materials], bool)[material[keep]]
    return Emitters(chosen[keep], vertices[keep], corners[keep], object_ids[keep], radiance[keep], two_sided)


def deform_emitters(emitters: Emitters, first_vertex: int, positions: np.ndarray) -> None:
    """Move the corners among the vertices from `first_vertex` on to `positions` (V, 3)."""
    if not len(emitters.vertices):
        return
    place = emitters.vertices - first_vertex
    # Triangles share no vertices with other meshes.
    inside = (place[:, 0] >= 0) & (place[:, 0] < len(positions))
    emitters.corners[inside] = positions[place[inside]]


def bound_emitters(emitters: Emitters, matrices: np.ndarray) -> LightBounds:
    """Return a row of bounds for each triangle, with objects placed by `matrices` (ids, 4, 4)."""
    linear, shift = matrices[emitters.object_ids, :3, :3], matrices[emitters.object_ids, :3, 3]
    corners = np.einsum("eij,ekj->eki", linear, emitters.corners) + shift[:, None, :]
    # A mirror turns the order of the corners round, not the side that shines.
    face = _face_vectors(corners) * np.sign(np.linalg.det(linear))[:, None]
    length = np.linalg.norm(face, axis=1)
    bounds = empty_bounds(len(corners))
    bounds.lower, bounds.upper = corners.min(axis=1), corners.max(axis=1)
    bounds.intensity = 0.5 * length * emitters.radiance
    bounds.axis = np.where(length[:, None] > 0.0, face / np.where(length > 0.0, length, 1.0)[:, None], bounds.axis)
    bounds.reach[:] = 0.5 * np.pi
    bounds.two_sided = emitters.two_sided.copy()
    bounds.range[:] = np.inf
    return bounds


def _face_vectors(corners: np.ndarray) -> np.ndarray:
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
