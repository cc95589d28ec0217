"""A vertex of a path on a surface of any BSDF, and the light that the samplers of lamps and of the sky bring to it.

Each sample is weighed against the BSDF's own density in its direction (the balance heuristic, Veach and Guibas 1995),
so that rays drawn from the BSDF may count what they meet by `meet_lamp`, `meet_sun` and `meet_sky`, and nothing is
counted twice. What is diffuse and what is glossy of the surface's answer stay apart.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from luxel.kernels.bsdf import ALPHA_FLOOR, BSDF, BSDFValue, evaluate_and_density
from luxel.kernels.direct import (
    choose_light,
    emitter_density,
    luminance,
    sample_each,
    shadow_ray,
    sun_light,
)
from luxel.kernels.gloss import fetch_gloss
from luxel.kernels.light_sample import LightSample, balance
from luxel.kernels.records import Surface
from luxel.kernels.sampling import random_2d
from luxel.kernels.sky import SKY_DISTANCE, is_sky_sampled, sample_sky, sky_density, sky_radiance
from luxel.kernels.surface import surface_at
from luxel.kernels.surface_bsdf import bsdf_frame
from luxel.kernels.trace import offset_origin
from luxel.kernels.transmittance import trace_transmittance
from luxel.kernels.triangle import fetch_triangle
from luxel.scene.device import Scene

LEAST_COSINE = 1e-3
"""Of the viewer with the shading normal: where that turns away, the surface is seen all the same."""
LEAST_INTEREST = 0.05
"""Added to the cosine by which lights are kept: gloss reflects at grazing angles, too."""


@dataclass
class Vertex:
    """A surface that a path has met, with the frame of its BSDF and where rays may leave it."""

    surface: Surface
    frame: mi.Frame3f
    wo: mi.Vector3f
    """Local unit direction to where the path came from, on the side that the triangle is seen from."""
    above: mi.Point3f
    """Where rays start that stay on the side of `wo`."""
    below: mi.Point3f
    """Where rays start that pass through the surface."""
    diffuses_light: mi.Bool
    """Light from behind gets through in many directions: lamps there count."""
    is_solid: mi.Bool
    """Bounds a body of glass."""
    inside: mi.Color3f
    """Absorption in that body, 1/m."""
    medium: mi.Color3f
    """Absorption, 1/m, where the path came from."""


@dataclass
class Reflected:
    """Radiance that a vertex sends along `wo`, by parts of its BSDF."""

    diffuse: mi.Color3f
    glossy: mi.Color3f


def make_vertex(scene: Scene, surface: Surface, medium: mi.Color3f, active: mi.Bool) -> Vertex:
    """Return `surface` as a vertex of a path that comes to it through a medium of that absorption (1/m).

    A path that meets glass from behind has come through it, whatever it was told.
    """
    frame, bsdf = bsdf_frame(scene, surface), surface.bsdf
    wo = frame.to_local(surface.wo)
    turned = dr.mulsign(mi.Float(1.0), dr.dot(frame.n, surface.n_shading))
    wo.z = turned * dr.fmax(turned * wo.z, LEAST_COSINE)
    wo = dr.normalize(wo)
    above = offset_origin(scene, surface.p, surface.n_geometric)
    vertex = Vertex(
        surface, frame, wo, above, above, mi.Bool(False), mi.Bool(False), mi.Color3f(0.0), mi.Color3f(medium)
    )
    if scene.features.transmission:
        lets_pass = mi.Float(bsdf.transmission) > 0.0
        other = surface_at(scene, surface.prim_id, surface.barycentric, active, wo=-surface.wo)
        vertex.below = offset_origin(scene, other.p, other.n_geometric)
        vertex.diffuses_light = lets_pass & (mi.Float(bsdf.alpha) >= ALPHA_FLOOR)
        vertex.is_solid = lets_pass & ~mi.Bool(bsdf.thin)
    if has_media(scene):
        material = fetch_triangle(scene, surface.prim_id, active).material
        row = fetch_gloss(scene, material, 4, active)
        vertex.inside = dr.select(vertex.is_solid, mi.Color3f(row.x, row.y, row.z), mi.Color3f(0.0))
        vertex.medium = dr.select(vertex.is_solid & (wo.z < 0.0), vertex.inside, vertex.medium)
    return vertex


def has_media(scene: Scene) -> bool:
    """Return whether any body of glass absorbs light."""
    return scene.features.transmission and scene.materials.gloss.has_absorption


def lambert_vertex(scene: Scene, surface: Surface) -> Vertex:
    """Return `surface` as if it were white and diffuse: it sends back E over pi."""
    white = replace(surface, bsdf=BSDF(mi.Color3f(1.0)))
    origin = offset_origin(scene, surface.p, surface.n_geometric)
    never, nothing = mi.Bool(False), mi.Color3f(0.0)
    ahead = mi.Vector3f(0.0, 0.0, 1.0)
    return Vertex(white, mi.Frame3f(surface.n_shading), ahead, origin, origin, never, never, nothing, nothing)


def attenuate(absorption: mi.Color3f, distance: mi.Float) -> mi.Color3f:
    """Return what is left of light after `distance` metres (Beer): all of it where nothing absorbs, however far."""
    return dr.select(absorption > 0.0, dr.exp(-absorption * distance), 1.0)


def medium_along(vertex: Vertex, wi: mi.Vector3f) -> mi.Color3f:
    """Return the absorption, 1/m, that a path meets which leaves along `wi` (local)."""
    leaves = vertex.is_solid & (wi.z > 0.0) & (vertex.wo.z < 0.0)
    beyond = dr.select(leaves, mi.Color3f(0.0), vertex.medium)
    return dr.select(vertex.is_solid & (wi.z < 0.0), vertex.inside, beyond)


def is_consistent(vertex: Vertex, direction: mi.Vector3f, wi: mi.Vector3f) -> mi.Bool:
    """Return whether shading normal and triangle agree on which side `direction` is; else such light does not exist."""
    return (dr.dot(vertex.surface.n_geometric, direction) > 0.0) == (wi.z * vertex.wo.z > 0.0)


def respond(vertex: Vertex, direction: mi.Vector3f, active: mi.Bool) -> tuple[BSDFValue, mi.Float]:
    """Return BSDF times cosine for light along `direction` (world), and the density with which the BSDF draws it."""
    wi = vertex.frame.to_local(direction)
    exists = active & is_consistent(vertex, direction, wi)
    return evaluate_and_density(vertex.surface.bsdf, vertex.wo, wi, exists)


def sample_lamps(scene: Scene, vertex: Vertex, seed: mi.UInt32, lane: mi.UInt32, active: mi.Bool) -> Reflected:
    """Return the vertex's share of lamps' and suns' light that their sampler brings: one shadow ray a sample."""
    surface, lights = vertex.surface, scene.lights
    total = Reflected(mi.Color3f(0.0), mi.Color3f(0.0))
    for index in range(lights.delta_each):
        _add(total, _reflect(scene, vertex, sample_each(scene, surface, index, seed, lane, active), active))
    if lights.entry_count > 0:
        facing, share = surface, mi.Float(1.0)
        if scene.features.transmission:
            # The tree knows one side of a surface: where both are lit, chance picks which.
            picks_below = vertex.diffuses_light & (random_2d(seed + 10, lane).x < 0.5)
            facing = facing_side(vertex, picks_below)
            share = side_share(vertex)

        def interest(direction: mi.Vector3f) -> mi.Float:
            cosine = dr.dot(facing.n_shading, direction)
            return dr.select(cosine > 0.0, cosine + LEAST_INTEREST, 0.0)

        sample = choose_light(scene, facing, seed, lane, active, interest)
        sample.density *= share
        sample.weight /= share
        _add(total, _reflect(scene, vertex, sample, active))
    return total


def facing_side(vertex: Vertex, below: mi.Bool) -> Surface:
    """Return the surface with its shading normal on the side of `wo`, or, where `below`, on the other."""
    n = vertex.surface.n_shading
    return replace(vertex.surface, n_shading=dr.select(below, -n, n))


def side_share(vertex: Vertex) -> mi.Float:
    """Return the probability with which the light sampler looks to either side that it may look to."""
    return dr.select(vertex.diffuses_light, 0.5, 1.0)


def sample_bright_sky(scene: Scene, vertex: Vertex, seed: mi.UInt32, lane: mi.UInt32, active: mi.Bool) -> Reflected:
    """Return the vertex's share of the sky that one ray towards its bright places brings, where it has such."""
    nothing = mi.Color3f(0.0)
    if not is_sky_sampled(scene):
        return Reflected(nothing, nothing)
    direction, density = sample_sky(scene, random_2d(seed, lane), active)
    value, drawn = respond(vertex, direction, active)
    focus = scene.lights.sky_table.focus
    weight = focus / dr.fmax(drawn + density * focus, 1e-30)
    lit = active & (luminance(value.total) > 0.0)
    passes = trace_transmittance(scene, _origin(vertex, direction), direction, mi.Float(SKY_DISTANCE), lit)
    light = sky_radiance(scene, direction, lit) * passes * weight
    return Reflected(light * value.diffuse, light * value.glossy)


def _origin(vertex: Vertex, direction: mi.Vector3f) -> mi.Point3f:
    """Return where a ray along `direction` leaves."""
    return dr.select(dr.dot(vertex.surface.n_geometric, direction) > 0.0, vertex.above, vertex.below)


def _reflect(scene: Scene, vertex: Vertex, sample: LightSample, active: mi.Bool) -> Reflected:
    """Return what the vertex makes of one sample, weighed against the BSDF's own density."""
    value, density = respond(vertex, sample.direction, active)
    light = sample.radiance * (sample.weight * balance(sample.density, density))
    lit = active & (luminance(light * value.total) > 0.0)
    origin = _origin(vertex, sample.direction)
    direction, distance = shadow_ray(origin, sample)
    light *= trace_transmittance(scene, origin, direction, distance, lit)
    if has_media(scene):
        medium = medium_along(vertex, vertex.frame.to_local(direction))
        light *= dr.select(sample.is_far, mi.Color3f(1.0), attenuate(medium, distance))
    return Reflected(light * value.diffuse, light * value.glossy)


def _add(total: Reflected, more: Reflected) -> None:
    total.diffuse += more.diffuse
    total.glossy += more.glossy


@dataclass
class Drawn:
    """The last direction that a path has drawn from a BSDF, as the weights of what it meets ask for it."""

    p: mi.Point3f
    """Where it was drawn."""
    n: mi.Normal3f
    """Shading normal there, on the side that the direction is on."""
    share: mi.Float
    """`side_share` there."""
    density: mi.Float
    """Per steradian; 0: a delta lobe or a camera, so that nobody else samples what it meets."""


def weigh_lamp(scene: Scene, drawn: Drawn, prim_id: mi.UInt32, point: mi.Point3f, active: mi.Bool) -> mi.Float:
    """Return what an emitting `point` of triangle `prim_id` counts for, met along the direction."""
    sampled = active & (drawn.density > 0.0)
    density = emitter_density(scene, Surface.at(drawn.p, drawn.n), prim_id, point, sampled) * drawn.share
    return balance(drawn.density, density)


def meet_suns(scene: Scene, drawn: Drawn, direction: mi.Vector3f, active: mi.Bool) -> mi.Color3f:
    """Return what the discs of suns bring along `direction`, weighed against the light sampler."""
    total = mi.Color3f(0.0)
    for index in range(scene.lights.disc_count):
        radiance, density = sun_light(scene, Surface.at(drawn.p, drawn.n), index, direction, active)
        total += radiance * balance(drawn.density, density)
    return total


def meet_sky(scene: Scene, drawn: Drawn, direction: mi.Vector3f, active: mi.Bool) -> mi.Color3f:
    """Return what the sky brings along `direction`, weighed against rays towards its bright places."""
    sky = sky_radiance(scene, direction, active)
    if not is_sky_sampled(scene):
        return sky
    sought = sky_density(scene, direction, active) * scene.lights.sky_table.focus
    return sky * balance(drawn.density, sought)
