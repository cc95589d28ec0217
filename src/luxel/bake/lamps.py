"""The lights of a scene by name, and scenes in which some of them burn brighter, dimmer or not at all."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import replace

import numpy as np

from luxel.errors import LuxelError
from luxel.scene.model import Colour, SceneData
from luxel.scene.rules import BRIGHTEST

SKY = "sky"
"""The name of what comes from infinitely far away."""
NAMED = 12
"""Names of lights that a sentence lists."""


def name_lights(data: SceneData) -> list[str]:
    """Return the names of everything that sends light: lights, emissive materials in use, the sky.

    One without a name is called by its kind; where a name is taken, a number that is free stands behind it.
    """
    return list(_sources(data))


def list_lights(names: Collection[str]) -> str:
    """Return the names as a sentence lists them: the first `NAMED`, and how many more there are."""
    listed = ", ".join(f"'{name}'" for name in list(names)[:NAMED]) or "none"
    return f"{listed} and {len(names) - NAMED} more" if len(names) > NAMED else listed


def scale_lights(data: SceneData, factors: dict[str, float]) -> SceneData:
    """Return the scene with the named lights' power multiplied; others stay as they are.

    Raises LuxelError for an unknown name, or a factor that is negative or above 1e9.
    """
    sources = _sources(data)
    lights, materials, sky = list(data.lights), list(data.materials), data.sky
    for name, factor in factors.items():
        if name not in sources:
            raise LuxelError(f"{data.name} has no light '{name}'; its lights: {list_lights(sources)}")
        if not 0.0 <= factor <= BRIGHTEST:
            raise LuxelError(f"light '{name}': {factor} is no factor of its power; give one from 0 to {BRIGHTEST:g}")
        kind, index = sources[name]
        if kind == "light":
            lights[index] = replace(lights[index], color=_times(lights[index].color, factor))
        elif kind == "material":
            materials[index] = replace(materials[index], emission=_times(materials[index].emission, factor))
        else:
            sky = replace(sky, color=_times(sky.color, factor))
    return replace(data, lights=lights, materials=materials, sky=sky, mitsuba_full=None)


def only_light(data: SceneData, name: str) -> SceneData:
    """Return the scene with light `name` alone."""
    return scale_lights(data, {other: 0.0 for other in name_lights(data) if other != name})


def parse_lights(texts: list[str] | None) -> dict[str, float]:
    """Return the `NAME=FACTOR` texts as a dict. Raises LuxelError for one that is not of that form."""
    result: dict[str, float] = {}
    for text in texts or []:
        name, _, value = text.rpartition("=")
        try:
            factor = float(value)
        except ValueError:
            factor = math.nan
        if not name or not math.isfinite(factor):
            raise LuxelError(f"--light {text} is not NAME=FACTOR, such as lamp=0.5")
        result[name.strip()] = factor
    return result


def _sources(data: SceneData) -> dict[str, tuple[str, int]]:
    """Return (kind, index) of each source, by name."""
    used = {mesh.material for item in data.objects for mesh in item.meshes}
    found = [(light.name or light.kind, "light", index) for index, light in enumerate(data.lights)]
    found += [
        (item.name or "emissive", "material", index)
        for index, item in enumerate(data.materials)
        if index in used and max(item.emission) > 0.0
    ]
    if max(data.sky.color) > 0.0:
        found.append((SKY, "sky", 0))
    wishes = {wish for wish, _, _ in found}
    named: dict[str, tuple[str, int]] = {}
    for wish, kind, index in found:
        name, number = wish, 1
        while name in named or (number > 1 and name in wishes):
            number += 1
            name = f"{wish}-{number}"
        named[name] = kind, index
    return named


def _times(color: Colour, factor: float) -> Colour:
    red, green, blue = (float(channel) for channel in np.asarray(color) * factor)
    return red, green, blue
