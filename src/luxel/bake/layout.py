"""Where a bake's texels lie: the still surfaces laid flat in the atlas, and the points that each texel averages."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.errors import LuxelError
from luxel.kernels.records import Surface
from luxel.kernels.surface import surface_at
from luxel.methods.lightmap.flatten.atlas import Texels
from luxel.methods.lightmap.flatten.flat_scene import FlatScene
from luxel.methods.lightmap.flatten.nearest import find_nearest
from luxel.methods.lightmap.flatten.octaves import on_triangle
from luxel.scene.arrays import from_numpy, vectors_from_numpy
from luxel.scene.device import Scene
from luxel.scene.model import SceneData

NAMED = 4
"""Objects that one warning names."""


@dataclass
class Layout:
    """F faces, M texels, P points. Atlas coordinates are in texels; texel (i, j) has its middle at (i, j)."""

    width: int
    height: int
    texel_size: float
    """Metres."""
    prim: np.ndarray
    """(F,) triangle of the scene."""
    back: np.ndarray
    """(F,) bool: the triangle's back."""
    uv: np.ndarray
    """(F, 3, 2) of the triangle's corners."""
    chart: np.ndarray
    """(F,); -1: not in the atlas."""
    normal: np.ndarray
    """(F, 3) unit, on the face's side."""
    slot: np.ndarray
    """(M,) y * width + x."""
    starts: np.ndarray
    """(M + 1,): texel m averages the points starts[m] .. starts[m + 1]."""
    source: np.ndarray
    """(M,) texel whose light each takes: itself, or the nearest of its chart where all its points lie inside things."""
    open: np.ndarray
    """(M,) bool: some point of the texel lies in the open, not inside things."""
    face: np.ndarray
    """(P,)."""
    weights: np.ndarray
    """(P, 3) of the face's corners."""
    inside: np.ndarray
    """(F, 3, 3) the face's corners by the weights of its triangle's; (0, 3, 3): faces are whole triangles."""

    def at_corners(self, face: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return values (n, 3, C) at the corners of faces `face` (n,), given those at their triangles' corners."""
        return self.inside[face] @ values if len(self.inside) else values

    def points(self, first: int, last: int, scene: Scene) -> Surface:
        """Return the points first .. last as surfaces of `scene`, seen from the face's side."""
        face = self.face[first:last]
        weights = on_triangle(self.inside, face, self.weights[first:last])
        place = vectors_from_numpy(mi.Point2f, weights[:, 1:])
        side = vectors_from_numpy(mi.Vector3f, self.normal[face])
        prim = from_numpy(mi.UInt32, self.prim[face])
        return surface_at(scene, prim, place, dr.full(mi.Bool, True, last - first), wo=side)


def leave_still(data: SceneData) -> SceneData:
    """Return the scene without what moves, with a warning that names it. Raises LuxelError where everything does."""
    objects = [item for item in data.objects if item.motion is None and item.deform is None]
    if data.objects and not objects:
        raise LuxelError(f"{data.name}: everything moves, so there is no still surface to bake light for")
    if len(objects) == len(data.objects):
        return data
    moving = [f"'{item.name}'" for item in data.objects if item.motion is not None or item.deform is not None]
    named = ", ".join(moving[:NAMED]) + (f" and {len(moving) - NAMED} more" if len(moving) > NAMED else "")
    warning = f"What moves is left out of the bake: {named}."
    return replace(data, objects=objects, duration=0.0, warnings=[*data.warnings, warning])


def make_layout(flat: FlatScene) -> Layout:
    """Return what a finished bake needs to know of a scene laid flat."""
    faces, atlas, points, texels = flat.faces, flat.atlas, flat.points, flat.texels
    open_point = flat.in_open[texels.points]
    owner = np.repeat(np.arange(len(texels.slot)), np.diff(texels.starts))
    return Layout(
        width=atlas.width, height=atlas.height, texel_size=float(atlas.texel_size), prim=faces.prim, back=faces.back,
        uv=atlas.uv.astype(np.float32), chart=atlas.chart.astype(np.int32), normal=faces.normal.astype(np.float32),
        slot=texels.slot, starts=texels.starts, source=_find_sources(texels, atlas.width),
        open=np.bincount(owner, weights=open_point, minlength=len(texels.slot)) > 0,
        face=points.face[texels.points].astype(np.int32), weights=points.weights[texels.points].astype(np.float32),
        inside=faces.inside,
    )  # fmt: skip


def _find_sources(texels: Texels, width: int) -> np.ndarray:
    """Return the texel (M,) whose light each takes: one without points takes that of the nearest of its chart."""
    source = np.arange(len(texels.slot))
    full = np.flatnonzero(np.diff(texels.starts) > 0)
    bare = np.flatnonzero(np.diff(texels.starts) == 0)
    places = np.column_stack([texels.slot % width, texels.slot // width])
    index = find_nearest(places[full], texels.chart[full], places[bare], texels.chart[bare])[:, 0]
    source[bare[index >= 0]] = full[index[index >= 0]]
    return source


def layout_arrays(layout: Layout) -> dict[str, Any]:
    """Return the layout's fields by name, for a file."""
    return {item.name: getattr(layout, item.name) for item in fields(Layout)}


def layout_from(arrays: dict[str, np.ndarray]) -> Layout:
    """Return the layout that `layout_arrays` took apart. Raises LuxelError where a part is missing."""
    values: dict[str, Any] = {}
    for item in fields(Layout):
        if item.name not in arrays:
            raise LuxelError(f"the bake is of another version of luxel: it lacks '{item.name}'; bake the scene anew")
        value = arrays[item.name]
        values[item.name] = value.item() if value.ndim == 0 else value
    return Layout(**values)
