"""All rows of the transport, batch by batch: cast, refine, keep on disk; then fill the rows of buried texels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from luxel.methods.base import Progress
from luxel.methods.lightmap.bake.checkpoint import read_checkpoint, write_checkpoint
from luxel.methods.lightmap.bake.form_factor import weigh_by_form_factor
from luxel.methods.lightmap.bake.probe_grid import AXES, INSIDE, ProbeGrid
from luxel.methods.lightmap.bake.refine import Refiner
from luxel.methods.lightmap.bake.surfels import BakedSurfels
from luxel.methods.lightmap.bake.visibility import Leaves, cast_rows
from luxel.methods.lightmap.bake.words import HIT_BITS
from luxel.methods.lightmap.flatten.atlas import Atlas, Texels
from luxel.methods.lightmap.flatten.flat_scene import FlatScene
from luxel.methods.lightmap.flatten.nearest import find_nearest
from luxel.methods.lightmap.flatten.origins import RAYS_AT_ONCE, Origins, make_origins
from luxel.methods.lightmap.flatten.tables import AtlasTables
from luxel.scene.device import Scene

Batch = tuple[np.ndarray, np.ndarray]
"""Words, and the rays that each item of the clusters' lists was seen by."""


@dataclass
class RowCaster:
    """What a batch of rows needs."""

    still: Scene
    tables: AtlasTables
    leaves: Leaves
    refiner: Refiner
    rays: int
    by_form_factor: bool


@dataclass
class Part:
    """Rows of one kind: row m casts from the origins points[starts[m]:starts[m + 1]]."""

    origins: Origins
    starts: np.ndarray
    points: np.ndarray
    seed: int
    is_texels: bool = False


def cast_all_rows(
    caster: RowCaster, flat: FlatScene, probes: ProbeGrid, surfels: BakedSurfels, seed: int, mark: str,
    workdir: Path | None, report: Progress,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Return the words (M + 6 P + S, budget) of texels, probe directions and surfels, and how many rays each item of
    the clusters' lists was seen by.

    Batches found in `workdir` are not cast again; `mark` tells bakes apart.
    """
    height = max(1, RAYS_AT_ONCE // caster.rays)
    batches = [
        (part, at, min(at + height, len(part.starts) - 1))
        for part in _list_parts(flat, probes, surfels, seed)
        for at in range(0, len(part.starts) - 1, height)
    ]
    report("casting rays", 0.0)
    found, seen = [], np.zeros(len(caster.refiner.lists.items), np.int64)
    for number, (part, first, last) in enumerate(batches):
        file = None if workdir is None else Path(workdir) / f"lightmap-{mark}-{seed}-{number:05d}.npz"
        batch = _read_batch(file, (last - first, caster.refiner.budget), len(seen))
        if batch is None:
            batch = _cast_batch(caster, part, first, last, surfels)
            write_checkpoint(file, words=batch[0], seen=batch[1])
        found.append(batch[0])
        seen += batch[1]
        report("casting rays", (number + 1) / len(batches))
    return np.concatenate(found), seen


def _list_parts(flat: FlatScene, probes: ProbeGrid, surfels: BakedSurfels, seed: int) -> list[Part]:
    """Return the rows of texels, of the probes' directions and of surfels, in the order of their words."""
    directions = np.tile(AXES, (probes.total, 1))
    in_space = make_origins(np.repeat(probes.positions(), 6, axis=0), directions, directions)
    each = np.arange(6 * probes.total + 1)
    surfel_starts = np.arange(len(surfels.p) + 1) * surfels.samples.shape[1]
    return [
        Part(flat.origins, flat.texels.starts, flat.texels.points, seed, is_texels=True),
        Part(in_space, each, each[:-1], seed + 7919),
        Part(flat.origins, surfel_starts, surfels.samples.ravel(), seed + 104729),
    ]


def _cast_batch(caster: RowCaster, part: Part, first: int, last: int, surfels: BakedSurfels) -> Batch:
    leaf = cast_rows(
        caster.still, caster.tables, caster.leaves, part.origins, part.starts, part.points,
        (first, last), caster.rays, part.seed,
    )  # fmt: skip
    if not (caster.by_form_factor and part.is_texels):
        return caster.refiner.refine(leaf)
    place = part.points[np.minimum(part.starts[first:last], max(len(part.points) - 1, 0))]
    return caster.refiner.refine(
        *weigh_by_form_factor(leaf, caster.refiner.tree, surfels, part.origins, place, caster.rays)
    )


def find_open_probes(words: np.ndarray, count: int, caster: RowCaster) -> np.ndarray:
    """Return which probes (P,) lie in the open, from the rows of their directions, which `words` starts with."""
    if not caster.leaves.sky_resolution:
        # Without a sky the void also stands for rays that leave the scene, and says nothing.
        return np.ones(count, bool)
    rows = words[: 6 * count]
    lost = np.where(rows >> HIT_BITS == caster.leaves.void, rows & ((1 << HIT_BITS) - 1), 0).sum(axis=1)
    return lost.reshape(-1, 6).mean(axis=1) < INSIDE * caster.rays


def fill_rows(words: np.ndarray, atlas: Atlas, texels: Texels, fine: np.ndarray) -> None:
    """Give each texel inside geometry the row of the nearest fine one of its chart; charts without one stay black."""
    bare, good = np.flatnonzero(~fine), np.flatnonzero(fine)
    words[bare] = 0
    places = np.column_stack([texels.slot % atlas.width, texels.slot // atlas.width])
    index = find_nearest(places[good], texels.chart[good], places[bare], texels.chart[bare])[:, 0]
    words[bare[index >= 0]] = words[good[index[index >= 0]]]


def _read_batch(file: Path | None, shape: tuple[int, int], items: int) -> Batch | None:
    """Return a batch that an earlier bake left, None where there is none of this shape."""
    held = read_checkpoint(file, "words", "seen")
    if held is None or held[0].shape != shape or len(held[1]) != items:
        return None
    return held[0], held[1]
