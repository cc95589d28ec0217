"""Rays against a scene: the nearest hit, and whether anything is in the way.

On the CPU the groups are queried one after the other; with OptiX they are one structure. Cut-outs (alpha-tested
triangles) and blended surfaces are walked through: a ray goes on behind every hit that does not stop it
(`is_opaque`). So are moving objects where only the still ones are asked for and all share one structure.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from luxel.kernels.material import opacity
from luxel.kernels.ray_origin import NO_TRIANGLE, largest, next_step
from luxel.kernels.sampling import hash_pair, to_unit
from luxel.kernels.transform import transform_point, transform_vector
from luxel.kernels.triangle import fetch_triangle, interpolate
from luxel.scene.accel import Group
from luxel.scene.device import Scene
from luxel.scene.rounding import STEP

CUTOUT_LAYER_LIMIT = 64
"""Layers of alpha-tested triangles, or of moving ones where still ones are asked for, that one ray passes before the
next one stops it."""


@dataclass
class Hit:
    """The nearest triangle along a ray."""

    t: mi.Float
    """Distance in units of the ray direction's length; infinite for a miss."""
    prim_id: mi.UInt32
    """Over the whole scene."""
    barycentric: mi.Point2f
    valid: mi.Bool


def trace_closest(
    scene: Scene,
    origin: mi.Point3f,
    direction: mi.Vector3f,
    active: mi.Bool,
    *,
    coherent: bool = False,
    still: bool = False,
    limit: mi.Float | None = None,
) -> Hit:
    """Return the nearest hit of each ray; `direction` is unit and in world space.

    `still`: moving objects let it by. `limit`: metres at which each ray ends; a hit's distance is meaningless where it
    is not valid then.
    """
    nothing = mi.Float(dr.inf) if limit is None else mi.Float(limit)
    if scene.one is not None:
        if scene.one.cutout or (still and scene.features.moving):
            return _closest_stopping(scene, None, origin, direction, nothing, active, still)
        return _query(scene, None, _make_ray(origin, direction, nothing), active, coherent)
    hit = Hit(mi.Float(nothing), mi.UInt32(0), mi.Point2f(0.0), mi.Bool(False))
    for group in _groups(scene, still):
        o, d = _to_group_space(scene, group, origin, direction)
        found = _closest_in_group(scene, group, o, d, hit.t, active, coherent)
        nearer = found.valid & (found.t < hit.t)
        hit = Hit(
            dr.select(nearer, found.t, hit.t),
            dr.select(nearer, found.prim_id, hit.prim_id),
            dr.select(nearer, found.barycentric, hit.barycentric),
            hit.valid | nearer,
        )
    return hit


def trace_occluded(
    scene: Scene,
    origin: mi.Point3f,
    direction: mi.Vector3f,
    distance: mi.Float,
    active: mi.Bool,
    *,
    still: bool = False,
) -> mi.Bool:
    """Return whether anything lies within `distance` along each ray (unit direction, world space).

    `still`: moving objects let it by.
    """
    if scene.one is not None:
        if scene.one.cutout or (still and scene.features.moving):
            return _closest_stopping(scene, None, origin, direction, distance, active, still).valid
        return scene.one.accel.ray_test(_make_ray(origin, direction, distance), active) & active
    blocked = mi.Bool(False)
    for group in _groups(scene, still):
        o, d = _to_group_space(scene, group, origin, direction)
        wanted = active & ~blocked
        if group.cutout:
            blocked |= _closest_in_group(scene, group, o, d, distance, wanted, False).valid
        else:
            blocked |= _structure(scene, group).ray_test(_make_ray(o, d, distance), wanted)
    return blocked & active


def offset_origin(scene: Scene, p: mi.Point3f, n: mi.Normal3f) -> mi.Point3f:
    """Return `p` moved off its surface along `n`, so that a ray from there does not meet it again.

    `p` is a `Surface`'s, which clears its triangle already: this covers what transforms and storage round off since,
    and points from outside that lie on a surface as well as their coordinates can say.
    """
    return mi.Point3f(p + mi.Vector3f(n) * rounding_at(scene, p))


def rounding_at(scene: Scene, p: mi.Point3f) -> mi.Float:
    """Return the distance, metres, that clears what rounding does to a point at `p`."""
    return STEP * dr.fmax(largest(p), scene.coordinate)


def _groups(scene: Scene, still: bool) -> list[Group]:
    return [group for group in scene.groups if group.object_id == 0] if still else scene.groups


def _make_ray(origin: mi.Point3f, direction: mi.Vector3f, distance: mi.Float) -> mi.Ray3f:
    return mi.Ray3f(origin, direction, distance, 0.0, [])


def _to_group_space(
    scene: Scene, group: Group, origin: mi.Point3f, direction: mi.Vector3f
) -> tuple[mi.Point3f, mi.Vector3f]:
    """Bring a ray to the space of a moving group. The direction keeps its scale there, so distances stay the same."""
    if group.object_id == 0:
        return origin, direction
    row = mi.UInt32(group.object_id)
    return (
        transform_point(scene.geometry.to_object, row, origin),
        transform_vector(scene.geometry.to_object, row, direction),
    )


def _closest_in_group(
    scene: Scene,
    group: Group,
    origin: mi.Point3f,
    direction: mi.Vector3f,
    limit: mi.Float,
    active: mi.Bool,
    coherent: bool,
) -> Hit:
    if group.cutout:
        return _closest_stopping(scene, group, origin, direction, limit, active, False)
    return _query(scene, group, _make_ray(origin, direction, limit), active, coherent)


def _query(scene: Scene, group: Group | None, ray: mi.Ray3f, active: mi.Bool, coherent: bool) -> Hit:
    """Return the nearest hit in one group, or, for None, in the one structure of all groups."""
    pi = _structure(scene, group).ray_intersect_preliminary(ray, coherent=coherent, active=active)
    valid = pi.is_valid() & active
    prim_id = pi.prim_index
    if group is not None:
        prim_id += group.prim_offset
    elif scene.one is not None and scene.one.several:
        instance = dr.reinterpret_array(mi.UInt32, pi.instance)
        owner = dr.select(instance != 0, instance, dr.reinterpret_array(mi.UInt32, pi.shape))
        prim_id += dr.gather(mi.UInt32, scene.one.prim_offsets, owner, valid)
    return Hit(pi.t, prim_id, mi.Point2f(pi.prim_uv), valid)


def _structure(scene: Scene, group: Group | None) -> mi.Scene:
    """Return what rays are traced against: the group's own structure, or the one of all groups."""
    found = group.accel if group is not None else scene.one.accel if scene.one is not None else None
    assert found is not None
    return found


@dr.syntax
def _closest_stopping(
    scene: Scene,
    group: Group | None,
    origin: mi.Point3f,
    direction: mi.Vector3f,
    limit: mi.Float,
    active: mi.Bool,
    still: bool,
) -> Hit:
    """Walk through a group (None: the one structure of all groups) until a hit stops the ray.

    Holes of cut-outs do not, nor, where `still`, what moves.
    """
    # Still groups come first in the shared buffers.
    still_count = sum(item.prim_count for item in _groups(scene, True))
    cutout = group.cutout if group is not None else scene.one is not None and scene.one.cutout
    start = mi.Float(0.0)
    going = mi.Bool(active)
    layer = mi.UInt32(0)
    passed = mi.UInt32(NO_TRIANGLE)
    step = mi.Float(0.0)
    t = mi.Float(dr.inf)
    prim = mi.UInt32(0)
    barycentric = mi.Point2f(0.0)
    found = mi.Bool(False)
    while going:
        ray = mi.Ray3f(origin + start * direction, direction, limit - start, 0.0, [])
        hit = _query(scene, group, ray, going, False)
        stops = mi.Bool(hit.valid)
        if dr.hint(cutout, mode="scalar"):
            stops &= is_opaque(scene, hit.prim_id, hit.barycentric, hit.valid)
        if dr.hint(still, mode="scalar"):
            stops &= hit.prim_id < still_count
        solid = stops | (hit.valid & (layer >= CUTOUT_LAYER_LIMIT))
        t = dr.select(solid, start + hit.t, t)
        prim = dr.select(solid, hit.prim_id, prim)
        barycentric = dr.select(solid, hit.barycentric, barycentric)
        found |= solid
        # One triangle is met once; where the ray meets it again it was not yet clear of it.
        again = hit.prim_id == passed
        step = next_step(origin, direction, start + hit.t, step, again)
        start = dr.select(hit.valid, start + hit.t + step, start)
        passed = mi.UInt32(hit.prim_id)
        layer += dr.select(again, mi.UInt32(0), 1)
        going &= hit.valid & ~solid & (start < limit)
    return Hit(t, prim, barycentric, found)


def is_opaque(scene: Scene, prim_id: mi.UInt32, barycentric: mi.Point2f, active: mi.Bool) -> mi.Bool:
    """Return whether the surface stops a ray there.

    Cut-outs do where alpha reaches the material's cutoff. Where a ray passes by chance, the threshold is drawn anew
    for each hit and each `Scene.layer_seed`, so that every ray of a frame meets one stochastic layer.
    """
    point = interpolate(scene, fetch_triangle(scene, prim_id, active), barycentric, active)
    share = opacity(scene, point, active)
    if not scene.features.blended:
        return share > 0.5
    place = dr.reinterpret_array(mi.UInt32, barycentric.x) ^ (
        dr.reinterpret_array(mi.UInt32, barycentric.y) * 0x9E3779B1
    )
    word, _ = hash_pair(scene.layer_seed + prim_id * 0x85EBCA6B, place)
    return to_unit(word) < share
