"""All light sources as tables: delta lights, emissive triangles with an alias table, and the sky."""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.scene.alias import build_alias_table
from luxel.scene.arrays import to_floats
from luxel.scene.model import Light, SceneData
from luxel.scene.sky_table import LUMINANCE, SkyTable, build_sky_table
from luxel.scene.textures import FLAG_EMIT_BACK, MaterialTables, mean_emission_texture

DELTA_EACH_LIMIT = 8
"""Up to so many delta lights get a shadow ray of their own each frame; more are sampled with the triangles."""
KINDS = {"directional": 0.0, "point": 1.0, "spot": 2.0}
ENTRY_IS_DELTA = 0x80000000


@dataclass
class LightTables:
    """What the light sampler and the sky read."""

    delta: mi.Float
    """(L, 16): position, kind | unit direction, range | colour, 0 | cos inner, cos outer, and where the
    fall-off is linear in the angle: inner, outer (radians; else 0, 0). Of a directional light the last four are
    1 - cos of its disc's angular radius, 0, 0, 0."""
    soft_suns: bool
    """Whether a directional light is wider than one direction."""
    discs: mi.Float
    """(D, 8), of each sun that the sky shows: unit vector to it, 1 - cos of its angular radius | radiance, 0."""
    disc_count: int
    delta_each: int
    """How many delta lights (the first ones) are evaluated each; the others are among `entries`."""
    delta_count: int
    entries: mi.UInt32
    """Sampled sources: a triangle, or a delta light with the high bit set."""
    probabilities: mi.Float
    """Of each entry, by power."""
    alias: mi.Float
    """(E, 2): threshold, partner (Walker's alias method)."""
    entry_count: int
    sky_color: mi.Color3f
    sky_image: mi.Float
    """(H, W, 4) latitude-longitude radiance, or one row of ones."""
    sky_width: int
    sky_height: int
    sky_rotation: mi.Float
    """Radians about +Y."""
    sky_table: SkyTable
    """How the sky's image is sampled."""
    has_sky: bool
    scale: mi.Float
    """Multiplies every source, sky and emission included: a run-time value."""


def build_light_tables(
    data: SceneData, materials: MaterialTables, triangles: np.ndarray, areas: np.ndarray
) -> LightTables:
    """Return the tables; `triangles` is (F, 4) as in `Geometry`, `areas` (F,) in m^2."""
    delta = _delta_rows(data.lights, 0.0)
    each = len(data.lights) if len(data.lights) <= DELTA_EACH_LIMIT else 0
    entries, powers = _emissive_triangles(data, materials, triangles, areas)
    if not each and data.lights:
        surplus = np.arange(len(data.lights), dtype=np.int64)
        entries = np.concatenate([entries, surplus | ENTRY_IS_DELTA])
        powers = np.concatenate([powers, _delta_powers(data.lights, areas)])
    if not powers.any():
        # Lamps that are all out.
        entries, powers = entries[:0], powers[:0]
    probabilities = powers / powers.sum() if len(powers) else np.ones(1)
    image = data.sky.image
    height, width = image.shape[:2] if image is not None else (1, 1)
    pixels = np.ones((height, width, 4), np.float32)
    if image is not None:
        pixels[..., :3] = np.nan_to_num(image[..., :3], posinf=65504.0)
    return LightTables(
        delta=to_floats(delta),
        soft_suns=any(light.kind == "directional" and light.angular_diameter > 0.0 for light in data.lights),
        discs=to_floats(_disc_rows(data.lights, 0.0)),
        disc_count=sum(map(_has_disc, data.lights)),
        delta_each=each,
        delta_count=len(data.lights),
        entries=mi.UInt32(entries.astype(np.uint32) if len(entries) else np.zeros(1, np.uint32)),
        probabilities=mi.Float(probabilities.astype(np.float32)),
        alias=mi.Float(build_alias_table(probabilities).astype(np.float32).ravel()),
        entry_count=len(entries),
        sky_color=mi.Color3f(*(dr.opaque(mi.Float, float(c)) for c in data.sky.color)),
        sky_image=mi.Float(pixels.ravel()),
        sky_width=width,
        sky_height=height,
        sky_rotation=dr.opaque(mi.Float, float(np.deg2rad(data.sky.rotation))),
        sky_table=build_sky_table(image),
        has_sky=max(data.sky.color) > 0.0,
        scale=dr.opaque(mi.Float, 1.0),
    )


def refresh_delta_lights(tables: LightTables, lights: list[Light], time: float) -> None:
    """Move the delta lights to `time`."""
    if any(light.motion is not None for light in lights):
        tables.delta = to_floats(_delta_rows(lights, time))
        tables.discs = to_floats(_disc_rows(lights, time))


def _delta_rows(lights: list[Light], time: float) -> np.ndarray:
    rows = np.zeros((max(len(lights), 1), 16), np.float32)
    for row, light in zip(rows, lights, strict=False):
        position, direction = np.asarray(light.position, float), np.asarray(light.direction, float)
        if light.motion is not None:
            matrix = light.motion(time)
            position = matrix[:3, :3] @ position + matrix[:3, 3]
            direction = matrix[:3, :3] @ direction
        direction = direction / max(float(np.linalg.norm(direction)), 1e-12)
        row[:4] = [*position, KINDS[light.kind]]
        row[4:8] = [*direction, min(light.range, 1e18)]
        row[8:11] = light.color
        row[12:14] = light.cos_inner, light.cos_outer
        if light.kind == "directional":
            row[12:14] = _versine(light), 0.0
        if light.kind == "spot" and light.spot_falloff == "linear-angle":
            row[14:16] = np.arccos(np.clip((light.cos_inner, light.cos_outer), -1.0, 1.0))
    return rows


def _has_disc(light: Light) -> bool:
    return light.kind == "directional" and light.in_sky and light.angular_diameter > 0.0


def _versine(light: Light) -> float:
    """Return 1 - cos of a sun's angular radius."""
    return 2.0 * math.sin(0.25 * math.radians(light.angular_diameter)) ** 2


def _disc_rows(lights: list[Light], time: float) -> np.ndarray:
    suns = [light for light in lights if _has_disc(light)]
    rows = np.zeros((max(len(suns), 1), 8), np.float32)
    for row, sun, delta in zip(rows, suns, _delta_rows(suns, time), strict=False):
        row[:4] = [*-delta[4:7], delta[12]]
        # E = pi L sin^2 r.
        row[4:7] = np.asarray(sun.color) / (math.pi * math.sin(0.5 * math.radians(sun.angular_diameter)) ** 2)
    return rows


def _emissive_triangles(
    data: SceneData, materials: MaterialTables, triangles: np.ndarray, areas: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the triangles that emit and their power (luminance)."""
    flags = np.array(materials.slots, np.uint32).reshape(-1, 8)[:, 4]
    power_of = np.zeros(len(data.materials))
    for index, material in enumerate(data.materials):
        sides = 2.0 if flags[index] & FLAG_EMIT_BACK else 1.0
        if max(material.emission) > 0.0:
            power_of[index] = sides * luminance(np.asarray(material.emission) * mean_emission_texture(material))
            # A texture that is black on average over the image may still be bright where the triangle lies.
            power_of[index] = max(power_of[index], 1e-3 * luminance(np.asarray(material.emission)))
    power = np.pi * areas * power_of[triangles[:, 3] & 0xFFFF]
    chosen = np.flatnonzero(power > 0.0)
    return chosen, power[chosen]


def _delta_powers(lights: list[Light], areas: np.ndarray) -> np.ndarray:
    solid_angle = {"point": 4.0 * np.pi, "spot": np.pi, "directional": 0.25 * float(areas.sum())}
    return np.array([luminance(np.asarray(light.color)) * solid_angle[light.kind] for light in lights])


def luminance(color: np.ndarray) -> float:
    """Return the Rec. 709 luminance of a colour (3,)."""
    return float(np.dot(color, LUMINANCE))
