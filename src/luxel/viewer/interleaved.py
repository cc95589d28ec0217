"""One camera's picture that fills up pass by pass: small films, shifted by whole pixels, laid between one another."""

from __future__ import annotations

import functools
import operator
from dataclasses import dataclass, fields

import numpy as np

from luxel.image.layers import Layers
from luxel.render.exposure import Meter
from luxel.render.shared import Cache, CameraView
from luxel.scene.model import Camera
from luxel.viewer.display import DisplayEncoder
from luxel.viewer.resolution import complete_side, order_offsets

AGREE = 0.02
"""Relative change of a film's mean luminance, from its pass before, under which no eye tells the two apart."""


@dataclass(frozen=True)
class DisplaySettings:
    """How a picture is shown."""

    look: str = "image"
    exposure: float = 1.0


class InterleavedView:
    """A picture of one size and stride of one cache.

    While the camera turns one small film looks through the middles of blocks of pixels; at rest the films of all
    offsets take turns, and together they are the picture of full size, pixel by pixel.
    """

    def __init__(
        self, cache: Cache, size: tuple[int, int], aspect: float, stride: int, pixel_filter: str = "none"
    ) -> None:
        """`size` is the full (width, height), which `stride` divides; `aspect` the window's width over height.

        `pixel_filter` smooths the picture at rest.
        """
        self.cache = cache
        self.size = size
        self.aspect = aspect
        self.stride = stride
        self.pixel_filter = pixel_filter
        self.generation = cache.generation
        self.passes = 0
        """Passes at rest."""
        self.meter: Meter | None = None
        """The light of what is shown."""
        self._order = order_offsets(stride)
        self._moving = self._make_view()
        self._resting: list[CameraView] = []
        self._canvas = np.zeros((size[1], size[0], 3), np.uint8)
        self._small: np.ndarray | None = None
        self._meters: list[Meter | None] = []
        self._agreeing = 0
        """Passes in a row that brought what the film had brought before."""
        self._shown = DisplaySettings()

    def _make_view(self) -> CameraView:
        """Return a view on a small film; all share one recording, the turning one too, whose frames are unfiltered."""
        small = self.size[0] // self.stride, self.size[1] // self.stride
        return CameraView(self.cache, small, self.aspect, filter=self.pixel_filter, spread=1.0 / self.stride)

    def fits(self, cache: Cache, size: tuple[int, int], aspect: float, stride: int, pixel_filter: str = "none") -> bool:
        """Return whether this is a view of `cache` as it is now, of that size, stride and filter."""
        known = (self.cache, self.size, self.aspect, self.stride, self.pixel_filter, self.generation)
        return known == (cache, size, aspect, stride, pixel_filter, cache.generation)

    def mark_changed(self) -> None:
        """Say that scene or lights have changed."""
        for view in (self._moving, *self._resting):
            view.mark_changed()

    def turn(self, camera: Camera, encoder: DisplayEncoder, shown: DisplaySettings, learn: bool) -> None:
        """Make one pass while the camera turns: the small picture."""
        self.passes = self._agreeing = 0
        self._shown = shown
        picture = self._moving.look(camera, learn=learn)
        self._small, self.meter = encoder.encode(self._moving.film, picture, shown.look, shown.exposure)

    def rest(self, camera: Camera, encoder: DisplayEncoder, shown: DisplaySettings, learn: bool) -> None:
        """Make one pass at rest: the next film of the full picture."""
        if shown != self._shown:
            self.encode_again(encoder, shown)
        place = self.passes % len(self._order)
        column, row = self._order[place]
        if place == len(self._resting):
            self._resting.append(self._make_view())
            self._meters.append(None)
        view, middle = self._resting[place], 0.5 * (self.stride - 1)
        shift = (2.0 * (column - middle) / self.size[0], -2.0 * (row - middle) / self.size[1])
        picture = view.look(camera, shift, learn=learn)
        before = self._meters[place] if self.is_full else None
        self._lay(place, *encoder.encode(view.film, picture, shown.look, shown.exposure))
        self.passes += 1
        now = self._meters[place]
        same = before is not None and now is not None and abs(now.mean - before.mean) <= AGREE * before.mean
        self._agreeing = self._agreeing + 1 if same else 0
        self.meter = functools.reduce(
            operator.add, (meter for meter in self._meters[: self.passes] if meter is not None)
        )

    def encode_again(self, encoder: DisplayEncoder, shown: DisplaySettings) -> None:
        """Show what has been rendered in another way, without rendering."""
        self._shown = shown
        for place, view in enumerate(self._resting[: self.passes]):
            if view.picture is not None:
                self._lay(place, *encoder.encode(view.film, view.picture, shown.look, shown.exposure))
        view = self._moving
        if view.picture is not None:
            self._small, _ = encoder.encode(view.film, view.picture, shown.look, shown.exposure)

    def _lay(self, place: int, pixels: np.ndarray, meter: Meter) -> None:
        column, row = self._order[place]
        self._canvas[row :: self.stride, column :: self.stride] = pixels
        self._meters[place] = meter

    def image(self) -> np.ndarray:
        """Return the picture as far as it has come, (h, w, 3) uint8: a divisor of the full size until it is full."""
        side = complete_side(self.stride, self.passes)
        if side == 0 or (side == 1 < self.stride and self._small is not None):
            assert self._small is not None, "a pass comes first"
            return self._small
        step = self.stride // side
        # A copy: the picture is encoded while the next pass is laid into the canvas.
        return self._canvas[::step, ::step].copy()

    @property
    def is_full(self) -> bool:
        """Every pixel has been rendered since the camera came to rest."""
        return self.passes >= len(self._order)

    @property
    def is_even(self) -> bool:
        """Whether the passes that lie between one another show the same light.

        A cache that is learning gives each pass another one. So every film but a lone one must have come twice, alike.
        """
        count = len(self._order)
        return self.is_full and (count == 1 or self._agreeing >= count)

    @property
    def samples(self) -> int:
        """Frames that every pixel's running means hold at least."""
        if not self.is_full:
            return 0
        return 1 + min(view.still_frames for view in self._resting)

    @property
    def middle_view(self) -> CameraView:
        """The small film's view, through the middles of the pixels' blocks: its pinhole is the picture's."""
        return self._moving

    def view_at(self, x: float, y: float) -> CameraView:
        """Return the view that saw the picture's point (x, y in 0..1) last, or the small film's."""
        if not self.is_full:
            return self._moving if self._moving.picture is not None else self._resting[0]
        column = min(int(x * self.size[0]), self.size[0] - 1) % self.stride
        row = min(int(y * self.size[1]), self.size[1] - 1) % self.stride
        return self._resting[self._order.index((column, row))]

    def layers(self) -> Layers:
        """Return the full picture taken apart; only where it `is_full`."""
        parts = [view.layers() for view in self._resting]
        joined = {}
        for item in fields(Layers):
            sample = getattr(parts[0], item.name)
            if sample is None:
                continue
            whole = np.empty((self.size[1], self.size[0], *sample.shape[2:]), sample.dtype)
            for (column, row), part in zip(self._order, parts, strict=True):
                whole[row :: self.stride, column :: self.stride] = getattr(part, item.name)
            joined[item.name] = whole
        return Layers(**joined)
