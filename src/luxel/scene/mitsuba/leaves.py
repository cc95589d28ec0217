"""What Mitsuba's BSDFs reflect and refract, at texture coordinates, by the names of `luxel.Material`."""

from __future__ import annotations

import re
from typing import Any

import mitsuba as mi
import numpy as np

from luxel.scene.mitsuba.bsdf import CONDUCTORS, GLASSES, GLOSSY, PLASTICS, PRINCIPLED, Layer, leaf_albedo
from luxel.scene.mitsuba.textures import children, colour_rows, number_rows, surface_at

Facts = dict[str, np.ndarray]
"""(N, 1 or 3) rows by name. `alpha` is the microfacets' width, 0 for a mirror."""

SLOTS = {
    "base_color": ("reflectance", "diffuse_reflectance", "base_color", "specular_transmittance", "diff_trans"),
    "glass_color": ("spec_trans", "metallic"),
    "surface": ("alpha", "alpha_u", "alpha_v", "roughness", "metallic"),
    "transmission": ("spec_trans",),
    "specular_color": ("specular_reflectance",),
    "clearcoat": ("clearcoat",),
    "clearcoat_roughness": ("clearcoat_gloss",),
    "index": ("eta", "k"),
}
"""Which textures of a BSDF a quantity depends on."""
WIDTHS = {"base_color": 3, "specular_color": 3, "eta": 3, "k": 3}
DEFAULTS = {"specular_color": 1.0, "ior": 1.5}
"""What is not zero where a BSDF does not say it."""
SHARES = ("roughness", "metallic", "spec_trans", "clearcoat", "clearcoat_gloss")
"""What `principled` takes from 0 to 1."""
CLEARCOAT_SHARE = 0.25
"""Burley's clear coat has this weight, and no cosines below it: it is weak at grazing angles."""
CLEARCOAT_ALPHA = (0.1, 0.001)
"""Width of a principled clear coat at gloss 0 and 1, in Mitsuba's source and Burley's notes."""


def read_leaf(layer: Layer, si: Any, count: int) -> Facts:
    """Return the facts of a BSDF that holds no other, at `count` places."""
    kind, bsdf = layer.bsdf.class_name(), layer.bsdf
    slots = dict(children(bsdf))
    facts: Facts = {}
    if kind in PLASTICS:
        facts = {"base_color": leaf_albedo(layer, si, count), "specular": np.ones(1)}
    elif kind in CONDUCTORS:
        facts = {name: _colour(slots.get(name), si, count) for name in ("eta", "k")}
        # A metal by index has no use for a base colour; samplers guess by it how much is reflected.
        facts |= {"metallic": np.ones(1), "base_color": np.ones(1)}
    elif kind in GLASSES:
        tint = _colour(slots.get("specular_transmittance"), si, count)
        facts = {"base_color": tint, "specular": np.ones(1), "transmission": np.ones(1)}
    elif kind in PRINCIPLED:
        facts = _read_principled(bsdf, slots, si, count, bends=kind == "Principled")
    elif layer.kind == "diffuse":
        facts = {"base_color": leaf_albedo(layer, si, count)}
    if kind in (*PLASTICS, *GLASSES):
        facts["ior"] = _number(bsdf, "eta")
    if kind in GLOSSY and kind not in PRINCIPLED:
        facts["specular_color"] = _colour(slots.get("specular_reflectance"), si, count)
        facts["alpha"] = _width(bsdf, slots, si, count)
    return _filled(facts, count)


def _read_principled(bsdf: Any, slots: dict[str, Any], si: Any, count: int, bends: bool) -> Facts:
    """Return the facts of a principled BSDF; `bends`: its glass is solid, and not a pane."""

    def share(name: str) -> np.ndarray:
        return number_rows(slots[name].eval_1(si), count).clip(0.0, 1.0) if name in slots else np.zeros((count, 1))

    base = _colour(slots["base_color"], si, count).clip(0.0, 1.0) * (1.0 - 0.5 * share("diff_trans"))
    ior, clear = _principled_ior(bsdf, slots, si), share("spec_trans")
    wide, narrow = CLEARCOAT_ALPHA
    facts = {
        "base_color": base,
        "specular": np.ones(1),
        "ior": ior,
        "metallic": share("metallic"),
        "transmission": clear,
        "alpha": share("roughness") ** 2,
        "clearcoat": CLEARCOAT_SHARE * share("clearcoat"),
        "clearcoat_alpha": wide + (narrow - wide) * share("clearcoat_gloss"),
    }
    if bends:
        # Light meets two sides of solid glass, and the root of the colour at each; here one colour serves all parts.
        glass = (1.0 - share("metallic")) * clear
        return facts | {"base_color": base + glass * (np.sqrt(base) - base)}
    # This pane reflects as one of its faces would, with no light to and fro between them, and only where it is clear;
    # what passes spreads less, by its index (Burley 2015).
    face = ((ior - 1.0) / (ior + 1.0)) ** 2
    lower = np.sqrt(face / (2.0 - face))
    spread = np.where(clear > 0.0, np.clip(0.65 * ior - 0.35, 0.0, 1.0), 1.0)
    return facts | {
        "ior": (1.0 + lower) / (1.0 - lower),
        "specular": np.where(clear > 0.0, 1.0, 0.0),
        "alpha": (spread * share("roughness")) ** 2,
    }


def _principled_ior(bsdf: Any, slots: dict[str, Any], si: Any) -> np.ndarray:
    """Return the index, which `specular` may stand for: it is 12.5 times the reflectance at normal incidence."""
    if "eta" in slots:
        return number_rows(slots["eta"].eval_1(si), 1)
    found = mi.traverse(bsdf)
    if "eta" in found:
        return _number(bsdf, "eta")
    mirrored = np.sqrt(0.08 * np.clip(_number(bsdf, "specular"), 0.0, 12.0))
    return (1.0 + mirrored) / (1.0 - mirrored)


def holds_impossible(layer: Layer, uv: np.ndarray) -> bool:
    """Return whether a width, a complex index or a share of a BSDF is out of its range at one of `uv` (N, 2)."""
    kind, slots = layer.bsdf.class_name(), dict(children(layer.bsdf))
    si, count = surface_at(uv), len(uv)
    limits = (0.0, 1.0) if kind in PRINCIPLED else (0.0, np.inf)
    names = SHARES if kind in PRINCIPLED else ("alpha", "alpha_u", "alpha_v")
    values = [number_rows(slots[name].eval_1(si), count) for name in names if name in slots]
    if kind.startswith("Rough") and not values:
        values = [_number(layer.bsdf, "alpha")]
    if kind in CONDUCTORS:
        values += [_colour(slots[name], si, count) for name in ("eta", "k") if name in slots]
    return any(value.min() < limits[0] or value.max() > limits[1] for value in values)


def is_anisotropic(layer: Layer) -> bool:
    """Return whether a BSDF is rougher along one direction than along the other."""
    slots = dict(children(layer.bsdf))
    turned = slots.get("anisotropic")
    return "alpha_u" in slots or (turned is not None and _is_used(turned))


def is_used(layer: Layer, *names: str) -> bool:
    """Return whether a BSDF has more than none of one of these textures."""
    slots = dict(children(layer.bsdf))
    return any(name in slots and _is_used(slots[name]) for name in names)


def distribution_of(layer: Layer) -> str:
    """Return the name of the microfacets' distribution; "ggx" where there are none or it is not said."""
    found = re.search(r"distribution = (\w+)", str(layer.bsdf))
    return "beckmann" if found is not None and found[1] == "beckmann" else "ggx"


def is_nonlinear(layer: Layer) -> bool:
    """Return whether a plastic's colour deepens by reflection inside of it."""
    return re.search(r"nonlinear = (1|true)", str(layer.bsdf)) is not None


def _is_used(texture: Any) -> bool:
    return texture.is_spatially_varying() or float(np.array(texture.mean()).ravel()[0]) > 0.0


def _width(bsdf: Any, slots: dict[str, Any], si: Any, count: int) -> np.ndarray:
    """Return the microfacets' width, the mean of both directions'."""
    widths = [slots[name] for name in ("alpha", "alpha_u", "alpha_v") if name in slots]
    if widths:
        return np.mean([number_rows(texture.eval_1(si), count) for texture in widths], axis=0)
    return _number(bsdf, "alpha") if bsdf.class_name().startswith("Rough") else np.zeros(1)


def _number(bsdf: Any, name: str) -> np.ndarray:
    """Return a parameter that is no texture, (1,)."""
    return np.array(mi.traverse(bsdf)[name], np.float64).ravel()[:1]


def _colour(texture: Any, si: Any, count: int) -> np.ndarray:
    return np.ones((count, 3)) if texture is None else np.nan_to_num(colour_rows(texture.eval(si), count))


def _filled(facts: Facts, count: int) -> Facts:
    """Return all facts as rows, what is not said with its default."""
    names = ("base_color", "metallic", "transmission", "specular", "specular_color", "ior", "alpha", "clearcoat")
    rows = {}
    for name in (*names, "clearcoat_alpha", "eta", "k"):
        value = facts.get(name, np.full(1, DEFAULTS.get(name, 0.0)))
        rows[name] = np.broadcast_to(value, (count, WIDTHS.get(name, 1))).astype(np.float64)
    return rows
