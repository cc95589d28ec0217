"""How much light gets through to a surface: what lies on a shadow ray, per channel.

Holes of cut-outs let it by, blended surfaces by chance (`is_opaque`), and smooth thin panes weaken and colour it; all
else stops it. What refracts does not count: light behind it comes by paths that meet its source.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from luxel.kernels.bsdf import ALPHA_FLOOR, BSDF, straight_transmittance
from luxel.kernels.material import fetch_flags
from luxel.kernels.ray_origin import NO_TRIANGLE, next_step
from luxel.kernels.surface import surface_at_hit
from luxel.kernels.surface_bsdf import bsdf_frame
from luxel.kernels.trace import CUTOUT_LAYER_LIMIT, Hit, trace_closest, trace_occluded
from luxel.kernels.triangle import fetch_triangle
from luxel.scene.device import Scene
from luxel.scene.gloss import FLAG_THIN


def trace_transmittance(
    scene: Scene, origin: mi.Point3f, direction: mi.Vector3f, distance: mi.Float, active: mi.Bool
) -> mi.Color3f:
    """Return the share of light, per channel, that passes straight along each shadow ray (unit direction, world space).

    0 where the lane is not active.
    """
    if scene.features.gloss and scene.materials.gloss.has_thin:
        return _walk_through_panes(scene, origin, direction, distance, active)
    passes = active & ~trace_occluded(scene, origin, direction, distance, active)
    return mi.Color3f(dr.select(passes, mi.Float(1.0), 0.0))


def is_pane(bsdf: BSDF) -> mi.Bool:
    """Return whether some light passes straight: what rays meet behind it, shadow rays reach, too."""
    if not bsdf.features.transmission:
        return mi.Bool(False)
    return mi.Bool(bsdf.thin) & (mi.Float(bsdf.alpha) < ALPHA_FLOOR) & (mi.Float(bsdf.transmission) > 0.0)


@dr.syntax
def _walk_through_panes(
    scene: Scene, origin: mi.Point3f, direction: mi.Vector3f, distance: mi.Float, active: mi.Bool
) -> mi.Color3f:
    """Go from hit to hit until nothing is left of the light or the way is done."""
    passes = dr.select(active, mi.Color3f(1.0), mi.Color3f(0.0))
    going = mi.Bool(active)
    start, step, layer = mi.Float(0.0), mi.Float(0.0), mi.UInt32(0)
    passed = mi.UInt32(NO_TRIANGLE)
    while going:
        hit = trace_closest(scene, origin + start * direction, direction, going)
        place = start + hit.t
        met = going & hit.valid & (place < distance)
        # One triangle is met once; where the ray meets it again it was not yet clear of it.
        again = hit.prim_id == passed
        fresh = met & ~again
        # Most rays end at what is no pane: one flag tells, so that no BSDF is made there.
        pane = fresh & _is_thin(scene, hit.prim_id, fresh)
        passes = dr.select(fresh & ~pane, mi.Color3f(0.0), passes)
        if pane:
            passes *= _pane_transmittance(scene, hit, direction, pane)
        passes = dr.select(met & (layer >= CUTOUT_LAYER_LIMIT), mi.Color3f(0.0), passes)
        step = next_step(origin, direction, place, step, again)
        start = dr.select(met, place + step, start)
        passed = mi.UInt32(hit.prim_id)
        layer += dr.select(again, mi.UInt32(0), 1)
        going &= met & (dr.max(passes) > 0.0)
    return passes


def _is_thin(scene: Scene, prim_id: mi.UInt32, active: mi.Bool) -> mi.Bool:
    """Return whether the triangles' material is thin: what `is_pane` is true of is."""
    material = fetch_triangle(scene, prim_id, active).material
    return (fetch_flags(scene, material, active) & FLAG_THIN) != 0


def _pane_transmittance(scene: Scene, hit: Hit, direction: mi.Vector3f, active: mi.Bool) -> mi.Color3f:
    """Return the share of light that the surface at `hit` lets pass straight: 0 of all but panes."""
    surface = surface_at_hit(scene, hit, direction)
    wo = bsdf_frame(scene, surface).to_local(surface.wo)
    return straight_transmittance(surface.bsdf, wo, active & is_pane(surface.bsdf))
