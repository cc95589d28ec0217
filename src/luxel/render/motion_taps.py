"""Where each judged frame's surfaces were seen in the frame before: the same for whoever flies, so traced once."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.kernels.camera import Pinhole, camera_ray, make_pinhole, project
from luxel.kernels.film import Film
from luxel.kernels.gbuffer import trace_gbuffer
from luxel.kernels.surface import previous_position
from luxel.metrics.motion import PixelTaps, SeenSurfaces, find_taps
from luxel.render.frame import make_film
from luxel.render.motion_path import MotionPath, frame_time
from luxel.scene.device import Scene, set_time
from luxel.scene.model import Camera


def trace_taps(
    scene: Scene, path: MotionPath, size: tuple[int, int], progress: Callable[[float], None] | None = None
) -> list[PixelTaps]:
    """Return the taps of each judged frame of `path` for (width, height) `size`. Leaves the scene at time 0."""
    film, found = make_film(size), []
    try:
        for number, frame in enumerate(path.judged):
            cameras = path.views[frame - 3], path.views[frame - 2], path.views[frame - 1]
            surfaces = [
                trace_surfaces(scene, film, (cameras[index], cameras[index + 1]), frame - 1 + index) for index in (0, 1)
            ]
            found.append(find_taps(surfaces[1], surfaces[0]))
            if progress is not None:
                progress((number + 1) / len(path.judged))
    finally:
        set_time(scene, 0.0)
    return found


def trace_surfaces(scene: Scene, film: Film, cameras: tuple[Camera, Camera], frame: int) -> SeenSurfaces:
    """Return what `frame` sees through the second of two cameras; the first one is that of the frame before."""
    times = frame_time(frame - 1), frame_time(frame)
    before, now = (
        make_pinhole(camera, film.width, film.height, time, origin=scene.host.origin)
        for camera, time in zip(cameras, times, strict=True)
    )
    for time in times:
        set_time(scene, time)
    return _take_apart(scene, film, now, before)


def _take_apart(scene: Scene, film: Film, now: Pinhole, before: Pinhole) -> SeenSurfaces:
    gbuffer = trace_gbuffer(scene, film, now, before)
    surface = gbuffer.surface
    p = previous_position(scene, surface)
    # Depth is counted from where a ray starts: for an orthographic camera that is another place for each pixel.
    x, y, _ = project(before, p)
    away = dr.norm(p - camera_ray(before, x, y)[0])
    motion = mi.Color3f(gbuffer.motion.x, gbuffer.motion.y, 0.0)
    return SeenSurfaces(
        depth=film.to_image(gbuffer.depth),
        normal=film.to_image(mi.Color3f(mi.Vector3f(surface.n_geometric))),
        object_id=film.to_image(dr.select(surface.active, surface.object_id, 0)).astype(np.int64),
        motion=film.to_image(motion)[..., :2],
        depth_before=film.to_image(dr.select(surface.active, away, 0.0)),
    )
