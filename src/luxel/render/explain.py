"""What lights a pixel: the surface there, its light, the cache items that answered and why others did not, in words."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.kernels.direct import direct_irradiance
from luxel.kernels.records import Surface
from luxel.kernels.sampling import cosine_hemisphere, random_2d, to_world
from luxel.kernels.surface import surface_at_hit
from luxel.kernels.trace import offset_origin, trace_closest
from luxel.methods.base import Contribution
from luxel.methods.path_tracer import trace_indirect
from luxel.render.looks.shot import Shot, require_pixel, surface_at_pixel, take_shot
from luxel.render.tonemap import luminance, to_display
from luxel.scene.device import Scene

if TYPE_CHECKING:
    from luxel.render.renderer import Renderer

PATHS = 1024
"""Paths that are traced from the point, to know what light is there to be had: some 5 % of noise in a room."""
SEED = 0x0E3A
"""Of those paths."""
BACK_OFFSET = 3
"""Counters between the random numbers of the paths and those of the rays that look around."""

Three = tuple[float, float, float]


@dataclass(frozen=True)
class Paths:
    """What paths from the point find, whatever the method says."""

    count: int
    direct: Three
    """E, W/m^2."""
    indirect: Three
    """E, W/m^2."""
    noise: float
    """Standard error of the luminance of `indirect`."""
    backs: float
    """Share of the rays around the point that hit the back of a surface first."""
    misses: float
    """Share of them that hit nothing."""


@dataclass(frozen=True)
class Explanation:
    """All that is known of one pixel."""

    pixel: tuple[int, int]
    """Column and row, from the top left."""
    method: str
    item: str
    """What the method calls one item of its cache; empty where it keeps none."""
    verdict: str
    """One word, a key of `diagnosis.VERDICTS`."""
    words: tuple[str, ...]
    """Sentences, the most important one first."""
    radiance: Three
    """What the pixel holds, W/(m^2 sr)."""
    shown: Three
    """The displayed colour, 0..1."""
    exposure: float
    hit: bool
    """False: no surface is there, and the rest is empty."""
    position: Three | None = None
    """World space, metres."""
    normal: Three | None = None
    """Geometric, on the side that is seen."""
    front: bool = True
    """The side that is seen is the triangles' front."""
    distance: float | None = None
    """From the eye, metres."""
    object_name: str = ""
    material_name: str = ""
    albedo: Three = (0.0, 0.0, 0.0)
    emission: Three = (0.0, 0.0, 0.0)
    """Radiance; that of the sky where nothing was hit."""
    direct: Three = (0.0, 0.0, 0.0)
    """E in the image, W/m^2."""
    indirect: Three = (0.0, 0.0, 0.0)
    """E in the image, W/m^2."""
    weight: float = 0.0
    """Coverage that the method answered with; 0 is no answer."""
    contributions: tuple[Contribution, ...] = ()
    """Heaviest first."""
    paths: Paths | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain values, for JSON."""
        return asdict(self)


def explain_pixel(source: Renderer | Shot, x: int, y: int) -> Explanation:
    """Return what lights the pixel in column `x` and row `y` (from 0, top left) of the last frame.

    Raises LuxelError for a pixel outside the image, and before the first frame.
    """
    from luxel.render.diagnosis import diagnose

    shot = source if isinstance(source, Shot) else take_shot(source)
    require_pixel(shot.film, x, y)
    layers = shot.layers
    radiance = shot.image[y, x]
    found = Explanation(
        pixel=(x, y),
        method=shot.method.name,
        item=shot.method.item,
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
    data, layers = shot.scene.host.data, shot.layers
    triangle = np.array(dr.gather(mi.Vector4u, shot.scene.geometry.triangles, surface.prim_id)).reshape(4, -1)[:, 0]
    name = data.objects[int(triangle[3] >> 16) - 1].name
    return replace(
        found,
        position=_first(surface.p),
        normal=_first(surface.n_geometric),
        front=bool(np.array(surface.front).ravel()[0]),
        distance=distance,
        object_name=name or f"object {int(triangle[3] >> 16)}",
        material_name=data.materials[int(triangle[3] & 0xFFFF)].name,
        albedo=_three(layers.albedo[y, x]),
        direct=_three(layers.direct[y, x]),
        indirect=_three(layers.indirect[y, x]),
        weight=float(layers.weight[y, x]),
        contributions=tuple(shot.method.explain(shot.scene, shot.state, surface)),
        paths=_trace_paths(shot.scene, surface),
    )


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


def _three(values: Any) -> Three:
    red, green, blue = (float(value) for value in values)
    return red, green, blue
