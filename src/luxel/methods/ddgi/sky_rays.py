"""A few rays of each probe that look for the bright places of a sky image.

They bring light alone: depth, and whether a probe is inside something, are judged by the even rays. Even rays that miss
and rays that look for the sky share each direction by the balance heuristic (Veach and Guibas 1995), so together they
bring the sky once.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from luxel.kernels.sampling import hash_pair, sequence_2d
from luxel.kernels.sky import SKY_DISTANCE, is_sky_sampled, sample_sky, sky_density, sky_radiance
from luxel.kernels.transmittance import trace_transmittance
from luxel.methods.base import Frame
from luxel.methods.ddgi.state import AWAKE, DdgiState, SkyRays
from luxel.scene.device import Scene

SALT = 0x51C7
"""Keeps these rays' numbers apart from the even ones'."""


def sky_rays_of(scene: Scene, state: DdgiState) -> int:
    """Return how many rays of each probe look for the sky: none where it has no bright places."""
    return state.settings.sky_rays if is_sky_sampled(scene) else 0


def weight_of_miss(
    scene: Scene, state: DdgiState, direction: mi.Vector3f, ray_count: mi.UInt32, active: mi.Bool
) -> mi.Float:
    """Return what an even ray that misses counts for, beside the probe's rays that look for the sky.

    A ray that looks for the sky counts as the share of one that the bright places have in the sky's light.
    """
    rays = sky_rays_of(scene, state)
    if rays == 0:
        return mi.Float(1.0)
    even = mi.Float(ray_count) * (0.25 * dr.inv_pi)
    return even / (even + _worth(scene, rays) * sky_density(scene, direction, active))


def trace_sky(scene: Scene, state: DdgiState, frame: Frame) -> SkyRays | None:
    """Cast the rays of probes that are awake towards the sky; None where there are none."""
    rays = sky_rays_of(scene, state)
    if rays == 0:
        return None
    lane = dr.arange(mi.UInt32, state.settings.total * rays)
    probe = lane // rays
    awake = dr.gather(mi.UInt32, state.probes.status, probe) == AWAKE
    origin = dr.gather(mi.Point3f, state.probes.p, probe, awake)
    point = sequence_2d(frame.index * rays + lane % rays, hash_pair(probe + state.seed, mi.UInt32(SALT)))
    direction, density = sample_sky(scene, point, awake)
    passes = trace_transmittance(scene, origin, direction, mi.Float(SKY_DISTANCE), awake)

    # In units of an even ray, of which the probe casts `count`.
    even, worth = mi.Float(state.rays_of(probe)) * (0.25 * dr.inv_pi), _worth(scene, rays)
    weight = even * (worth / rays) / (even + worth * density)
    light = sky_radiance(scene, direction, dr.max(passes) > 0.0) * passes * weight
    directions, lights = (dr.empty(mi.Float, 4 * dr.width(lane)) for _ in range(2))
    dr.scatter(directions, mi.Vector4f(direction.x, direction.y, direction.z, 0.0), lane)
    dr.scatter(lights, mi.Vector4f(light.x, light.y, light.z, 0.0), lane)
    return SkyRays(directions, lights, rays)


@dr.syntax
def sum_sky(sky: SkyRays, direction: mi.Vector3f, probe: mi.UInt32, active: mi.Bool) -> mi.Color3f:
    """Return the sum over a probe's rays towards the sky of the cosine with `direction` times what they brought."""
    total, ray = mi.Color3f(0.0), mi.UInt32(probe * sky.count)
    end = ray + sky.count
    going = mi.Bool(active)
    while going:
        row = dr.gather(mi.Vector4f, sky.direction, ray, going)
        light = dr.gather(mi.Vector4f, sky.light, ray, going)
        w = dr.fmax(direction.x * row.x + direction.y * row.y + direction.z * row.z, 0.0)
        total += mi.Color3f(light.x, light.y, light.z) * w
        ray += 1
        going &= ray < end
    return total


def _worth(scene: Scene, rays: int) -> mi.Float:
    """Return the even rays that a probe's rays towards the sky are worth."""
    return rays * scene.lights.sky_table.focus
