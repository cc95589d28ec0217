"""Cache items in open space, drawn as balls in their scene, which hides those behind it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.errors import LuxelError
from luxel.inspect.looks.shot import Shot
from luxel.kernels.camera import Pinhole, camera_ray
from luxel.kernels.film import TILE, Film
from luxel.kernels.octahedral import direction_to_square
from luxel.scene.arrays import from_numpy, vectors_from_numpy

RIM = 0.35
"""Brightness of a ball's rim where its colours are no light of their own."""
NONE = 0xFFFFFFFF
"""Number of no ball."""
OUTLINE = 0.3
"""How far the rim of a lit ball still faces the eye: what faces it less is dark, so that balls stand out."""


def paint_spheres(
    shot: Shot,
    data: Mapping[str, Any],
    ground: np.ndarray,
    *,
    paint: Callable[[np.ndarray], np.ndarray] | None = None,
    radius: float | None = None,
) -> np.ndarray:
    """Return `ground` (H, W, 3) with the balls of a view of kind `spheres` over it, ready to be shown, 0..1.

    `data` is the view's. `paint` turns what its atlas holds at each pixel, (H, W, 3), to displayed colours, which are
    shown as they are within a dark outline; without it the atlas holds displayed colours, and the balls are shaded.
    `radius` is in metres; None takes the view's. Raises LuxelError for a radius that is not above 0.
    """
    size = float(data["radius"]) if radius is None else float(radius)
    if not 0.0 < size < np.inf:
        raise LuxelError(f"a radius of {size} m cannot be drawn: give one above 0")
    if not len(data["p"]):
        return ground
    found = _cast_at_spheres(data, size, shot.film, shot.camera, shot.gbuffer.depth)
    color, hit, facing = (shot.film.to_image(value) for value in found)
    if paint is not None:
        color, shade = paint(color), np.clip(facing / OUTLINE, 0.0, 1.0) ** 2
    else:
        shade = RIM + (1.0 - RIM) * facing
    color = np.clip(color, 0.0, 1.0) * shade[..., None]
    return np.where(hit.astype(bool)[..., None], color, ground).astype(np.float32)


@dataclass
class Lists:
    """Which balls may be seen through each tile of the film."""

    starts: mi.UInt32
    """(tiles + 1): tile t owns items starts[t] .. starts[t + 1]."""
    items: mi.UInt32


def _list_by_tile(centers: np.ndarray, radius: float, film: Film, camera: Pinhole) -> Lists:
    """Return the balls of each tile by the box around their outline in the image."""
    low, high, seen = _outline_tiles(centers, radius, film, camera)
    numbers = np.nonzero(seen)[0]
    first, spans = low[:, numbers], (high - low + 1)[:, numbers]
    # One entry a ball and tile, then sorted by tile.
    each = spans[0] * spans[1]
    ball = np.repeat(np.arange(len(numbers)), each)
    step = np.arange(len(ball)) - np.repeat(np.cumsum(each) - each, each)
    tile = first[0, ball] + step % spans[0, ball] + film.tiles_x * (first[1, ball] + step // spans[0, ball])
    order = np.argsort(tile, kind="stable")
    starts = np.searchsorted(tile[order], np.arange(film.tiles_x * film.tiles_y + 1))
    items = np.append(numbers[ball[order]], 0)
    return Lists(from_numpy(mi.UInt32, starts), from_numpy(mi.UInt32, items))


def _outline_tiles(
    centers: np.ndarray, radius: float, film: Film, camera: Pinhole
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the first and last tile column and row of each ball, (2, N) int64, and whether it is in view at all.

    In the plane of depth and one image axis a ball's two tangents through the eye bound it.
    """
    eye, right, up, forward, across, upwards = (
        np.array(v).reshape(3).astype(np.float64) for v in vars(camera).values()
    )
    orthographic = across.any()
    if orthographic:
        right, up = across, upwards
    offset = centers.astype(np.float64) - eye
    z = offset @ forward
    low, high = np.zeros((2, len(z)), np.int64), np.zeros((2, len(z)), np.int64)
    for axis, (side, pixels, count) in enumerate(((right, film.width, film.tiles_x), (-up, film.height, film.tiles_y))):
        half = np.linalg.norm(side)
        x = offset @ side / half
        reach = radius * np.sqrt(np.maximum(x**2 + z**2 - radius**2, 0.0))
        beyond = np.maximum(z**2 - radius**2, 1e-12)
        # A ball around the eye's own plane may be anywhere in the image.
        near = z <= radius
        edges = [np.where(near, sign * 1e6, (x * z + sign * reach) / beyond) for sign in (-1.0, 1.0)]
        if orthographic:
            edges = [x - radius, x + radius]
        places = [(np.clip(edge / half, -1e6, 1e6) * 0.5 + 0.5) * pixels / TILE for edge in edges]
        low[axis] = np.maximum(np.floor(places[0]), 0)
        high[axis] = np.minimum(np.floor(places[1]), count - 1)
    return low, high, (z > -radius) & (low <= high).all(axis=0)


@dr.syntax
def _nearest_sphere(
    centers: mi.Point3f,
    radius: mi.Float,
    lists: Lists,
    tile: mi.UInt32,
    eye: mi.Point3f,
    direction: mi.Vector3f,
    farthest: mi.Float,
) -> tuple[mi.Float, mi.UInt32]:
    """Return distance and number of the first ball along each ray; `farthest` and NONE where there is none."""
    t, found = mi.Float(farthest), mi.UInt32(NONE)
    item = dr.gather(mi.UInt32, lists.starts, tile)
    end = dr.gather(mi.UInt32, lists.starts, tile + 1)
    while item < end:
        index = dr.gather(mi.UInt32, lists.items, item)
        away = dr.gather(mi.Point3f, centers, index) - eye
        along = dr.dot(away, direction)
        # Square of the ray's distance from the middle without cancellation (Haines et al. 2019, chapter 7).
        inside = dr.square(radius) - dr.squared_norm(away - along * direction)
        entry = along - dr.sqrt(dr.fmax(inside, 0.0))
        nearer = (inside > 0.0) & (entry > 0.0) & (entry < t)
        t = dr.select(nearer, entry, t)
        found = dr.select(nearer, index, found)
        item += 1
    return t, found


def _cast_at_spheres(
    data: Mapping[str, Any], radius: float, film: Film, camera: Pinhole, depth: mi.Float
) -> tuple[mi.Color3f, mi.Bool, mi.Float]:
    """Return for each lane the colour of the sphere it sees, whether it sees one, and how far that faces the eye."""
    centers = vectors_from_numpy(mi.Point3f, data["p"])
    atlas = np.ascontiguousarray(data["atlas"], np.float32)
    lane = dr.arange(mi.UInt32, film.lane_count)
    column, row, inside = film.pixel_of_lane(lane)
    x = (mi.Float(column) + 0.5) * (2.0 / film.width) - 1.0
    y = 1.0 - (mi.Float(row) + 0.5) * (2.0 / film.height)
    eye, direction = camera_ray(camera, x, y)
    lists = _list_by_tile(data["p"], radius, film, camera)
    size = dr.opaque(mi.Float, radius)
    t, index = _nearest_sphere(centers, size, lists, lane // TILE**2, eye, direction, from_numpy(mi.Float, depth))
    hit = inside & (index != NONE)
    normal = dr.normalize(eye + t * direction - dr.gather(mi.Point3f, centers, index, hit))

    # Show the texel itself: what blurs between texels would hide what the cache holds.
    resolution = atlas.shape[1]
    place = mi.Point2i((direction_to_square(normal) * 0.5 + 0.5) * resolution)
    place = dr.clip(place, 0, resolution - 1)
    texel = index * resolution**2 + mi.UInt32(place.x + resolution * place.y)
    color = dr.gather(mi.Color3f, from_numpy(mi.Float, atlas), texel, hit)
    return color, hit, dr.select(hit, dr.clip(-dr.dot(normal, direction), 0.0, 1.0), 0.0)
