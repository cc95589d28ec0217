"""What surrounds a Mitsuba scene: a sky baked from its environment emitter, and the suns found in it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.scene.arrays import from_numpy, vectors_from_numpy
from luxel.scene.edit import WIDEST_SUN
from luxel.scene.mitsuba.materials import as_triple
from luxel.scene.model import Light, Sky
from luxel.scene.sky_image import repair_sky_image
from luxel.scene.sky_suns import SUN_NAME, cut_suns, equal_rows, sky_lights
from luxel.scene.warnings import Warnings

CUT_SUN = math.radians(2.5)
"""Half angle up to which a sun that the horizon cuts counts as a whole one of the same light."""
PROCEDURAL_SKY_HEIGHT = 256
"""Rows of the image that a computed sky is baked to."""
MAX_SKY_HEIGHT = 1024
WIDE_SUN = math.radians(0.5 * WIDEST_SUN)
"""Half angle of a sun's disc beyond which it stays in the sky."""


def convert_sky(emitter: Any, warnings: Warnings) -> tuple[Sky, list[Light]]:
    """Return the sky of an environment emitter, and the suns that were parted from it; both are as they shine."""
    kind = emitter.class_name()
    if kind == "ConstantBackgroundEmitter":
        return Sky(as_triple(_evaluate(emitter, np.array([(0.0, 1.0, 0.0)]))[0])), []
    parameters = mi.traverse(emitter)
    scales = False
    if "to_world" in parameters:
        matrix = _turn(parameters)
        scales = not np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-3)
    if scales:
        warnings.add("A sky's to_world that scales is read as Mitsuba shows the sky; its light may differ.")
    if "data" in parameters:
        _repair(emitter, parameters, warnings)
    if kind == "SunskyEmitter":
        image, suns = _split_sun(emitter, parameters)
    elif "data" in parameters and not scales:
        image, suns = _split_image(parameters, lambda: _bake_sky(emitter, parameters))
    else:
        # An image that is scaled is not turned as a whole: its suns are where they show.
        image = _bake_sky(emitter, parameters)
        image, suns = cut_suns(image, *equal_rows(*image.shape[:2]))
    sky = Sky((1.0, 1.0, 1.0), image=image, suns=suns)
    return sky, sky_lights(sky)


def _repair(emitter: Any, parameters: Any, warnings: Warnings) -> None:
    """Mend the image of an `envmap` in place. Raises `LuxelError` where it gives no light."""
    stored = np.array(parameters["data"], np.float32)
    if np.isfinite(stored).all() and stored.min() >= 0.0 and stored.max() > 0.0:
        return
    # Mitsuba repeats a column on either side.
    inner, mended = repair_sky_image(stored[:, 1:-1, :3], f"Sky image of emitter '{emitter.id() or 'envmap'}'")
    stored[..., :3] = np.concatenate([inner[:, -1:], inner, inner[:, :1]], axis=1)
    _set_image(parameters, np.nan_to_num(stored))
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


def _split_image(parameters: Any, bake: Callable[[], np.ndarray]) -> tuple[np.ndarray, list[Light]]:
    """Return the sky of an `envmap` without its suns, and these as lights; the emitter is left as it was.

    They are cut out of the file's own pixels, which a turn would blur.
    """
    stored = np.array(parameters["data"], np.float32)
    # Mitsuba repeats a column on either side. Its first and last row are the poles, and between the middles of pixels
    # it blends: a pixel counts by the solid angle of the tent over it.
    inner = stored[:, 1:-1, :3]
    height, width = inner.shape[:2]
    if height < 3:
        return bake(), []
    step = math.pi / (height - 1)
    polar = np.arange(height) * step
    tent = 2.0 * np.sin(polar) * (1.0 - math.cos(step)) / step
    tent[[0, -1]] = 1.0 - math.sin(step) / step
    left, suns = cut_suns(inner, polar, tent * (2.0 * math.pi / width))
    if not suns:
        return bake(), []
    cut = stored.copy()
    cut[..., :3] = np.concatenate([left[:, -1:], left, left[:, :1]], axis=1)
    _set_image(parameters, cut)
    image = bake()
    _set_image(parameters, stored)
    matrix = _turn(parameters)
    scale = float(np.array(parameters["scale"]).ravel()[0])
    for sun in suns:
        # Its left edge looks along -Z, ours along +Z.
        travels = matrix @ (np.asarray(sun.direction) * (-1.0, 1.0, -1.0))
        sun.direction = as_triple(travels / np.linalg.norm(travels))
        sun.color = as_triple(np.asarray(sun.color) * scale)
    return image, suns


def _turn(parameters: Any) -> np.ndarray:
    """Return the (3, 3) part of to_world."""
    return np.array(parameters["to_world"].matrix, float).reshape(4, 4)[:3, :3]


def _set_image(parameters: Any, pixels: np.ndarray) -> None:
    parameters["data"] = from_numpy(mi.TensorXf, pixels)
    parameters.update()


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
    first, second = (from_numpy(mi.Float, axis) for axis in np.meshgrid(grid, grid))
    point = dr.zeros(mi.Interaction3f, side * side)
    sample, weight = emitter.sample_direction(point, mi.Point2f(first, second))
    towards = np.array(sample.d, float).T
    weights = np.nan_to_num(np.array(weight, float).T, posinf=0.0) / (side * side)
    total = weights.sum(axis=1) @ towards
    if weights.max() <= 0.0 or np.linalg.norm(total) == 0.0:
        return None
    to_sun = total / np.linalg.norm(total)
    lit = weights.max(axis=1) > 0.0
    unit = towards[lit] / np.linalg.norm(towards[lit], axis=1, keepdims=True)
    # The outermost samples lie half a cell of the grid inside the disc's edge.
    chord = float(np.linalg.norm(unit - to_sun, axis=1).max()) / (1.0 - 1.0 / side)
    radius = 2.0 * math.asin(min(0.5 * chord, 1.0))
    if radius > WIDE_SUN:
        return None
    # The horizon cuts a low wide sun, and what is left of it is no disc.
    mean_height = 1.0 - float((unit @ to_sun).mean())
    if radius > CUT_SUN and abs(2.0 * mean_height / (1.0 - math.cos(radius)) - 1.0) > 0.02:
        return None
    irradiance = (weights * (towards @ to_sun)[:, None]).sum(axis=0)
    return Light(
        "directional",
        as_triple(irradiance),
        direction=as_triple(-to_sun),
        angular_diameter=math.degrees(2.0 * radius),
        in_sky=True,
        name=SUN_NAME,
    )


def _evaluate(emitter: Any, towards: np.ndarray) -> np.ndarray:
    """Return the radiance (N, 3) that arrives from the directions `towards` (N, 3)."""
    si = dr.zeros(mi.SurfaceInteraction3f, len(towards))
    si.wi = vectors_from_numpy(mi.Vector3f, -towards)
    radiance = np.array(emitter.eval(si)).reshape(3, -1).T
    return np.broadcast_to(np.maximum(np.nan_to_num(radiance), 0.0), (len(towards), 3))
