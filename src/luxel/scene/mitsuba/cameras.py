"""Mitsuba's sensors as cameras: pinholes and orthographic ones."""

from __future__ import annotations

import math
from typing import Any

import mitsuba as mi
import numpy as np

from luxel.scene.mitsuba.materials import as_triple
from luxel.scene.model import Camera
from luxel.scene.warnings import Warnings

KINDS = ("PerspectiveCamera", "ThinLensCamera", "OrthographicCamera")


def convert_sensors(scene: Any, warnings: Warnings) -> list[Camera]:
    """Return a camera for each sensor that makes a picture; names what is left out."""
    cameras = []
    for sensor in scene.sensors():
        kind = sensor.class_name()
        if kind in KINDS:
            cameras.append(_convert_sensor(sensor, kind, warnings))
        else:
            warnings.add("Sensors of these types are left out: {names}.", kind)
    for index, camera in enumerate(cameras[1:], 2):
        camera.name = camera.name if camera.name != "default" else f"camera-{index}"
    return cameras


def _convert_sensor(sensor: Any, kind: str, warnings: Warnings) -> Camera:
    """Return its camera. Mitsuba cameras look along +Z of their matrix; `x_fov` is what any fov axis came to."""
    matrix = np.array(sensor.world_transform().matrix, float).reshape(4, 4)
    parameters = mi.traverse(sensor)
    eye, forward, up = matrix[:3, 3], matrix[:3, 2], matrix[:3, 1]
    target = eye + forward / np.linalg.norm(forward)
    camera = Camera(as_triple(eye), as_triple(target), as_triple(up), name=_camera_name(sensor))
    zoom, shift = _crop(sensor)
    if kind == "OrthographicCamera":
        # Mitsuba's image spans -1..1 in x before `to_world`; in y it keeps the film's aspect.
        across, upright = np.linalg.norm(matrix[:3, 0]), np.linalg.norm(up)
        camera.orthographic_width = float(2.0 * across * zoom)
        if abs(across - upright) > 1e-3 * across:
            size = np.array(sensor.film().crop_size(), float)
            camera.orthographic_height = float(2.0 * upright * zoom * size[1] / size[0])
    else:
        half = math.tan(math.radians(_number(parameters["x_fov"])) / 2.0)
        camera.fov = math.degrees(2.0 * math.atan(half * zoom))
        shift += _principal_point(sensor, parameters)
    camera.lens_shift = (float(shift[0]), float(shift[1]))
    if kind == "ThinLensCamera":
        warnings.add("Depth of field is left out, the camera becomes a pinhole: {names}.", camera.name)
    camera.mirrored = bool(np.linalg.det(matrix[:3, :3]) < 0)
    return camera


def _crop(sensor: Any) -> tuple[float, np.ndarray]:
    """Return the share of the film's width that its crop window shows, and the lens shift (2,) of its middle."""
    film = sensor.film()
    size, crop, offset = (np.array(value, float) for value in (film.size(), film.crop_size(), film.crop_offset()))
    # Pixels from the film's middle, y down, over half the window.
    middle = (offset + crop / 2.0 - size / 2.0) / (crop / 2.0)
    return float(crop[0] / size[0]), middle * (1.0, -1.0)


def _principal_point(sensor: Any, parameters: Any) -> np.ndarray:
    """Return the lens shift (2,) of a principal point off the centre; Mitsuba gives it in widths of the whole film."""
    keys = ("principal_point_offset_x", "principal_point_offset_y")
    offset = np.array([_number(parameters[key]) if key in parameters else 0.0 for key in keys])
    film = sensor.film()
    size, crop = (np.array(value, float) for value in (film.size(), film.crop_size()))
    return 2.0 * offset * size / crop * (1.0, -1.0)


def _number(value: Any) -> float:
    return float(np.array(value).ravel()[0])


def _camera_name(sensor: Any) -> str:
    """Return the sensor's id; Mitsuba makes up one with an underscore where the file gives none."""
    name = sensor.id()
    return name if name and not name.startswith("_") else "default"
