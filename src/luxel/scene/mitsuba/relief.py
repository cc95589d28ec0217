"""Normal and bump maps of Mitsuba as normal textures."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np

from luxel.scene.mitsuba.bsdf import Layer, find_relief
from luxel.scene.mitsuba.textures import bake, children, colour_rows, surface_at
from luxel.scene.model import Material, Mesh, Texture
from luxel.scene.warnings import Warnings

UNEVEN = 0.3
"""Share by which the stretch of uv may vary over a mesh before its bumps are said to be approximate."""


@dataclass(frozen=True)
class Stretch:
    """How a mesh lays its texture coordinates out, as means over its area; all zero where it has none."""

    along_u: float = 0.0
    """Metres that one unit of u takes."""
    along_v: float = 0.0
    spread: float = 0.0
    """Relative standard deviation of the two, the larger."""
    mirrored: bool = False
    """Seen from the front, v runs clockwise from u on most of the mesh."""

    def key(self) -> tuple[int, int, bool]:
        """Return what meshes share whose relief may be one texture: lengths within 5 %."""
        lengths = (self.along_u, self.along_v)
        steps = [round(math.log(length) / 0.05) if length > 0.0 else 0 for length in lengths]
        return steps[0], steps[1], self.mirrored


def measure_stretch(mesh: Mesh) -> Stretch:
    """Return the stretch of the mesh's first texture coordinates."""
    if mesh.uv is None or not len(mesh.faces):
        return Stretch()
    points, uv = mesh.positions[mesh.faces].astype(float), mesh.uv[mesh.faces].astype(float)
    edge_1, edge_2 = points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]
    (du1, dv1), (du2, dv2) = (uv[:, 1] - uv[:, 0]).T, (uv[:, 2] - uv[:, 0]).T
    determinant = du1 * dv2 - du2 * dv1
    area = np.linalg.norm(np.cross(edge_1, edge_2), axis=1)
    usable = (np.abs(determinant) > 1e-12) & (area > 0.0)
    if not usable.any():
        return Stretch()
    inverse = 1.0 / np.where(usable, determinant, 1.0)
    along_u = np.linalg.norm((edge_1 * dv2[:, None] - edge_2 * dv1[:, None]) * inverse[:, None], axis=1)[usable]
    along_v = np.linalg.norm((edge_2 * du1[:, None] - edge_1 * du2[:, None]) * inverse[:, None], axis=1)[usable]
    weight = area[usable] / area[usable].sum()
    means = [float(weight @ values) for values in (along_u, along_v)]
    spreads = [
        float(np.sqrt(weight @ (values / mean - 1.0) ** 2))
        for values, mean in zip((along_u, along_v), means, strict=True)
    ]
    return Stretch(means[0], means[1], max(spreads), float(weight @ np.sign(determinant[usable])) < 0.0)


def set_relief(material: Material, tree: Layer, stretch: Stretch, warnings: Warnings) -> None:
    """Give `material` the normal texture of a tree's normal or bump map; `stretch` is that of the mesh."""
    layer = find_relief(tree)
    if layer is None:
        return
    if layer.bsdf.class_name() == "NormalMap":
        texture = dict(children(layer.bsdf)).get("normalmap")
        _fill(material, texture, lambda uv: _stored_normals(texture, stretch, uv), 1, warnings)
        return
    texture = dict(children(layer.bsdf)).get("nested_texture")
    scale = float(np.array(mi.traverse(layer.bsdf)["scale"]).ravel()[0])
    if stretch.along_u == 0.0 or not _has_gradient(texture):
        warnings.add("Bump maps without texture coordinates or without a slope are left out: {names}.", material.name)
        return
    if stretch.spread > UNEVEN:
        warnings.add("Bumps on unevenly stretched texture coordinates have their mean height: {names}.", material.name)
    _fill(material, texture, lambda uv: _bumps(texture, scale, stretch, uv), 2, warnings)


def _fill(material: Material, texture: Any, evaluate: Any, finer: int, warnings: Warnings) -> None:
    image, baked = bake(evaluate, [texture], material.name, warnings, finer=finer)
    material.normal_texture = baked or Texture(image[:1, :1])
    material.normal_texture.srgb = False


def _stored_normals(texture: Any, stretch: Stretch, uv: np.ndarray) -> np.ndarray:
    """Return (N, 3) in 0..1. Mitsuba's green points to the left of +u; that of the model points against +v."""
    stored = colour_rows(texture.eval_3(surface_at(uv)), len(uv)).clip(0.0, 1.0)
    green = stored[:, 1] if stretch.mirrored else 1.0 - stored[:, 1]
    return np.stack([stored[:, 0], green, stored[:, 2]], axis=1)


def _has_gradient(texture: Any) -> bool:
    try:
        texture.eval_1_grad(surface_at(np.array([[0.5, 0.5]], np.float32)))
    except RuntimeError:
        return False
    return True


def _bumps(texture: Any, scale: float, stretch: Stretch, uv: np.ndarray) -> np.ndarray:
    """Return (N, 3) in 0..1: the normals of a height field whose coordinates are stretched so."""
    slope = np.broadcast_to(np.array(texture.eval_1_grad(surface_at(uv)), float).reshape(2, -1).T, (len(uv), 2))
    normal = np.stack(
        [-scale * slope[:, 0] / stretch.along_u, scale * slope[:, 1] / stretch.along_v, np.ones(len(uv))], axis=1
    )
    return 0.5 + 0.5 * normal / np.linalg.norm(normal, axis=1, keepdims=True)
