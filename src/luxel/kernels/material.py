"""Rows of the material tables: albedo, emission and opacity at a point of a triangle.

The one evaluation of each. What a camera sees, what the light sampler draws and what stops a ray all ask here.
"""

from __future__ import annotations

from collections.abc import Iterator

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.kernels.texture import fetch_texture
from luxel.kernels.triangle import TrianglePoint
from luxel.scene.device import Scene
from luxel.scene.gloss import GLOSS_PACKETS, GLOSS_SLOTS
from luxel.scene.textures import FLAG_EMIT_BACK, FLAG_EMIT_COLORS, FLAG_REFLECT_BACK


def fetch_slots(scene: Scene, material: mi.UInt32, active: mi.Bool) -> mi.Vector4u:
    """Return the texture rows of albedo, emission, normal and roughness; 0 means none."""
    return dr.gather(mi.Vector4u, scene.materials.slots, 2 * material, active)


def fetch_flags(scene: Scene, material: mi.UInt32, active: mi.Bool) -> mi.UInt32:
    """Return the material's `FLAG_` bits."""
    return dr.gather(mi.UInt32, scene.materials.slots, 8 * material + 4, active)


def fetch_factors(scene: Scene, material: mi.UInt32, packet: int, active: mi.Bool) -> mi.Vector4f:
    """Return packet 0 to 3 of the material's factors, as `MaterialTables.factors` lists them."""
    return dr.gather(mi.Vector4f, scene.materials.factors, 4 * material + packet, active)


def emits_light(scene: Scene, material: mi.UInt32, active: mi.Bool) -> mi.Bool:
    """Return whether the material emits on either side, whatever its texture."""
    row = fetch_factors(scene, material, 1, active)
    return active & (dr.max(mi.Color3f(row.x, row.y, row.z)) > 0.0)


def base_color(scene: Scene, point: TrianglePoint, active: mi.Bool) -> mi.Color3f:
    """Return the base colour, not yet held to 0..1; where the tables combine it with metallic, the albedo of that."""
    color = _base_without_vertices(scene, point, active)
    return color * mi.Color3f(point.color.x, point.color.y, point.color.z) if scene.features.colors else color


def _base_without_vertices(scene: Scene, point: TrianglePoint, active: mi.Bool) -> mi.Color3f:
    tables = scene.materials
    row = fetch_factors(scene, point.material, 0, active)
    color = mi.Color3f(row.x, row.y, row.z)
    if tables.has_albedo:
        slot = fetch_slots(scene, point.material, active).x
        texel = fetch_texture(tables, slot, point.uv, point.uv2, active)
        color *= mi.Color3f(texel.x, texel.y, texel.z)
    return color


def metallic_share(scene: Scene, point: TrianglePoint, active: mi.Bool) -> mi.Float:
    """Return the share of the surface that is metal, where it is read apart from the colour; else 0."""
    if not scene.materials.has_metallic:
        return mi.Float(0.0)
    metallic = fetch_factors(scene, point.material, 3, active).y
    slot = fetch_slots(scene, point.material, active).w
    return metallic * fetch_texture(scene.materials, slot, point.uv, point.uv2, active).z


def transmitted_share(scene: Scene, point: TrianglePoint, active: mi.Bool) -> mi.Float:
    """Return the share of what is no metal that is glass."""
    if not scene.features.transmission:
        return mi.Float(0.0)
    gloss = scene.materials.gloss
    share = dr.gather(mi.Vector4f, gloss.factors, GLOSS_PACKETS * point.material, active).z
    if gloss.has_textures:
        slot = dr.gather(mi.Vector4u, gloss.slots, (GLOSS_SLOTS // 4) * point.material, active).z
        share *= fetch_texture(scene.materials, slot, point.uv, point.uv2, active).x
    return share


def diffuse_albedo(scene: Scene, point: TrianglePoint, front: mi.Bool, active: mi.Bool) -> mi.Color3f:
    """Return the diffuse reflectance, 0..1, of the side that is looked at."""
    tables = scene.materials
    albedo = _base_without_vertices(scene, point, active)
    if tables.has_metallic:
        albedo *= 1.0 - metallic_share(scene, point, active)
    if scene.features.colors:
        albedo *= mi.Color3f(point.color.x, point.color.y, point.color.z)
    if scene.features.transmission:
        albedo *= 1.0 - transmitted_share(scene, point, active)
    albedo = dr.clip(albedo, 0.0, 1.0)
    if tables.one_sided:
        flags = fetch_flags(scene, point.material, active)
        albedo = dr.select(front | ((flags & FLAG_REFLECT_BACK) != 0), albedo, mi.Color3f(0.0))
    return dr.select(active, albedo, mi.Color3f(0.0))


def roughness_at(scene: Scene, point: TrianglePoint, active: mi.Bool) -> mi.Float:
    """Return the roughness as it looks; the width of the microfacets' distribution is its square."""
    roughness = fetch_factors(scene, point.material, 2, active).x
    if scene.materials.has_roughness:
        slot = fetch_slots(scene, point.material, active).w
        roughness *= fetch_texture(scene.materials, slot, point.uv, point.uv2, active).y
    return roughness


def emitted_radiance(scene: Scene, point: TrianglePoint, front: mi.Bool, active: mi.Bool) -> mi.Color3f:
    """Return the radiance, W/(m^2 sr), that the side that is looked at emits."""
    tables = scene.materials
    row = fetch_factors(scene, point.material, 1, active)
    emission = mi.Color3f(row.x, row.y, row.z) * scene.lights.scale
    flags = fetch_flags(scene, point.material, active)
    if tables.has_emission:
        slot = fetch_slots(scene, point.material, active).y
        texel = fetch_texture(tables, slot, point.uv, point.uv2, active)
        emission *= mi.Color3f(texel.x, texel.y, texel.z)
    if scene.features.colors:
        color = mi.Color3f(point.color.x, point.color.y, point.color.z)
        emission *= dr.select((flags & FLAG_EMIT_COLORS) != 0, color, mi.Color3f(1.0))
    return dr.select(active & (front | ((flags & FLAG_EMIT_BACK) != 0)), emission, mi.Color3f(0.0))


def surface_alpha(scene: Scene, point: TrianglePoint, active: mi.Bool) -> mi.Float:
    """Return alpha as factor, texture and vertex colour make it."""
    tables = scene.materials
    alpha = fetch_factors(scene, point.material, 0, active).w
    if scene.features.colors:
        alpha *= point.color.w
    if tables.has_albedo:
        slot = fetch_slots(scene, point.material, active).x
        alpha *= fetch_texture(tables, slot, point.uv, point.uv2, active).w
    return alpha


def opacity(scene: Scene, point: TrianglePoint, active: mi.Bool) -> mi.Float:
    """Return the probability that the surface stops a ray: 0 or 1 for cut-outs, alpha where a ray passes by chance."""
    alpha = surface_alpha(scene, point, active)
    cutoff = fetch_factors(scene, point.material, 1, active).w
    return dr.select(cutoff < 0.0, dr.clip(alpha, 0.0, 1.0), dr.select(alpha < cutoff, 0.0, 1.0))


def describe_reflection(scene: Scene, materials: np.ndarray) -> Iterator[np.ndarray]:
    """Yield what `materials` (N,) reflect and let pass, on the host, for hashes of it: factors, sides, texture."""
    tables = scene.materials
    factors, slots = np.array(tables.factors).reshape(-1, 16), np.array(tables.slots).reshape(-1, 8)
    textures, transforms = np.array(tables.textures).reshape(-1, 4), np.array(tables.transforms).reshape(-1, 8)
    texels = np.array(tables.texels)
    for material in materials:
        row = slots[material, 0]
        first, width, height, _ = textures[row].tolist()
        yield factors[material, [0, 1, 2, 3, 7]]
        yield slots[material, 4] & FLAG_REFLECT_BACK
        yield textures[row, 1:]
        yield transforms[row]
        yield texels[first : first + width * height]
