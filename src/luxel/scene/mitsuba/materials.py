"""Mitsuba's BSDFs and area emitters as metal-rough materials, baked where they are textured.

Here is each one's diffuse part; `gloss.py` adds what it reflects and refracts.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from luxel.scene.diffuse import as_diffuse
from luxel.scene.mitsuba.bsdf import Layer, is_attribute, note_layers
from luxel.scene.mitsuba.gloss import CENTRE, LEAST_LAMP_ALPHA, as_triple, put_colour, with_gloss
from luxel.scene.mitsuba.relief import Stretch, set_relief
from luxel.scene.mitsuba.shapes import corner_interactions, split_corners
from luxel.scene.mitsuba.textures import (
    bake,
    colour_rows,
    encode_srgb,
    surface_at,
    textures_below,
)
from luxel.scene.model import Material, Mesh, Texture
from luxel.scene.textures import to_linear
from luxel.scene.warnings import Warnings

SEEN_THROUGH = "What is seen through a lamp of glass or with holes is left out: {names}."


def make_materials(shape: Any, tree: Layer, stretch: Stretch, warnings: Warnings) -> list[Material]:
    """Return the material of a Mitsuba shape, and a second one where its back reflects another colour.

    `tree` is the shape's BSDF, `stretch` what `measure_stretch` says of its mesh.
    """
    bsdf, emitter = shape.bsdf(), shape.emitter()
    ids = [layer.bsdf.id() for layer in tree.walk() if layer.bsdf.id()]
    name = next(iter(ids), shape.id() or bsdf.class_name())
    note_layers(tree, name, warnings)
    back = tree.back()
    front = Material(name=name, reflect_back=back == "same" or (back == "any" and not tree.has("diffuse")))
    _set_albedo(front, tree, warnings, back=False)
    materials = [front]
    if back == "differs":
        materials.append(Material(name=f"{name}-back", reflect_back=False))
        _set_albedo(materials[1], tree, warnings, back=True)
    if emitter is not None:
        _set_emission(front, emitter, warnings)
    emission = front.emission
    shines_fully = _shine_fully(front, by_colours=_reads_attributes(tree))
    set_relief(front, tree, stretch, warnings)
    full = [with_gloss(front, tree, warnings, emission=emission)]
    if not shines_fully:
        warnings.add(SEEN_THROUGH, name, diffuse_only=full[0] is not front)
    return full + [with_gloss(plain, tree, warnings, back=True) for plain in materials[1:]]


def paint_mesh(
    shape: Any, tree: Layer, mesh: Mesh, materials: list[Material], warnings: Warnings, back: bool = False
) -> Mesh:
    """Give the mesh what a material reads from it: colours per vertex or face, and uv where Mitsuba makes them up.

    `materials` are those of `make_materials`; `back` asks for the mesh of the second one.
    """
    if not shape.is_mesh():
        if not _reads_attributes(tree):
            return mesh
        warnings.add(
            "Stored colours of shapes that are no meshes are left out, grey stands in: {names}.", materials[0].name
        )
        return replace(mesh, colors=np.full((len(mesh.positions), 3), 0.5, np.float32))
    stored = np.array(shape.faces_buffer(), np.uint32).reshape(-1, 3)
    if _reads_attributes(tree):
        si = corner_interactions(shape, stored)
        corners = _evaluate(tree, si, stored.size, back)
        if as_diffuse(materials[-1 if back else 0]).alpha_mode == "opaque":
            # A lamp that is met everywhere keeps what it reflects.
            corners = corners[:, :3] * corners[:, 3:]
        return _with_colours(mesh, stored, corners)
    fields = (item for material in materials for item in vars(material).items())
    textured = any(isinstance(value, Texture) for name, value in fields if name != "normal_texture")
    if textured and mesh.uv is None:
        # Mitsuba then takes the weights of the second and third corner.
        corners = np.tile(np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)], np.float32), (len(stored), 1))
        return replace(split_corners(mesh), uv=_in_order_of(mesh, stored, corners))
    return mesh


# --- diffuse light -------------------------------------------------------------------------------------------------


def _reads_attributes(tree: Layer) -> bool:
    return any(is_attribute(texture) for texture in tree.varying())


def _evaluate(tree: Layer, si: Any, count: int, back: bool) -> np.ndarray:
    """Return (count, 4): the reflectance of what does not let light pass, and its share (alpha)."""
    alpha = 1.0 - tree.passing(si, count)
    if tree.back() == "differs":
        # A ray meets two meshes, one for each side: together they let pass what the file says.
        alpha = 1.0 - np.sqrt(np.clip(1.0 - alpha, 0.0, 1.0))
    return np.concatenate([tree.reflect(si, count, back) / np.maximum(alpha, 1e-4), alpha], axis=1).clip(0.0, 1.0)


def _set_albedo(material: Material, tree: Layer, warnings: Warnings, back: bool) -> None:
    """Fill base colour and alpha: one value, or an image where a texture makes them vary."""
    varying = tree.varying()
    if _reads_attributes(tree):
        if any(not is_attribute(texture) for texture in varying):
            warnings.add("Images mixed with colours per vertex are read at the vertices only: {names}.", material.name)
        material.base_color = (1.0, 1.0, 1.0)
        if tree.has("mask") or tree.has("passes"):
            material.alpha_mode = "blend"
        return

    def evaluate(uv: np.ndarray) -> np.ndarray:
        return _evaluate(tree, surface_at(uv), len(uv), back)

    image, texture = bake(evaluate, varying, material.name, warnings) if varying else (evaluate(CENTRE), None)
    put_colour(material, image, texture)


def _with_colours(mesh: Mesh, stored: np.ndarray, corners: np.ndarray) -> Mesh:
    """Return the mesh with colours; `corners` (3 F, 3 or 4) are those of the corners of `stored` (F, 3).

    Where the faces around a vertex do not agree on its colour, each face gets vertices of its own.
    """
    if (corners[:, 3:] > 1.0 - 1e-3).all():
        corners = corners[:, :3]
    colours = np.zeros((len(mesh.positions), corners.shape[1]), np.float32)
    colours[stored.ravel()] = corners
    if np.abs(colours[stored.ravel()] - corners).max(initial=0.0) < 1e-4:
        return replace(mesh, colors=colours)
    return replace(split_corners(mesh), colors=_in_order_of(mesh, stored, corners).astype(np.float32))


def _in_order_of(mesh: Mesh, stored: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return values of the corners of `stored` in the order of the mesh's own, which may be wound the other way."""
    turned = mesh.faces[:, 0] != stored[:, 0]
    by_face = corners.reshape(len(stored), 3, -1)
    return np.where(turned[:, None, None], by_face[:, ::-1], by_face).reshape(len(corners), -1)


# --- emission ------------------------------------------------------------------------------------------------------


def _shine_fully(material: Material, by_colours: bool) -> bool:
    """Undo what alpha takes from the emission: Mitsuba's lamps shine fully, however much of a ray goes on behind.

    `by_colours`: the alpha stands in the mesh. Return False where nothing is seen behind any more.
    """
    if max(material.emission) <= 0.0 or material.alpha_mode == "opaque":
        return True
    if material.base_color_texture is None and not by_colours and material.alpha >= LEAST_LAMP_ALPHA:
        red, green, blue = (channel / material.alpha for channel in material.emission)
        material.emission = (red, green, blue)
        return True
    # It still has to be met by rays.
    image = material.base_color_texture
    if image is None:
        red, green, blue = (channel * material.alpha for channel in material.base_color)
        material.base_color = (red, green, blue)
    elif image.image.shape[2] == 4:
        linear = to_linear(image)
        image.image = encode_srgb(linear[..., :3] * linear[..., 3:])
    material.alpha, material.alpha_mode = 1.0, "opaque"
    return False


def _set_emission(material: Material, emitter: Any, warnings: Warnings) -> None:
    """Fill the emission from an area emitter, which shines from the front only."""
    if emitter.class_name() != "AreaLight":
        warnings.add("Emitters of these types are left out: {names}.", emitter.class_name())
        return

    def evaluate(uv: np.ndarray) -> np.ndarray:
        radiance = np.nan_to_num(colour_rows(emitter.eval(surface_at(uv)), len(uv)))
        if radiance.min() < 0.0:
            warnings.add("Negative radiance counts as none: {names}.", material.name)
        return np.maximum(radiance, 0.0)

    textures = [texture for _, texture in textures_below(emitter)]
    varying = [texture for texture in textures if texture.is_spatially_varying()]
    if any(is_attribute(texture) for texture in textures):
        warnings.add("Radiance stored per vertex or face is left out: {names}.", material.name)
        return
    if not varying:
        material.emission = as_triple(evaluate(CENTRE)[0])
        return
    image, texture = bake(evaluate, varying, material.name, warnings)
    peak = float(image.max())
    if texture is None or peak <= 0:
        material.emission = as_triple(image.reshape(-1, 3)[0])
        return
    texture.image, texture.srgb = (image / peak).astype(np.float32), False
    material.emission, material.emission_texture = (peak, peak, peak), texture
