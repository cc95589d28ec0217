"""What lights a pixel: the surface there, its light, the cache items that answered and why others did not, in words."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.image.tonemap import to_display
from luxel.inspect.diagnosis import diagnose
from luxel.inspect.explanation import Explanation, Paths, Three
from luxel.inspect.looks.shot import Shot, require_pixel, surface_at_pixel, take_shot
from luxel.kernels.direct import direct_irradiance
from luxel.kernels.records import Surface
from luxel.kernels.sampling import cosine_hemisphere, random_2d, to_world
from luxel.kernels.surface import surface_at_hit
from luxel.kernels.trace import offset_origin, trace_closest
from luxel.kernels.triangle import fetch_triangle
from luxel.methods.inspect import Contribution
from luxel.methods.path_tracer import trace_indirect
from luxel.scene.colours import luminance
from luxel.scene.device import Scene

if TYPE_CHECKING:
    from luxel.render.renderer import Renderer

PATHS = 1024
"""Paths that are traced from the point, to know what light is there to be had: some 5 % of noise in a room."""
SEED = 0x0E3A
"""Of those paths."""
BACK_OFFSET = 3
"""Counters between the random numbers of the paths and those of the rays that look around."""


def explain_pixel(source: Renderer | Shot, x: int, y: int) -> Explanation:
    """Return what lights the pixel in column `x` and row `y` (from 0, top left) of the last frame.

    Raises LuxelError for a pixel outside the image, and before the first frame.
    """
    shot = source if isinstance(source, Shot) else take_shot(source)
    require_pixel(shot.film, x, y)
    layers = shot.layers
    radiance = shot.image[y, x]
    found = Explanation(
        pixel=(x, y),
        method=shot.method.name,
        item="" if shot.method.inspector is None else shot.method.inspector.item,
        inspected=shot.method.inspector is not None,
        verdict="",
        words=(),
        radiance=_three(radiance),
        shown=_three(to_display(radiance, shot.exposure)),
        exposure=shot.exposure,
        hit=bool(layers.hit[y, x]),
        emission=_three(layers.emission[y, x]),
    )
    if found.hit:
        found = _look_at_surface(found, shot, x, y)
    verdict, words = diagnose(found)
    return replace(found, verdict=verdict, words=words)


def _look_at_surface(found: Explanation, shot: Shot, x: int, y: int) -> Explanation:
    """Return `found` with all that the surface at the pixel adds."""
    surface, distance = surface_at_pixel(shot, x, y, PATHS)
    data, layers, origin = shot.scene.host.data, shot.layers, shot.scene.host.origin
    prim_id = int(np.array(surface.prim_id).ravel()[0])
    triangle = fetch_triangle(shot.scene, surface.prim_id, mi.Bool(True))
    material, object_id = (int(np.array(number).ravel()[0]) for number in (triangle.material, triangle.object_id))
    name = data.objects[shot.scene.host.object_of_triangle(prim_id)].name
    paths = _trace_paths(shot.scene, surface)
    albedo, weight = _three(layers.albedo[y, x]), float(layers.weight[y, x])
    direct, indirect = _three(layers.direct[y, x]), _three(layers.indirect[y, x])
    if shot.scene.features.blended:
        # The picture is the mean over many layers of see-through surfaces; what is explained is the one that is named.
        light = shot.method.query(shot.scene, shot.state, surface)
        albedo, direct = _first(surface.albedo), paths.direct
        indirect = _three(np.array(light.irradiance).reshape(3, -1).mean(axis=1))
        weight = float(np.mean(np.array(light.weight)))
    return replace(
        found,
        position=_place(np.array(surface.p).reshape(3, -1)[:, 0], origin),
        normal=_first(surface.n_geometric),
        front=bool(np.array(surface.front).ravel()[0]),
        distance=distance,
        object_name=name or f"object {object_id}",
        material_name=data.materials[material].name,
        metallic=data.materials[material].metallic,
        albedo=albedo,
        direct=direct,
        indirect=indirect,
        weight=weight,
        contributions=tuple(
            item if item.p is None else replace(item, p=_place(item.p, origin)) for item in _ask(shot, surface)
        ),
        paths=paths,
    )


def _ask(shot: Shot, surface: Surface) -> list[Contribution]:
    """Return what the method's inspector says of the cache items around the first point of `surface`."""
    inspector = shot.method.inspector
    return [] if inspector is None else inspector.explain(shot.scene, shot.state, surface)


def _trace_paths(scene: Scene, surface: Surface) -> Paths:
    """Return what paths from the point find, one a lane, and what lies around it."""
    lane, seed = dr.arange(mi.UInt32, PATHS), dr.opaque(mi.UInt32, SEED)
    direct = direct_irradiance(scene, surface, seed, lane, surface.active)
    indirect = np.array(trace_indirect(scene, surface, seed, lane, surface.active)).T
    direction = to_world(surface.n_geometric, cosine_hemisphere(random_2d(seed + BACK_OFFSET, lane)))
    hit = trace_closest(scene, offset_origin(scene, surface.p, surface.n_geometric), direction, surface.active)
    around = surface_at_hit(scene, hit, direction)
    return Paths(
        count=PATHS,
        direct=_three(np.array(direct).reshape(3, -1).mean(axis=1)),
        indirect=_three(indirect.mean(axis=0)),
        noise=float(luminance(indirect).std(ddof=1) / PATHS**0.5),
        backs=float(np.mean(np.broadcast_to(np.array(hit.valid & ~around.front), PATHS))),
        misses=float(np.mean(np.broadcast_to(~np.array(hit.valid), PATHS))),
    )


def _first(value: Any) -> Three:
    return _three(np.array(value).reshape(3, -1)[:, 0])


def _place(values: Any, origin: np.ndarray) -> Three:
    """Return a place of the device in the file's coordinates."""
    return _three(np.asarray(values, np.float64) + origin)


def _three(values: Any) -> Three:
    red, green, blue = (float(value) for value in values)
    return red, green, blue
