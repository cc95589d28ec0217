"""Where each judged frame's surfaces were seen in the frame before: the same for whoever flies, so traced once.

The rule by which a tap counts is the one of whoever keeps a history, that of `kernels/reproject.py`.
"""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import numpy as np

from luxel.kernels.camera import make_pinhole
from luxel.kernels.film import Film
from luxel.kernels.gbuffer import trace_gbuffer
from luxel.kernels.reproject import Taps, find_taps, remember
from luxel.metrics.motion import PixelTaps
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
            found.append(taps_between(scene, film, (path.views[frame - 2], path.views[frame - 1]), frame))
            if progress is not None:
                progress((number + 1) / len(path.judged))
    finally:
        set_time(scene, 0.0)
    return found


def taps_between(scene: Scene, film: Film, cameras: tuple[Camera, Camera], frame: int) -> PixelTaps:
    """Return the taps of `frame`, seen through the second of two cameras; the first one is that of the frame before."""
    times = frame_time(frame - 1), frame_time(frame)
    before, now = (
        make_pinhole(camera, film.width, film.height, time, origin=scene.host.origin)
        for camera, time in zip(cameras, times, strict=True)
    )
    set_time(scene, times[0])
    last = remember(trace_gbuffer(scene, film, before, before))
    # The scene moves on under it.
    dr.eval(last)
    set_time(scene, times[1])
    gbuffer = trace_gbuffer(scene, film, now, before)
    taps = find_taps(scene, film, gbuffer, before, last)
    # The sky has a place of its own in the frame before, but no light that could flicker.
    return _as_arrays(film, taps, film.to_image(gbuffer.surface.active))


def _as_arrays(film: Film, taps: Taps, hit: np.ndarray) -> PixelTaps:
    """Return device taps as pixels, row by row, with their weights; none where nothing was `hit` (H, W)."""
    number_of_lane = np.zeros(film.lane_count, np.int64)
    lanes = film.lanes_of_image()
    number_of_lane[lanes] = np.arange(lanes.size).reshape(lanes.shape)
    weight = np.stack([film.to_image(weight) for weight in taps.weights], axis=-1) * hit[..., None]
    pixel = np.stack([number_of_lane[film.to_image(lane)] for lane in taps.lanes], axis=-1)
    return PixelTaps(np.where(weight > 0.0, pixel, 0), weight.astype(np.float32))
