"""Charts: pieces of surface laid flat, from the file's second texture coordinates or from xatlas.

xatlas (Jonathan Young, after thekla_atlas) cuts and flattens; placing the charts is `atlas.py`'s work.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
import xatlas

from luxel.errors import LuxelError
from luxel.methods.base import Progress, stay_silent
from luxel.methods.lightmap.flatten.faces import Faces

OVERLAP_GRID = 512
"""Cells along the unit square that look for overlaps in a file's coordinates."""
OVERLAP_SHARE = 0.005
"""Share of doubly covered cells from which a file's coordinates overlap; borders of triangles stay below it."""
FLAT_TEXELS = 512
"""Texels along a square of the surface's area, for xatlas's own packing, which is not used."""
CHART_FACES = 1000
"""Faces of a chart, about, where a surface has many: flattening takes longer than in proportion. Without the limit a
surface of 70,144 faces took xatlas 24.9 s instead of 2.7 s, and came out in 362 charts instead of 344."""
BATCH_FACES = 50_000
"""Faces that xatlas gets at a time: progress can be told in between."""


@dataclass
class Charts:
    """The flattened surface. Faces that no chart holds have chart -1."""

    chart: np.ndarray
    """(F,) chart of each face."""
    uv: np.ndarray
    """(F, 3, 2) metres times `density`, each chart's lowest corner at the origin, its area that of its surface."""
    count: int
    notes: list[str]
    """What the user should know, a sentence each."""
    density: np.ndarray
    """(C,) texels along a metre of it, over those along one within the scene's bounds (`density.py`)."""


def unwrap(faces: Faces, name: str, report: Progress = stay_silent) -> Charts:
    """Return charts for all faces. Raises LuxelError where xatlas refuses the geometry of scene `name`."""
    chart = np.full(len(faces.prim), -1, np.int64)
    uv = np.zeros((len(faces.prim), 3, 2))
    notes: list[str] = []
    by_xatlas, count = [], 0
    weld = faces.weld
    for unit in np.unique(faces.unit):
        members = np.flatnonzero(faces.unit == unit)
        complaint = "" if faces.uv2 is None else find_fault(faces.uv2[members])
        if faces.uv2 is None or complaint:
            if complaint and complaint != MISSING:
                notes.append(
                    f"The second texture coordinates of object {unit // 2} {complaint}; it was unwrapped anew."
                )
            by_xatlas.append(members)
            continue
        uv[members] = faces.uv2[members]
        chart[members] = count + _connect(faces.uv2[members], faces.corners[members], weld)
        count = int(chart.max()) + 1
    if by_xatlas:
        _run_xatlas(faces, by_xatlas, chart, uv, count, name, report)
    count = int(chart.max()) + 1
    if count == 0:
        raise LuxelError(f"{name}: xatlas could not unwrap any surface; repair the meshes or give them a second UV set")
    return Charts(chart, to_metres(faces, chart, uv, count), count, notes, np.ones(count))


MISSING = "are missing"


def find_fault(uv: np.ndarray) -> str:
    """Return what is wrong with light map coordinates (T, 3, 2), in words; empty where they can be used."""
    if not uv.any():
        return MISSING
    if not np.isfinite(uv).all() or uv.min() < -1e-4 or uv.max() > 1.0 + 1e-4:
        return "leave the unit square"
    edge_1, edge_2 = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    signed = edge_1[:, 0] * edge_2[:, 1] - edge_1[:, 1] * edge_2[:, 0]
    if (np.abs(signed) < 1e-12).mean() > 0.5:
        return "are without area"
    from luxel.methods.lightmap.flatten.raster import cover

    cell, _, weights = cover(uv * OVERLAP_GRID, (OVERLAP_GRID, OVERLAP_GRID))
    inside = weights.min(axis=1) > 0.02
    _, times = np.unique(cell[inside], return_counts=True)
    return "overlap" if len(times) and (times > 1).mean() > OVERLAP_SHARE else ""


def _connect(uv: np.ndarray, corners: np.ndarray, distance: float) -> np.ndarray:
    """Return which triangles (T, 3, 2) hang together, as numbers from 0.

    They share a vertex, `corners` (T, 3, 3) within `distance`, and its coordinates: pieces of a file's layout that only
    touch there may lie far apart in the scene.
    """
    keys = np.column_stack([uv.reshape(-1, 2) * 65536, corners.reshape(-1, 3) / max(distance, 1e-300)])
    _, ids = np.unique(np.round(keys).astype(np.int64), axis=0, return_inverse=True)
    ids = ids.reshape(-1, 3)
    size = int(ids.max()) + 1
    graph = scipy.sparse.coo_array((np.ones(ids.size), (ids.ravel(), ids[:, [1, 2, 0]].ravel())), shape=(size, size))
    _, piece = scipy.sparse.csgraph.connected_components(graph, directed=False)
    return np.unique(piece[ids[:, 0]], return_inverse=True)[1]


def _run_xatlas(
    faces: Faces, units: list[np.ndarray], chart: np.ndarray, uv: np.ndarray, first: int, name: str, report: Progress
) -> None:
    """Unwrap each unit's faces; fill in `chart` and `uv`, charts numbered from `first`."""
    batches = _plan_batches(faces, units)
    done, total = 0, sum(len(members) for members in units)
    for meshes, area_limit in batches:
        report("unwrapping", done / total)
        first = _unwrap_batch(faces, meshes, area_limit, chart, uv, first, name)
        done += sum(len(members) for members in meshes)
    report("unwrapping", 1.0)


def _plan_batches(faces: Faces, units: list[np.ndarray]) -> list[tuple[list[np.ndarray], float]]:
    """Return what xatlas gets at a time: faces, mesh by mesh, and the largest area of a chart (0: any).

    A connected part of many faces comes alone, so that its charts can be kept small; the rest comes together.
    """
    batches: list[tuple[list[np.ndarray], float]] = []
    small: list[np.ndarray] = []
    for members in units:
        _, part, count = np.unique(faces.part[members], return_inverse=True, return_counts=True)
        for number in np.flatnonzero(count > CHART_FACES):
            large = members[part == number]
            batches.append(([large], float(faces.area[large].mean()) * CHART_FACES))
        rest = members[count[part] <= CHART_FACES]
        if len(rest):
            small.append(rest)
            if sum(map(len, small)) > BATCH_FACES:
                batches.append((small, 0.0))
                small = []
    return [*batches, (small, 0.0)] if small else batches


def _unwrap_batch(
    faces: Faces, meshes: list[np.ndarray], area_limit: float, chart: np.ndarray, uv: np.ndarray, first: int, name: str
) -> int:
    """Unwrap faces, mesh by mesh; return the number of the next chart."""
    atlas = xatlas.Atlas()
    for members in meshes:
        order = _outward(faces, members)
        corners = np.take_along_axis(faces.corners[members], order[..., None], axis=1)
        normals = np.take_along_axis(faces.normals[members], order[..., None], axis=1)
        index = np.arange(3 * len(members), dtype=np.uint32).reshape(-1, 3)
        flat = [np.ascontiguousarray(array.reshape(-1, 3), np.float32) for array in (corners, normals)]
        try:
            atlas.add_mesh(flat[0], index, flat[1])
        except RuntimeError as error:
            raise LuxelError(f"{name}: xatlas refuses a mesh ({error}); give it a second UV set") from None
    growing, packing = xatlas.ChartOptions(), xatlas.PackOptions()
    growing.max_chart_area = area_limit
    area = float(sum(faces.area[members].sum() for members in meshes))
    packing.texels_per_unit = FLAT_TEXELS / area**0.5
    packing.rotate_charts = False
    atlas.generate(chart_options=growing, pack_options=packing)
    for number, members in enumerate(meshes):
        _, index, found = atlas.get_mesh(number)
        _, of_vertex = atlas.get_mesh_vertex_assignment(number)
        index = index.reshape(-1, 3)
        placed = found[index] * np.array([atlas.width, atlas.height]) / packing.texels_per_unit
        uv[members] = np.take_along_axis(placed, _outward(faces, members)[..., None], axis=1)
        given = of_vertex[index[:, 0]].astype(np.int64)
        missing = given >= 0xFFFFFFFF
        ids = np.unique(given[~missing], return_inverse=True)[1]
        chart[members[~missing]] = first + ids
        first += int(ids.max()) + 1 if len(ids) else 0
    return first


def _outward(faces: Faces, members: np.ndarray) -> np.ndarray:
    """Return the order of each face's corners (n, 3): backs run the other way round, so that xatlas sees their side."""
    return np.where(faces.back[members][:, None], [0, 2, 1], [0, 1, 2])


def to_metres(faces: Faces, chart: np.ndarray, uv: np.ndarray, count: int) -> np.ndarray:
    """Return `uv` moved to the origin and scaled so that each chart's flat area is that of its surface."""
    held = chart >= 0
    edge_1, edge_2 = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    flat = 0.5 * np.abs(edge_1[:, 0] * edge_2[:, 1] - edge_1[:, 1] * edge_2[:, 0])
    flat_sum = np.bincount(chart[held], weights=flat[held], minlength=count)
    area_sum = np.bincount(chart[held], weights=faces.area[held], minlength=count)
    scale = np.sqrt(area_sum / np.maximum(flat_sum, 1e-30))
    lower = np.full((count, 2), np.inf)
    np.minimum.at(lower, chart[held], uv[held].min(axis=1))
    moved = np.zeros_like(uv)
    moved[held] = (uv[held] - lower[chart[held]][:, None]) * scale[chart[held]][:, None, None]
    return moved
