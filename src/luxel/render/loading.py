"""From a name, a file or a choice to a scene that can be seen: what `luxel.load` and every command call.

Reading is `luxel.scene.load`. What it cannot decide alone is whether the glowing surfaces of a file light it, or are
mere signs of it such as a 2 cm LED: that takes a small render. Built-in scenes, and files with a lamp or a sky of their
own or with nothing that glows, need none.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from luxel import scene as scenes
from luxel.scene.choice import SceneChoice
from luxel.scene.diffuse import as_diffuse
from luxel.scene.edit import (
    add_default_light,
    apply_envmap,
    apply_sky,
    apply_sun,
    default_camera,
    has_glow,
    has_own_light,
    parse_camera,
)
from luxel.scene.model import Material, SceneData

JUDGE_SIZE, JUDGE_SPP, JUDGE_SEED = 64, 16, 0x11D5
"""Pixels of a side, paths a pixel, and the seed of the render that decides."""
TOO_DARK = 1e-4
"""Radiance over the brightest emitter's, below which the glow does not count as the scene's light."""
GLOWS = 1e-2
"""The same ratio, from which a pixel shows a glowing surface: black texels of a JPEG are not quite black."""
ONLY_GLOW = "The scene is dark but for its glowing surfaces"


def load(path_or_name: str | Path, *, animation: str | int | None = None, **dials: float | int | str) -> SceneData:
    """Return a built-in scene ("cornell-box", "two-rooms:wall=0.05") or read a file (.gltf, .glb, .xml).

    Keyword `dials` override those in the text; they are for built-in scenes only. `animation` chooses what of a glTF
    file plays: a name, a number from 0, or "all"; None: its first animation. A file without light gets a default sky
    and sun, and so does one whose only light are glowing surfaces that leave what they should light in the dark;
    `SceneData.warnings` says so. Raises `LuxelError` for an unknown name, dial or animation, and for a file that is
    missing, empty or malformed.
    """
    data = scenes.load(path_or_name, animation=animation, **dials)
    return data if scenes.is_built_in(path_or_name) else add_missing_light(data)


def load_choice(choice: SceneChoice) -> SceneData:
    """Return the scene with the choice's options applied; its first camera is the chosen one.

    Raises LuxelError for an unknown scene, a bad file or a bad option.
    """
    # Another sky takes the place of the default light, so nothing is left to decide.
    own_sky = choice.sky is not None or choice.envmap is not None
    read = scenes.load if own_sky else load
    data = read(choice.source, animation=choice.animation)
    data.name = choice.label
    changes: list[tuple[Callable[[SceneData, str], SceneData], str | None]] = [
        (apply_sun, choice.sun), (apply_sky, choice.sky), (apply_envmap, choice.envmap),
    ]  # fmt: skip
    for apply, text in changes:
        if text is not None:
            data = apply(data, text)
            # The file's own scene does not know of the change.
            data.mitsuba_full = None
    if choice.camera is not None:
        data.cameras.insert(0, parse_camera(choice.camera, data))
    return data


def add_missing_light(data: SceneData) -> SceneData:
    """Add the default sky and sun where the only light are glowing surfaces that light next to nothing.

    A scene with a lamp or a sky of its own is left alone, without a render, and so is a Mitsuba file with an emitter:
    such a file says all of its light, and Mitsuba shows no other. Returns `data`.
    """
    says_all = data.mitsuba_full is not None
    if has_glow(data) and not has_own_light(data) and not says_all and is_left_dark(data):
        add_default_light(data, ONLY_GLOW)
    return data


def is_left_dark(data: SceneData) -> bool:
    """Return whether the glowing surfaces leave in the dark what they should light; `data` stays as it is.

    One small render by the path tracer from the first camera, or the default one: the median radiance of the pixels
    that show a surface which does not glow, over the brightest emitter's radiance. A view of nothing but glowing
    surfaces, such as unlit ones, is not dark.
    """
    from luxel import runtime

    runtime.start("auto")
    import drjit as dr
    import mitsuba as mi

    from luxel.kernels.camera import make_pinhole
    from luxel.kernels.direct import direct_irradiance
    from luxel.kernels.film import Film
    from luxel.kernels.gbuffer import trace_gbuffer
    from luxel.kernels.triangle import read_triangles
    from luxel.methods.path_tracer import trace_indirect
    from luxel.scene.device import upload

    scene, film = upload(data), Film(JUDGE_SIZE, JUDGE_SIZE)
    pinhole = make_pinhole(default_camera(data), film.width, film.height, origin=scene.host.origin)
    surface = trace_gbuffer(scene, film, pinhole, pinhole).surface
    dr.eval(surface)
    lane = dr.arange(mi.UInt32, film.lane_count)
    total = np.zeros((film.height, film.width, 3))
    for sample in range(JUDGE_SPP):
        seed = dr.opaque(mi.UInt32, JUDGE_SEED + sample * 0x01000193 & 0xFFFFFFFF)
        light = direct_irradiance(scene, surface, seed + 3, lane, surface.active)
        light += trace_indirect(scene, surface, seed, lane, surface.active)
        total += film.to_image(light * surface.albedo) / (JUDGE_SPP * np.pi)

    brightest = max(_peak_emission(data.materials[index]) for index in _used_materials(data))
    seen = film.to_image(surface.active).astype(bool)
    material = read_triangles(scene).material[np.where(seen, film.to_image(surface.prim_id), 0)]
    pure = np.array([_only_glows(as_diffuse(item)) for item in data.materials])[material]
    glows = pure | (film.to_image(surface.emission).max(axis=2) > GLOWS * brightest)
    judged = total.max(axis=2)[seen & ~glows]
    return bool(judged.size) and float(np.median(judged)) < TOO_DARK * brightest


def _used_materials(data: SceneData) -> set[int]:
    return {mesh.material for item in data.objects for mesh in item.meshes if len(mesh.faces)}


def _only_glows(material: Material) -> bool:
    """Whether a surface emits and reflects nothing, as unlit ones do: no light that came could be seen on it."""
    return max(material.emission) > 0.0 and max(material.base_color) == 0.0


def _peak_emission(material: Material) -> float:
    """Return the largest radiance that the material emits, in any channel."""
    peak = np.ones(3)
    texture = material.emission_texture
    if texture is not None:
        from luxel.scene.textures import to_linear

        # The sRGB curve rises, so the brightest texel stays the brightest.
        image = texture.image if texture.image.ndim == 3 else texture.image[..., None]
        peak = to_linear(replace(texture, image=image.max(axis=(0, 1), keepdims=True)))[0, 0, :3]
    return float((np.asarray(material.emission) * peak).max())
