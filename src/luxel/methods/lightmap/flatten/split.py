"""Triangles that lie in several charts, one for each octave of distance: which one a point of theirs lies in."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.methods.lightmap.flatten.octaves import NEAR
from luxel.scene.arrays import from_numpy
from luxel.scene.triangles import Box

SPLIT = 0x80000000
"""Bit that tells the number of a split triangle from that of a face."""


@dataclass
class Split:
    """S sides of split triangles, on the host."""

    face: np.ndarray
    """(S, K) uint32: a face of each octave, or of the nearest that the triangle has."""
    corners: np.ndarray
    """(S, 3, 3) world positions."""
    bounds: np.ndarray
    """(2, 3) lower and upper corner of what octaves are counted from."""


@dataclass
class SplitTables:
    """The same on the device."""

    face: mi.UInt32
    """(S, K)."""
    corners: mi.Float
    """(S, 12): the corners from the middle of the bounds, three words each and one spare."""
    half: mi.Vector3f
    """Half the bounds' sides."""
    inverse_size: mi.Float
    """One over their diagonal."""
    octaves: int


def find_split(
    prim: np.ndarray, back: np.ndarray, octave: np.ndarray, area: np.ndarray, whole: np.ndarray, bounds: Box
) -> tuple[Split, np.ndarray]:
    """Return the table of parts (n,) by the sides of triangles that they belong to, and which side (n,) that is.

    Of several parts in one octave the largest stands for all: they lie in one chart.
    """
    _, first, side = np.unique(2 * prim + back, return_index=True, return_inverse=True)
    face = np.full((len(first), int(octave.max(initial=0)) + 1), -1, np.int64)
    order = np.argsort(area, kind="stable")
    face[side[order], octave[order]] = order
    steps = np.arange(face.shape[1])
    for row in face:
        held = np.flatnonzero(row >= 0)
        row[:] = row[held[np.abs(steps[:, None] - held).argmin(axis=1)]]
    return Split(face.astype(np.uint32), whole[first], np.stack([bounds.lower, bounds.upper])), side


def upload_split(split: Split) -> SplitTables | None:
    """Return the device's tables; None where no triangle is split."""
    if not len(split.face):
        return None
    middle, half = split.bounds.mean(axis=0), 0.5 * (split.bounds[1] - split.bounds[0])
    rows = np.zeros((len(split.corners), 3, 4), np.float32)
    rows[:, :, :3] = split.corners - middle
    return SplitTables(
        face=from_numpy(mi.UInt32, split.face),
        corners=from_numpy(mi.Float, rows),
        half=mi.Vector3f(*(dr.opaque(mi.Float, float(value)) for value in half)),
        inverse_size=dr.opaque(mi.Float, 0.5 / max(float(np.linalg.norm(half)), 5e-10)),
        octaves=split.face.shape[1],
    )


def face_at(split: SplitTables, number: mi.UInt32, barycentric: mi.Point2f, active: mi.Bool) -> mi.UInt32:
    """Return the face that points of split triangles `number` lie in: `octaves.measure_octaves` on the device."""
    a, b, c = (dr.gather(mi.Vector4f, split.corners, 3 * number + i, active) for i in range(3))
    p = a * (1.0 - barycentric.x - barycentric.y) + b * barycentric.x + c * barycentric.y
    away = dr.fmax(dr.fmax(dr.abs(p.x) - split.half.x, dr.abs(p.y) - split.half.y), dr.abs(p.z) - split.half.z)
    octave = dr.ceil(dr.log2(dr.fmax(away, 0.0) * split.inverse_size + (1.0 - NEAR)))
    step = mi.UInt32(dr.clip(octave, 0.0, split.octaves - 1.0))
    return dr.gather(mi.UInt32, split.face, number * split.octaves + step, active)
