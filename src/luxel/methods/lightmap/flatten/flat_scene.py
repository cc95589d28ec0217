"""The still scene laid flat: what carries light, its charts in the atlas, dense points and texels on them."""

from __future__ import annotations

from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from luxel.kernels.triangle import triangle_count
from luxel.methods.base import Progress, stay_silent
from luxel.methods.lightmap.flatten.atlas import Atlas, Points, Texels, find_texels, make_atlas, spread_points
from luxel.methods.lightmap.flatten.density import cut_charts, thin_out
from luxel.methods.lightmap.flatten.faces import NONE, Faces, find_faces, still_scene
from luxel.methods.lightmap.flatten.origins import Origins, find_inside_geometry, make_origins
from luxel.methods.lightmap.flatten.pieces import find_pieces, find_seen
from luxel.methods.lightmap.flatten.rims import move_to_rims
from luxel.methods.lightmap.flatten.split import SPLIT, Split, find_split, upload_split
from luxel.methods.lightmap.flatten.tables import AtlasTables
from luxel.methods.lightmap.flatten.unwrap import Charts, unwrap
from luxel.methods.lightmap.params import LightmapParams
from luxel.scene.arrays import from_numpy
from luxel.scene.device import Scene
from luxel.scene.triangles import Box

CHART_TEXELS = 2
"""Texels a chart, on average, below which the large ones would get none: then more are taken than were asked for."""


@dataclass
class FlatScene:
    """The still scene, cut and laid flat. N dense points, M texels."""

    still: Scene
    faces: Faces
    atlas: Atlas
    points: Points
    weight: np.ndarray
    """(N,) what the points count for where surfels are shared out: their area by their chart's density squared."""
    tables: AtlasTables
    split: Split
    """What `tables` holds of triangles in several parts."""
    origins: Origins
    """Rays start at the points."""
    in_open: np.ndarray
    """(N,) points that do not lie inside things."""
    valid: np.ndarray
    """(N,) points that take part: those in the open, and all of a chart that lies inside things altogether."""
    piece: np.ndarray
    """(N,) piece of a chart that each point belongs to."""
    texels: Texels
    reached: np.ndarray
    """(M,) texels that sample points that take part."""
    notes: list[str]


def lay_out(scene: Scene, params: LightmapParams, seed: int, report: Progress = stay_silent) -> FlatScene:
    """Find what carries light, lay it flat and spread points and texels over it. Raises LuxelError."""
    name = scene.host.data.name
    report("finding what light can reach", 0.0)
    still = still_scene(scene)
    faces = find_faces(scene, still)
    faces, charts = cut_charts(scene, faces, unwrap(faces, name, report))
    charts = thin_out(scene, faces, charts)

    report("spreading points", 0.0)
    atlas = make_atlas(faces, charts, count_texels(params, charts), params.texels_per_metre, name)
    points = spread_points(faces, atlas)
    report("spreading points", 0.4)
    face_of, split = name_faces(scene, atlas, faces)
    tables = pack_tables(face_of, place_triangles(atlas, faces), atlas.width, atlas.height, split)
    origins = make_origins(points.p, faces.normal[points.face], points.normal)
    in_open = ~find_inside_geometry(still, tables, origins, seed)
    report("spreading points", 0.6)
    points, in_open = move_to_rims(still, tables, faces, atlas, points, in_open, seed)
    origins = make_origins(points.p, faces.normal[points.face], points.normal)

    # A chart that lies inside things altogether takes part as it is: some ray may meet it all the same.
    valid = in_open | (np.bincount(points.chart, weights=in_open, minlength=atlas.chart_count) == 0)[points.chart]
    piece = find_pieces(still, atlas, points, faces.normal[points.face], valid)
    report("spreading points", 0.8)
    texels, reached = find_texels(atlas, points, valid, piece, find_seen(still, tables, points, piece))
    return FlatScene(
        still=still, faces=faces, atlas=atlas, points=points,
        weight=points.area * charts.density[points.chart] ** 2, tables=tables, split=split, origins=origins,
        in_open=in_open, valid=valid, piece=piece, texels=texels, reached=reached, notes=charts.notes,
    )  # fmt: skip


def count_texels(params: LightmapParams, charts: Charts) -> int:
    """Return the texels to aim at: `texel_target`, or more, which is noted, where so many would miss large charts."""
    target, least = params.texel_target, CHART_TEXELS * charts.count
    if params.texels_per_metre > 0.0 or target >= least:
        return target
    charts.notes.append(f"'texel_target' {target:,} is too little for {charts.count:,} charts; {least:,} was taken.")
    return least


def name_faces(scene: Scene, atlas: Atlas, faces: Faces) -> tuple[np.ndarray, Split]:
    """Return the face (2 T,) uint32 of each triangle's front and back, and those of triangles in several parts."""
    face_of = np.full(2 * triangle_count(scene), NONE, np.uint32)
    held = np.flatnonzero((atlas.chart >= 0) & (faces.octave < 0))
    face_of[2 * faces.prim[held] + faces.back[held]] = held
    parts = np.flatnonzero((atlas.chart >= 0) & (faces.octave >= 0))
    prim, back = faces.prim[parts], faces.back[parts]
    bounds = Box(scene.host.lower, scene.host.upper)
    split, side = find_split(prim, back, faces.octave[parts], faces.area[parts], faces.whole[parts], bounds)
    face_of[2 * prim + back] = SPLIT | side
    split.face = parts[split.face].astype(np.uint32)
    return face_of, split


def place_triangles(atlas: Atlas, faces: Faces) -> np.ndarray:
    """Return where the corners of each face's whole triangle would lie in the atlas, (F, 3, 2), beyond its chart."""
    parts = np.flatnonzero(faces.octave >= 0)
    uv = atlas.uv.copy()
    if len(parts):
        uv[parts] = np.linalg.solve(faces.inside[parts], uv[parts])
    return uv


def pack_tables(face_of: np.ndarray, uv: np.ndarray, width: int, height: int, split: Split) -> AtlasTables:
    """Return the device tables; `face_of` (2 T,), `uv` (F, 3, 2) texels."""
    rows = np.zeros((len(uv), 8), np.float32)
    rows[:, :6] = uv.reshape(-1, 6)
    return AtlasTables(from_numpy(mi.UInt32, face_of), from_numpy(mi.Float, rows), width, height, upload_split(split))
