"""The floor of a frame: what no implementation of the same method on the same machine can avoid.

The bare ray casts of the same count and kind (the g-buffer's, the direct light's shadow rays, the method's rays and
their shadow rays, from the same places), plus the bytes that a frame must read and write over the measured bandwidth.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.kernels.camera import camera_ray
from luxel.kernels.direct import shadow_ray_count
from luxel.kernels.sampling import cosine_hemisphere, random_2d, to_world
from luxel.kernels.surface import surface_at_hit
from luxel.kernels.trace import offset_origin, trace_closest, trace_occluded
from luxel.kernels.triangle import read_positions, read_triangles
from luxel.methods.workload import Workload
from luxel.render.renderer import Renderer
from luxel.scene.device import Scene
from luxel.scene.lights import ENTRY_IS_DELTA, NO_ENTRY

COPY_FLOATS = 1 << 24
"""Floats that the bandwidth measurement copies: 64 MiB, beyond the caches of most machines."""


def count_rays(renderer: Renderer) -> dict[str, int] | None:
    """Return rays of a frame at most, by kind: `closest` and `shadow`, of the frame itself and of the method.

    `short` is there where the method casts rays that end after a length of its own. A miss, or a point that faces away
    from a light, casts no shadow ray. None where the method has no `workload`.
    """
    workload = renderer.method.workload
    if workload is None:
        return None
    film, scene = renderer.film, renderer.scene
    pixels = film.width * film.height
    own = workload.ray_counts(renderer.state)
    shadow = 0 if "direct" in renderer.method.holds else pixels * shadow_ray_count(scene)
    of_method = own.get("shadow", own.get("closest", 0) * shadow_ray_count(scene))
    counts = {
        "closest": pixels + own.get("closest", 0),
        "shadow": shadow + of_method + own.get("sky", 0),
    }
    if "short" in own:
        counts["short"] = own["short"]
    return counts


def measure_floor(renderer: Renderer, repeats: int = 5) -> float | None:
    """Return the floor of `renderer`'s frame in milliseconds: casts and memory traffic, median of `repeats`.

    None where the method has no `workload`.
    """
    workload = renderer.method.workload
    if workload is None:
        return None
    casts = _primary_casts(renderer) + _secondary_casts(renderer, workload)
    total = sum(_median_ms(cast, repeats) for cast in casts)
    return total + 1e3 * touched_bytes(renderer, workload) / measure_bandwidth(repeats)


def measure_method_rays(renderer: Renderer, repeats: int = 5) -> float | None:
    """Return the milliseconds of the bare casts of the method's own rays; None where it casts or counts none."""
    workload = renderer.method.workload
    casts = [] if workload is None else _secondary_casts(renderer, workload)
    return sum(_median_ms(cast, repeats) for cast in casts) if casts else None


def _primary_casts(renderer: Renderer) -> list[Callable[[], Any]]:
    """Return the g-buffer's casts and the shadow rays of the direct light, as functions that cast them."""
    scene, film, camera = renderer.scene, renderer.film, renderer.view_camera
    lane = dr.arange(mi.UInt32, film.lane_count)
    column, row, inside = film.pixel_of_lane(lane)
    x = (mi.Float(column) + 0.5) * (2.0 / film.width) - 1.0
    y = 1.0 - (mi.Float(row) + 0.5) * (2.0 / film.height)
    eye, direction = camera_ray(camera, x, y)
    hit = trace_closest(scene, eye, direction, inside, coherent=True)
    surface = surface_at_hit(scene, hit, direction)
    origin = offset_origin(scene, surface.p, surface.n_geometric)
    dr.eval(direction, inside, hit.valid, origin, surface.n_geometric)
    casts: list[Callable[[], Any]] = [lambda: trace_closest(scene, eye, direction, inside, coherent=True).t]
    if "direct" not in renderer.method.holds:
        casts += _shadow_casts(renderer, origin, mi.Vector3f(surface.n_geometric), hit.valid)
    return casts


def _secondary_casts(renderer: Renderer, workload: Workload) -> list[Callable[[], Any]]:
    """Return the method's casts: its rays from its own places, and the shadow rays at their hits."""
    scene = renderer.scene
    surfaces = workload.ray_origins(scene, renderer.state)
    if surfaces is None:
        return []
    p, n, active = surfaces
    lane = dr.arange(mi.UInt32, dr.width(active))
    given = workload.ray_directions(scene, renderer.state)
    direction = to_world(n, cosine_hemisphere(random_2d(lane, mi.UInt32(1)))) if given is None else given
    origin = offset_origin(scene, p, n)
    hit = trace_closest(scene, origin, direction, active)
    surface = surface_at_hit(scene, hit, direction)
    behind = offset_origin(scene, surface.p, surface.n_geometric)
    dr.eval(origin, direction, active, behind, surface.n_geometric, hit.valid)
    casts: list[Callable[[], Any]] = [lambda: trace_closest(scene, origin, direction, active).t]
    return casts + _shadow_casts(renderer, behind, mi.Vector3f(surface.n_geometric), hit.valid)


def _shadow_casts(renderer: Renderer, origin: mi.Point3f, n: mi.Vector3f, active: mi.Bool) -> list[Callable[[], Any]]:
    """Return one cast a shadow ray of each point: along a delta light's direction or to a point of an emitter."""
    scene = renderer.scene
    casts: list[Callable[[], Any]] = []
    for target, is_point, count in light_targets(scene):
        to_light = target - origin if is_point else mi.Vector3f(target)
        distance = dr.norm(to_light) * (1.0 - 1e-3) if is_point else mi.Float(1e10)
        to_light = dr.normalize(to_light)
        # Half of the sphere is under the surface: the frame casts no ray there either.
        wanted = active & (dr.dot(to_light, n) > 0.0)
        dr.eval(to_light, distance, wanted)

        def cast(d: mi.Vector3f = to_light, t: mi.Float = distance, a: mi.Bool = wanted) -> mi.Bool:
            return trace_occluded(scene, origin, d, t, a)

        casts += [cast] * count
    return casts


def light_targets(scene: Scene) -> list[tuple[mi.Vector3f, bool, int]]:
    """Return (direction or point, whether it is a point, rays a point) for the shadow rays of `direct_irradiance`."""
    lights, data = scene.lights, scene.host.local
    targets = []
    rows = np.array(lights.delta).reshape(-1, 16)
    for row in rows[np.array(lights.each_rows)[: lights.delta_each]]:
        is_point = row[3] > 0.5
        values = row[:3] if is_point else -row[4:7]
        targets.append((mi.Vector3f(*(dr.opaque(mi.Float, float(v)) for v in values)), bool(is_point), 1))
    if lights.entry_count:
        entry = int(np.array(lights.entries)[0])
        if entry == NO_ENTRY:
            point = scene.host.upper
        elif entry & ENTRY_IS_DELTA:
            point = np.asarray(data.lights[entry & 0x7FFFFFFF].position, float)
        else:
            point = read_positions(scene)[read_triangles(scene).vertices[entry]].mean(axis=0)
        targets.append((mi.Vector3f(*(dr.opaque(mi.Float, float(v)) for v in point)), True, 1))
    return targets


def touched_bytes(renderer: Renderer, workload: Workload) -> int:
    """Return the bytes that a frame must move: the state read and written once, the picture written once."""
    own = workload.touched_bytes(renderer.state)
    pixel_floats = 16  # albedo, emission, direct, indirect, weight, depth, and the running mean that is read again
    return own + renderer.film.lane_count * pixel_floats * 4


def measure_bandwidth(repeats: int = 5) -> float:
    """Return the copy bandwidth of the device, bytes read and written a second."""
    source = dr.arange(mi.Float, COPY_FLOATS)
    dr.eval(source)
    ms = _median_ms(lambda: source + 1.0, repeats)
    return 2 * 4 * COPY_FLOATS / (1e-3 * ms)


def _median_ms(function: Callable[[], Any], repeats: int) -> float:
    """Return the median device time of evaluating `function`'s result, after two warm-up runs.

    Kernel times, without Python: a cast is traced anew each time, which a frame does not do.
    """
    spent = []
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for _ in range(repeats + 2):
            dr.sync_thread()
            dr.kernel_history_clear()
            dr.eval(function())
            dr.sync_thread()
            spent.append(sum(entry["execution_time"] for entry in dr.kernel_history()))
    return statistics.median(spent[2:])
