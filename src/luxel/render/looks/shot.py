"""What one camera sees of a world, with the method's cache behind it: all that a look is drawn from."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from luxel.errors import LuxelError
from luxel.kernels.camera import Pinhole
from luxel.kernels.film import Film
from luxel.kernels.gbuffer import GBuffer, trace_gbuffer
from luxel.methods.base import Method
from luxel.render.layers import Layers
from luxel.render.tonemap import auto_exposure
from luxel.scene.device import Scene

if TYPE_CHECKING:
    from luxel.render.renderer import Renderer


@dataclass
class Shot:
    """A frame that was rendered: made by `take_shot`, or by whoever runs frames in another way."""

    scene: Scene
    method: Method
    state: Any
    film: Film
    camera: Pinhole
    layers: Layers
    """What came out, (H, W) of the film."""
    exposure: float
    """Factor that light is shown with."""
    truth: Layers | None = None
    """The same view path traced; some looks need it."""

    @cached_property
    def gbuffer(self) -> GBuffer:
        """The surfaces at the pixels, in tile order: traced when first asked for."""
        return trace_gbuffer(self.scene, self.film, self.camera, self.camera)

    @cached_property
    def image(self) -> np.ndarray:
        """The linear image, (H, W, 3) radiance."""
        return self.layers.image()


def take_shot(renderer: Renderer, *, truth: Layers | None = None, exposure: float | None = None) -> Shot:
    """Return the last frame of `renderer`; `exposure` None brings the mean luminance to 0.18.

    Raises LuxelError before the first frame, and where `truth` has another size.
    """
    layers = renderer.layers()
    if truth is not None and truth.hit.shape != layers.hit.shape:
        height, width = truth.hit.shape
        raise LuxelError(
            f"the truth is {width}x{height}, the image {renderer.film.width}x{renderer.film.height}: "
            "render both at one size"
        )
    if exposure is None:
        exposure = auto_exposure(layers.image())
    return Shot(
        renderer.scene, renderer.method, renderer.state, renderer.film, renderer.view_camera, layers, exposure, truth
    )
