"""Where a camera stands and which way it looks, on the host."""

from __future__ import annotations

import numpy as np

from luxel.scene.model import Camera


def camera_axes(camera: Camera, time: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return eye, right, up, forward: float64 (3,), the last three unit and orthogonal."""
    if camera.motion is not None:
        matrix = np.asarray(camera.motion(time), np.float64)
        eye, forward, up = matrix[:3, 3], -matrix[:3, 2], matrix[:3, 1]
    else:
        eye = np.asarray(camera.eye, np.float64)
        forward, up = np.asarray(camera.target, np.float64) - eye, np.asarray(camera.up, np.float64)
    forward = forward / max(float(np.linalg.norm(forward)), 1e-12)
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-9:  # looking straight up or down: any right will do
        right = np.cross(forward, (0.0, 0.0, 1.0) if abs(forward[2]) < 0.9 else (1.0, 0.0, 0.0))
    right = right / np.linalg.norm(right)
    return eye, right, np.cross(right, forward), forward
