"""One step of a path through all that materials do: at a surface, and on to the next.

Light is met and sampled, a direction is drawn from the whole BSDF, and a ray is followed along it. What the light
counts for is up to whoever goes on step by step (`full_path.py`).
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from luxel.kernels.bsdf import BSDFSample, diffuse_albedo, sample
from luxel.kernels.sampling import hash_pair, random_2d, to_unit
from luxel.kernels.surface import surface_at
from luxel.kernels.trace import trace_closest
from luxel.kernels.transmittance import is_pane
from luxel.kernels.vertex import (
    Drawn,
    Reflected,
    Vertex,
    attenuate,
    has_media,
    is_consistent,
    make_vertex,
    medium_along,
    meet_sky,
    meet_suns,
    sample_bright_sky,
    sample_lamps,
    side_share,
    weigh_lamp,
)
from luxel.scene.device import Scene

ROULETTE_START = 4
"""Bounces before Russian roulette may end a path."""
BOUNCE_LIMIT = 128
"""Bounces after which a path ends whatever it carries; with roulette one in 500 paths of no loss comes so far."""
DIMENSIONS = 16
"""Counter values that one bounce may use."""


@dataclass
class Path:
    """A ray that has met a surface, and what it stands for."""

    prim_id: mi.UInt32
    barycentric: mi.Point2f
    direction: mi.Vector3f
    length: mi.Float
    """Metres."""
    throughput: mi.Color3f
    drawn: Drawn
    counter: mi.UInt32
    """Of the random numbers, with the lane's."""
    depth: mi.UInt32
    """Surfaces that it has left."""
    medium: mi.Color3f
    """Absorption along the ray, 1/m."""


@dataclass
class Step:
    """What a step has found. Colours are black where it has not been taken, or not so far."""

    emission: mi.Color3f
    """That of the surface, times the path's throughput and the weight of a lamp that is met."""
    throughput: mi.Color3f
    """At the surface."""
    lamps: Reflected
    sky: Reflected
    """What samplers bring, without the throughput."""
    albedo: mi.Color3f
    """Diffuse albedo of the surface."""
    taken: BSDFSample
    straight: mi.Bool
    """The path has gone through a pane."""
    beyond: mi.Color3f
    """Throughput of a ray that meets nothing."""
    sun: mi.Color3f
    sky_met: mi.Color3f
    """What it brings."""
    goes_on: mi.Bool
    """There is another surface."""


def take_step(scene: Scene, path: Path, lane: mi.UInt32, going: mi.Bool) -> Step:
    """Return what `path` finds at its surface and on its way from there; bring it to the next one."""
    nothing = mi.Color3f(0.0)
    # Come to a surface, through glass perhaps, and see what it emits.
    surface = surface_at(scene, path.prim_id, path.barycentric, going, wo=-path.direction)
    vertex = make_vertex(scene, surface, path.medium if has_media(scene) else nothing, going)
    throughput = path.throughput * attenuate(vertex.medium, path.length)
    emission = throughput * surface.emission
    is_lamp = going & (dr.max(surface.emission) > 0.0)
    emission *= weigh_lamp(scene, path.drawn, path.prim_id, surface.p, is_lamp)
    here = dr.select(going, throughput, nothing)

    # Ask the samplers of lamps and sky.
    lamps = sample_lamps(scene, vertex, path.counter, lane, going)
    sky = sample_bright_sky(scene, vertex, path.counter + 9, lane, going)
    albedo = diffuse_albedo(surface.bsdf, vertex.wo, going)

    # Draw where to go on, and play Russian roulette on what the path can still carry.
    lobe_word, roulette_word = hash_pair(path.counter + 7, lane)
    taken = sample(surface.bsdf, vertex.wo, to_unit(lobe_word), random_2d(path.counter + 8, lane), going)
    straight = taken.delta & taken.transmitted & is_pane(surface.bsdf)
    throughput *= taken.weight
    depth = path.depth + 1
    carried = dr.max(throughput)
    survive = dr.select(depth >= ROULETTE_START, dr.fmin(carried, 0.95), 1.0)
    leaves = going & (carried > 0.0) & (to_unit(roulette_word) < survive) & (depth < BOUNCE_LIMIT)
    throughput /= dr.fmax(survive, 1e-6)

    # See what is there; the sky ends the path.
    origin, direction, exists = _leave(vertex, taken, straight)
    leaves &= exists
    drawn = dr.select(straight, path.drawn, _remember(vertex, taken))
    hit = trace_closest(scene, origin, direction, leaves)
    missed = leaves & ~hit.valid
    beyond = dr.select(missed, throughput, nothing)
    sun = beyond * meet_suns(scene, drawn, direction, missed)
    sky_met = beyond * meet_sky(scene, drawn, direction, missed)

    if has_media(scene):
        path.medium = medium_along(vertex, taken.wi)
    path.prim_id, path.barycentric, path.length = mi.UInt32(hit.prim_id), mi.Point2f(hit.barycentric), mi.Float(hit.t)
    path.direction, path.throughput, path.drawn, path.depth = direction, throughput, drawn, depth
    path.counter = path.counter + DIMENSIONS
    emission = dr.select(going, emission, nothing)
    return Step(emission, here, lamps, sky, albedo, taken, straight, beyond, sun, sky_met, leaves & hit.valid)


def _leave(vertex: Vertex, taken: BSDFSample, straight: mi.Bool) -> tuple[mi.Point3f, mi.Vector3f, mi.Bool]:
    """Return origin and direction of the ray, on the side that both normals mean, and whether it exists.

    A delta lobe's only direction is bent to that side.
    """
    ahead = mi.Vector3f(vertex.frame.to_world(taken.wi))
    agrees = is_consistent(vertex, ahead, taken.wi)
    n = mi.Vector3f(vertex.surface.n_geometric)
    direction = dr.normalize(dr.select(agrees, ahead, ahead - 2.0 * dr.dot(ahead, n) * n))
    direction = dr.select(straight, -vertex.surface.wo, direction)
    return dr.select(taken.transmitted, vertex.below, vertex.above), direction, agrees | taken.delta


def _remember(vertex: Vertex, taken: BSDFSample) -> Drawn:
    """Return what the weights of what the ray meets ask for."""
    n = vertex.surface.n_shading
    return Drawn(
        vertex.surface.p,
        dr.select(taken.transmitted, -n, n),
        side_share(vertex),
        dr.select(taken.delta, 0.0, taken.density),
    )
