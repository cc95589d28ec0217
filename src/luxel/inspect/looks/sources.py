"""Where the light of one point comes from: each item of the cache that lights it, in a colour of its own."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from luxel.inspect.looks.frame import NOTHING, Drawn, Span, as_color, backdrop, shaded
from luxel.inspect.looks.legend import Legend
from luxel.inspect.looks.shot import Shot
from luxel.inspect.ramps import id_colors
from luxel.kernels.camera import project
from luxel.methods.inspect import Look, inspector_of

LIGHTEST = 0.5
"""Brightness of the colour of an item that brings next to nothing; that of the heaviest ones is 1."""
HEAVIEST = 0.9
"""Share of the coloured pixels that are no brighter than an item's full colour."""
SEAM = 0.45
"""Brightness of a pixel where one item ends and another begins."""
RING, RIM = 0.018, 0.004
"""Radius and width of the ring around the chosen point, over the picture's diagonal."""
RING_LEAST, RIM_LEAST = 5.0, 1.5
"""Pixels that they have at least."""
WHITE, DARK = np.ones(3, np.float32), 0.3 * NOTHING


def draw_sources(shot: Shot, look: Look, span: Span) -> Drawn:
    """Return the items that light the shot's point: brighter is heavier; what it does not see stays grey."""
    told = inspector_of(shot.method).sources(shot.scene, shot.state, shot.chosen_point, shot.gbuffer.surface)
    film, hit = shot.film, shot.layers.hit
    item, share, marked = (film.to_image(value) for value in (told.item, told.share, told.marked))
    answered = film.to_image(told.answered).astype(bool)
    colors = id_colors(item)
    colors = np.where(hit[..., None], shaded(colors, shot), colors)
    # Items differ in weight by a factor of ten and more: the square root keeps the light ones in sight.
    most = float(np.quantile(share[answered], HEAVIEST)) if answered.any() else 1.0
    heavy = np.sqrt(np.minimum(share / max(most, 1e-9), 1.0))[..., None]
    colors = colors * (LIGHTEST + (1.0 - LIGHTEST) * heavy)
    image = np.where(answered[..., None], colors, backdrop(shot))
    image = np.where((_find_seams(item, answered) & ~marked.astype(bool))[..., None], SEAM * image, image)
    image = np.where((marked.astype(bool) & hit)[..., None], WHITE, image)
    entries = tuple((name, as_color(id_colors(np.array(number)))) for name, number in told.heaviest)
    return _ring_point(image, shot).astype(np.float32), Legend(told.words, entries=entries)


def _find_seams(item: np.ndarray, answered: np.ndarray) -> np.ndarray:
    """Return the pixels (H, W) whose right or lower neighbour belongs to another item."""
    number = np.where(answered, item.astype(np.int64), -1)
    seams = np.zeros(number.shape, bool)
    seams[:, :-1] |= number[:, :-1] != number[:, 1:]
    seams[:-1] |= number[:-1] != number[1:]
    return seams & answered


def _ring_point(image: np.ndarray, shot: Shot) -> np.ndarray:
    """Draw a white ring with dark edges around the chosen point, if it lies in front of the eye."""
    height, width = image.shape[:2]
    x, y, in_front = (np.array(value).ravel()[0] for value in project(shot.camera, mi.Point3f(shot.chosen_point.p)))
    if not (in_front and np.array(shot.chosen_point.active).ravel()[0]):
        return image
    column, row = (0.5 + 0.5 * x) * width - 0.5, (0.5 - 0.5 * y) * height - 0.5
    diagonal = float(np.hypot(width, height))
    radius, rim = max(RING_LEAST, RING * diagonal), max(RIM_LEAST, RIM * diagonal)
    reach = radius + rim + 1.0
    (top, bottom), (left, right) = (
        np.clip((int(middle - reach), int(middle + reach) + 2), 0, most)
        for middle, most in ((row, height), (column, width))
    )
    rows, columns = np.mgrid[top:bottom, left:right]
    away = np.abs(np.hypot(columns - column, rows - row) - radius)
    part = image[top:bottom, left:right]
    for half, color in ((rim, DARK), (0.5 * rim, WHITE)):
        cover = np.clip(0.5 + half - away, 0.0, 1.0)[..., None]
        part = cover * color + (1.0 - cover) * part
    image[top:bottom, left:right] = part
    return image
