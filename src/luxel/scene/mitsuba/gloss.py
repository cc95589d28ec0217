"""Mitsuba's BSDFs as coats, metals and glass of a material, beside the diffuse part that `materials.py` makes.

A tree of blends becomes one surface: shares of metal and glass add up as the blend has them, and one width of
microfacets, the mean, serves all. What the diffuse condition shows stays as it is without gloss (`Material.diffuse`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from luxel.scene.diffuse import as_diffuse
from luxel.scene.mitsuba.bsdf import CONDUCTORS, GLASSES, GLOSSY, PLASTICS, PRINCIPLED, Layer, is_attribute
from luxel.scene.mitsuba.leaves import (
    SLOTS,
    Facts,
    distribution_of,
    holds_impossible,
    is_anisotropic,
    is_nonlinear,
    is_used,
    read_leaf,
)
from luxel.scene.mitsuba.textures import (
    bake,
    children,
    encode_srgb,
    is_two_valued,
    number_rows,
    surface_at,
)
from luxel.scene.model import Colour, Material, Texture
from luxel.scene.rules import HIGHEST_IOR, LOWEST_IOR
from luxel.scene.warnings import Warnings

CENTRE = np.array([[0.5, 0.5]], np.float32)
GRID = 16
"""Places along u and v whose mean stands for what cannot vary."""
PLACES = np.stack(np.meshgrid(*[(np.arange(GRID) + 0.5) / GRID] * 2), axis=-1).reshape(-1, 2).astype(np.float32)
"""(256, 2): them."""
LEAST = 1e-6
"""Shares below it are none."""
LEFT_OUT = ("sheen", "flatness", "spec_tint")
KEPT = ("base_color", "base_color_texture", "alpha", "alpha_mode", "reflect_back", "emission")
"""Fields that tell whether the diffuse condition shows what it would without gloss."""
BLACK = (0.0, 0.0, 0.0)
LEAST_LAMP_ALPHA = 0.05
"""Below it a lamp that shines by chance would be mere noise."""
THIN = ("ThinDielectric", "PrincipledThin")


def with_gloss(
    plain: Material, tree: Layer, warnings: Warnings, back: bool = False, emission: Colour = BLACK
) -> Material:
    """Return the material of one side of `tree` with its gloss; `plain` itself, what is diffuse of it, without any.

    `emission` is the lamp's own radiance; in `plain` it makes up for rays that go on behind.
    """
    leaves = _leaves(tree, back)
    glossy = [leaf for leaf in leaves if leaf.bsdf.class_name() in GLOSSY]
    if not glossy:
        return plain
    if any(is_attribute(texture) for leaf in leaves for texture in _textures(leaf)):
        warnings.add("Gloss of materials with colours per vertex is left out: {names}.", plain.name)
        return plain
    full = replace(plain)
    reader = _Reader(tree, leaves, plain.name, warnings, back)
    shines = max(emission) > 0.0
    if shines or not all(leaf.kind == "diffuse" and leaf.bsdf.class_name() not in PRINCIPLED for leaf in leaves):
        reader.fill_colour(full)
    if shines and not _keep_shining(full, emission):
        warnings.add("Reflections of lamps whose holes vary are left out: {names}.", plain.name)
        return plain
    _name_what_differs(glossy, leaves, plain.name, warnings)
    reader.fill_surface(full)
    reader.fill_weights(full)
    reader.fill_constants(full, glossy)
    if not tree.has("diffuse"):
        full.reflect_back = tree.has("twosided") or any(map(_is_clear, leaves))
    shown = as_diffuse(full)
    if full.metallic > 0.0 or any(getattr(shown, field) is not getattr(plain, field) for field in KEPT):
        full.diffuse = plain
    return full


def put_colour(material: Material, image: np.ndarray, texture: Texture | None) -> None:
    """Fill base colour and alpha from (H, W, 4) linear values, in `texture` where they vary."""
    if texture is None:
        value = image.reshape(-1, 4)[0]
        material.base_color, material.alpha = as_triple(value), float(value[3])
        if material.alpha < 1e-3:
            # Nothing is there: rays need not be asked.
            material.alpha, material.alpha_mode = 0.0, "mask"
        elif material.alpha < 1.0 - 1e-3:
            material.alpha_mode = "blend"
        return
    opaque = image[..., 3].min() > 1.0 - 1e-3
    if not opaque:
        material.alpha_mode = "mask" if is_two_valued(image[..., 3]) else "blend"
    alpha = np.round(image[..., 3:] * 255).astype(np.uint8)
    colour = encode_srgb(image[..., :3])
    texture.image, texture.srgb = (colour if opaque else np.concatenate([colour, alpha], axis=-1)), True
    material.base_color, material.base_color_texture = (1.0, 1.0, 1.0), texture


def _keep_shining(material: Material, emission: Colour) -> bool:
    """Let a lamp shine fully, however many rays go on behind it; return False where its holes are not even."""
    share = material.alpha
    if material.alpha_mode == "opaque":
        share = 1.0
    elif material.base_color_texture is not None and material.base_color_texture.image.shape[-1] == 4:
        texels = material.base_color_texture.image[..., 3]
        share = float(texels.min()) / 255.0 if np.ptp(texels) <= 1 else 0.0
    if share < LEAST_LAMP_ALPHA:
        return False
    red, green, blue = (channel / share for channel in emission)
    material.emission = (red, green, blue)
    return True


def as_triple(values: np.ndarray) -> Colour:
    """Return the first three values as Python floats."""
    return (float(values[0]), float(values[1]), float(values[2]))


# --- the tree ------------------------------------------------------------------------------------------------------


def _split(layer: Layer, si: Any, count: int, back: bool, weight: np.ndarray) -> list[tuple[Layer, np.ndarray]]:
    """Return the BSDFs of one side that hold no other, each with its share (count, 1); holes have none."""
    if layer.kind == "mask":
        weight = weight * np.clip(number_rows(layer.textures["opacity"].eval_1(si), count), 0.0, 1.0)
    if layer.kind == "blend":
        second = np.clip(number_rows(layer.textures["weight"].eval_1(si), count), 0.0, 1.0)
        shares = (weight * (1.0 - second), weight * second)
        parts = [_split(inner, si, count, back, share) for inner, share in zip(layer.inner, shares, strict=True)]
        return parts[0] + parts[1]
    if layer.inner:
        return _split(layer.inner[-1 if back and layer.kind == "twosided" else 0], si, count, back, weight)
    return [] if layer.bsdf.class_name() == "Null" else [(layer, weight)]


def _leaves(layer: Layer, back: bool) -> list[Layer]:
    """Return the BSDFs of one side that hold no other; holes are none."""
    if layer.kind == "blend":
        return [leaf for inner in layer.inner for leaf in _leaves(inner, back)]
    if layer.inner:
        return _leaves(layer.inner[-1 if back and layer.kind == "twosided" else 0], back)
    return [] if layer.bsdf.class_name() == "Null" else [layer]


def mix_facts(tree: Layer, uv: np.ndarray, back: bool) -> Facts:
    """Return the facts of one side at `uv` (N, 2), and `opacity`, the share that is no hole."""
    si, count = surface_at(uv), len(uv)
    parts = _split(tree, si, count, back, np.ones((count, 1)))
    facts = [read_leaf(leaf, si, count) for leaf, _ in parts]
    opacity = sum((weight for _, weight in parts), np.zeros((count, 1)))
    if len(facts) == 1:
        return facts[0] | {"opacity": opacity}
    shares = [weight / np.maximum(opacity, LEAST) for _, weight in parts]
    metal = [share * fact["metallic"] for share, fact in zip(shares, facts, strict=True)]
    dielectric = [share - part for share, part in zip(shares, metal, strict=True)]
    coat = [part * fact["specular"] for part, fact in zip(dielectric, facts, strict=True)]
    matt = [part * (1.0 - fact["transmission"]) for part, fact in zip(dielectric, facts, strict=True)]
    clear = [share * fact["clearcoat"] for share, fact in zip(shares, facts, strict=True)]
    glossy = [one + other for one, other in zip(metal, coat, strict=True)]

    def mean(name: str, weights: list[np.ndarray], fallback: float | np.ndarray = 0.0) -> np.ndarray:
        return _mean([fact[name] for fact in facts], weights, fallback)

    return {
        "opacity": opacity,
        # What scatters evenly has its own colour where there is any; metal and glass take the mean of all.
        "base_color": mean("base_color", matt, mean("base_color", shares)),
        "metallic": sum(metal, np.zeros((count, 1))),
        "transmission": mean("transmission", dielectric),
        "specular": mean("specular", dielectric),
        "specular_color": mean("specular_color", glossy, 1.0),
        "ior": mean("ior", coat, 1.5),
        "alpha": mean("alpha", glossy),
        "clearcoat": sum(clear, np.zeros((count, 1))),
        "clearcoat_alpha": mean("clearcoat_alpha", clear),
        "eta": mean("eta", metal),
        "k": mean("k", metal),
    }


def _mean(values: list[np.ndarray], weights: list[np.ndarray], fallback: float | np.ndarray) -> np.ndarray:
    total = sum(weights, np.zeros_like(weights[0]))
    added = sum((value * weight for value, weight in zip(values, weights, strict=True)), 0.0 * values[0])
    return np.where(total > LEAST, added / np.maximum(total, LEAST), fallback)


def _textures(layer: Layer, *quantities: str) -> list[Any]:
    """Return the textures of a BSDF on which quantities depend, or all of them."""
    names = {slot for quantity in quantities or SLOTS for slot in SLOTS[quantity]}
    found = {name: texture for name, texture in children(layer.bsdf) if name in names and hasattr(texture, "eval_1")}
    return list(found.values())


def _is_clear(leaf: Layer) -> bool:
    """Return whether light passes through a BSDF."""
    return leaf.kind == "passes" or is_used(leaf, "spec_trans")


def _name_what_differs(glossy: list[Layer], leaves: list[Layer], name: str, warnings: Warnings) -> None:
    if any(leaf.bsdf.class_name() in PRINCIPLED for leaf in glossy):
        warnings.add(
            "Principled materials are read as a coat, a metal and glass, which comes near them: {names}.", name
        )
    if any(is_used(leaf, *LEFT_OUT) for leaf in glossy if leaf.bsdf.class_name() in PRINCIPLED):
        warnings.add("Sheen, flatness and tinted highlights are left out: {names}.", name)
    if any(holds_impossible(leaf, PLACES) for leaf in glossy):
        warnings.add("Widths, indices and shares out of range are read as the nearest that can be: {names}.", name)
    if any(map(is_anisotropic, glossy)):
        warnings.add("Roughness that depends on the direction is read as its mean: {names}.", name)
    # Paint beside a metal needs no mean: the two share no field.
    shared = len(glossy) > 1 or any(leaf.bsdf.class_name() not in CONDUCTORS for leaf in glossy)
    if len(leaves) > 1 and shared:
        warnings.add("Blends of glossy materials are read as one surface of their mean roughness: {names}.", name)


# --- fields --------------------------------------------------------------------------------------------------------


class _Reader:
    """Evaluates the facts of one side and puts them into a material's fields, as images where textures vary."""

    def __init__(self, tree: Layer, leaves: list[Layer], name: str, warnings: Warnings, back: bool) -> None:
        self.tree, self.leaves, self.name, self.warnings, self.back = tree, leaves, name, warnings, back
        shares = [texture for layer in tree.walk() for texture in layer.textures.values() if layer.inner]
        self.shares = [texture for texture in shares if texture.is_spatially_varying()]
        """Textures of masks and blends."""

    def fill_colour(self, material: Material) -> None:
        """Fill base colour and alpha, which the diffuse part has mixed with metal and glass."""
        material.base_color_texture, material.alpha_mode = None, "opaque"
        two_meshes = self.tree.back() == "differs"

        def colour(facts: Facts) -> np.ndarray:
            opacity = facts["opacity"].clip(0.0, 1.0)
            # A ray meets two meshes, one for each side: together they let pass what the file says.
            opacity = 1.0 - np.sqrt(1.0 - opacity) if two_meshes else opacity
            return np.concatenate([facts["base_color"].clip(0.0, 1.0), opacity], axis=1)

        # A principled glass has a colour of its own.
        clear = any(leaf.bsdf.class_name() == "Principled" and is_used(leaf, "spec_trans") for leaf in self.leaves)
        image, texture = self._bake(colour, "base_color", *(("glass_color",) if clear else ()), masks=True)
        put_colour(material, image, texture)

    def fill_surface(self, material: Material) -> None:
        """Fill roughness and metallic, which share a texture."""

        def surface(facts: Facts) -> np.ndarray:
            alpha = facts["alpha"]
            if alpha.max() > 1.0:
                self.warnings.add("Roughness above 1 is read as 1: {names}.", self.name)
            return np.concatenate([np.zeros_like(alpha), np.sqrt(alpha.clip(0.0, 1.0)), facts["metallic"]], axis=1)

        image, texture = self._bake(surface, "surface")
        _, material.roughness, material.metallic = as_triple(image.reshape(-1, 3)[0])
        if texture is not None:
            material.roughness, material.metallic = 1.0, float(image[..., 2].max() > 0.0)
            material.metallic_roughness_texture = _as_bytes(texture, image)

    def fill_weights(self, material: Material) -> None:
        """Fill weight and colour of the coat, the share of glass, and the clear coat."""

        def fill(field: str, fact: Callable[[Facts], np.ndarray], quantity: str, channels: list[int]) -> None:
            """`channels`: which of the value's columns each channel of the texture has; -1 for ones."""
            image, texture = self._bake(fact, quantity)
            value = image.reshape(-1, image.shape[-1])[0]
            if texture is not None:
                full = np.concatenate([image, np.ones_like(image[..., :1])], axis=-1)
                setattr(material, f"{field}_texture", _as_bytes(texture, full[..., channels]))
                value = np.ones_like(value)
            setattr(material, field, as_triple(value) if len(value) == 3 else float(value[0]))

        fill("specular", lambda facts: facts["specular"], "none", [1, 1, 1, 0])
        fill("specular_color", lambda facts: facts["specular_color"], "specular_color", [0, 1, 2])
        fill("transmission", lambda facts: facts["transmission"], "transmission", [0, 0, 0])
        fill("clearcoat", lambda facts: facts["clearcoat"], "clearcoat", [0, 0, 0])
        if material.clearcoat > 0.0:
            fill("clearcoat_roughness", _clearcoat_roughness, "clearcoat_roughness", [0, 0, 0])

    def fill_constants(self, material: Material, glossy: list[Layer]) -> None:
        """Fill what is one value for the whole surface."""
        facts = self._mean_facts()
        ior = float(facts["ior"][0])
        # What is under a coat lets no light pass, so nothing there is met from a denser side.
        lowest = 1.0 if self._has(*PLASTICS, *PRINCIPLED) else LOWEST_IOR
        if ior < lowest:
            self.warnings.add(f"Indices of refraction below {lowest:g} are read as that: {{names}}.", self.name)
        material.ior = min(max(ior, lowest), HIGHEST_IOR)
        if self._has(*CONDUCTORS):
            if any(texture.is_spatially_varying() for leaf in glossy for texture in _textures(leaf, "index")):
                self.warnings.add("Complex indices that vary are read as their mean: {names}.", self.name)
            material.eta, material.k = as_triple(facts["eta"].clip(0.0)), as_triple(facts["k"].clip(0.0))
        names = {distribution_of(leaf) for leaf in glossy if leaf.bsdf.class_name().startswith("Rough")}
        material.distribution = "beckmann" if names == {"beckmann"} else "ggx"
        if len(names) > 1:
            self.warnings.add("Blends of two distributions of facets are read as GGX: {names}.", self.name)
        if self._has(*PLASTICS, *GLASSES):
            material.interface = "plastic"
        elif self._has(*PRINCIPLED):
            material.interface = "principled"
        material.nonlinear = any(leaf.bsdf.class_name() in PLASTICS and is_nonlinear(leaf) for leaf in glossy)
        material.thin = any(leaf.bsdf.class_name() in THIN for leaf in glossy)

    def _has(self, *names: str) -> bool:
        return any(leaf.bsdf.class_name() in names for leaf in self.leaves)

    def _bake(
        self, fact: Callable[[Facts], np.ndarray], *quantities: str, masks: bool = False
    ) -> tuple[np.ndarray, Texture | None]:
        """Return values of the whole surface (H, W, C), and the texture to put them in where they vary."""
        several = len(self.leaves) > 1
        slots = tuple(SLOTS) if several else tuple(name for name in quantities if name in SLOTS)
        found = [texture for leaf in self.leaves for texture in (_textures(leaf, *slots) if slots else [])]
        varying = [texture for texture in found if texture.is_spatially_varying()]
        varying += self.shares if several or masks else []

        def evaluate(uv: np.ndarray) -> np.ndarray:
            return fact(mix_facts(self.tree, uv, self.back))

        return bake(evaluate, varying, self.name, self.warnings) if varying else (evaluate(CENTRE), None)

    def _mean_facts(self) -> Facts:
        return {name: rows.mean(axis=0) for name, rows in mix_facts(self.tree, PLACES, self.back).items()}


def _clearcoat_roughness(facts: Facts) -> np.ndarray:
    return np.sqrt(facts["clearcoat_alpha"].clip(0.0, 1.0))


def _as_bytes(texture: Texture, image: np.ndarray) -> Texture:
    """Return `texture` with linear values as its image, as data."""
    texture.image, texture.srgb = np.round(image.clip(0.0, 1.0) * 255.0).astype(np.uint8), False
    return texture
