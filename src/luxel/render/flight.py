"""Fly the camera along a scene's key views, so that a cache that learns from views has seen every surface."""

from __future__ import annotations

import drjit as dr
import numpy as np

from luxel.kernels.camera import camera_axes
from luxel.render.flight_plan import free_ways, plan_flight
from luxel.render.renderer import Renderer
from luxel.scene.device import Scene
from luxel.scene.local import local_camera
from luxel.scene.model import Camera


def fly_through(renderer: Renderer, frames_a_view: int = 8) -> int:
    """Render `frames_a_view` frames from each key view and one on the way to the next; return the frames flown.

    Ends at the camera it began with. Raises LuxelError where there is nothing to fly through (`find_flight`).
    """
    home = renderer.camera
    stops = find_flight(renderer.scene)
    # The makers of a scene know that their ways are free; those found by looking may lead through a wall.
    known = bool(renderer.scene.host.data.flight)
    free = [True] * len(stops) if known else free_ways(renderer.scene, [*stops, home]).tolist()
    flown = 0
    for stop, following, passes in zip(stops, [*stops[1:], home], free, strict=True):
        for _ in range(frames_a_view):
            renderer.step(camera=stop)
        if passes:
            renderer.step(camera=interpolate(stop, following, 0.5))
        flown += frames_a_view + passes
    renderer.step(camera=home)
    dr.sync_thread()
    return flown + 1


def find_flight(scene: Scene) -> list[Camera]:
    """Return the scene's own key views; where it names none, as a file does, those that `plan_flight` finds.

    Raises LuxelError where its cameras see no surface.
    """
    return scene.host.data.flight or [local_camera(view, -scene.host.origin) for view in plan_flight(scene)]


def interpolate(first: Camera, second: Camera, share: float) -> Camera:
    """Return the view `share` of the way between two cameras at rest."""
    eye_a, _, up_a, forward_a = camera_axes(first)
    eye_b, _, up_b, forward_b = camera_axes(second)
    eye = (1.0 - share) * eye_a + share * eye_b
    forward = (1.0 - share) * forward_a + share * forward_b
    if np.linalg.norm(forward) < 1e-6:  # exactly opposite views: turn by the first one's side
        forward = np.cross(forward_a, up_a)
    up = (1.0 - share) * up_a + share * up_b
    return Camera(
        _triple(eye),
        _triple(eye + forward),
        _triple(up),
        fov=(1.0 - share) * first.fov + share * second.fov,
        name="flight",
    )


def _triple(vector: np.ndarray) -> tuple[float, float, float]:
    return float(vector[0]), float(vector[1]), float(vector[2])
