"""Which radius each view asks for, and what that leaves to those surfels that only rays see.

A view's radius in pixels is its own: its screen keeps it, as pixels of two films are not the same. All views together
may take no more than one could: they share it alike. Among the sizes that several ask for the smallest wins, surfel by
surfel (`view.py`), so that whoever looks last changes nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from luxel.kernels.gbuffer import GBuffer
from luxel.kernels.records import Light
from luxel.kernels.reduce import sum_columns
from luxel.methods.gibs.params import SURFELS_PER_SQUARE_RADIUS, VIEW_SHARE
from luxel.methods.gibs.surfels import Eyes, GibsState

LEAST_PIXELS, MOST_PIXELS = 2.0, 16.0
"""Radius in pixels, where it is the view's own."""
LEAST_COSINE = 0.05
"""Pixels that see a surface at a smaller angle count as this one: they would ask for any number of surfels."""
SMOOTHING = 0.1
"""Blend of a view's radius in pixels, and of what all views take, a frame."""
MUCH_LARGER = 1.25
"""By how much a radius may rise in a frame and still be smoothed."""
MOST_APART = 8
"""Frames that a look stands for at most: as many as have passed since the view's last one."""
NO_VIEW = 0.5
"""Views, smoothed, below which nobody looks."""


@dataclass
class GibsScreen:
    """What one view has asked for."""

    pixels: mi.Float
    """Radius in pixels, smoothed unless it rises by much; 0: nothing yet."""
    looked: mi.UInt32
    """1 + the frame of its last look; 0: none."""


@dataclass
class Wish:
    """What a look at the cache asks for."""

    pixels: mi.Float
    """Radius in pixels."""
    taken: mi.Float
    """Surfels of that radius that cover the view."""
    frames: mi.Float
    """Frames that the look stands for; 0 where it is not the view's first in this frame."""


@dataclass
class SeenLight(Light):
    """What `gibs` answers at pixels, with what its `observe` goes by."""

    fine: mi.Float | None = None
    """Coverage by surfels that are small enough for the pixel."""
    wish: Wish | None = None


def new_screen() -> GibsScreen:
    """Return the screen of a view that has not looked yet."""
    return GibsScreen(dr.opaque(mi.Float, 0.0), dr.opaque(mi.UInt32, 0))


def new_eyes() -> Eyes:
    """Return the record of nobody."""
    looks, asked, pixels, views, taken = (dr.opaque(mi.Float, 0.0) for _ in range(5))
    return Eyes(looks, asked, pixels, views, taken, dr.opaque(mi.UInt32, 0))


def measure_view(
    state: GibsState, screen: GibsScreen, index: mi.UInt32, gbuffer: GBuffer
) -> tuple[Wish, GibsScreen]:  # fmt: skip
    """Return what a view asks for with its share of the surfels, and its next screen; `index` is the frame's."""
    surface = gbuffer.surface
    cosine = dr.fmax(dr.abs(dr.dot(surface.wo, mi.Vector3f(surface.n_geometric))), LEAST_COSINE)
    (area,) = sum_columns([dr.select(surface.active, 1.0 / cosine, 0.0)])
    share = state.dials.view_surfels / dr.fmax(state.eyes.views, 1.0)
    filling = dr.sqrt(SURFELS_PER_SQUARE_RADIUS * area / dr.fmax(share, 1.0))
    fixed = state.dials.radius_pixels
    wanted = dr.select(fixed > 0.0, fixed, dr.clip(filling, LEAST_PIXELS, MOST_PIXELS))
    # Much larger ones are taken at once: in the frames until then smaller ones would take the whole pool.
    at_once = (screen.pixels * MUCH_LARGER < wanted) | (fixed > 0.0)
    pixels = dr.select(at_once, wanted, dr.lerp(screen.pixels, wanted, SMOOTHING))
    # A view of nothing but sky wants none, and says nothing of the next view.
    pixels = dr.select(area > 0.0, pixels, screen.pixels)
    now = index + 1
    # A cache from a file may be younger than the view.
    apart = dr.select(now > screen.looked, dr.minimum(now - screen.looked, MOST_APART), 0)
    frames = dr.select(screen.looked == 0, 1.0, mi.Float(apart))
    taken = SURFELS_PER_SQUARE_RADIUS * area / dr.fmax(dr.square(pixels), 1e-6)
    return Wish(pixels, taken, frames), GibsScreen(pixels, now)


def note_look(eyes: Eyes, wish: Wish) -> Eyes:
    """Return the record with one more look at this frame: in whatever order they come, it is the same."""
    smallest = dr.select(eyes.looks > 0.0, dr.fmin(eyes.pixels, wish.pixels), wish.pixels)
    return replace(
        eyes, looks=eyes.looks + wish.frames, asked=eyes.asked + wish.frames * wish.taken, pixels=smallest
    )  # fmt: skip


def settle_eyes(state: GibsState) -> Eyes:
    """Return what the looks since the last update add up to, smoothed: how many views, what they take and leave.

    What is left is told as the size of the surfels that only rays see: those of the largest radius have a share of
    their own, and each size down needs twice as many.
    """
    eyes = state.eyes
    first = eyes.views <= 0.0
    views = dr.select(first, eyes.looks, dr.lerp(eyes.views, eyes.looks, SMOOTHING))
    taken = dr.select(first, eyes.asked, dr.lerp(eyes.taken, eyes.asked, SMOOTHING))
    share = state.dials.view_surfels
    left = (share / VIEW_SHARE - taken) / (share * (1.0 / VIEW_SHARE - 1.0))
    size = mi.UInt32(dr.floor(dr.log2(dr.fmax(left, 1.0))))
    # Arrays of their own and no plain zeros, which a second look in the same frame would record anew.
    looks, asked = (dr.select(value < 0.0, value, 0.0) for value in (eyes.looks, eyes.asked))
    return Eyes(
        looks=looks,
        asked=asked,
        pixels=mi.Float(eyes.pixels),
        views=views,
        taken=taken,
        ray_size=dr.select(views > NO_VIEW, size, eyes.ray_size),
    )
