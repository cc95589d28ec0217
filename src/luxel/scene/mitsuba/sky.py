"""What surrounds a Mitsuba scene: a sky baked from its environment emitter, and the sun found in it."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.scene.mitsuba.materials import as_triple
from luxel.scene.model import Light, Sky
from luxel.scene.sky_image import repair_sky_image
from luxel.scene.warnings import Warnings

PROCEDURAL_SKY_HEIGHT = 256
"""Rows of the image that a computed sky is baked to."""
MAX_SKY_HEIGHT = 1024
WIDE_SUN = math.radians(8.0)
"""Half angle of a sun's disc beyond which its light is no longer that of one direction: it stays in the sky."""


def convert_sky(emitter: Any, warnings: Warnings) -> tuple[Sky, list[Light]]:
    """Return the sky of an environment emitter, and the sun that was parted from it."""
    kind = emitter.class_name()
    if kind == "ConstantBackgroundEmitter":
        return Sky(as_triple(_evaluate(emitter, np.array([(0.0, 1.0, 0.0)]))[0])), []
    parameters = mi.traverse(emitter)
    if "to_world" in parameters:
        matrix = np.array(parameters["to_world"].matrix, float).reshape(4, 4)[:3, :3]
        if not np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-3):
            warnings.add("A sky's to_world that scales is read as Mitsuba shows the sky; its light may differ.")
    if kind == "SunskyEmitter":
        image, sun = _split_sun(emitter, parameters)
    else:
        _repair(emitter, parameters, warnings)
        image, sun = _bake_sky(emitter, parameters), []
    return Sky((1.0, 1.0, 1.0), image=image), sun


def _repair(emitter: Any, parameters: Any, warnings: Warnings) -> None:
    """Mend the image of an `envmap` in place. Raises `LuxelError` where it gives no light."""
    if "data" not in parameters:
        return
    stored = np.array(parameters["data"], np.float32)
    if np.isfinite(stored).all() and stored.min() >= 0.0 and stored.max() > 0.0:
        return
    # Mitsuba repeats a column on either side.
    inner, mended = repair_sky_image(stored[:, 1:-1, :3], f"Sky image of emitter '{emitter.id() or 'envmap'}'")
    stored[..., :3] = np.concatenate([inner[:, -1:], inner, inner[:, :1]], axis=1)
    parameters["data"] = mi.TensorXf(np.nan_to_num(stored))
    parameters.update()
    for sentence in mended:
        warnings.add(sentence)


def _bake_sky(emitter: Any, parameters: Any) -> np.ndarray:
    """Return the emitter's radiance as the (H, W, 3) float32 latitude-longitude image that `Sky` describes.

    Each pixel is the mean of four points, and an image is read on a grid twice as fine as its own, which a turned or
    shifted one would blur.
    """
    height, width = PROCEDURAL_SKY_HEIGHT, 2 * PROCEDURAL_SKY_HEIGHT
    if "data" in parameters:
        # Mitsuba repeats a column on either side.
        height, width = 2 * int(parameters["data"].shape[0]), 2 * (int(parameters["data"].shape[1]) - 2)
    over = max(1, -(-height // MAX_SKY_HEIGHT))
    height, width = max(1, height // over), max(1, width // over)
    over = max(over, 2)
    bands = []
    for row in range(0, height, 64):
        count = min(64, height - row)
        polar = (np.arange(row * over, (row + count) * over) + 0.5) / (height * over) * math.pi
        azimuth = ((np.arange(width * over) + 0.5) / (width * over) - 0.5) * 2 * math.pi
        theta, phi = np.meshgrid(polar, azimuth, indexing="ij")
        towards = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi)], axis=-1)
        radiance = _evaluate(emitter, towards.reshape(-1, 3))
        bands.append(radiance.reshape(count, over, width, over, 3).mean(axis=(1, 3)))
    return np.ascontiguousarray(np.concatenate(bands), np.float32)


def _split_sun(emitter: Any, parameters: Any) -> tuple[np.ndarray, list[Light]]:
    """Return the sky without the sun's disc, and the disc as a directional light; the emitter is left as it was."""
    sun_scale, sky_scale = float(parameters["sun_scale"]), float(parameters["sky_scale"])
    light = None
    if sun_scale > 0.0:
        _set_scales(parameters, sun_scale, 0.0)
        light = _find_sun(emitter)
        _set_scales(parameters, 0.0 if light is not None else sun_scale, sky_scale)
    image = _bake_sky(emitter, parameters)
    _set_scales(parameters, sun_scale, sky_scale)
    return image, [] if light is None else [light]


def _set_scales(parameters: Any, sun: float, sky: float) -> None:
    parameters["sun_scale"], parameters["sky_scale"] = sun, sky
    parameters.update()


def _find_sun(emitter: Any) -> Light | None:
    """Return the light of an emitter whose sky is dark, found by its own sampling: whatever its parameters mean.

    None where it is black, or too wide to be one direction.
    """
    side = 128
    grid = (np.arange(side, dtype=np.float32) + 0.5) / side
    first, second = (np.ascontiguousarray(axis.ravel()) for axis in np.meshgrid(grid, grid))
    point = dr.zeros(mi.Interaction3f, side * side)
    sample, weight = emitter.sample_direction(point, mi.Point2f(mi.Float(first), mi.Float(second)))
    towards = np.array(sample.d, float).T
    weights = np.nan_to_num(np.array(weight, float).T, posinf=0.0) / (side * side)
    total = weights.sum(axis=1) @ towards
    if weights.max() <= 0.0 or np.linalg.norm(total) == 0.0:
        return None
    to_sun = total / np.linalg.norm(total)
    lit = weights.max(axis=1) > 0.0
    unit = towards[lit] / np.linalg.norm(towards[lit], axis=1, keepdims=True)
    if math.acos(min(float((unit @ to_sun).min()), 1.0)) > WIDE_SUN:
        return None
    irradiance = (weights * (towards @ to_sun)[:, None]).sum(axis=0)
    return Light("directional", as_triple(irradiance), direction=as_triple(-to_sun), name="sun")


def _evaluate(emitter: Any, towards: np.ndarray) -> np.ndarray:
    """Return the radiance (N, 3) that arrives from the directions `towards` (N, 3)."""
    si = dr.zeros(mi.SurfaceInteraction3f, len(towards))
    si.wi = mi.Vector3f(*(mi.Float(np.ascontiguousarray(-towards[:, axis], np.float32)) for axis in range(3)))
    radiance = np.array(emitter.eval(si)).reshape(3, -1).T
    return np.broadcast_to(np.maximum(np.nan_to_num(radiance), 0.0), (len(towards), 3))
