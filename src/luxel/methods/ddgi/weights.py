"""What weighs a probe at a point, factor by factor, and how its irradiance is read (Majercik et al. 2019)."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from luxel.methods.ddgi.atlas import Footprint, block_size, bound_by_chebyshev, read_color, read_moments
from luxel.methods.ddgi.planes import visibility_past_planes
from luxel.methods.ddgi.state import DdgiState
from luxel.methods.ddgi.volume import Volume, grid_coordinates, probe_of_node

CRUSH_THRESHOLD = 0.2
"""Visibility below which weights fall faster still (Majercik et al. 2019: probes that hardly see the point)."""


def read_irradiance(state: DdgiState, probe: mi.UInt32, footprint: Footprint, active: mi.Bool) -> mi.Color3f:
    """Return a probe's irradiance, in the atlas's unit."""
    settings = state.settings
    block = probe * block_size(settings.irradiance_resolution)
    return read_color(state.irradiance_atlas, settings.half_irradiance, block, footprint, active)


def encoded_irradiance(state: DdgiState, probe: mi.UInt32, footprint: Footprint, active: mi.Bool) -> mi.Color3f:
    """Return what of a probe's irradiance is averaged: itself, or its fourth root.

    Away from a bright patch light falls off in a hollow curve, and the mean of what probes around get lies above what
    the point gets: by 10 to 16 % in Sponza. Roots are nearly straight there.
    """
    color = read_irradiance(state, probe, footprint, active)
    return dr.sqrt(dr.sqrt(dr.maximum(color, 0.0))) if state.settings.roots else color


def decode_irradiance(state: DdgiState, mean: mi.Color3f) -> mi.Color3f:
    """Return the irradiance, in the atlas's unit, that a mean of `encoded_irradiance` stands for."""
    return dr.square(dr.square(mean)) if state.settings.roots else mean


def biased_point(state: DdgiState, volume: Volume, p: mi.Point3f, n: mi.Normal3f, wo: mi.Vector3f) -> mi.Point3f:
    """Return the point that visibility is asked for: off the surface, so that it does not shadow itself."""
    dials = state.dials
    return mi.Point3f(p + (mi.Vector3f(n) * dials.normal_bias + wo * dials.view_bias) * volume.side)


def octant_index(state: DdgiState, volume: Volume, base: mi.Vector3i, inner: mi.Point3f) -> mi.UInt32:
    """Return the index of the eighth of the cell that a point lies in."""
    cell = probe_of_node(volume, base)
    octant = dr.select(inner.x > 0.5, mi.UInt32(1), 0)
    octant += dr.select(inner.y > 0.5, mi.UInt32(2), 0)
    octant += dr.select(inner.z > 0.5, mi.UInt32(4), 0)
    return cell * 8 + octant


def trilinear_weight(state: DdgiState, volume: Volume, q: mi.Point3f, node: mi.Vector3i, t: mi.Point3f) -> mi.Float:
    """Return the trilinear factor of a probe at `q` whose node is `t` cells from the point.

    A moved probe's weight peaks where it is and still vanishes at the neighbouring nodes: along each axis a tent with
    its top at the offset. Symmetric in the two sides, so cages join without a seam (the thesis's listing 3.12 treats
    offsets to one side only).
    """
    if not state.settings.corrected_weights:
        w = dr.fmax(1.0 - dr.abs(t), 0.0)
        return w.x * w.y * w.z
    o = grid_coordinates(volume, q) - mi.Point3f(node)
    side = dr.select(t < o, mi.Point3f(1.0), -1.0)
    height, base = dr.fmax(dr.fma(side, t, 1.0), 0.0), dr.fma(side, o, 1.0)
    return (height.x * height.y * height.z) * dr.rcp(base.x * base.y * base.z)


def backface_weight(state: DdgiState, p: mi.Point3f, n: mi.Normal3f, q: mi.Point3f) -> mi.Float:
    """Return the smooth back-face factor: ((cos + 1) / 2)^2, plus the 2019 paper's offset where it is wanted."""
    to_probe = q - p
    cosine = dr.dot(to_probe, mi.Vector3f(n)) * dr.rsqrt(dr.fmax(dr.squared_norm(to_probe), 1e-20))
    return dr.square(dr.fma(cosine, 0.5, 0.5)) + state.dials.backface_offset


def chebyshev_visibility(state: DdgiState, probe: mi.UInt32, q: mi.Point3f, x: mi.Point3f, active: mi.Bool) -> mi.Float:
    """Return how far the probe at `q` sees `x`, 0..1: an upper bound of the share of its texel that reaches so far."""
    settings, away = state.settings, mi.Vector3f(x - q)
    resolution, half = settings.depth_resolution, settings.half_depth
    if settings.planes:
        visibility = visibility_past_planes(state.depth_atlas, half, probe, away, resolution, active)
    else:
        distance = dr.norm(away)
        footprint, block = Footprint(away, resolution), probe * block_size(resolution)
        mean, variance = read_moments(state.depth_atlas, half, block, footprint, active)
        visibility = bound_by_chebyshev(variance, dr.fmax(distance - mean, 0.0))
    return dr.select(
        visibility < CRUSH_THRESHOLD, visibility * visibility * visibility * (1.0 / CRUSH_THRESHOLD**2), visibility
    )
