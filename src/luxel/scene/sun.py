"""The sun by angles and by the hour."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from luxel.errors import LuxelError
from luxel.scene.edit import DEFAULT_SUN, WIDEST_SUN, apply_sun
from luxel.scene.model import Light, SceneData
from luxel.scene.rules import BRIGHTEST, is_number

NIGHT = 1e-9
"""W/m^2 of a sun that is out."""


def with_sun(
    data: SceneData, azimuth: float, elevation: float, strength: float | None = None, diameter: float | None = None
) -> list[Light]:
    """Return the lights of `data` with one sun in place of its directional ones, of the tint that they had.

    Angles in degrees as in `edit.apply_sun`; strength in W/m^2 of its strongest channel, diameter of its disc in
    degrees, None: as before. Suns that are part of the sky stay. Raises LuxelError for a sun that cannot be.
    """
    before = sun_angles(data)
    strength = (max(DEFAULT_SUN) if before is None else before[2]) if strength is None else strength
    diameter = (0.0 if before is None else before[3]) if diameter is None else diameter
    given = {"azimuth": azimuth, "elevation": elevation, "strength": strength, "diameter": diameter}
    for name, value in given.items():
        if not is_number(value):
            raise LuxelError(f"the sun's {name} cannot be {value}: give a finite number")
    if not -90.0 <= elevation <= 90.0:
        raise LuxelError(f"the sun's elevation cannot be {elevation:g}: give degrees from -90 to 90")
    if not 0.0 <= strength <= BRIGHTEST:
        raise LuxelError(f"the sun's strength cannot be {strength:g}: give W/m^2 from 0 to {BRIGHTEST:g}")
    if not 0.0 <= diameter <= WIDEST_SUN:
        raise LuxelError(f"the sun's diameter cannot be {diameter:g}: give degrees from 0 to {WIDEST_SUN:g}")
    # A sun that is out keeps a trace of light, and with it its tint for the next morning.
    strength = max(strength, NIGHT)
    lights = apply_sun(replace(data), f"{azimuth},{elevation},{strength},{diameter}").lights
    suns = _suns(data)
    if suns and max(suns[0].color) > 0.0:
        tint = np.asarray(suns[0].color) / max(suns[0].color)
        red, green, blue = (float(strength * channel) for channel in tint)
        lights[-1].color = (red, green, blue)
    return lights


def sun_angles(data: SceneData) -> tuple[float, float, float, float] | None:
    """Return azimuth and elevation, strength in W/m^2 and diameter of the first sun that is no part of the sky.

    Angles in degrees; None without one.
    """
    for light in _suns(data):
        x, y, z = -np.asarray(light.direction) / np.linalg.norm(light.direction)
        azimuth = math.degrees(math.atan2(x, z)) % 360.0
        elevation = math.degrees(math.asin(float(np.clip(y, -1.0, 1.0))))
        return azimuth, elevation, max(light.color), light.angular_diameter
    return None


def _suns(data: SceneData) -> list[Light]:
    return [light for light in data.lights if light.kind == "directional" and not light.in_sky]


def sun_at_hour(hour: float) -> tuple[float, float, float]:
    """Return azimuth, elevation (degrees) and strength (W/m^2) of a plain sun at `hour`, 0..24.

    It rises in the east (+X) at 6, stands 60 degrees high in the south (+Z) at 12 and sets at 18; a thicker air dims it
    near the horizon. No place on earth is meant.
    """
    turn = (hour - 12.0) / 12.0 * math.pi
    elevation = 60.0 * math.cos(turn)
    azimuth = (90.0 - 90.0 * (hour - 6.0) / 6.0) % 360.0
    height = max(math.sin(math.radians(elevation)), 0.0)
    strength = max(DEFAULT_SUN) * math.exp(-0.15 * (1.0 / max(height, 0.05) - 1.0)) if height > 0.0 else 0.0
    return azimuth, elevation, strength
