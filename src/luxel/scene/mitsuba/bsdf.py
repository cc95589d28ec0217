"""What a Mitsuba BSDF does with diffuse light, however it is nested: reflects on each side, or lets pass.

Under the diffuse condition metals and mirrors reflect nothing, and glass lets light pass straight through.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import mitsuba as mi
import numpy as np

from luxel.scene.mitsuba.textures import children, colour_rows, number_rows
from luxel.scene.warnings import Warnings

Back = Literal["any", "none", "same", "differs"]
Kind = Literal["diffuse", "passes", "specular", "twosided", "mask", "blend", "wrapped"]
WRAPPERS: dict[str, Kind] = {
    "TwoSidedBRDF": "twosided",
    "MaskBSDF": "mask",
    "BlendBSDF": "blend",
    "BumpMap": "wrapped",
    "NormalMap": "wrapped",
}
PLASTICS = ("SmoothPlastic", "RoughPlastic")
CONDUCTORS = ("SmoothConductor", "RoughConductor")
GLASSES = ("SmoothDielectric", "ThinDielectric", "RoughDielectric")
PRINCIPLED = ("Principled", "PrincipledThin")
GLOSSY = (*PLASTICS, *CONDUCTORS, *GLASSES, *PRINCIPLED)
"""Classes of BSDFs whose gloss is read (`leaves.py`); all others are what is diffuse about them."""
NOT_DIFFUSE = {
    "alpha", "alpha_u", "alpha_v", "roughness", "anisotropic", "spec_tint", "sheen", "sheen_tint", "flatness",
    "clearcoat", "clearcoat_gloss", "eta", "k", "specular_reflectance", "specular_transmittance",
}  # fmt: skip
"""Texture slots that do not reach the diffuse reflectance."""


@dataclass
class Layer:
    """One BSDF of a tree of BSDFs."""

    kind: Kind
    bsdf: Any
    inner: list[Layer] = field(default_factory=list)
    textures: dict[str, Any] = field(default_factory=dict)
    """Those of this BSDF itself that reach its diffuse light, by slot."""
    both_sides: bool = False
    """A leaf that reflects alike on both sides by itself."""

    def walk(self) -> list[Layer]:
        """Return this layer and all below it."""
        return [self, *(layer for inner in self.inner for layer in inner.walk())]

    def varying(self) -> list[Any]:
        """Return the textures whose value depends on the place."""
        found = [texture for layer in self.walk() for texture in layer.textures.values()]
        return [texture for texture in found if texture.is_spatially_varying() or is_attribute(texture)]

    def has(self, kind: Kind) -> bool:
        """Return whether a layer of `kind` is anywhere in the tree."""
        return any(layer.kind == kind for layer in self.walk())

    def back(self) -> Back:
        """Return how the back side reflects beside the front; "any" where neither reflects."""
        if self.kind == "diffuse":
            return "same" if self.both_sides else "none"
        if self.kind in ("passes", "specular"):
            return "any"
        if self.kind == "twosided":
            if all(layer.back() == "any" for layer in self.inner):
                return "any"
            return "same" if len(self.inner) == 1 or self.inner[0].bsdf is self.inner[1].bsdf else "differs"
        backs: list[Back] = [layer.back() for layer in self.inner if layer.back() != "any"]
        if not backs:
            return "any"
        return backs[0] if len(set(backs)) == 1 else "differs"

    def reflect(self, si: Any, count: int, back: bool = False) -> np.ndarray:
        """Return (count, 3): the share of light that is reflected diffusely on one side."""
        if self.kind == "diffuse":
            return leaf_albedo(self, si, count) if self.both_sides or not back else np.zeros((count, 3))
        if self.kind in ("passes", "specular"):
            return np.zeros((count, 3))
        if self.kind == "twosided":
            return self.inner[-1 if back else 0].reflect(si, count)
        parts = [layer.reflect(si, count, back) for layer in self.inner]
        return _mix(self, si, count, parts)

    def passing(self, si: Any, count: int) -> np.ndarray:
        """Return (count, 1): the share of light that goes straight through."""
        if self.kind == "passes":
            return np.ones((count, 1))
        if not self.inner:
            return np.zeros((count, 1))
        mixed = _mix(self, si, count, [layer.passing(si, count) for layer in self.inner])
        if self.kind == "mask":
            mixed = mixed + 1.0 - np.clip(number_rows(self.textures["opacity"].eval_1(si), count), 0.0, 1.0)
        return mixed


def is_attribute(texture: Any) -> bool:
    """Return whether a texture reads values that the mesh stores per vertex or face."""
    return texture.class_name() == "MeshAttribute"


def read_bsdf(bsdf: Any) -> Layer:
    """Return the tree of `bsdf`."""
    below = children(bsdf)
    kind = WRAPPERS.get(bsdf.class_name())
    textures = {name: value for name, value in below if isinstance(value, mi.Texture)}
    if kind is None:
        kind = _classify(bsdf)
        used = {name: value for name, value in textures.items() if name not in NOT_DIFFUSE} if kind == "diffuse" else {}
        parts = [bsdf.flags(index) for index in range(bsdf.component_count())]
        diffuse = [part for part in parts if mi.has_flag(part, mi.BSDFFlags.DiffuseReflection)]
        return Layer(kind, bsdf, [], used, any(mi.has_flag(part, mi.BSDFFlags.BackSide) for part in diffuse))
    inner = [(value.ptr, read_bsdf(value)) for _, value in below if isinstance(value, mi.BSDF)]
    layers = [layer for _, layer in inner]
    if kind == "twosided" and len(inner) == 2 and inner[0][0] == inner[1][0]:
        layers = layers[:1]
    used = {name: value for name, value in textures.items() if name in ("opacity", "weight")}
    return Layer(kind, bsdf, layers, used)


def note_layers(tree: Layer, name: str, warnings: Warnings) -> None:
    """Name what of the tree luxel leaves out."""
    flags = mi.BSDFFlags
    for layer in tree.walk():
        has = {flag: mi.has_flag(layer.bsdf.flags(), flag) for flag in (flags.GlossyReflection, flags.DeltaReflection)}
        kind = layer.bsdf.class_name()

        def note(sentence: str, only: bool = kind in GLOSSY) -> None:
            warnings.add(sentence, name, diffuse_only=only)

        if layer.kind == "passes" and kind != "Null":
            note("Glass is not refracted, light passes straight through it: {names}.")
        if layer.kind == "specular" or _slot_is_used(layer, "metallic"):
            note("Metals and mirrors are black to diffuse light, their reflections are left out: {names}.")
        elif layer.kind == "diffuse" and any(has.values()):
            note("Of glossy materials only the diffuse part is kept: {names}.")
        if _slot_is_used(layer, "spec_trans"):
            note("Light that a principled material refracts is left out, it is dark there: {names}.")
        if layer.kind == "diffuse" and mi.has_flag(layer.bsdf.flags(), flags.DiffuseTransmission):
            warnings.add("Diffuse light that shines through is left out: {names}.", name)
        if layer.kind == "wrapped" and layer is not find_relief(tree):
            warnings.add("Bump and normal maps inside a blend, or of one side only, are left out: {names}.", name)


def find_relief(tree: Layer) -> Layer | None:
    """Return the normal or bump map that the whole of `tree` has, or None."""
    layer = tree
    while layer.kind != "wrapped":
        if layer.kind not in ("twosided", "mask") or len(layer.inner) != 1:
            return None
        layer = layer.inner[0]
    return layer


def _classify(bsdf: Any) -> Kind:
    """Return "diffuse" (has a diffuse part), "passes" (transmits) or "specular" (only reflects) of a leaf."""
    flags = mi.BSDFFlags
    if mi.has_flag(bsdf.flags(), flags.DiffuseReflection):
        return "diffuse"
    through = (flags.Null, flags.DeltaTransmission, flags.GlossyTransmission, flags.DiffuseTransmission)
    return "passes" if any(mi.has_flag(bsdf.flags(), flag) for flag in through) else "specular"


def _mix(layer: Layer, si: Any, count: int, parts: list[np.ndarray]) -> np.ndarray:
    """Return what masks and blends make of their parts; what a mask lets through is not among them."""
    if layer.kind == "mask":
        return parts[0] * np.clip(number_rows(layer.textures["opacity"].eval_1(si), count), 0.0, 1.0)
    if layer.kind == "blend":
        weight = np.clip(number_rows(layer.textures["weight"].eval_1(si), count), 0.0, 1.0)
        return parts[0] * (1.0 - weight) + parts[1] * weight
    return parts[0]


def leaf_albedo(layer: Layer, si: Any, count: int) -> np.ndarray:
    """Return the diffuse reflectance; metal and refraction take their share of a principled BSDF."""
    albedo = np.clip(np.nan_to_num(colour_rows(layer.bsdf.eval_diffuse_reflectance(si), count)), 0.0, 1.0)
    if not layer.bsdf.class_name().startswith("Principled"):
        return albedo
    for slot, share in (("metallic", 1.0), ("spec_trans", 1.0), ("diff_trans", 0.5)):
        if slot in layer.textures:
            amount = number_rows(layer.textures[slot].eval_1(si), count)
            albedo = albedo * (1.0 - np.clip(share * amount, 0.0, 1.0))
    return albedo


def _slot_is_used(layer: Layer, slot: str) -> bool:
    """Return whether a principled layer has more than none of `slot` anywhere."""
    texture = layer.textures.get(slot)
    if texture is None:
        return False
    return is_attribute(texture) or texture.is_spatially_varying() or float(np.array(texture.mean()).ravel()[0]) > 0.0
