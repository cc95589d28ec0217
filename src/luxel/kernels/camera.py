"""The pinhole as the kernels read it: four vectors that change without a compilation."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.scene.model import Camera


@dataclass
class Pinhole:
    """A ray's direction is forward + x * right + y * up for image coordinates x, y in -1..1."""

    eye: mi.Point3f
    right: mi.Vector3f
    up: mi.Vector3f
    forward: mi.Vector3f


def make_pinhole(camera: Camera, width: int, height: int, time: float = 0.0) -> Pinhole:
    """Return the pinhole of `camera` at `time` seconds for an image of `width` x `height` pixels."""
    eye, right, up, forward = camera_axes(camera, time)
    half = np.tan(np.deg2rad(camera.fov) / 2.0)
    vectors = (right * half, up * half * height / width, forward)
    return Pinhole(mi.Point3f(*_opaque(eye)), *(mi.Vector3f(*_opaque(vector)) for vector in vectors))


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


def camera_ray(pinhole: Pinhole, x: mi.Float, y: mi.Float) -> mi.Vector3f:
    """Return the unit direction through image coordinates `x`, `y` in -1..1 (y up)."""
    return dr.normalize(pinhole.forward + x * pinhole.right + y * pinhole.up)


def project(pinhole: Pinhole, p: mi.Point3f) -> tuple[mi.Float, mi.Float, mi.Bool]:
    """Return image coordinates in -1..1 of world points, and whether they are in front of the camera."""
    offset = p - pinhole.eye
    depth = dr.dot(offset, pinhole.forward)
    x = dr.dot(offset, pinhole.right) / dr.squared_norm(pinhole.right)
    y = dr.dot(offset, pinhole.up) / dr.squared_norm(pinhole.up)
    inverse = 1.0 / dr.select(dr.abs(depth) > 1e-12, depth, 1e-12)
    return x * inverse, y * inverse, depth > 0.0


def _opaque(vector: np.ndarray) -> list[mi.Float]:
    return [dr.opaque(mi.Float, float(value)) for value in vector]
