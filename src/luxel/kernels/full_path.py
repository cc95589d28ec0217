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

from luxel.kernels.gbuffer import GBuffer
from luxel.kernels.lane_pack import pack_lanes, take_record
from luxel.kernels.path_step import BOUNCE_LIMIT, DIMENSIONS, Path, take_step
from luxel.kernels.records import PathLight, Surface
from luxel.kernels.sampling import cosine_hemisphere, random_2d, to_world
from luxel.kernels.side_by_side import take_lanes
from luxel.kernels.trace import offset_origin, trace_closest
from luxel.kernels.vertex import Drawn, lambert_vertex, meet_sky, sample_bright_sky
from luxel.scene.device import Scene

PACKED_AFTER = 1, 1, 1, 1, 2, 2, 4
"""Bounces after which, each time, the paths that go on are brought together; the last ones then end by themselves."""
PACKED_FROM = 1 << 18
"""Lanes from which that pays: it is a dozen small launches each time, whatever the width."""


@dataclass
class _Rest:
    """What is left of paths, in no order."""

    path: Path
    place: mi.UInt32
    """Where its light belongs."""
    lane: mi.UInt32
    """Its counter of random numbers."""
    fresh: mi.Bool
    """Nothing but panes has been met since the first rough surface."""


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
    path = Path(
        mi.UInt32(prim_id), mi.Point2f(barycentric), mi.Vector3f(-wo), mi.Float(depth), mi.Color3f(1.0), seen,
        mi.UInt32(seed), mi.UInt32(0), mi.Color3f(0.0),
    )  # fmt: skip
    lane = gbuffer.lane if lane is None else lane
    path, out, share, alive = _follow_chain(scene, path, out, lane, active)
    # A kernel of its own for what follows: few values stay alive across its rays.
    dr.eval(path, out, share, alive)
    near, far = _follow_bounces(scene, path, lane, alive)
    out.direct += share * near
    out.indirect += share * far
    out.glossy += (1.0 - share) * (near + far)
    return out


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
    path = Path(
        hit.prim_id, hit.barycentric, direction, hit.t, mi.Color3f(dr.pi), drawn,
        mi.UInt32(seed + DIMENSIONS), mi.UInt32(0), mi.Color3f(0.0),
    )  # fmt: skip
    bright = dr.pi * sample_bright_sky(scene, lambert_vertex(scene, surface), seed + 9, lane, going).diffuse
    return _follow_bounces(scene, path, lane, hit.valid)[1] + sky + bright


def _no_light() -> PathLight:
    return PathLight(*(mi.Color3f(0.0) for _ in range(6)))


@dr.syntax
def _follow_chain(
    scene: Scene, path: Path, out: PathLight, lane: mi.UInt32, active: mi.Bool
) -> tuple[Path, PathLight, mi.Color3f, mi.Bool]:
    """Follow `path` from the eye until it leaves its first rough surface, and add to `out` what it finds.

    Return where it has come to, the light found, the share of light from there that is the diffuse lobe's, and whether
    there is a surface.
    """
    going, alive, nothing = mi.Bool(active), mi.Bool(False), mi.Color3f(0.0)
    share = mi.Color3f(0.0)
    while going:
        step = take_step(scene, path, lane, going)
        taken, seen = step.taken, step.throughput
        splits = going & ~taken.delta
        out.emission += step.emission
        out.direct += seen * step.lamps.diffuse
        out.indirect += seen * step.sky.diffuse
        out.glossy += seen * (step.lamps.glossy + step.sky.glossy)
        out.albedo += seen * step.albedo
        out.throughput += dr.select(taken.delta, step.beyond, seen)

        # What the ray brings is seen at the chain's end, or lights its first rough surface.
        share = dr.select(splits, taken.diffuse / dr.fmax(taken.weight, 1e-30), share)
        sun = dr.select(splits, step.sun, nothing)
        sky = dr.select(splits, step.sky_met, nothing)
        out.emission += dr.select(splits, nothing, step.sun + step.sky_met)
        out.direct += share * sun
        out.indirect += share * sky
        out.glossy += (1.0 - share) * (sun + sky)
        alive = dr.select(going, step.goes_on & splits, alive)
        going = step.goes_on & ~splits
    return path, out, share, alive


def _follow_bounces(scene: Scene, path: Path, lane: mi.UInt32, active: mi.Bool) -> tuple[mi.Color3f, mi.Color3f]:
    """Return the light that comes along `path`, which has left its first rough surface: first lamps, and all else.

    First lamps are those with nothing but panes before them.
    """
    width = dr.width(active)
    rest = _Rest(path, dr.arange(mi.UInt32, width), lane, mi.Bool(active))
    if width < PACKED_FROM:
        return _bounce(scene, rest, mi.UInt32(BOUNCE_LIMIT), active)[1]
    dr.make_opaque(rest)
    near, far = dr.zeros(mi.Color3f, width), dr.zeros(mi.Color3f, width)
    for bounces in (*PACKED_AFTER, BOUNCE_LIMIT):
        order, active = pack_lanes(active)
        rest, found, going = _bounce(scene, take_record(rest, order), dr.opaque(mi.UInt32, bounces), active)
        dr.eval(rest, found, going)
        dr.scatter_add(near, found[0], rest.place, active)
        dr.scatter_add(far, found[1], rest.place, active)
        active = going
    return near, far


@dr.syntax
def _bounce(
    scene: Scene, rest: _Rest, bounces: mi.UInt32, active: mi.Bool
) -> tuple[_Rest, tuple[mi.Color3f, mi.Color3f], mi.Bool]:
    """Go on for so many bounces; return the rest, the light found on the way, and whether there is a rest."""
    going, nothing = mi.Bool(active), mi.Color3f(0.0)
    near, far = mi.Color3f(0.0), mi.Color3f(0.0)
    done = mi.UInt32(0)
    while going & (done < bounces):
        step = take_step(scene, rest.path, rest.lane, going)
        lamps, sky = step.lamps, step.sky
        near += dr.select(rest.fresh, step.emission, nothing)
        far += dr.select(rest.fresh, nothing, step.emission)
        far += step.throughput * (lamps.diffuse + lamps.glossy + sky.diffuse + sky.glossy)
        rest.fresh &= step.straight
        near += dr.select(rest.fresh, step.sun, nothing)
        far += step.sky_met + dr.select(rest.fresh, nothing, step.sun)
        going = mi.Bool(step.goes_on)
        done += 1
    return rest, (near, far), going
