"""The bake, step by step: the scene laid flat, surfels, tree, visibility, clusters. NumPy in, NumPy out."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.errors import LuxelError
from luxel.kernels.surface import surface_at
from luxel.methods.base import Report, stay_silent
from luxel.methods.lightmap.bake.fingerprint import fingerprint_rows, fingerprint_scene
from luxel.methods.lightmap.bake.outlook import Outlook, look_out
from luxel.methods.lightmap.bake.probe_grid import make_probe_grid
from luxel.methods.lightmap.bake.refine import Refiner
from luxel.methods.lightmap.bake.rows import Caster, cast_all_rows, fill_rows, find_open_probes
from luxel.methods.lightmap.bake.sky import make_sky_tree
from luxel.methods.lightmap.bake.surfels import Surfels, label_cells, make_surfels
from luxel.methods.lightmap.bake.tree import Items, Tree, TreeDials, merge_pairs, order_tree, put_side_by_side
from luxel.methods.lightmap.bake.visibility import Leaves
from luxel.methods.lightmap.bake.words import NODE_LIMIT
from luxel.methods.lightmap.flatten.atlas import Points
from luxel.methods.lightmap.flatten.faces import NONE, Faces
from luxel.methods.lightmap.flatten.flat_scene import FlatScene, lay_out, place_triangles
from luxel.methods.lightmap.flatten.octaves import on_triangle
from luxel.methods.lightmap.flatten.split import Split
from luxel.methods.lightmap.params import LightmapParams
from luxel.scene.device import Scene
from luxel.scene.triangles import Box


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


def bake_scene(
    scene: Scene, params: LightmapParams, seed: int, *, flat: FlatScene | None = None, workdir: Path | None = None,
    report: Report = stay_silent,
) -> Bake:  # fmt: skip
    """Bake the still part of `scene`. Stopped, it goes on from what `workdir` holds. Raises LuxelError.

    `flat` is what `lay_out` returns for the same scene, parameters and seed; without it, it is made here.
    """
    flat = flat or lay_out(scene, params, seed, report)
    still, faces, atlas, points, texels = flat.still, flat.faces, flat.atlas, flat.points, flat.texels
    report("making surfels", 0.0)
    albedo = read_albedo(still, faces, points)
    surfels, of_point = make_surfels(
        points, flat.weight, flat.piece, albedo, flat.valid, params, atlas.texel_size, seed, report
    )
    labels = label_cells(atlas, points, of_point, texels)
    resolution = params.sky_resolution if scene.lights.has_sky else 0
    check_room(len(surfels.p), resolution, scene.host.data.name)
    report("looking around", 0.0)
    bounds = Box(scene.host.lower, scene.host.upper)
    outlook = look_out(still, flat.tables, flat.origins, surfels, labels, bounds, seed)
    tree, roots, direction, angle = grow_tree(surfels, outlook, resolution, params, report)
    leaf_area = np.concatenate([surfels.area, angle, [0.0]])[tree.leaf]
    caster = Caster(
        still=still,
        tables=flat.tables,
        leaves=make_leaves(tree, len(surfels.p), resolution, labels),
        refiner=Refiner(tree, roots, leaf_area, params.clusters_per_texel, params.refine == "heaviest"),
        rays=params.rays_per_texel,
        by_form_factor=params.visibility == "form-factor",
    )
    probes, mark = make_probe_grid(scene, params.probe_target), fingerprint_scene(scene, params)
    batch_mark = fingerprint_rows(
        mark, np.array(flat.tables.face_of), atlas.uv, points.p, points.normal, texels.starts, texels.points,
        surfels.samples, labels, tree.leaf, tree.children, probes.positions(),
    )  # fmt: skip
    words, seen = cast_all_rows(caster, flat.origins, texels, probes, surfels, seed, batch_mark, workdir, report)
    probe_fine = find_open_probes(words[len(texels.slot) :], probes.total, caster)
    fill_rows(words, atlas, texels, flat.reached)
    samples = surfels.samples.ravel()
    return Bake(
        fingerprint=mark, width=atlas.width, height=atlas.height, texel_size=atlas.texel_size,
        face_of=np.array(flat.tables.face_of), face_uv=place_triangles(atlas, faces).astype(np.float32),
        split_face=flat.split.face, split_corners=flat.split.corners, split_bounds=flat.split.bounds,
        face_chart=atlas.chart.astype(np.int32), texel_slot=texels.slot, texel_chart=texels.chart,
        texel_fine=flat.reached, cell_surfel=labels, surfel_p=surfels.p, surfel_normal=surfels.normal,
        surfel_area=surfels.area, surfel_albedo=surfels.albedo, surfel_chart=surfels.chart,
        sample_p=points.p[samples], sample_n_geometric=faces.normal[points.face[samples]],
        sample_n_shading=points.normal[samples], sky_resolution=resolution, sky_direction=direction, sky_angle=angle,
        tree_leaf=tree.leaf, tree_children=tree.children, tree_low=tree.low, tree_high=tree.high, roots=roots,
        words=words, seen=np.zeros(0, np.int64) if params.cluster_mean == "area" else seen, rays=params.rays_per_texel,
        probe_lower=probes.lower, probe_size=probes.size, probe_counts=np.array(probes.counts),
        probe_fine=probe_fine, notes=np.array(flat.notes, dtype=np.str_),
    )  # fmt: skip


def check_room(surfel_count: int, resolution: int, name: str) -> None:
    """Raise LuxelError where the trees of so many surfels and the sky would have more nodes than words can name."""
    # Binary trees: fewer than two nodes a leaf, the void's among them.
    if 2 * (surfel_count + resolution * resolution + 1) > NODE_LIMIT:
        raise LuxelError(
            f"{name}: {surfel_count:,} surfels make more clusters than {NODE_LIMIT:,}, the most there can be; every "
            "piece of a surface takes one surfel: lower 'surfel_target', join meshes, or leave small parts out"
        )


def read_albedo(still: Scene, faces: Faces, points: Points) -> np.ndarray:
    """Return the albedo (N, 3) of each dense point, on its face's side."""
    prim = mi.UInt32(faces.prim[points.face].astype(np.uint32))
    weights = on_triangle(faces.inside, points.face, points.weights)
    place = mi.Point2f(np.ascontiguousarray(weights[:, 1:].T, np.float32))
    side = mi.Vector3f(np.ascontiguousarray(faces.normal[points.face].T, np.float32))
    surface = surface_at(still, prim, place, dr.full(mi.Bool, True, len(points.p)), wo=side)
    return np.broadcast_to(np.array(surface.albedo).T, (len(points.p), 3)).astype(np.float64)


def grow_tree(
    surfels: Surfels, outlook: Outlook, resolution: int, params: LightmapParams, report: Report = stay_silent
) -> tuple[Tree, np.ndarray, np.ndarray, np.ndarray]:
    """Return trees side by side, their roots, the sky's directions and solid angles.

    One tree for each region of surfels that see one another, one for the sky, and the void, a tree of one leaf.
    """
    dials = TreeDials(params.tree_normal, params.tree_chart, params.tree_outlook, params.tree_balance)
    trees, done, count = [], 0, len(surfels.p)
    report("growing the tree", 0.0)
    for number in np.unique(outlook.region):
        held = np.flatnonzero(outlook.region == number)
        items = Items(
            surfels.p[held], surfels.normal[held], surfels.area[held], surfels.chart[held], outlook.view[held]
        )
        merges = merge_pairs(items, dials, lambda now, before=done: report("growing the tree", (before + now) / count))
        tree = order_tree(merges, len(held))
        done += len(held)
        trees.append(replace(tree, leaf=held[tree.leaf]))
    direction, angle = np.zeros((0, 3)), np.zeros(0)
    if resolution:
        sky, direction, angle = make_sky_tree(resolution)
        trees.append(replace(sky, leaf=sky.leaf + count))
    last = count + resolution * resolution
    void = Tree(np.array([last]), np.zeros((0, 2), np.int64), np.zeros(1, np.int64), np.ones(1, np.int64))
    return *put_side_by_side([*trees, void]), direction, angle


def make_leaves(tree: Tree, surfel_count: int, resolution: int, labels: np.ndarray) -> Leaves:
    """Return which leaf a ray meets in each fine cell and each direction of the sky."""
    leaf_of = tree.leaf_of
    held = labels != NONE
    of_cell = np.full(len(labels), NONE, np.uint32)
    of_cell[held] = leaf_of[labels[held]]
    sky = leaf_of[surfel_count : surfel_count + resolution * resolution]
    of_sky = mi.UInt32((sky if resolution else np.zeros(1)).astype(np.uint32))
    return Leaves(mi.UInt32(of_cell), of_sky, resolution, int(leaf_of[-1]))


def bake_arrays(bake: Bake) -> dict[str, Any]:
    """Return the bake's fields by name, for a file."""
    return {item.name: getattr(bake, item.name) for item in fields(bake)}
