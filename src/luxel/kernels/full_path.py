"""One path through a pixel with all that materials do: the eye's specular chain, then light at its first rough surface.

Delta lobes (mirrors, smooth glass by chance, panes) take the path on from the eye until another lobe is drawn. There it
splits: what the diffuse lobe sends back is irradiance times albedo, the rest is glossy radiance, both on the same
samples. From then on whole BSDFs are drawn from, and lamps are sampled at each vertex, weighed against each other
(`vertex.py`). A lamp that a path meets after a delta lobe counts whole, and as indirect light: shadow rays do not bend.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from luxel.kernels.bsdf import diffuse_albedo, sample
from luxel.kernels.gbuffer import GBuffer
from luxel.kernels.records import PathLight, Surface
from luxel.kernels.sampling import cosine_hemisphere, hash_pair, random_2d, to_unit, to_world
from luxel.kernels.side_by_side import take_lanes
from luxel.kernels.surface import surface_at
from luxel.kernels.trace import offset_origin, trace_closest
from luxel.kernels.transmittance import is_pane
from luxel.kernels.vertex import (
    Drawn,
    attenuate,
    has_media,
    is_consistent,
    lambert_vertex,
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
class _Leg:
    """A ray that has met a surface, and what it stands for."""

    prim_id: mi.UInt32
    barycentric: mi.Point2f
    direction: mi.Vector3f
    length: mi.Float
    """Metres."""
    throughput: mi.Color3f
    drawn: Drawn


def trace_full(scene: Scene, gbuffer: GBuffer, seed: mi.UInt32, lane: mi.UInt32 | None = None) -> PathLight:
    """Return a one-path estimate of the light at the pixels of `gbuffer`, lane by lane.

    `seed` and the lanes' numbers are the counters of the random numbers. `lane`: which lanes of `gbuffer` the paths
    go through; None: each one.
    """
    first = gbuffer.surface
    wanted = (first.p, first.n_shading, first.prim_id, first.barycentric, first.wo, first.active)
    own = (*wanted, gbuffer.background, gbuffer.depth)
    if lane is not None:
        own = tuple(take_lanes(item, lane) for item in own)
    p, n, prim_id, barycentric, wo, active, background, depth = own
    out = _no_light()
    out.throughput = dr.select(active, mi.Color3f(0.0), mi.Color3f(1.0))
    out.emission = mi.Color3f(background)
    seen = Drawn(mi.Point3f(p), mi.Normal3f(n), mi.Float(1.0), mi.Float(0.0))
    leg = _Leg(
        mi.UInt32(prim_id), mi.Point2f(barycentric), mi.Vector3f(-wo), mi.Float(depth), mi.Color3f(1.0), seen,
    )  # fmt: skip
    return _follow(scene, leg, out, False, seed, gbuffer.lane if lane is None else lane, active)


def trace_full_irradiance(
    scene: Scene, surface: Surface, seed: mi.UInt32, lane: mi.UInt32, active: mi.Bool
) -> mi.Color3f:
    """Return a one-path estimate of the indirect irradiance (W/m^2) on the side of `surface.wo`.

    All but what `direct_irradiance` finds, with what every surface on the way does; the surface itself is not asked.
    """
    origin = offset_origin(scene, surface.p, surface.n_geometric)
    local = cosine_hemisphere(random_2d(seed + 8, lane))
    direction = mi.Vector3f(to_world(surface.n_shading, local))
    # A shading normal may send the ray under the surface; such light does not exist.
    going = active & surface.active
    above = going & (dr.dot(direction, surface.n_geometric) > 0.0)
    drawn = Drawn(
        mi.Point3f(surface.p), mi.Normal3f(surface.n_shading), mi.Float(1.0), dr.fmax(local.z, 1e-6) * dr.inv_pi
    )
    hit = trace_closest(scene, origin, direction, above)
    sky = dr.pi * meet_sky(scene, drawn, direction, above & ~hit.valid)
    leg = _Leg(hit.prim_id, hit.barycentric, direction, hit.t, mi.Color3f(dr.pi), drawn)
    bright = dr.pi * sample_bright_sky(scene, lambert_vertex(scene, surface), seed + 9, lane, going).diffuse
    return _follow(scene, leg, _no_light(), True, seed + DIMENSIONS, lane, hit.valid).indirect + sky + bright


def _no_light() -> PathLight:
    return PathLight(*(mi.Color3f(0.0) for _ in range(6)))


@dr.syntax
def _follow(
    scene: Scene, leg: _Leg, out: PathLight, split: bool, seed: mi.UInt32, lane: mi.UInt32, active: mi.Bool
) -> PathLight:
    """Add to `out` what a path finds from the end of `leg` on.

    `split`: it has left its first rough surface already, by a diffuse lobe.
    """
    going, nothing = mi.Bool(active), mi.Color3f(0.0)
    throughput, share = mi.Color3f(leg.throughput), mi.Color3f(1.0 if split else 0.0)
    # The path has left its first rough surface; nothing but panes has been met since.
    rough, fresh = mi.Bool(split), mi.Bool(split)
    prim_id, barycentric = mi.UInt32(leg.prim_id), mi.Point2f(leg.barycentric)
    direction, length = mi.Vector3f(leg.direction), mi.Float(leg.length)
    medium, drawn = mi.Color3f(0.0), leg.drawn
    absorbs = has_media(scene)
    depth, counter = mi.UInt32(0), mi.UInt32(seed)
    while going:
        # Come to a surface, through glass perhaps, and see what it emits.
        surface = surface_at(scene, prim_id, barycentric, going, wo=-direction)
        vertex = make_vertex(scene, surface, medium, going)
        throughput *= attenuate(vertex.medium, length)
        met = throughput * surface.emission
        met *= weigh_lamp(scene, drawn, prim_id, surface.p, going & (dr.max(surface.emission) > 0.0))
        out.emission += dr.select(going & ~rough, met, nothing)
        _add_met(out, met, share, fresh, going & rough)

        # Ask the samplers of lamps and sky.
        lamps = sample_lamps(scene, vertex, counter, lane, going)
        sky = sample_bright_sky(scene, vertex, counter + 9, lane, going)
        whole = throughput * (lamps.diffuse + lamps.glossy + sky.diffuse + sky.glossy)
        _add_met(out, whole, share, mi.Bool(False), going & rough)
        seen = dr.select(going & ~rough, throughput, nothing)
        out.direct += seen * lamps.diffuse
        out.indirect += seen * sky.diffuse
        out.glossy += seen * (lamps.glossy + sky.glossy)
        out.albedo += seen * diffuse_albedo(surface.bsdf, vertex.wo, going)

        # Draw where to go on.
        lobe_word, roulette_word = hash_pair(counter + 7, lane)
        taken = sample(surface.bsdf, vertex.wo, to_unit(lobe_word), random_2d(counter + 8, lane), going)
        out.throughput += dr.select(taken.delta, nothing, seen)
        splits = going & ~rough & ~taken.delta
        straight = taken.delta & taken.transmitted & is_pane(surface.bsdf)
        share = dr.select(splits, taken.diffuse / dr.fmax(taken.weight, 1e-30), share)
        fresh = dr.select(straight, fresh, splits)
        rough |= splits
        throughput *= taken.weight

        # Russian roulette on what the path can still carry.
        depth += 1
        carried = dr.max(throughput)
        survive = dr.select(depth >= ROULETTE_START, dr.fmin(carried, 0.95), 1.0)
        going &= (carried > 0.0) & (to_unit(roulette_word) < survive) & (depth < BOUNCE_LIMIT)
        throughput /= dr.fmax(survive, 1e-6)

        # Leave on the side that both normals mean; a delta lobe's only direction is bent to it.
        ahead = mi.Vector3f(vertex.frame.to_world(taken.wi))
        agrees = is_consistent(vertex, ahead, taken.wi)
        n = mi.Vector3f(surface.n_geometric)
        direction = dr.normalize(dr.select(agrees, ahead, ahead - 2.0 * dr.dot(ahead, n) * n))
        direction = dr.select(straight, -surface.wo, direction)
        going &= agrees | taken.delta
        origin = dr.select(taken.transmitted, vertex.below, vertex.above)
        if dr.hint(absorbs, mode="scalar"):
            medium = medium_along(vertex, taken.wi)
        kept = Drawn(
            surface.p,
            dr.select(taken.transmitted, -surface.n_shading, surface.n_shading),
            side_share(vertex),
            dr.select(taken.delta, 0.0, taken.density),
        )
        drawn = dr.select(straight, drawn, kept)

        # See what is there; the sky ends the path.
        hit = trace_closest(scene, origin, direction, going)
        missed = going & ~hit.valid
        sun = throughput * meet_suns(scene, drawn, direction, missed)
        sky_met = throughput * meet_sky(scene, drawn, direction, missed)
        out.emission += dr.select(missed & ~rough, sun + sky_met, nothing)
        out.throughput += dr.select(missed & ~rough, throughput, nothing)
        _add_met(out, sun, share, fresh, missed & rough)
        _add_met(out, sky_met, share, mi.Bool(False), missed & rough)
        going &= hit.valid
        prim_id, barycentric, length = mi.UInt32(hit.prim_id), mi.Point2f(hit.barycentric), mi.Float(hit.t)
        counter += DIMENSIONS
    return out


def _add_met(out: PathLight, light: mi.Color3f, share: mi.Color3f, fresh: mi.Bool, active: mi.Bool) -> None:
    """Add light that came to the first rough surface along the path: `share` of it is what its diffuse lobe has."""
    light = dr.select(active, light, mi.Color3f(0.0))
    diffuse = share * light
    out.direct += dr.select(fresh, diffuse, mi.Color3f(0.0))
    out.indirect += dr.select(fresh, mi.Color3f(0.0), diffuse)
    out.glossy += light - diffuse
