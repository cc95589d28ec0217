"""A picture to keep: rendered beside the visitor's own, pass by pass, so that nobody has to wait for it."""

from __future__ import annotations

from collections.abc import Callable

from luxel.errors import LuxelError
from luxel.image.layers import Layers
from luxel.methods.params import find_method
from luxel.render.shared import Cache
from luxel.scene.model import Camera
from luxel.viewer.display import DisplayEncoder
from luxel.viewer.interleaved import DisplaySettings, InterleavedView
from luxel.viewer.resolution import STRIDES
from luxel.viewer.world import World

FRAMES = 32
"""Frames whose direct light each pixel averages; a progressive method's light needs `PROGRESSIVE_FRAMES`."""
PROGRESSIVE_FRAMES = 256
PIXEL_LIMIT = 3840 * 2160


class Snapshot:
    """One picture of a method's cache at a size of its own. The cache goes on meanwhile and learns nothing from it."""

    def __init__(
        self, world: World, camera: Camera, size: tuple[int, int], stride: int, keep: Callable[[Layers], None],
        pixel_filter: str = "none",
    ) -> None:  # fmt: skip
        """`size` is (width, height); `stride` at most that of the passes; `keep` takes the picture.

        `pixel_filter` smooths it.

        Raises LuxelError for a size that is too large.
        """
        width, height = size
        if not (0 < width * height <= PIXEL_LIMIT):
            raise LuxelError(f"a picture of {width}x{height} is too large to keep here: use `luxel render`")
        self.method = world.main
        self._camera = camera
        self._size = size
        self._stride = max(each for each in STRIDES if each <= stride and width % each == height % each == 0)
        self._keep = keep
        self._filter = pixel_filter
        self._interleaved_of = self._start(world)

    def _start(self, world: World) -> InterleavedView:
        return InterleavedView(*self._shape(world))

    def _shape(self, world: World) -> tuple[Cache, tuple[int, int], float, int, str]:
        aspect = self._size[0] / self._size[1]
        return world.cache(self.method), self._size, aspect, self._stride, self._filter

    def step(self, world: World, encoder: DisplayEncoder) -> bool:
        """Make one pass; return whether the picture is done and has been handed over."""
        interleaved = self._interleaved_of
        if not interleaved.fits(*self._shape(world)):
            interleaved = self._interleaved_of = self._start(world)
        interleaved.rest(self._camera, encoder, DisplaySettings(), learn=False)
        if interleaved.samples < (PROGRESSIVE_FRAMES if find_method(self.method).progressive else FRAMES):
            return False
        self._keep(interleaved.layers())
        return True
