"""Mitsuba's BSDFs and area emitters as metal-rough materials: each one's diffuse part, baked where it is textured."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.scene.model import Colour, Material, Texture
from luxel.scene.warnings import Warnings

MAX_TEXTURE_SIZE = 1024
"""Larger images are averaged down to it: diffuse light needs no more, and memory stays bounded."""
PROCEDURAL_SIZE = 512
"""Used where a texture has no resolution of its own."""
NOT_DIFFUSE = {"nested_texture", "normalmap", "alpha", "alpha_u", "alpha_v", "roughness"}
"""Texture slots that do not reach the diffuse reflectance."""

Evaluate = Callable[[np.ndarray], np.ndarray]
"""(N, 2) uv -> (N, C) linear values."""


def make_material(shape: Any, warnings: Warnings) -> Material:
    """Return the material of a Mitsuba shape: diffuse albedo, pass-through, sidedness, emission."""
    bsdf, emitter = shape.bsdf(), shape.emitter()
    name = bsdf.id() or bsdf.class_name()
    kind = _classify(bsdf)
    material = Material(name=name, reflect_back=_has_back(bsdf))
    if kind == "passes" and emitter is not None:
        # A lamp of glass still has to be met by rays: it emits and reflects nothing.
        material.base_color = (0.0, 0.0, 0.0)
    elif kind == "passes":
        if bsdf.class_name() != "Null":
            warnings.add("Glass is not refracted, light passes straight through it: {names}.", name)
        material.alpha, material.alpha_mode = 0.0, "mask"
    elif kind == "specular":
        warnings.add("Metals and mirrors are black to diffuse light, their reflections are left out: {names}.", name)
        material.base_color = (0.0, 0.0, 0.0)
    else:
        _set_albedo(material, bsdf, warnings)
    _warn_about_layers(bsdf, kind, name, warnings)
    if emitter is not None:
        _set_emission(material, emitter, warnings)
    return material


# --- what kind of surface ------------------------------------------------------------------------------------------


def _classify(bsdf: Any) -> str:
    """Return "diffuse" (has a diffuse part), "passes" (transmits) or "specular" (only reflects)."""
    flags = mi.BSDFFlags
    if mi.has_flag(bsdf.flags(), flags.DiffuseReflection):
        return "diffuse"
    through = (flags.Null, flags.DeltaTransmission, flags.GlossyTransmission, flags.DiffuseTransmission)
    if bsdf.class_name() != "MaskBSDF" and any(mi.has_flag(bsdf.flags(), flag) for flag in through):
        return "passes"
    return "specular"


def _has_back(bsdf: Any) -> bool:
    """Return whether anything but pass-through happens on the back side."""
    parts = [bsdf.flags(index) for index in range(bsdf.component_count())]
    return any(mi.has_flag(part, mi.BSDFFlags.BackSide) and not mi.has_flag(part, mi.BSDFFlags.Null) for part in parts)


def _warn_about_layers(bsdf: Any, kind: str, name: str, warnings: Warnings) -> None:
    flags = mi.BSDFFlags
    shiny = (flags.GlossyReflection, flags.DeltaReflection)
    if kind == "diffuse" and any(mi.has_flag(bsdf.flags(), flag) for flag in shiny):
        warnings.add("Of glossy materials only the diffuse part is kept: {names}.", name)
    if kind == "diffuse" and mi.has_flag(bsdf.flags(), flags.DiffuseTransmission):
        warnings.add("Diffuse light that shines through is left out: {names}.", name)
    if bsdf.class_name() in ("BumpMap", "NormalMap"):
        warnings.add("Bump and normal maps of Mitsuba files are left out: {names}.", name)


def _textures(item: Any) -> list[tuple[str, Any]]:
    """Return (slot, texture) of every texture below a BSDF or an emitter."""

    found: list[tuple[str, Any]] = []

    class Finder(mi.TraversalCallback):
        def put(self, name: str, value: Any, *_: Any) -> None:
            if isinstance(value, mi.Texture):
                found.append((name, value))
            elif isinstance(value, mi.Object):
                # Mitsuba does not let a callback be entered again, so each level has its own.
                value.traverse(Finder())

    item.traverse(Finder())
    return found


# --- baking --------------------------------------------------------------------------------------------------------


def _set_albedo(material: Material, bsdf: Any, warnings: Warnings) -> None:
    """Fill base colour and alpha: one value, or an image where a texture makes them vary."""
    slots = [(slot, texture) for slot, texture in _textures(bsdf) if slot not in NOT_DIFFUSE]
    if any(texture.class_name() == "MeshAttribute" for _, texture in slots):
        warnings.add("Colours stored per vertex or face are not read, a grey of 0.5 stands in: {names}.", material.name)
        material.base_color = (0.5, 0.5, 0.5)
        return
    dim = _diffuse_share(bsdf)
    masked = bsdf.class_name() == "MaskBSDF"

    def evaluate(uv: np.ndarray) -> np.ndarray:
        si = _surface(uv)
        albedo = np.clip(_rows(bsdf.eval_diffuse_reflectance(si), len(uv)) * dim, 0.0, 1.0)
        if not masked:
            return albedo
        return np.concatenate([albedo, 1.0 - _rows(bsdf.eval_null_transmission(si), len(uv))[:, :1]], axis=1)

    if masked:
        material.alpha_mode = "mask"
    varying = [texture for _, texture in slots if texture.is_spatially_varying()]
    image, texture = bake(evaluate, varying, material.name, warnings) if varying else (evaluate(_CENTRE), None)
    if texture is None:
        value = np.nan_to_num(image.reshape(-1, image.shape[-1])[0])
        material.base_color = as_triple(value)
        material.alpha = float(value[3]) if masked else 1.0
        return
    encoded = image.copy()
    colour = image[..., :3]
    bright = 1.055 * np.maximum(colour, 1e-9) ** (1 / 2.4) - 0.055
    encoded[..., :3] = np.where(colour <= 0.0031308, colour * 12.92, bright)
    texture.image, texture.srgb = np.round(encoded * 255).astype(np.uint8), True
    material.base_color, material.base_color_texture = (1.0, 1.0, 1.0), texture


def _diffuse_share(bsdf: Any) -> float:
    """Return what metalness and transmission of a "principled" BSDF leave to its diffuse part; 1 for others."""
    share = 1.0
    if bsdf.class_name() == "Principled":
        parameters = mi.traverse(bsdf)
        for slot in ("metallic.value", "spec_trans.value"):
            if slot in parameters:
                share *= 1.0 - float(np.array(parameters[slot]).ravel()[0])
    return share


def _set_emission(material: Material, emitter: Any, warnings: Warnings) -> None:
    """Fill the emission from an area emitter, which shines from the front only."""
    if emitter.class_name() != "AreaLight":
        warnings.add("Emitters of these types are treated as plain area lights: {names}.", emitter.class_name())

    def evaluate(uv: np.ndarray) -> np.ndarray:
        return np.maximum(np.nan_to_num(_rows(emitter.eval(_surface(uv)), len(uv))), 0.0)

    varying = [texture for _, texture in _textures(emitter) if texture.is_spatially_varying()]
    if not varying:
        material.emission = as_triple(evaluate(_CENTRE)[0])
        return
    image, texture = bake(evaluate, varying, material.name, warnings)
    peak = float(image.max())
    if texture is None or peak <= 0:
        material.emission = as_triple(image.reshape(-1, 3)[0])
        return
    texture.image, texture.srgb = (image / peak).astype(np.float32), False
    material.emission, material.emission_texture = (peak, peak, peak), texture


def bake(evaluate: Evaluate, varying: list[Any], name: str, warnings: Warnings) -> tuple[np.ndarray, Texture | None]:
    """Evaluate a textured quantity on a grid. Returns (H, W, C) float32 and the texture to put it in, None if constant.

    The grid covers one period of the first texture, in that texture's own coordinates, so that any `to_uv` is exact.
    """
    transforms = [_to_uv(texture) for texture in varying]
    transform = transforms[0]
    if any(not np.allclose(transform, other) for other in transforms[1:]) or abs(np.linalg.det(transform)) < 1e-9:
        transform = np.eye(3)
    inverse = np.linalg.inv(transform)

    def in_texture_space(st: np.ndarray) -> np.ndarray:
        return evaluate((st @ inverse[:2, :2].T + inverse[:2, 2]).astype(np.float32))

    width, height = _resolution(varying)
    over = max(1, -(-max(width, height) // MAX_TEXTURE_SIZE))
    columns, rows = min(width, max(1, width // over)), min(height, max(1, height // over))
    image = _sample_grid(in_texture_space, rows, columns, over)
    if np.ptp(image.reshape(-1, image.shape[-1]), axis=0).max() < 1e-4:
        return image, None
    wraps = [_find_wrap(in_texture_space, axis) for axis in (0, 1)]
    if None in wraps:
        warnings.add("The textures of a material do not repeat together, one tile of them does: {names}.", name)
    return image, Texture(
        image,
        wrap_u=wraps[0] or "repeat",
        wrap_v=wraps[1] or "repeat",
        transform=transform.astype(np.float32),
    )


def _sample_grid(evaluate: Evaluate, rows: int, columns: int, over: int) -> np.ndarray:
    """Return (rows, columns, C) means of `over` x `over` samples a texel; row 0 is v = 0."""
    s = (np.arange(columns * over) + 0.5) / (columns * over)
    bands = []
    for row in range(0, rows, 128):
        count = min(128, rows - row)
        t = (np.arange(row * over, (row + count) * over) + 0.5) / (rows * over)
        st = np.stack(np.meshgrid(s, t), axis=-1).reshape(-1, 2)
        values = np.nan_to_num(evaluate(st))
        bands.append(values.reshape(count, over, columns, over, -1).mean(axis=(1, 3)))
    return np.concatenate(bands).astype(np.float32)


def _find_wrap(evaluate: Evaluate, axis: int) -> Any:
    """Return how the values go on beyond 0..1 along `axis`: "repeat", "mirror", "clamp"; None for none of them."""
    inside = np.random.default_rng(7).uniform(0.05, 0.95, (64, 2))
    beyond, mirrored, edge = inside.copy(), inside.copy(), inside.copy()
    beyond[:, axis] += 1.0
    mirrored[:, axis] = 1.0 - inside[:, axis]
    edge[:, axis] = 1.0 - 1e-5
    seen = evaluate(beyond)
    for wrap, points in (("repeat", inside), ("mirror", mirrored), ("clamp", edge)):
        # A few points may fall on an edge of the pattern, where rounding decides.
        if (np.abs(evaluate(points) - seen).max(axis=1) < 0.02).mean() > 0.9:
            return wrap
    return None


def _resolution(varying: list[Any]) -> tuple[int, int]:
    """Return the largest (width, height) among the textures; procedural ones count as `PROCEDURAL_SIZE`."""
    sizes = []
    for texture in varying:
        width, height = (int(side) for side in texture.resolution())
        sizes.append((width, height) if width > 1 or height > 1 else (PROCEDURAL_SIZE, PROCEDURAL_SIZE))
    return max(size[0] for size in sizes), max(size[1] for size in sizes)


def _to_uv(texture: Any) -> np.ndarray:
    parameters = mi.traverse(texture)
    for key, value in parameters.items():
        if key.split(".")[-1] == "to_uv":
            return np.array(value.matrix, float).reshape(3, 3)
    return np.eye(3)


def _surface(uv: np.ndarray) -> Any:
    """Return Mitsuba surface interactions at `uv` (N, 2), seen from straight in front."""
    count = len(uv)
    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.t = mi.Float(0.0)
    si.uv = mi.Point2f(*(mi.Float(np.ascontiguousarray(uv[:, axis], np.float32)) for axis in (0, 1)))
    si.wi = mi.Vector3f(0.0, 0.0, 1.0)
    si.n = mi.Normal3f(0.0, 0.0, 1.0)
    si.sh_frame = mi.Frame3f(si.n)
    dr.make_opaque(si.t, si.wi, si.n)
    return si


def _rows(spectrum: Any, count: int) -> np.ndarray:
    """Return a Dr.Jit RGB array as (count, 3); one that does not vary has a single entry."""
    return np.broadcast_to(np.array(spectrum).reshape(3, -1).T, (count, 3))


_CENTRE = np.array([[0.5, 0.5]], np.float32)


def as_triple(values: np.ndarray) -> Colour:
    """Return the first three values as Python floats."""
    return (float(values[0]), float(values[1]), float(values[2]))
