"""The looks that a method brings: what it reads at the pixels, its items as spheres, and its sheets."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from luxel.image.tonemap import to_display
from luxel.inspect.looks.frame import NOTHING, Drawn, Span, backdrop, draw_light, draw_number, on_surfaces, shaded
from luxel.inspect.looks.legend import Legend, fit_scale
from luxel.inspect.looks.shot import Shot
from luxel.inspect.looks.sources import draw_sources
from luxel.inspect.looks.spheres import paint_spheres
from luxel.inspect.ramps import colorize, id_colors
from luxel.methods.inspect import Look, Reading, inspector_of

Paint = Callable[[np.ndarray], np.ndarray]

DISC = 0.5
"""Radius that an item's disc is drawn with, in its own: discs that overlap in truth stand apart in the picture."""
BETWEEN = 0.72
"""Brightness of a number's colour between the discs."""
DARK = 0.55
"""Brightness of every other piece of an item."""
GAP = 2
"""Pixels between the tiles of a sheet."""
BEADS = 8
"""Small balls that draw the way from a node to its probe."""


# ---------- Readings at the pixels ----------


def _draw_number(shot: Shot, look: Look, span: Span) -> Drawn:
    reading, answered = _read(shot, look)
    ramp = "heat" if look.kind == "cost" else "field"
    image, legend = draw_number(shot.film.to_image(reading.value), answered, look, span, ramp)
    if reading.place is not None:
        image = np.where(answered[..., None], image * (BETWEEN + (1.0 - BETWEEN) * _discs(shot, reading)), image)
    return image.astype(np.float32), legend


def _draw_light(shot: Shot, look: Look, span: Span) -> Drawn:
    reading, answered = _read(shot, look)
    image, legend = draw_light(shot.film.to_image(reading.value), shot, look.doc, look.unit, 1.0 / np.pi)
    disc = _discs(shot, reading) * answered[..., None]
    return (disc * image + (1.0 - disc) * backdrop(shot)).astype(np.float32), legend


def _draw_items(shot: Shot, look: Look, span: Span) -> Drawn:
    reading, answered = _read(shot, look)
    disc = _discs(shot, reading) * answered[..., None]
    colors = shaded(id_colors(shot.film.to_image(reading.value)), shot)
    if reading.dark is not None:
        colors = np.where(shot.film.to_image(reading.dark).astype(bool)[..., None], DARK * colors, colors)
    return (disc * colors + (1.0 - disc) * backdrop(shot)).astype(np.float32), Legend(look.doc)


def _draw_mix(shot: Shot, look: Look, span: Span) -> Drawn:
    reading, answered = _read(shot, look)
    return on_surfaces(shaded(shot.film.to_image(reading.value), shot), answered), Legend(look.doc)


def _read(shot: Shot, look: Look) -> tuple[Reading, np.ndarray]:
    reading = inspector_of(shot.method).read(shot.scene, shot.state, shot.gbuffer.surface, look.name)
    return reading, shot.film.to_image(reading.answered).astype(bool) & shot.layers.hit


def _discs(shot: Shot, reading: Reading) -> np.ndarray:
    """Return how far each pixel lies on a disc, (H, W, 1) in 0..1, with rims as soft as a pixel; 1 without discs."""
    if reading.place is None or reading.radius is None:
        return np.ones((shot.film.height, shot.film.width, 1))
    width_at_one = 2.0 * float(np.linalg.norm(np.array(shot.camera.right))) / shot.film.width
    pixel = shot.film.to_image(shot.gbuffer.depth) * width_at_one / shot.film.to_image(reading.radius)
    place = shot.film.to_image(reading.place)
    with np.errstate(invalid="ignore"):
        return np.nan_to_num(np.clip(0.5 + (DISC - place) / np.maximum(pixel, 1e-6), 0.0, 1.0))[..., None]


# ---------- Views ----------


def _draw_spheres(shot: Shot, look: Look, span: Span) -> Drawn:
    data = inspector_of(shot.method).views(shot.scene, shot.state)[look.view].data
    if look.unit or look.span is not None:
        ground = to_display(shot.image, shot.exposure) if look.unit else backdrop(shot)
        paint, legend = _choose_paint(shot, look, span)
        return paint_spheres(shot, data, ground, paint=paint), legend
    if "offset" in data:
        data = _with_ways(data)
    return paint_spheres(shot, data, backdrop(shot)), Legend(look.doc, entries=tuple(data.get("names", ())))


def _draw_sheet(shot: Shot, look: Look, span: Span) -> Drawn:
    data = inspector_of(shot.method).views(shot.scene, shot.state)[look.view].data
    paint, legend = _choose_paint(shot, look, span)
    return fit_tiles([paint(tile) for tile in data["tiles"]], shot.film.height, shot.film.width), legend


def _choose_paint(shot: Shot, look: Look, span: Span) -> tuple[Paint, Legend]:
    """Return how what a view holds becomes colours, and what they mean.

    Irradiance is shown as white paper there would look, numbers by a ramp.
    """
    if look.unit:
        factor = 1.0 / np.pi
        _, legend = draw_light(np.zeros((1, 1, 3)), shot, look.doc, look.unit, factor)
        return lambda values: to_display(values, shot.exposure * factor), legend
    scale = fit_scale(np.zeros(0), look.span if span is None else span)
    return lambda values: colorize(scale.place(values[..., 0])), Legend(look.doc, look.unit, scale, "field")


def _with_ways(data: dict[str, Any]) -> dict[str, Any]:
    """Return the spheres and, along each one's `offset`, small ones in its colour."""
    moved = np.abs(data["offset"]).max(axis=1) > 0.0
    steps = np.linspace(0.0, 1.0, BEADS + 1)[1:, None, None]
    beads = (data["p"][moved] + steps * data["offset"][moved]).reshape(-1, 3)
    p = np.concatenate([data["p"], beads])
    atlas = np.concatenate([data["atlas"], np.tile(data["atlas"][moved], (BEADS, 1, 1, 1))])
    return {**data, "p": p.astype(np.float32), "atlas": atlas}


def fit_tiles(tiles: list[np.ndarray], height: int, width: int) -> np.ndarray:
    """Return displayed `tiles` (h, w, 3) in rows in the middle of a picture (height, width, 3), as large as they fit.

    Texels are repeated, or averaged where even one pixel each is too much.
    """
    scale = next((s for s in range(64, 0, -1) if _fits(tiles, s, height, width)), 0)
    if not scale:
        shrink = next((s for s in range(2, 256) if _fits(tiles, 1.0 / s, height, width)), 256)
        tiles = [_average(tile, shrink) for tile in tiles]
    tiles = [np.repeat(np.repeat(tile, max(scale, 1), axis=0), max(scale, 1), axis=1) for tile in tiles]
    picture = np.broadcast_to(NOTHING, (height, width, 3)).copy()
    places, used = _place_tiles([tile.shape[:2] for tile in tiles], width)
    top = max(0, (height - used) // 2)
    left = max(0, (width - max(x + tile.shape[1] for (_, x), tile in zip(places, tiles, strict=True))) // 2)
    for (y, x), tile in zip(places, tiles, strict=True):
        part = tile[: max(0, height - top - y), : max(0, width - left - x)]
        picture[top + y : top + y + part.shape[0], left + x : left + x + part.shape[1]] = part
    return picture.astype(np.float32)


def _fits(tiles: list[np.ndarray], scale: float, height: int, width: int) -> bool:
    sizes = [(max(1, int(tile.shape[0] * scale)), max(1, int(tile.shape[1] * scale))) for tile in tiles]
    return max(size[1] for size in sizes) <= width and _place_tiles(sizes, width)[1] <= height


def _place_tiles(sizes: list[tuple[int, int]], width: int) -> tuple[list[tuple[int, int]], int]:
    """Return the top left corner (y, x) of each tile, in rows of at most `width`, and the height of all."""
    places, x, y, tall = [], 0, 0, 0
    for high, wide in sizes:
        if x and x + wide > width:
            x, y, tall = 0, y + tall + GAP, 0
        places.append((y, x))
        x, tall = x + wide + GAP, max(tall, high)
    return places, y + tall


def _average(tile: np.ndarray, shrink: int) -> np.ndarray:
    """Return the means of `shrink` x `shrink` texels; what is left over at the far edges is dropped."""
    high, wide = max(1, tile.shape[0] // shrink), max(1, tile.shape[1] // shrink)
    part = tile[: high * shrink, : wide * shrink]
    if part.shape[:2] != (high * shrink, wide * shrink):
        return tile[:high, :wide]
    return part.reshape(high, shrink, wide, shrink, 3).mean(axis=(1, 3))


CACHE_KINDS: dict[str, Callable[[Shot, Look, Span], Drawn]] = {
    "number": _draw_number,
    "cost": _draw_number,
    "light": _draw_light,
    "item": _draw_items,
    "mix": _draw_mix,
    "spheres": _draw_spheres,
    "sheet": _draw_sheet,
    "source": draw_sources,
}
"""How each kind of a method's looks is drawn."""
