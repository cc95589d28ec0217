"""Where a point of a triangle lies in the atlas, on the device."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from luxel.methods.lightmap.flatten.faces import NONE
from luxel.methods.lightmap.flatten.split import SPLIT, SplitTables, face_at


@dataclass
class AtlasTables:
    """From a point of a triangle to its place in the atlas."""

    face_of: mi.UInt32
    """(2 T,) face of each triangle's front and back; `NONE`: not in the atlas; with `SPLIT`: which row of `split`."""
    face_uv: mi.Float
    """(F, 8): coordinates in texels of the corners of the face's whole triangle, two words spare."""
    width: int
    height: int
    split: SplitTables | None
    """None: no triangle lies in several charts."""


def find_face(
    tables: AtlasTables, prim_id: mi.UInt32, back: mi.Bool, barycentric: mi.Point2f, active: mi.Bool
) -> tuple[mi.UInt32, mi.Bool]:
    """Return the face that each point lies in, and whether there is one in the atlas."""
    active = active & (2 * prim_id < dr.width(tables.face_of))
    face = dr.gather(mi.UInt32, tables.face_of, 2 * prim_id + dr.select(back, mi.UInt32(1), 0), active)
    found = active & (face != NONE)
    if tables.split is not None:
        split = found & ((face & SPLIT) != 0)
        part = face_at(tables.split, face & (SPLIT - 1), barycentric, split)
        face = mi.UInt32(dr.select(split, part, face))
    return face, found


def locate(
    tables: AtlasTables, prim_id: mi.UInt32, back: mi.Bool, barycentric: mi.Point2f, active: mi.Bool
) -> tuple[mi.Point2f, mi.Bool]:
    """Return each point's place in the atlas, in texels, and whether it has one."""
    face, found = find_face(tables, prim_id, back, barycentric, active)
    first = dr.gather(mi.Vector4f, tables.face_uv, 2 * face, found)
    second = dr.gather(mi.Vector2f, tables.face_uv, 4 * face + 2, found)
    a = 1.0 - barycentric.x - barycentric.y
    u = a * first.x + barycentric.x * first.z + barycentric.y * second.x
    v = a * first.y + barycentric.x * first.w + barycentric.y * second.y
    return mi.Point2f(u, v), found
