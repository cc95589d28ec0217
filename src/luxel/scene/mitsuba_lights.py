"""Mitsuba's emitters without a surface: lights, and a sky baked from whatever surrounds the scene."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.scene.mitsuba_materials import Warnings, as_triple
from luxel.scene.model import Colour, Light, Sky

PROCEDURAL_SKY_HEIGHT = 256
"""Rows of the image that a computed sky is baked to."""
MAX_SKY_HEIGHT = 1024


def convert_emitters(scene: Any, warnings: Warnings) -> tuple[list[Light], Sky]:
    """Return the lights and the sky of a `mi.Scene`; area emitters belong to their shapes' materials."""
    lights: list[Light] = []
    sky = Sky()
    for emitter in scene.emitters():
        kind = emitter.class_name()
        if kind in ("AreaLight", "DirectionalArea"):
            continue
        if kind == "ConstantBackgroundEmitter":
            sky = Sky(as_triple(_evaluate(emitter, np.array([(0.0, 1.0, 0.0)]))[0]))
        elif kind == "SunskyEmitter":
            image, sun = _split_sun(emitter)
            sky = Sky((1.0, 1.0, 1.0), image=image)
            lights += sun
        elif emitter.is_environment():
            sky = Sky((1.0, 1.0, 1.0), image=_bake_sky(emitter))
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
    direction = as_triple(matrix[:3, 2] / np.linalg.norm(matrix[:3, 2]))
    if kind == "DirectionalEmitter":
        return Light("directional", _read_colour(parameters, "irradiance"), direction=direction, name=name)
    if "texture.value" not in parameters or not np.allclose(np.array(parameters["texture.value"]), 1.0):
        warnings.add("The image that a spot light projects is left out.")
    inner, outer = (math.radians(float(np.array(parameters[key]).ravel()[0])) for key in ("beam_width", "cutoff_angle"))
    return Light(
        "spot",
        _read_colour(parameters, "intensity"),
        position=as_triple(matrix[:3, 3]),
        direction=direction,
        cos_inner=math.cos(inner),
        cos_outer=math.cos(outer),
        name=name,
    )


def _read_colour(parameters: Any, slot: str) -> Colour:
    """Return a spectrum parameter as RGB; Mitsuba keeps one number for a grey."""
    for key in (f"{slot}.value", f"{slot}.radiance.value"):
        if key in parameters:
            values = np.array(parameters[key], float).ravel()
            return as_triple(values if len(values) == 3 else np.repeat(values[:1], 3))
    return (1.0, 1.0, 1.0)


# --- the sky -------------------------------------------------------------------------------------------------------


def _bake_sky(emitter: Any) -> np.ndarray:
    """Return the emitter's radiance as the (H, W, 3) float32 latitude-longitude image that `Sky` describes."""
    parameters = mi.traverse(emitter)
    height, width = PROCEDURAL_SKY_HEIGHT, 2 * PROCEDURAL_SKY_HEIGHT
    if "data" in parameters:
        # Mitsuba repeats a column on either side.
        height, width = int(parameters["data"].shape[0]), int(parameters["data"].shape[1]) - 2
    over = max(1, -(-height // MAX_SKY_HEIGHT))
    height, width = max(1, height // over), max(1, width // over)
    polar = (np.arange(height) + 0.5) / height * math.pi
    azimuth = ((np.arange(width) + 0.5) / width - 0.5) * 2 * math.pi
    theta, phi = np.meshgrid(polar, azimuth, indexing="ij")
    towards = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi)], axis=-1)
    radiance = _evaluate(emitter, towards.reshape(-1, 3))
    return np.ascontiguousarray(radiance.reshape(height, width, 3), np.float32)


def _split_sun(emitter: Any) -> tuple[np.ndarray, list[Light]]:
    """Return the sky without the sun's disc, and the disc as a directional light; the emitter is left as it was."""
    parameters = mi.traverse(emitter)
    sun_scale, sky_scale = float(parameters["sun_scale"]), float(parameters["sky_scale"])
    parameters["sun_scale"] = 0.0
    parameters.update()
    image = _bake_sky(emitter)
    parameters["sun_scale"], parameters["sky_scale"] = sun_scale, 0.0
    parameters.update()
    matrix = np.array(parameters["to_world"].matrix, float).reshape(4, 4)[:3, :3]
    to_sun = matrix @ np.array(parameters["sun_direction"], float).ravel()
    to_sun /= np.linalg.norm(to_sun)
    # The disc's half angle is about 0.27 degrees; a cone of 2 degrees holds discs of any usual aperture.
    irradiance = _cone_irradiance(emitter, to_sun, math.radians(2.0)) if sun_scale > 0 else np.zeros(3)
    parameters["sky_scale"] = sky_scale
    parameters.update()
    if irradiance.max() <= 0:
        return image, []
    return image, [Light("directional", as_triple(irradiance), direction=as_triple(-to_sun), name="sun")]


def _cone_irradiance(emitter: Any, axis: np.ndarray, half_angle: float) -> np.ndarray:
    """Return the irradiance (3,) on a plane facing `axis` from within `half_angle` of it, by a fine polar grid."""
    radii, turns = 400, 64
    theta = (np.arange(radii) + 0.5) / radii * half_angle
    phi = (np.arange(turns) + 0.5) / turns * 2 * math.pi
    helper = np.array([0.0, 0.0, 1.0]) if abs(axis[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    side = np.cross(axis, helper)
    side /= np.linalg.norm(side)
    other = np.cross(axis, side)
    t, p = np.meshgrid(theta, phi, indexing="ij")
    around = np.cos(p)[..., None] * side + np.sin(p)[..., None] * other
    towards = np.cos(t)[..., None] * axis + np.sin(t)[..., None] * around
    solid_angle = np.sin(t) * (half_angle / radii) * (2 * math.pi / turns)
    radiance = _evaluate(emitter, towards.reshape(-1, 3)).reshape(radii, turns, 3)
    return (radiance * (solid_angle * np.cos(t))[..., None]).sum(axis=(0, 1))


def _evaluate(emitter: Any, towards: np.ndarray) -> np.ndarray:
    """Return the radiance (N, 3) that arrives from the directions `towards` (N, 3)."""
    si = dr.zeros(mi.SurfaceInteraction3f, len(towards))
    si.wi = mi.Vector3f(*(mi.Float(np.ascontiguousarray(-towards[:, axis], np.float32)) for axis in range(3)))
    radiance = np.array(emitter.eval(si)).reshape(3, -1).T
    return np.broadcast_to(np.maximum(np.nan_to_num(radiance), 0.0), (len(towards), 3))
