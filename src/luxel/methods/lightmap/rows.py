"""All rows of the transport, batch by batch: cast, refine, keep on disk; then fill the rows of buried texels."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

from luxel.errors import LuxelError
from luxel.methods.lightmap.atlas import Atlas, Texels
from luxel.methods.lightmap.form_factor import weigh_by_form_factor
from luxel.methods.lightmap.params import LightmapParams
from luxel.methods.lightmap.probes import AXES, INSIDE, ProbeGrid
from luxel.methods.lightmap.refine import Refiner
from luxel.methods.lightmap.state import HIT_BITS, AtlasTables
from luxel.methods.lightmap.surfels import Surfels
from luxel.methods.lightmap.tree import Tree
from luxel.methods.lightmap.visibility import RAYS_AT_ONCE, Leaves, Origins, cast_rows, make_origins
from luxel.scene.device import Scene


def cast_all_rows(
    still: Scene,
    tables: AtlasTables,
    leaves: Leaves,
    origins: Origins,
    texels: Texels,
    probes: ProbeGrid,
    surfels: Surfels,
    tree: Tree,
    refiner: Refiner,
    params: LightmapParams,
    seed: int,
    mark: str,
    workdir: Path | None,
    progress: Callable[[float], None] | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return words (M + 6 P + S, budget) of texels, probe directions and surfels, which probes (P,) lie in the open, and how many
    rays each item of the clusters' lists was seen by.

    Batches found in `workdir` are not cast again.
    """  # fmt: skip
    rays, budget = params.rays_per_texel, params.clusters_per_texel
    height = max(1, RAYS_AT_ONCE // rays)
    directions = np.tile(AXES, (probes.total, 1))
    in_space = make_origins(np.repeat(probes.positions(), 6, axis=0), directions, directions)
    probe_starts = np.arange(6 * probes.total + 1)
    surfel_starts = np.arange(len(surfels.p) + 1) * surfels.samples.shape[1]
    parts = [
        (origins, texels.starts, texels.points, len(texels.slot), seed),
        (in_space, probe_starts, probe_starts[:-1], 6 * probes.total, seed + 7919),
        (origins, surfel_starts, surfels.samples.ravel(), len(surfels.p), seed + 104729),
    ]
    batches = [(part, at, min(at + height, part[3])) for part in parts for at in range(0, part[3], height)]
    found, seen = [], np.zeros(len(refiner.lists.items), np.int64)
    for number, ((source, starts, points, _, shift), first, last) in enumerate(batches):
        file = None if workdir is None else Path(workdir) / f"lightmap-{mark}-{seed}-{number:05d}.npz"
        batch = _read_batch(file, (last - first, budget), len(seen))
        if batch is None:
            leaf = cast_rows(still, tables, leaves, source, starts, points, (first, last), rays, shift)
            if params.visibility == "form-factor" and source is origins:
                place = points[np.minimum(starts[first:last], max(len(points) - 1, 0))]
                keys, weight = weigh_by_form_factor(leaf, tree, surfels, source, place, rays)
                batch = refiner.refine_sorted(keys, weight, last - first)
            else:
                batch = refiner.refine(leaf)
            _write_batch(file, batch)
        found.append(batch[0])
        seen += batch[1]
        if progress is not None:
            progress((number + 1) / len(batches))
    words = np.concatenate(found)
    # The void is the last leaf: nothing else is behind geometry.
    void = words >> HIT_BITS == leaves.void
    lost = np.where(void, words & ((1 << HIT_BITS) - 1), 0).sum(axis=1)[
        len(texels.slot) : len(texels.slot) + 6 * probes.total
    ]
    sky = not leaves.sky_resolution
    fine = np.ones(probes.total, bool) if sky else lost.reshape(-1, 6).mean(axis=1) < INSIDE * rays
    return words, fine, seen


def fill_rows(words: np.ndarray, atlas: Atlas, texels: Texels, fine: np.ndarray) -> None:
    """Give each texel inside geometry the row of the nearest fine one of its chart; charts without one stay black."""
    bare, good = np.flatnonzero(~fine), np.flatnonzero(fine)
    words[bare] = 0
    if not len(bare) or not len(good):
        return
    far = 4.0 * (atlas.width + atlas.height)
    places = np.column_stack([texels.slot % atlas.width, texels.slot // atlas.width, texels.chart * far])
    distance, index = KDTree(places[good]).query(places[bare], distance_upper_bound=0.5 * far)
    found = np.isfinite(distance)
    words[bare[found]] = words[good[index[found]]]


Batch = tuple[np.ndarray, np.ndarray]
"""Words, and the rays that each item of the clusters' lists was seen by."""


def _read_batch(file: Path | None, shape: tuple[int, int], items: int) -> Batch | None:
    """Return a batch that an earlier bake left; None where there is none, or a damaged one."""
    if file is None or not file.exists():
        return None
    try:
        with np.load(file) as held:
            words, seen = held["words"], held["seen"]
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
        return None
    return (words, seen) if words.shape == shape and len(seen) == items else None


def _write_batch(file: Path | None, batch: Batch) -> None:
    if file is None:
        return
    beside = file.with_name(f".{file.name}.{os.getpid()}.npz")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        np.savez(beside, words=batch[0], seen=batch[1])
        os.replace(beside, file)
    except OSError as error:
        beside.unlink(missing_ok=True)
        raise LuxelError(f"'{file}' cannot be written: {error.strerror or error}") from None
