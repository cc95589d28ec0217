"""Light on a part of a picture: the pixels in a box of the world or on one object, and how their light differs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from luxel.bench.reproduce.sponza_views import Region
    from luxel.scene.device import Scene
    from luxel.scene.model import Camera

BLOCK = 8
"""Side of the blocks over which light is averaged before its colour is judged, pixels: the truth's noise would pass for
colour otherwise."""


def region_mask(scene: Scene, camera: Camera, size: tuple[int, int], region: Region) -> np.ndarray:
    """Return (H, W) bool: the pixels of (width, height) `size` whose surface lies in the box `region`."""
    points, objects = _first_hits(scene, camera, size, scene.host.time)
    inside = (points >= np.array(region.lower)) & (points <= np.array(region.upper))
    return inside.all(axis=-1) & (objects > 0)


def object_mask(scene: Scene, camera: Camera, size: tuple[int, int], object_id: int, time: float) -> np.ndarray:
    """Return (H, W) bool: the pixels that show the object `object_id` (from 1) at `time` seconds."""
    from luxel.scene.device import set_time

    set_time(scene, time)
    return _first_hits(scene, camera, size, time)[1] == object_id


def _first_hits(scene: Scene, camera: Camera, size: tuple[int, int], time: float) -> tuple[np.ndarray, np.ndarray]:
    """Return points (H, W, 3) and object ids (H, W) of what the pixels see; id 0 where they see nothing."""
    from luxel.kernels.camera import make_pinhole
    from luxel.kernels.gbuffer import trace_gbuffer
    from luxel.render.frame import make_film

    film = make_film(size)
    pinhole = make_pinhole(camera, film.width, film.height, time, origin=scene.host.origin)
    surface = trace_gbuffer(scene, film, pinhole, pinhole).surface
    lanes = film.lanes_of_image()
    points = np.array(surface.p).T[lanes]
    return points, np.where(np.array(surface.active), np.array(surface.object_id), 0)[lanes]


def mean_light(light: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return the mean (3,) of `light` (H, W, 3) over `mask` (H, W); NaN where the mask is empty."""
    return light[mask].mean(axis=0, dtype=np.float64) if mask.any() else np.full(3, np.nan)


def mean_error(light: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> tuple[float, float]:
    """Return RMSE over blocks and bias of `light` (H, W, 3) over `mask`, both over the truth's mean there."""
    given, wanted = _blocks(light, mask), _blocks(truth, mask)
    mean = float(mean_light(truth, mask).mean()) if mask.any() else 0.0
    if not mean > 0.0:
        return float("nan"), float("nan")
    error = float(np.sqrt(np.mean((given - wanted) ** 2))) / mean
    return error, float(mean_light(light, mask).mean()) / mean - 1.0


def noise_on(halves: Sequence[np.ndarray], mask: np.ndarray) -> float:
    """Return half of the error between a truth's two halves (H, W, 3) over `mask`: the noise of their mean there."""
    first, second = halves
    return 0.5 * mean_error(first, second, mask)[0]


def chroma_spread(light: np.ndarray, mask: np.ndarray) -> float:
    """Return how much the light's colour varies over `mask`: standard deviation of the blocks' channel shares."""
    shares = _chroma(_blocks(light, mask))
    return float(np.sqrt(((shares - shares.mean(axis=0)) ** 2).sum(axis=1).mean())) if len(shares) else float("nan")


def chroma_distance(light: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> float:
    """Return the RMS distance of the blocks' channel shares from the truth's."""
    given, wanted = _chroma(_blocks(light, mask)), _chroma(_blocks(truth, mask))
    return float(np.sqrt(((given - wanted) ** 2).sum(axis=1).mean())) if len(wanted) else float("nan")


def _chroma(light: np.ndarray) -> np.ndarray:
    return light / np.maximum(light.sum(axis=1, keepdims=True), 1e-12)


def _blocks(light: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return the means (N, 3) of `light` over the blocks that hold pixels of `mask`, float64."""
    values = np.where(mask[..., None], light, 0.0).astype(np.float64)
    counts = mask[..., None].astype(np.float64)
    for axis in (0, 1):
        starts = np.arange(0, mask.shape[axis], BLOCK)
        values, counts = (np.add.reduceat(array, starts, axis=axis) for array in (values, counts))
    filled = counts[..., 0] > 0.0
    return values[filled] / counts[filled]
