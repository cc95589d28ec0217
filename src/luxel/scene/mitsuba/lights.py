"""Mitsuba's emitters without a surface as lights."""

from __future__ import annotations

import math
from typing import Any

import mitsuba as mi
import numpy as np

from luxel.scene.mitsuba.materials import as_triple
from luxel.scene.mitsuba.sky import convert_sky
from luxel.scene.mitsuba.textures import children, colour_rows, surface_at
from luxel.scene.model import Colour, Light, Sky
from luxel.scene.warnings import Warnings


def convert_emitters(scene: Any, warnings: Warnings) -> tuple[list[Light], Sky]:
    """Return the lights and the sky of a `mi.Scene`; area emitters belong to their shapes' materials."""
    lights: list[Light] = []
    sky = Sky()
    for emitter in scene.emitters():
        kind = emitter.class_name()
        if kind in ("AreaLight", "DirectionalArea"):
            continue
        if emitter.is_environment():
            sky, sun = convert_sky(emitter, warnings)
            lights += sun
        elif kind in ("DirectionalEmitter", "PointLight", "SpotLight"):
            lights.append(_convert_light(emitter, kind, warnings))
        else:
            warnings.add("Emitters of these types are left out: {names}.", kind)
    return lights, sky


def _convert_light(emitter: Any, kind: str, warnings: Warnings) -> Light:
    """Return a directional, point or spot light."""
    parameters = mi.traverse(emitter)
    name = emitter.id() if not emitter.id().startswith("_") else ""
    if kind == "PointLight":
        place = np.array(parameters["position"], float).ravel()
        return Light("point", _read_colour(parameters, "intensity"), position=as_triple(place), name=name)
    matrix = np.array(parameters["to_world"].matrix, float).reshape(4, 4)
    length = float(np.linalg.norm(matrix[:3, 2]))
    direction = as_triple(matrix[:3, 2] / length)
    if kind == "DirectionalEmitter":
        # Mitsuba does not normalise the direction, so a `to_world` that scales makes the light brighter.
        red, green, blue = _read_colour(parameters, "irradiance")
        return Light("directional", (red * length, green * length, blue * length), direction=direction, name=name)
    filtered = np.multiply(_read_colour(parameters, "intensity"), _mean_filter(emitter))
    if "texture.value" not in parameters:
        warnings.add("The image that a spot light projects is left out, its mean colour stays.")
    lengths = np.linalg.norm(matrix[:3, :3], axis=0)
    if np.ptp(lengths) > 1e-3 * lengths.max():
        warnings.add("A spot's cone that its to_world stretches is read as round: {names}.", name or "spot")
    inner, outer = (math.radians(float(np.array(parameters[key]).ravel()[0])) for key in ("beam_width", "cutoff_angle"))
    return Light(
        "spot",
        as_triple(filtered),
        position=as_triple(matrix[:3, 3]),
        direction=direction,
        cos_inner=math.cos(inner),
        cos_outer=math.cos(outer),
        spot_falloff="linear-angle",
        name=name,
    )


def _mean_filter(emitter: Any) -> np.ndarray:
    """Return the mean colour (3,) of the image that a spot projects: the part within its cone, a circle of the uv."""
    image = dict(children(emitter)).get("texture")
    if image is None:
        return np.ones(3)
    side = (np.arange(64) + 0.5) / 64
    uv = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    uv = uv[np.linalg.norm(uv - 0.5, axis=1) < 0.5]
    return colour_rows(image.eval(surface_at(uv)), len(uv)).mean(axis=0)


def _read_colour(parameters: Any, slot: str) -> Colour:
    """Return a spectrum parameter as RGB; Mitsuba keeps one number for a grey."""
    for key in (f"{slot}.value", f"{slot}.radiance.value"):
        if key in parameters:
            values = np.array(parameters[key], float).ravel()
            return as_triple(values if len(values) == 3 else np.repeat(values[:1], 3))
    return (1.0, 1.0, 1.0)
