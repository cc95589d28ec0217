"""What the lightmap answers at a surface: its texels where the surface was baked, the probes elsewhere."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from luxel.kernels.records import Light, Surface
from luxel.kernels.trace import rounding_at, trace_closest
from luxel.kernels.triangle import face_vector, fetch_triangle
from luxel.methods.lightmap.flatten.tables import locate
from luxel.methods.lightmap.run.probes import read_probes
from luxel.methods.lightmap.run.state import LightmapState, read_lightmap
from luxel.scene.device import Scene

FREE_REACH = 1e-3
"""A free point this near to a baked surface that faces its way, as a share of a probe's cube, takes its texels."""
FREE_COSINE = 0.9
"""Cosine between the free point's normal and that surface's, at least."""


def query_lightmap(scene: Scene, state: LightmapState, surface: Surface, *, free: bool = True) -> Light:
    """Return light on baked surfaces, on moving ones and, unless `free` is False, at free points on neither."""
    on_object = surface.active & (surface.object_id != 0)
    uv, found = locate(state.tables, surface.prim_id, ~surface.front, surface.barycentric, on_object)
    if free:
        near_uv, near = _place_of_free_points(scene, state, surface, surface.active & (surface.object_id == 0))
        uv, found = dr.select(near, near_uv, uv), found | near
    row = read_lightmap(state.tables, state.light, uv, found)
    answered = found & (row.w > 0.0)
    elsewhere = surface.active & ~answered
    light, seen = read_probes(scene, state, surface.p, surface.n_geometric, surface.n_shading, elsewhere)
    irradiance = dr.select(answered, mi.Color3f(row.x, row.y, row.z), dr.select(seen, light, mi.Color3f(0.0)))
    return Light(irradiance, mi.Color3f(0.0), dr.select(answered | (elsewhere & seen), mi.Float(1.0), 0.0))


def _place_of_free_points(
    scene: Scene, state: LightmapState, surface: Surface, active: mi.Bool
) -> tuple[mi.Point2f, mi.Bool]:
    """Return the place in the atlas of free points that lie on a baked surface and face its way."""
    reach = FREE_REACH * state.probes.size + 4.0 * rounding_at(scene, surface.p)
    origin = mi.Point3f(surface.p + mi.Vector3f(surface.n_geometric) * reach)
    down = -mi.Vector3f(surface.n_geometric)
    hit = trace_closest(scene, origin, down, active, still=True)
    hit_near = hit.valid & (hit.t < 2.0 * reach)
    face = face_vector(fetch_triangle(scene, hit.prim_id, hit_near).positions)
    cosine = -dr.dot(dr.normalize(face), down)
    hit_near &= dr.abs(cosine) > FREE_COSINE
    return locate(state.tables, hit.prim_id, cosine < 0.0, hit.barycentric, hit_near)
