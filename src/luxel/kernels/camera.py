"""The camera as the kernels read it: a few vectors that change without a compilation."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.scene.axes import camera_axes
from luxel.scene.model import Camera


@dataclass
class Pinhole:
    """A camera whose rays are linear in the image coordinates x, y in -1..1.

    They start at eye + x * across + y * upwards and go along forward + x * right + y * up. A perspective camera has no
    `across` and `upwards`, an orthographic one no `right` and `up`.
    """

    eye: mi.Point3f
    right: mi.Vector3f
    up: mi.Vector3f
    forward: mi.Vector3f
    across: mi.Vector3f
    upwards: mi.Vector3f


def make_pinhole(
    camera: Camera,
    width: int,
    height: int,
    time: float = 0.0,
    *,
    aspect: float | None = None,
    shift: tuple[float, float] = (0.0, 0.0),
    origin: np.ndarray | None = None,
) -> Pinhole:
    """Return the rays of `camera` at `time` seconds for an image of `width` x `height` pixels.

    `aspect` is the picture's width over height where its pixels are not square. `shift` moves the picture by image
    coordinates: what is seen through other points of the pixels. `origin` (3,), float64, is where the rays are measured
    from in the camera's coordinates: `Host.origin`, for a camera that has not been localised.
    """
    eye, right, up, forward = camera_axes(camera, time)
    eye = eye if origin is None else eye - origin
    aspect = width / height if aspect is None else aspect
    orthographic = camera.orthographic_width > 0.0
    half = camera.orthographic_width / 2.0 if orthographic else np.tan(np.deg2rad(camera.fov) / 2.0)
    stretched = orthographic and camera.orthographic_height > 0.0
    right, up = (
        right * (-half if camera.mirrored else half),
        up * (camera.orthographic_height / 2.0 if stretched else half / aspect),
    )
    move = (camera.lens_shift[0] + shift[0]) * right + (camera.lens_shift[1] + shift[1]) * up
    nothing = np.zeros(3)
    if orthographic:
        vectors = (eye + move, nothing, nothing, forward, right, up)
    else:
        vectors = (eye, right, up, forward + move, nothing, nothing)
    first, *others = ([dr.opaque(mi.Float, float(axis)) for axis in vector] for vector in vectors)
    return Pinhole(mi.Point3f(*first), *(mi.Vector3f(*other) for other in others))


def camera_ray(pinhole: Pinhole, x: mi.Float, y: mi.Float) -> tuple[mi.Point3f, mi.Vector3f]:
    """Return origin and unit direction of the ray through image coordinates `x`, `y` in -1..1 (y up)."""
    origin = pinhole.eye + x * pinhole.across + y * pinhole.upwards
    return mi.Point3f(origin), dr.normalize(pinhole.forward + x * pinhole.right + y * pinhole.up)


def project(pinhole: Pinhole, p: mi.Point3f) -> tuple[mi.Float, mi.Float, mi.Bool]:
    """Return image coordinates in -1..1 of world points, and whether they are in front of the camera."""
    offset = p - pinhole.eye
    # A shifted perspective camera's forward leans by this many right and up.
    shift_x = dr.dot(pinhole.forward, pinhole.right) / dr.fmax(dr.squared_norm(pinhole.right), 1e-24)
    shift_y = dr.dot(pinhole.forward, pinhole.up) / dr.fmax(dr.squared_norm(pinhole.up), 1e-24)
    straight = pinhole.forward - shift_x * pinhole.right - shift_y * pinhole.up
    depth = dr.dot(offset, straight)
    # How far one unit of x or y reaches at this depth; for a perspective camera it grows with it.
    safe = dr.select(dr.abs(depth) > 1e-12, depth, 1e-12)
    right, up = safe * pinhole.right + pinhole.across, safe * pinhole.up + pinhole.upwards
    x = dr.dot(offset, right) / dr.squared_norm(right) - shift_x
    y = dr.dot(offset, up) / dr.squared_norm(up) - shift_y
    return x, y, depth > 0.0


def pixel_width(pinhole: Pinhole, size: tuple[int, int], x: mi.Float, y: mi.Float, distance: mi.Float) -> mi.Float:
    """Return the side in metres of a square as large as the part of a plane that the pixel at `x`, `y` sees.

    The plane is met at right angles, `distance` metres from where the ray begins. `size` is (width, height) in pixels.
    Off a perspective image's middle pixels see less: their solid angle falls by the cube of the cosine to its axis.
    """
    ray = pinhole.forward + x * pinhole.right + y * pinhole.up
    # The forward axis is one long, so this is the cosine's power of 3/2; rays that are parallel spread nowhere.
    inverse = dr.rsqrt(dr.squared_norm(ray))
    spread = distance * inverse * dr.sqrt(inverse)
    across = (dr.norm(pinhole.right) * spread + dr.norm(pinhole.across)) * (2.0 / size[0])
    upwards = (dr.norm(pinhole.up) * spread + dr.norm(pinhole.upwards)) * (2.0 / size[1])
    return dr.sqrt(across * upwards)
