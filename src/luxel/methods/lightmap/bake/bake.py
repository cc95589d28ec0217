"""The bake, step by step: the scene laid flat, surfels, trees, visibility. NumPy in, NumPy out."""

from __future__ import annotations

from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.kernels.surface import surface_at
from luxel.methods.base import Progress, stay_silent
from luxel.methods.lightmap.bake.fingerprint import fingerprint_rows, fingerprint_scene
from luxel.methods.lightmap.bake.forest import Forest, check_node_count, grow_forest, make_leaves
from luxel.methods.lightmap.bake.mutual_visibility import estimate_mutual_visibility
from luxel.methods.lightmap.bake.probe_grid import ProbeGrid, make_probe_grid
from luxel.methods.lightmap.bake.record import Bake
from luxel.methods.lightmap.bake.refine import Refiner
from luxel.methods.lightmap.bake.rows import RowCaster, cast_all_rows, fill_rows, find_open_probes
from luxel.methods.lightmap.bake.surfels import BakedSurfels, label_cells, make_surfels
from luxel.methods.lightmap.flatten.atlas import Points
from luxel.methods.lightmap.flatten.faces import Faces
from luxel.methods.lightmap.flatten.flat_scene import FlatScene, lay_out, place_triangles
from luxel.methods.lightmap.flatten.octaves import on_triangle
from luxel.methods.lightmap.params import LightmapParams
from luxel.scene.arrays import from_numpy, vectors_from_numpy
from luxel.scene.device import Scene
from luxel.scene.triangles import Box


def bake_scene(
    scene: Scene, params: LightmapParams, seed: int, *, flat: FlatScene | None = None, workdir: Path | None = None,
    report: Progress = stay_silent,
) -> Bake:  # fmt: skip
    """Bake the still part of `scene`. Stopped, it goes on from what `workdir` holds. Raises LuxelError.

    `flat` is what `lay_out` returns for the same scene, parameters and seed; without it, it is made here.
    """
    flat = flat or lay_out(scene, params, seed, report)
    report("making surfels", 0.0)
    albedo = read_albedo(flat.still, flat.faces, flat.points)
    surfels, of_point = make_surfels(flat, albedo, params, seed, report)
    labels = label_cells(flat.atlas, flat.points, of_point, flat.texels)
    resolution = params.sky_resolution if scene.lights.has_sky else 0
    check_node_count(len(surfels.p), resolution, scene.host.data.name)

    # Surfels that see one another, directly or over others, share a tree.
    report("looking around", 0.0)
    bounds = Box(scene.host.lower, scene.host.upper)
    visibility = estimate_mutual_visibility(flat.still, flat.tables, flat.origins, surfels, labels, bounds, seed)
    forest = grow_forest(surfels, visibility, resolution, params, report)

    # Rows of texels, of the probes' directions and of the surfels themselves.
    caster = make_caster(flat, surfels, forest, labels, params)
    probes, mark = make_probe_grid(scene, params.probe_target), fingerprint_scene(scene, params)
    batch_mark = fingerprint_rows(
        mark, np.array(flat.tables.face_of), flat.atlas.uv, flat.points.p, flat.points.normal, flat.texels.starts,
        flat.texels.points, surfels.samples, labels, forest.tree.leaf, forest.tree.children, probes.positions(),
    )  # fmt: skip
    words, seen = cast_all_rows(caster, flat, probes, surfels, seed, batch_mark, workdir, report)
    probe_fine = find_open_probes(words[len(flat.texels.slot) :], probes.total, caster)
    fill_rows(words, flat.atlas, flat.texels, flat.reached)
    seen = np.zeros(0, np.int64) if params.cluster_mean == "area" else seen
    return pack_bake(mark, flat, labels, surfels, forest, probes, probe_fine, words, seen, params.rays_per_texel)


def read_albedo(still: Scene, faces: Faces, points: Points) -> np.ndarray:
    """Return the albedo (N, 3) of each dense point, on its face's side."""
    prim = from_numpy(mi.UInt32, faces.prim[points.face])
    weights = on_triangle(faces.inside, points.face, points.weights)
    place = vectors_from_numpy(mi.Point2f, weights[:, 1:])
    side = vectors_from_numpy(mi.Vector3f, faces.normal[points.face])
    surface = surface_at(still, prim, place, dr.full(mi.Bool, True, len(points.p)), wo=side)
    return np.broadcast_to(np.array(surface.albedo).T, (len(points.p), 3)).astype(np.float64)


def make_caster(
    flat: FlatScene, surfels: BakedSurfels, forest: Forest, labels: np.ndarray, params: LightmapParams
) -> RowCaster:
    """Return what casts and refines rows; `labels` names the surfel of each fine cell."""
    leaf_area = np.concatenate([surfels.area, forest.sky_angle, [0.0]])[forest.tree.leaf]
    by_weight = params.refine == "heaviest"
    return RowCaster(
        still=flat.still,
        tables=flat.tables,
        leaves=make_leaves(forest, labels),
        refiner=Refiner(forest.tree, forest.roots, leaf_area, params.clusters_per_texel, by_weight),
        rays=params.rays_per_texel,
        by_form_factor=params.visibility == "form-factor",
    )


def pack_bake(
    mark: str, flat: FlatScene, labels: np.ndarray, surfels: BakedSurfels, forest: Forest, probes: ProbeGrid,
    probe_fine: np.ndarray, words: np.ndarray, seen: np.ndarray, rays: int,
) -> Bake:  # fmt: skip
    """Return what all that was made comes to."""
    atlas, faces, points, texels, tree = flat.atlas, flat.faces, flat.points, flat.texels, forest.tree
    samples = surfels.samples.ravel()
    return Bake(
        fingerprint=mark, width=atlas.width, height=atlas.height, texel_size=atlas.texel_size,
        face_of=np.array(flat.tables.face_of), face_uv=place_triangles(atlas, faces).astype(np.float32),
        split_face=flat.split.face, split_corners=flat.split.corners, split_bounds=flat.split.bounds,
        face_chart=atlas.chart.astype(np.int32), texel_slot=texels.slot, texel_chart=texels.chart,
        texel_fine=flat.reached, cell_surfel=labels, surfel_p=surfels.p, surfel_normal=surfels.normal,
        surfel_area=surfels.area, surfel_albedo=surfels.albedo, surfel_chart=surfels.chart,
        sample_p=points.p[samples], sample_n_geometric=faces.normal[points.face[samples]],
        sample_n_shading=points.normal[samples], sky_resolution=forest.sky_resolution,
        sky_direction=forest.sky_direction, sky_angle=forest.sky_angle,
        tree_leaf=tree.leaf, tree_children=tree.children, tree_low=tree.low, tree_high=tree.high, roots=forest.roots,
        words=words, seen=seen, rays=rays,
        probe_lower=probes.lower, probe_size=probes.size, probe_counts=np.array(probes.counts),
        probe_fine=probe_fine, notes=np.array(flat.notes, dtype=np.str_),
    )  # fmt: skip
