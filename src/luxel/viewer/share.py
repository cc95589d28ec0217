"""The view as text: the command line and the Python lines that make the same picture without a viewer."""

from __future__ import annotations

import math
import shlex
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from luxel.methods.own import SOURCES
from luxel.methods.params import find_method
from luxel.render.exposure import Exposure
from luxel.scene.choice import PICTURE_FILTER
from luxel.scene.edit import DEFAULT_SUN
from luxel.scene.model import Camera, Light
from luxel.viewer.stats import Facts

FRAMES = 64
DIGITS = 7
ROUNDING = 1e-9
"""Share of a camera's largest number under which another one is rounding."""


@dataclass(frozen=True)
class LaunchOptions:
    """What the session was started with."""

    scene: str
    """As on the command line."""
    options: dict[str, str] = field(default_factory=dict)
    """Scene options without their dashes: `sun`, `sky`, `envmap`, `animation`."""
    lights: tuple[Light, ...] = ()
    """Lights without a surface at the start."""
    glowing: tuple[tuple[int, str, tuple[float, float, float]], ...] = ()
    """Emissive materials at the start."""
    matrices: tuple[np.ndarray, ...] = ()
    """Objects' places at the start."""
    seed: int = 0
    pixel_filter: str = PICTURE_FILTER


@dataclass(frozen=True)
class SharedView:
    """One view to be told."""

    camera: Camera
    size: tuple[int, int]
    time: float
    exposure: Exposure = field(default_factory=Exposure)


def describe_launch(
    scene: str, options: dict[str, str], facts: Facts, seed: int = 0, pixel_filter: str = PICTURE_FILTER
) -> LaunchOptions:
    """Return what a session starts with, from its first facts."""
    places = tuple(item.matrix.copy() for item in facts.objects)
    return LaunchOptions(scene, options, facts.lights, facts.glowing, places, seed, pixel_filter)


def _method_text(name: str) -> str:
    """Return what names a method to another process: its word, or FILE.py:Class where it came from a file."""
    return str(SOURCES.get(name, name))


def _exposure_words(exposure: Exposure) -> list[str]:
    if exposure.factor is not None:
        return ["--exposure", f"{exposure.factor:.6g}"]
    return [f"--exposure={exposure.stops:+.6g}ev"] if exposure.stops else []


def write_command(launch: LaunchOptions, facts: Facts, view: SharedView) -> str:
    """Return the `luxel render` line of a view."""
    choice = facts.choice
    words = ["luxel", "render", launch.scene, "--method", _method_text(choice.method)]
    words += ["--preset", choice.preset] if choice.preset else []
    for key, value in choice.settings.items():
        words += ["--set", f"{key}={_setting(value)}"]
    words += ["--size", f"{view.size[0]}x{view.size[1]}", "--frames", str(FRAMES)]
    words += ["--seed", str(launch.seed)] if launch.seed else []
    # Methods that show no gloss need not be told.
    tells = facts.materials == "diffuse" and find_method(choice.method).shows_gloss
    words += ["--materials", "diffuse"] if tells else []
    words += ["--filter", launch.pixel_filter] if launch.pixel_filter != PICTURE_FILTER else []
    for name, value in launch.options.items():
        if name != "sun" or facts.lights == launch.lights:
            words += [f"--{name}", value]
    if _only_the_sun_moved(launch, facts) and facts.sun is not None:
        # A sharp sun's diameter goes without saying.
        parts = facts.sun if facts.sun[3] > 0.0 else facts.sun[:3]
        words += ["--sun", ",".join(f"{part:.6g}" for part in parts)]
    words += ["--camera=" + camera_text(view.camera)]
    words += ["--time", f"{view.time:.6g}"] if view.time else []
    words += _exposure_words(view.exposure)
    return " ".join(shlex.quote(word) for word in [*words, "-o", f"{picture_name(facts)}.png"])


def write_python(launch: LaunchOptions, facts: Facts, view: SharedView) -> str:
    """Return the Python lines of a view, hand-made changes of the scene included."""
    choice, camera = facts.choice, view.camera
    changes = _python_changes(launch, facts)
    lines = ["import luxel"]
    if changes.objects:
        lines += ["import numpy as np"]
    edits = {name: value for name, value in launch.options.items() if name != "animation"}
    if edits:
        lines += ["from luxel.scene import edit"]
    playing = f", animation={launch.options['animation']!r}" if "animation" in launch.options else ""
    lines += ["", f"scene = luxel.load({launch.scene!r}{playing})"]
    for name, value in edits.items():
        lines += [f"edit.apply_{name}(scene, {value!r})"]
    lines += changes.lights + changes.objects
    eye, target, up = (_numbers(vector, _digits(camera)) for vector in _vectors(camera))
    lines += [f"camera = luxel.Camera({eye}, {target}, {up}, fov={camera.fov:.6g})"]
    settings = {key: value for key, value in choice.settings.items()}
    preset = f", preset={choice.preset!r}" if choice.preset else ""
    seed = f", seed={launch.seed}" if launch.seed else ""
    seed += ", materials='full'" if facts.materials == "full" else ""
    lines += [
        f"renderer = luxel.Renderer(scene, {_method_text(choice.method)!r}, {settings!r}{preset}, "
        f"size={view.size}, camera=camera{seed}, filter={launch.pixel_filter!r})"
    ]
    if facts.light_scale != 1.0:
        lines += [f"renderer.set_light_scale({facts.light_scale:.6g})"]
    moment = f", time_of=lambda _: {view.time:.6g}" if view.time else ""
    lines += [f"renderer.run({FRAMES}{moment})"]
    shown = view.exposure
    factor = f" * 2.0**{shown.stops:.6g}" if shown.stops else ""
    exposure = f"renderer.auto_exposure(){factor}" if shown.factor is None else f"{shown.factor:.6g}"
    return "\n".join([*lines, f'luxel.write_image("{picture_name(facts)}.png", renderer.image(), {exposure})'])


def missing_in_command(launch: LaunchOptions, facts: Facts) -> list[str]:
    """Return what the command line cannot say of the scene as it is now."""
    missing = []
    if facts.lights != launch.lights and not _only_the_sun_moved(launch, facts):
        missing.append("changed lamps")
    if facts.glowing != launch.glowing:
        missing.append("changed glow")
    if _moved(launch, facts):
        missing.append("moved objects")
    if facts.light_scale != 1.0:
        missing.append("the scale of all light")
    return missing


def camera_text(camera: Camera) -> str:
    """Return a camera as `--camera` reads it; its up vector is taken to be +Y."""
    digits = _digits(camera)
    eye, target = (",".join(f"{axis:.{digits}g}" for axis in vector) for vector in _vectors(camera)[:2])
    return f"{eye};{target};{camera.fov:.7g}"


def picture_name(facts: Facts) -> str:
    """Return a file name without suffix for pictures of the scene and method."""
    stem = Path(facts.name.split(":")[0]).stem or "view"
    return f"{stem}-{facts.choice.method}"


@dataclass(frozen=True)
class _Changes:
    lights: list[str]
    objects: list[str]


def _python_changes(launch: LaunchOptions, facts: Facts) -> _Changes:
    lights = []
    if facts.lights != launch.lights:
        far = np.linalg.norm(facts.origin) / max(float(np.linalg.norm(facts.upper - facts.lower)), 1e-9)
        digits = DIGITS + math.ceil(math.log10(max(float(far), 1.0)))
        rows = ", ".join(_light_text(light, digits) for light in facts.lights)
        lights.append(f"scene.lights = [{rows}]")
    before = {index: emission for index, _, emission in launch.glowing}
    for index, _, emission in facts.glowing:
        if before.get(index) != emission:
            lights.append(f"scene.materials[{index}].emission = {_numbers(emission)}")
    objects = [
        f"scene.objects[{index}].to_world = np.array({np.round(facts.objects[index].matrix, 7).tolist()})"
        for index in _moved(launch, facts)
    ]
    return _Changes(lights, objects)


def _moved(launch: LaunchOptions, facts: Facts) -> list[int]:
    """Return the objects that a hand has placed; what an animation moves is where the time says."""
    return [index for index, item in enumerate(facts.objects) if item.held and index < len(launch.matrices)]


def _only_the_sun_moved(launch: LaunchOptions, facts: Facts) -> bool:
    def others(lights: tuple[Light, ...]) -> list[Light]:
        return [light for light in lights if light.kind != "directional" or light.in_sky]

    def tint(lights: tuple[Light, ...]) -> np.ndarray | None:
        suns = [np.asarray(light.color) for light in lights if light.kind == "directional" and not light.in_sky]
        return suns[0] / max(float(suns[0].max()), 1e-30) if len(suns) == 1 else None

    if facts.lights == launch.lights or others(facts.lights) != others(launch.lights):
        return False
    # `--sun` brings one sun, of the default tint.
    now = tint(facts.lights)
    return now is not None and bool(np.allclose(now, np.asarray(DEFAULT_SUN) / max(DEFAULT_SUN), atol=2e-3))


def _light_text(light: Light, digits: int) -> str:
    parts = [repr(light.kind), _numbers(light.color)]
    if light.kind != "directional":
        parts.append(f"position={_numbers(light.position, digits)}")
    if light.kind != "point":
        parts.append(f"direction={_numbers(light.direction)}")
    if light.angular_diameter > 0.0:
        parts.append(f"angular_diameter={light.angular_diameter:.7g}")
    if light.in_sky:
        parts.append("in_sky=True")
    if light.kind == "spot":
        parts.append(f"cos_inner={light.cos_inner:.7g}, cos_outer={light.cos_outer:.7g}")
        parts.append(f"spot_falloff={light.spot_falloff!r}")
    return f"luxel.Light({', '.join(parts)}, name={light.name!r})"


def _numbers(values: Any, digits: int = DIGITS) -> str:
    return "(" + ", ".join(f"{float(value):.{digits}g}" for value in values) + ")"


def _digits(camera: Camera) -> int:
    """Return the digits that tell a camera's places apart: more where it is further away than it looks."""
    reach = max(abs(axis) for axis in (*camera.eye, *camera.target))
    return DIGITS + max(math.floor(math.log10(max(reach / max(math.dist(camera.eye, camera.target), 1e-9), 1.0))), 0)


def _vectors(camera: Camera) -> list[list[float]]:
    """Return eye, target and up, with numbers that are nothing beside the others as 0."""
    reach = max(abs(axis) for axis in (*camera.eye, *camera.target))
    pairs = ((camera.eye, reach), (camera.target, reach), (camera.up, 1.0))
    return [[axis if abs(axis) > ROUNDING * scale else 0.0 for axis in vector] for vector, scale in pairs]


def _setting(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return ",".join(f"{part:g}" for part in value) if isinstance(value, tuple | list) else str(value)
