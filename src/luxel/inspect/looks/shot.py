"""What one camera sees of a world, with the method's cache behind it: all that a look is drawn from."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.errors import LuxelError
from luxel.image.layers import Layers
from luxel.kernels.camera import Pinhole, camera_ray
from luxel.kernels.film import Film
from luxel.kernels.gbuffer import GBuffer, trace_gbuffer
from luxel.kernels.records import Surface
from luxel.kernels.surface import surface_at_hit
from luxel.kernels.trace import trace_closest
from luxel.methods.base import Method
from luxel.render.exposure import Exposure, resolve_exposure
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
    point: Surface | None = None
    """The chosen point, in its first lane: some looks show what lights it. None: the middle of the picture."""

    @cached_property
    def gbuffer(self) -> GBuffer:
        """The surfaces at the pixels, in tile order: traced when first asked for."""
        return trace_gbuffer(self.scene, self.film, self.camera, self.camera)

    @cached_property
    def chosen_point(self) -> Surface:
        """The chosen point, or what lies in the middle of the picture."""
        return self.point or surface_at_pixel(self, self.film.width // 2, self.film.height // 2)[0]

    @cached_property
    def image(self) -> np.ndarray:
        """The linear image, (H, W, 3) radiance."""
        return self.layers.image()


def take_shot(
    renderer: Renderer,
    *,
    truth: Layers | None = None,
    exposure: Exposure | float | None = None,
    pixel: tuple[int, int] | None = None,
) -> Shot:
    """Return the last frame of `renderer`; `exposure` None is automatic.

    `pixel` (column, row) chooses the point of looks that show what lights one; None takes the picture's middle.

    Raises LuxelError before the first frame, where `truth` has another size, and for a pixel outside the image.
    """
    layers = renderer.layers()
    if truth is not None and truth.hit.shape != layers.hit.shape:
        height, width = truth.hit.shape
        raise LuxelError(
            f"the truth is {width}x{height}, the image {renderer.film.width}x{renderer.film.height}: "
            "render both at one size"
        )
    factor = resolve_exposure(exposure, layers)
    shot = Shot(
        renderer.scene, renderer.method, renderer.state, renderer.film, renderer.view_camera, layers, factor, truth
    )
    if pixel is not None:
        require_pixel(shot.film, *pixel)
        shot.point = surface_at_pixel(shot, *pixel)[0]
    return shot


def require_pixel(film: Film, x: int, y: int) -> None:
    """Raise LuxelError where column `x` and row `y` are not on `film`."""
    width, height = film.width, film.height
    if not (0 <= x < width and 0 <= y < height):
        raise LuxelError(f"pixel {x},{y} is outside the image: columns go from 0 to {width - 1}, rows to {height - 1}")


def surface_at_pixel(shot: Shot, x: int, y: int, lanes: int = 1) -> tuple[Surface, float]:
    """Return the surface through a pixel's middle, `lanes` times over, and its distance from the eye, metres."""
    film = shot.film
    across = dr.full(mi.Float, (x + 0.5) * 2.0 / film.width - 1.0, lanes)
    up = dr.full(mi.Float, 1.0 - (y + 0.5) * 2.0 / film.height, lanes)
    dr.make_opaque(across, up)
    origin, direction = camera_ray(shot.camera, across, up)
    hit = trace_closest(shot.scene, origin, direction, dr.full(mi.Bool, True, lanes))
    return surface_at_hit(shot.scene, hit, direction), float(np.array(hit.t)[0])
