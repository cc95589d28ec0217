"""Looks of what the materials are: roughness, metal, glass, opacity, as the file says.

They do not depend on what the scene was uploaded with: under the diffuse condition, too, which lets light through glass
and knows no metal, the facts of `luxel.Material` are shown. Holes of cut-outs are looked through; a blended surface and
glass are shown where they are, whatever lies behind them.
"""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.inspect.looks.shot import Shot
from luxel.kernels.gbuffer import trace_gbuffer
from luxel.kernels.material import metallic_share, roughness_at, surface_alpha, transmitted_share
from luxel.kernels.triangle import TrianglePoint, fetch_triangle, interpolate
from luxel.scene.arrays import to_floats
from luxel.scene.device import Scene
from luxel.scene.gloss import is_glass
from luxel.scene.textures import MaterialTables, build_material_tables

CUTOFF = 7
"""Column of a material's factors: the alpha below which rays pass, negative where chance decides."""


def read_fact(shot: Shot, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return `name` (roughness, metallic, transmission or opacity) at the pixels (H, W), and where a surface is."""
    scene = _with_facts(shot.scene)
    seen = trace_gbuffer(_stopped_by_blends(scene), shot.film, shot.camera, shot.camera).surface
    active = seen.active
    point = interpolate(scene, fetch_triangle(scene, seen.prim_id, active), seen.barycentric, active)
    value = {
        "roughness": roughness_at,
        "metallic": metallic_share,
        "transmission": transmitted_share,
        "opacity": _opacity,
    }[name](scene, point, active)
    image = shot.film.to_image(dr.clip(mi.Float(value), 0.0, 1.0))
    return image, shot.film.to_image(active).astype(bool)


def _opacity(scene: Scene, point: TrianglePoint, active: mi.Bool) -> mi.Float:
    """Return alpha where chance decides; what stands of a cut-out stops every ray."""
    blended = dr.gather(mi.Float, scene.materials.factors, 16 * point.material + CUTOFF, active) < 0.0
    return dr.select(blended, surface_alpha(scene, point, active), 1.0)


def _with_facts(scene: Scene) -> Scene:
    """Return the scene with tables of all that its materials are, made once for each state of them."""
    host = scene.host
    if host.looks == "full":
        return scene
    materials = host.data.materials
    if host.facts is None or host.facts[0] is not materials:
        host.facts = materials, build_material_tables(host.data, True)
    tables: MaterialTables = host.facts[1]
    return replace(
        scene, materials=tables, features=replace(scene.features, transmission=any(map(is_glass, materials)))
    )


def _stopped_by_blends(scene: Scene) -> Scene:
    """Return the scene in which no ray passes by chance."""
    factors = np.array(scene.materials.factors).reshape(-1, 16)
    factors[:, CUTOFF] = np.maximum(factors[:, CUTOFF], 0.0)
    return replace(scene, materials=replace(scene.materials, factors=to_floats(factors)))
