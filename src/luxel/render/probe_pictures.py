"""Pictures of a cache in its scene: probes as shaded spheres, and where on the surfaces probes have sight."""

from __future__ import annotations

from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.errors import LuxelError
from luxel.kernels.camera import Pinhole, camera_ray
from luxel.kernels.film import Film
from luxel.kernels.gbuffer import trace_gbuffer
from luxel.kernels.octahedral import direction_to_square
from luxel.methods.base import View
from luxel.methods.ddgi.query import query_probes
from luxel.methods.ddgi.state import DdgiState
from luxel.render.tonemap import auto_exposure, to_display

if TYPE_CHECKING:
    from luxel.render.renderer import Renderer

AMBIENT = 0.35
"""Brightness of a sphere's rim where its colours are no light of their own."""
RAMP = np.array(
    [(0.05, 0.03, 0.2), (0.35, 0.1, 0.45), (0.75, 0.25, 0.3), (0.97, 0.6, 0.15), (1.0, 1.0, 0.75)], np.float32
)
"""Displayed colours of the heat map, from 0 to 1."""


def draw_probes(renderer: Renderer, by: str = "irradiance", radius: float | None = None) -> np.ndarray:
    """Return the last frame with the probes over it as spheres: (H, W, 3) float32, ready to be shown, 0..1.

    `by` is a view of kind `spheres` of the method: for ddgi `irradiance` (as a white diffuse sphere would look),
    `depth`, `state` or `offsets`. `radius` is in metres; None takes the view's. The scene hides spheres behind it.
    Raises LuxelError for another view, a radius that is not above 0, and before the first frame.
    """
    image = renderer.image()
    spheres = {
        name: view
        for name, view in renderer.method.views(renderer.scene, renderer.state).items()
        if view.kind == "spheres"
    }
    if by not in spheres:
        known = ", ".join(spheres) or "none"
        raise LuxelError(f"method '{renderer.method.name}' has no spheres by '{by}' to draw (it has: {known})")
    size = float(spheres[by].data["radius"]) if radius is None else float(radius)
    if not 0.0 < size < np.inf:
        raise LuxelError(f"a radius of {size} m cannot be drawn: give one above 0")
    exposure = auto_exposure(image)
    shown = to_display(image, exposure)
    if not len(spheres[by].data["p"]):
        return shown
    camera = renderer.view_camera
    depth = trace_gbuffer(renderer.scene, renderer.film, camera, camera).depth
    color, hit, facing = (
        renderer.film.to_image(v) for v in _cast_at_spheres(spheres[by], size, renderer.film, camera, depth)
    )
    if by == "irradiance":
        color = to_display(color / np.pi, exposure)
    else:
        color = np.clip(color, 0.0, 1.0) * (AMBIENT + (1.0 - AMBIENT) * facing[..., None])
    return np.where(hit.astype(bool)[..., None], color, shown).astype(np.float32)


@dr.syntax
def _nearest_sphere(
    centers: mi.Point3f, radius: mi.Float, eye: mi.Point3f, direction: mi.Vector3f, farthest: mi.Float
) -> tuple[mi.Float, mi.UInt32]:
    """Return distance and index of the first sphere along each ray; `farthest` and the count where there is none."""
    count = dr.width(centers)
    t, found = mi.Float(farthest), mi.UInt32(count)
    index, end = mi.UInt32(0), dr.opaque(mi.UInt32, count)
    while index < end:
        away = dr.gather(mi.Point3f, centers, index) - eye
        along = dr.dot(away, direction)
        # Square of the ray's distance from the middle without cancellation (Haines et al. 2019, chapter 7).
        inside = dr.square(radius) - dr.squared_norm(away - along * direction)
        entry = along - dr.sqrt(dr.fmax(inside, 0.0))
        nearer = (inside > 0.0) & (entry > 0.0) & (entry < t)
        t = dr.select(nearer, entry, t)
        found = dr.select(nearer, index, found)
        index += 1
    return t, found


def _cast_at_spheres(
    view: View, radius: float, film: Film, camera: Pinhole, depth: mi.Float
) -> tuple[mi.Color3f, mi.Bool, mi.Float]:
    """Return for each lane the colour of the sphere it sees, whether it sees one, and how far that faces the eye."""
    centers = mi.Point3f(*(mi.Float(np.ascontiguousarray(column, np.float32)) for column in view.data["p"].T))
    atlas = np.ascontiguousarray(view.data["atlas"], np.float32)
    column, row, inside = film.pixel_of_lane(dr.arange(mi.UInt32, film.lane_count))
    x = (mi.Float(column) + 0.5) * (2.0 / film.width) - 1.0
    y = 1.0 - (mi.Float(row) + 0.5) * (2.0 / film.height)
    direction = camera_ray(camera, x, y)
    eye = mi.Point3f(camera.eye)
    t, index = _nearest_sphere(centers, dr.opaque(mi.Float, radius), eye, direction, mi.Float(depth))
    hit = inside & (index < len(atlas))
    normal = dr.normalize(eye + t * direction - dr.gather(mi.Point3f, centers, index, hit))

    # Show the texel itself: what blurs between texels would hide what the cache holds.
    resolution = atlas.shape[1]
    place = mi.Point2i((direction_to_square(normal) * 0.5 + 0.5) * resolution)
    place = dr.clip(place, 0, resolution - 1)
    texel = index * resolution**2 + mi.UInt32(place.x + resolution * place.y)
    color = dr.gather(mi.Color3f, mi.Float(atlas.ravel()), texel, hit)
    return color, hit, dr.select(hit, dr.clip(-dr.dot(normal, direction), 0.0, 1.0), 0.0)


def draw_weights(renderer: Renderer) -> np.ndarray:
    """Return a heat map of the weights of probes with sight: (H, W, 3) float32, ready to be shown, 0..1.

    Dark blue where no probe of a cage sees the pixel's surface, pale yellow where all do; black where there is no
    surface. Raises LuxelError for a method other than ddgi.
    """
    if not isinstance(renderer.state, DdgiState):
        raise LuxelError(f"method '{renderer.method.name}' has no probes whose weights could be drawn; take ddgi")
    camera = renderer.view_camera
    surface = trace_gbuffer(renderer.scene, renderer.film, camera, camera).surface
    answer = query_probes(renderer.state, surface.p, surface.n_geometric, surface.n_shading, surface.wo, surface.active)
    seen = renderer.film.to_image(answer.seen)
    hit = renderer.film.to_image(surface.active).astype(bool)
    return np.where(hit[..., None], heat(seen), np.float32(0.0))


def heat(values: np.ndarray) -> np.ndarray:
    """Return displayed colours (..., 3) float32 for `values` (...), which are clipped to 0..1."""
    place = np.clip(np.nan_to_num(values), 0.0, 1.0) * (len(RAMP) - 1)
    stops = np.arange(len(RAMP))
    return np.stack([np.interp(place, stops, channel) for channel in RAMP.T], axis=-1).astype(np.float32)
