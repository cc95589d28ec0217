"""The browser's camera and ours.

viser (as OpenCV) looks along +Z with +Y down, gives its pose as a quaternion wxyz and a position, and its field of view
vertically in radians. Ours has an eye, a target, an up vector and a horizontal field of view in degrees.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from luxel.kernels.camera import camera_axes
from luxel.scene.model import Camera

NAME = "viewer"
SQUARE_FOV = 45.0


def camera_from_pose(
    wxyz: Sequence[float] | np.ndarray,
    position: Sequence[float] | np.ndarray,
    fov: float,
    aspect: float,
    reach: float = 1.0,
) -> Camera:
    """Return our camera for a pose; `fov` vertical in radians, `aspect` width over height.

    `reach` is the distance from the eye to the target, metres.
    """
    rotation = rotation_matrix(wxyz)
    eye = np.asarray(position, np.float64)
    target = eye + max(reach, 1e-6) * rotation[:, 2]
    return Camera(_triple(eye), _triple(target), _triple(-rotation[:, 1]), horizontal_fov(fov, aspect), name=NAME)


def look_of_camera(camera: Camera, time: float, reach: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return position, look-at point and up vector for the browser; `reach` where the camera names no target."""
    eye, _, up, forward = camera_axes(camera, time)
    if camera.motion is None:
        reach = float(np.linalg.norm(np.asarray(camera.target, np.float64) - eye))
    return eye, eye + forward * max(reach, 1e-3), up


def horizontal_fov(vertical: float, aspect: float) -> float:
    """Return the horizontal angle in degrees of a vertical one in radians."""
    return math.degrees(2.0 * math.atan(math.tan(vertical / 2.0) * aspect))


def vertical_fov(horizontal: float, aspect: float) -> float:
    """Return the vertical angle in radians of a horizontal one in degrees."""
    return 2.0 * math.atan(math.tan(math.radians(horizontal) / 2.0) / aspect)


def vertical_fov_in_window(horizontal: float, aspect: float) -> float:
    """Return the vertical angle in radians at which a scene's camera is shown in a window.

    A scene does not say which shape its pictures have. A wide window shows more at the sides rather than cut off what
    a square picture would show above and below, up to `SQUARE_FOV` degrees: wider cameras are not made for squares.
    """
    return max(vertical_fov(horizontal, aspect), math.radians(min(horizontal, SQUARE_FOV)))


def rotation_matrix(wxyz: Sequence[float] | np.ndarray) -> np.ndarray:
    """Return the (3, 3) rotation of a quaternion, which need not be normalised."""
    w, x, y, z = np.asarray(wxyz, np.float64) / max(float(np.linalg.norm(wxyz)), 1e-12)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion(rotation: np.ndarray) -> tuple[float, float, float, float]:
    """Return wxyz of a (3, 3) rotation: the eigenvector of Bar-Itzhack's matrix, sound for every turn."""
    m = rotation
    k = np.array(
        [
            [m[0, 0] - m[1, 1] - m[2, 2], 0.0, 0.0, 0.0],
            [m[0, 1] + m[1, 0], m[1, 1] - m[0, 0] - m[2, 2], 0.0, 0.0],
            [m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], m[2, 2] - m[0, 0] - m[1, 1], 0.0],
            [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], m[0, 0] + m[1, 1] + m[2, 2]],
        ]
    )
    x, y, z, w = np.linalg.eigh(k / 3.0)[1][:, -1]
    sign = 1.0 if w >= 0.0 else -1.0
    return (float(sign * w), float(sign * x), float(sign * y), float(sign * z))


def split_matrix(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (3,) position, (3, 3) rotation and (3, 3) rest, so that the linear part is rotation @ rest."""
    left, scale, right = np.linalg.svd(matrix[:3, :3])
    turn = left @ right
    if np.linalg.det(turn) < 0.0:  # a mirrored object: the mirror belongs to the rest
        left = left @ np.diag([1.0, 1.0, -1.0])
        scale = scale * np.array([1.0, 1.0, -1.0])
        turn = left @ right
    return matrix[:3, 3].copy(), turn, right.T @ np.diag(scale) @ right


def join_matrix(position: Sequence[float] | np.ndarray, rotation: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Return the (4, 4) matrix of what `split_matrix` returned."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation @ rest
    matrix[:3, 3] = position
    return matrix


def _triple(values: np.ndarray) -> tuple[float, float, float]:
    return (float(values[0]), float(values[1]), float(values[2]))
