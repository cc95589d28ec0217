"""What a click leaves in the scene: the point, and the cache items that light it, as discs or as dots."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from viser import SceneApi

from luxel.inspect.explanation import Explanation
from luxel.inspect.ramps import id_colors
from luxel.kernels.trace import trace_occluded
from luxel.methods.inspect import Contribution, Discs
from luxel.scene.arrays import from_numpy, vectors_from_numpy
from luxel.scene.device import Scene
from luxel.scene.rounding import STEP

DRAWN = 64
"""Dots at most."""
LINED = 12
"""Heaviest items of discs that a line leads to: those that the list names."""
CORNERS = 14
DISC_SHARE = 0.86
"""Radius that a disc is drawn with, in its own: discs of one area with their cells would overlap."""
LIFT = 0.3
"""Height above a disc of the point that the eye looks for, in its radii."""
POINT_SIZE = 0.0015
"""Of dots, over the scene's diagonal."""
DISPLAY_POWER = 2.2
"""viser takes the colours of many meshes as linear light, which a display shows by this power."""
LEAST_BRIGHT = 0.5
"""Brightness of discs that bring next to nothing."""
ANSWERED, SILENT, POINT = (240, 170, 60), (150, 90, 90), (90, 200, 250)


class Markers:
    """Markers in one visitor's scene. Discs that something hides from the eye are left out, as `find_visible` says."""

    def __init__(self, scene: SceneApi, diagonal: float) -> None:
        """`diagonal` is that of the scene's box, metres."""
        self._scene = scene
        self._unit = POINT_SIZE * diagonal
        self._handles: list[Any] = []
        self._mesh: Any = None
        self._origin = np.zeros(3)
        self.discs: Discs | None = None
        """Those that are drawn."""

    def draw(
        self, found: Explanation, discs: Discs | None, visible: np.ndarray | None, origin: np.ndarray | None = None
    ) -> None:
        """Draw what lights the point of `found`, in place of what was drawn before.

        `origin` (3,) is where the browser measures from in the file's coordinates; `discs` are measured from there.
        """
        self.clear()
        if found.position is None:
            return
        self._origin = np.zeros(3) if origin is None else origin
        point = np.asarray(found.position) - self._origin
        ball = self._scene.add_icosphere("/explain/point", 2.0 * self._unit, color=POINT, position=tuple(point))
        self._handles.append(ball)
        placed = [item for item in found.contributions if item.p is not None]
        if discs is not None and visible is not None:
            self._draw_discs(found, discs, visible)
            placed = placed[:LINED]
            colors = np.array([item_color(item) for item in placed], np.uint8)
        else:
            placed = placed[:DRAWN]
            colors = np.array([ANSWERED if item.answers else SILENT for item in placed], np.uint8)
        if placed:
            self._draw_dots(point, placed, colors)

    def show(self, shown: bool) -> None:
        """Show or hide all of them."""
        for handle in self._handles:
            if handle.visible != shown:
                handle.visible = shown

    def show_discs(self, discs: Discs, visible: np.ndarray) -> None:
        """Show those of `discs` that are `visible` (N,), if they are still the ones that are drawn."""
        if discs is self.discs:
            self._mesh.batched_scales = _scales(discs, visible)

    def clear(self) -> None:
        """Take all of them away."""
        for handle in self._handles:
            handle.remove()
        self._handles, self._mesh, self.discs = [], None, None

    def _draw_dots(self, point: np.ndarray, items: list[Contribution], colors: np.ndarray) -> None:
        """Draw a dot an item, and lines from the point to those that answer."""
        places = (np.asarray([item.p for item in items], np.float64) - self._origin).astype(np.float32)
        size = 2.0 * self._unit
        self._handles.append(
            self._scene.add_point_cloud("/explain/items", places, colors, point_size=size, point_shape="circle")
        )
        answered = np.asarray([item.answers for item in items])
        if answered.any():
            ends = np.stack([np.broadcast_to(point, places.shape), places], axis=1).astype(np.float32)[answered]
            tints = np.repeat(colors[answered][:, None], 2, axis=1)
            self._handles.append(
                self._scene.add_line_segments("/explain/lines", ends, tints, thickness=1.5, thickness_units="screen")
            )

    def _draw_discs(self, found: Explanation, discs: Discs, visible: np.ndarray) -> None:
        """Draw the items' discs in their colours, heavier ones brighter."""
        weights = {item.item: item.weight for item in found.contributions}
        weight = np.array([weights[item] for item in discs.item.tolist()])
        heavy = np.sqrt(weight / weight.max())[:, None]
        colors = id_colors(discs.item) * (LEAST_BRIGHT + (1.0 - LEAST_BRIGHT) * heavy)
        corners, faces = unit_disc()
        self.discs = discs
        self._mesh = self._scene.add_batched_meshes_simple(
            "/explain/discs",
            corners,
            faces,
            batched_wxyzs=turn_to_normals(discs.n),
            batched_positions=discs.p.astype(np.float32),
            batched_scales=_scales(discs, visible),
            batched_colors=np.rint(255.0 * colors**DISPLAY_POWER).astype(np.uint8),
            side="front",
            lod="off",
            cast_shadow=False,
            receive_shadow=False,
        )
        self._handles.append(self._mesh)


def find_visible(scene: Scene, eye: tuple[float, float, float], discs: Discs) -> np.ndarray:
    """Return which discs (N,) the eye, in the file's coordinates, sees the middle of. On the render thread."""
    # A surfel's middle lies within what is round: it is looked for a little above.
    place = np.asarray(eye, np.float64) - scene.host.origin
    targets = (discs.p + LIFT * discs.radius[:, None] * discs.n - place).T.astype(np.float32)
    distance = np.maximum(np.linalg.norm(targets, axis=0), 1e-9)
    direction = vectors_from_numpy(mi.Vector3f, (targets / distance).T)
    width = len(distance)
    origin = mi.Point3f(*(dr.full(mi.Float, float(axis), width) for axis in place))
    reach = from_numpy(mi.Float, distance) * (1.0 - 2.0 * STEP)
    hidden = trace_occluded(scene, origin, direction, reach, dr.full(mi.Bool, True, width))
    return ~np.array(hidden)


def _scales(discs: Discs, visible: np.ndarray) -> np.ndarray:
    return np.where(visible, DISC_SHARE * discs.radius, 0.0).astype(np.float32)


def item_color(item: Contribution) -> np.ndarray:
    """Return the colour (3,) uint8 that an item has in looks, and as discs."""
    return np.rint(255.0 * id_colors(np.array(item.item))).astype(np.uint8)


def unit_disc() -> tuple[np.ndarray, np.ndarray]:
    """Return corners (CORNERS, 3) and triangles of a disc of radius 1 that faces +Z."""
    angle = 2.0 * np.pi * np.arange(CORNERS) / CORNERS
    corners = np.stack([np.cos(angle), np.sin(angle), np.zeros(CORNERS)], axis=1).astype(np.float32)
    steps = np.arange(1, CORNERS - 1)
    return corners, np.stack([np.zeros_like(steps), steps, steps + 1], axis=1).astype(np.uint32)


def turn_to_normals(normals: np.ndarray) -> np.ndarray:
    """Return the shortest turns of +Z to unit `normals` (N, 3), as quaternions wxyz (N, 4)."""
    x, y, z = normals.T
    turns = np.stack([1.0 + z, -y, x, np.zeros_like(x)], axis=1)
    length = np.linalg.norm(turns, axis=1, keepdims=True)
    half_turn = np.array([0.0, 1.0, 0.0, 0.0])
    return np.where(length > 1e-6, turns / np.maximum(length, 1e-6), half_turn).astype(np.float32)
