"""Light for a point's own normal: what smooth normals and normal maps change of the light that a surfel keeps.

A surfel with normal n keeps its irradiance E and T, the tangential part of its vector irradiance (Gershun 1939), the
integral of radiance times direction over its hemisphere. Under another normal n' = c n + t, with the angle a from n,
the directions below n' count for nothing, while n' . V = c E + t . T takes them off. There, next to the horizon and
away from t, the radiance is taken as h (E / pi + 3 / (2 pi) T . w), linear in direction, and integrated exactly:

    E(n')  =  (c + (1 - c) / 2 h) E  +  (1 - a / pi h) t . T

Around a bend the surfel lies on another plane than the point. What the point sees under the surfel's horizon is taken
to be as bright: with the cosine d of n' to the point's geometric normal, (d - c) / 2 h E is added where d > c, and the
share (1 - d) / (1 - c) of the second term's a / pi is left.

h says how bright the horizon is: the mean radiance weighted by (1 - cosine)^2, over E / pi. Under one radiance
everywhere all this is exact for every n', as under every radiance at n' = n. Light that comes from the side that n'
turns away from can take it below zero: it never falls below `LEAST_SHARE` of the first term.

The estimates of T and h weigh a ray by one over its cosine, so under rays that follow the cosine their variance has no
bound. Hence a share of them is spread evenly over the hemisphere, by one warp of the mixture's exact density.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.kernels.direct import luminance
from luxel.kernels.packing import pack_normal, unpack_normal
from luxel.kernels.triangle import read_normals, read_positions, read_triangles
from luxel.scene.device import Scene

LEAST_SHARE = 0.3
HORIZON_SLOPE_MAX = 1.5
"""What h counts for at most in the second term. Measured on random rooms with patches of sun, for normals turned by 20,
40 and 60 degrees: errors of 0.023, 0.065 and 0.127 with both constants, 0.021, 0.079 and 0.31 without this one; with E
for every normal 0.17, 0.50 and 0.94."""
HORIZON_MAX = 4.0
STEPS = 32767.0
HORIZON_STEPS = 65535.0
FLAT_COSINE = 0.9999
"""Vertex normals this near to their triangle's are its own."""


@dataclass
class NormalLight:
    """What a surfel knows beside its irradiance, W/m^2: running means."""

    along_s: mi.Color3f
    along_t: mi.Color3f
    """Integral of radiance times direction over the hemisphere: its parts along both axes of `along_axes`."""
    horizon: mi.Float
    """pi times the mean luminance of the radiance near the horizon."""


@dataclass
class NormalLightSum:
    """What a look-up sums up beside the irradiance; all are weighted."""

    turned: mi.Color3f
    """Of t . T."""
    cosine: mi.Float
    """Of c."""
    horizon: mi.Float
    """Of h."""


def has_own_normals(scene: Scene) -> bool:
    """Return whether points of the scene have other normals than their triangles: maps, or smooth surfaces."""
    normals = read_normals(scene)
    if scene.materials.has_normal or (scene.features.deforming and bool(normals.any())):
        return True
    corners = read_triangles(scene).vertices
    positions = read_positions(scene)[corners].astype(np.float64)
    face = np.cross(positions[:, 1] - positions[:, 0], positions[:, 2] - positions[:, 0])
    cosine = np.abs((normals[corners] * face[:, None]).sum(axis=2))
    length = np.linalg.norm(normals[corners], axis=2) * np.linalg.norm(face, axis=1)[:, None]
    # Where there is no vertex normal, both sides are zero.
    return bool((cosine < FLAT_COSINE * length).any())


def new_normal_light(width: int) -> NormalLight:
    """Return `width` newborn ones."""
    return NormalLight(dr.zeros(mi.Color3f, width), dr.zeros(mi.Color3f, width), dr.zeros(mi.Float, width))


def copy_normal_light(light: NormalLight) -> NormalLight:
    """Return new arrays of the same content, for scatters."""
    return NormalLight(mi.Color3f(light.along_s), mi.Color3f(light.along_t), mi.Float(light.horizon))


def along_axes(n: mi.Vector3f, v: mi.Vector3f) -> tuple[mi.Float, mi.Float]:
    """Return the parts of `v` along both axes at right angles to `n`, an unpacked normal.

    Duff et al. 2017, "Building an Orthonormal Basis, Revisited", with the dot products taken apart.
    """
    inner = -dr.rcp(1.0 + dr.abs(n.z)) * (n.x * v.x + n.y * v.y) - dr.mulsign(v.z, n.z)
    return dr.fma(n.x, inner, v.x), dr.fma(n.y, inner, v.y)


def surfel_normal_kept(n: mi.Normal3f) -> mi.Vector3f:
    """Return the normal by which a surfel of unit normal `n` keeps its light.

    That is the packed one, which a look-up has: where `n.z` is next to zero a hair turns the axes far.
    """
    return unpack_normal(pack_normal(n))


# --- rays ------------------------------------------------------------------------------------------------------------


def widened_hemisphere(sample: mi.Point2f, even_share: mi.Float) -> mi.Vector3f:
    """Return directions about +Z, of which `even_share` are spread evenly and the others follow the cosine.

    One continuous warp, so that a low-discrepancy sequence keeps its spread: the concentric disc map (Shirley and Chiu
    1997), then the cosine at which the mixture's distribution, (1 - s) z^2 + s z, reaches that of the disc.
    """
    disc = mi.warp.square_to_uniform_disk_concentric(sample)
    squared = dr.squared_norm(disc)
    above = dr.fmax(1.0 - squared, 0.0)
    root = dr.sqrt(dr.fma(4.0 * (1.0 - even_share), above, dr.square(even_share)))
    z = dr.fmin(2.0 * above / dr.fmax(even_share + root, 1e-20), 1.0)
    stretch = dr.safe_sqrt((1.0 - dr.square(z)) / dr.fmax(squared, 1e-20))
    return mi.Vector3f(disc.x * stretch, disc.y * stretch, z)


def square_of_widened(direction: mi.Vector3f, even_share: mi.Float) -> mi.Point2f:
    """Return the sample from which `widened_hemisphere` makes a direction; those below the plane lie on the rim."""
    z = dr.fmax(direction.z, 0.0)
    inside = dr.fma(1.0 - even_share, z, even_share) * z
    along = dr.square(direction.x) + dr.square(direction.y)
    shrink = dr.safe_sqrt((1.0 - inside) / dr.fmax(along, 1e-20))
    return mi.warp.uniform_disk_to_square_concentric(mi.Point2f(direction.x * shrink, direction.y * shrink))


def widened_density(cosine: mi.Float, even_share: mi.Float) -> mi.Float:
    """Return the density per steradian of `widened_hemisphere` where the cosine is `cosine`; 0 under the horizon."""
    return dr.select(cosine > 0.0, dr.fma(1.0 - even_share, cosine, 0.5 * even_share) * dr.inv_pi, 0.0)


# --- estimate --------------------------------------------------------------------------------------------------------


def moments_of_ray(n: mi.Normal3f, direction: mi.Vector3f, active: mi.Bool) -> mi.Vector3f:
    """Return what turns a ray's share of E into those of T, along both axes, and of the horizon."""
    s, t = along_axes(surfel_normal_kept(n), direction)
    cosine = dr.dot(direction, mi.Vector3f(n))
    inverse = dr.select(active, dr.rcp(dr.fmax(cosine, 1e-12)), 0.0)
    # 3 / (2 pi) (1 - cosine)^2 is one on the mean over the hemisphere.
    near_horizon = 1.5 * dr.square(1.0 - cosine)
    return mi.Vector3f(s, t, near_horizon) * inverse


def sample_of_no_ray(mean: mi.Color3f) -> NormalLight:
    """Return the sample that rays add to."""
    return NormalLight(mi.Color3f(0.0), mi.Color3f(0.0), luminance(mean))


def add_ray(
    sample: NormalLight, mean: mi.Color3f, light: mi.Color3f, weight: mi.Float, moment: mi.Vector3f, share: mi.Float
) -> NormalLight:
    """Return each surfel's sample with one of its rays added, which is a `share` of them.

    `light` is the ray's share of E, with its `weight` applied. The surfel's `mean` serves as a control variate: one
    radiance everywhere brings no noise.
    """
    beyond = (light - mean * weight) * share
    return NormalLight(
        sample.along_s + beyond * moment.x,
        sample.along_t + beyond * moment.y,
        sample.horizon + luminance(beyond) * moment.z,
    )


def blend_normal_light(old: NormalLight, sample: NormalLight, blend: mi.Float, active: mi.Bool) -> NormalLight:
    """Return the running means after one sample each: `blend` is that of the irradiance, so all span one window."""
    blend = dr.select(active, blend, 0.0)
    return NormalLight(
        dr.lerp(old.along_s, sample.along_s, blend),
        dr.lerp(old.along_t, sample.along_t, blend),
        dr.lerp(old.horizon, sample.horizon, blend),
    )


def turn_normal_light(light: NormalLight, before: mi.Normal3f, now: mi.Normal3f) -> NormalLight:
    """Return the light of surfels whose normal went from `before` to `now`: light does not turn with an object."""
    before, now = surfel_normal_kept(before), surfel_normal_kept(now)
    # Axes are vectors whose parts along x, y and z are those of x, y and z along them.
    kept = [along_axes(before, mi.Vector3f(*row)) for row in np.eye(3).tolist()]
    world = [light.along_s * s + light.along_t * t for s, t in kept]
    turned = [along_axes(now, mi.Vector3f(*channel)) for channel in zip(*world, strict=True)]
    return NormalLight(
        mi.Color3f(*(s for s, _ in turned)), mi.Color3f(*(t for _, t in turned)), mi.Float(light.horizon)
    )


# --- look-up ---------------------------------------------------------------------------------------------------------


def pack_normal_light(light: NormalLight, irradiance: mi.Color3f, capacity: int) -> mi.UInt32:
    """Return (capacity, 4) words: six numbers of 16 bits, then what the largest of them stands for, and h."""
    numbers = [*light.along_s, *light.along_t]
    scale = mi.Float(1e-30)
    for number in numbers:
        scale = dr.fmax(scale, dr.abs(number))
    # Rounded up to the upper half of a float.
    bits = (dr.reinterpret_array(mi.UInt32, scale) + 0xFFFF) & 0xFFFF0000
    steps = STEPS / dr.reinterpret_array(mi.Float, bits)
    halves = [mi.UInt32(mi.Int32(dr.round(number * steps))) & 0xFFFF for number in numbers]
    words = [halves[index] | (halves[index + 3] << 16) for index in range(3)]
    mean = luminance(irradiance)
    horizon = dr.select(mean > 0.0, dr.clip(light.horizon / dr.fmax(mean, 1e-30), 0.0, HORIZON_MAX), 1.0)
    last = bits | mi.UInt32(dr.round(horizon * (HORIZON_STEPS / HORIZON_MAX)))
    rows = dr.empty(mi.UInt32, 4 * capacity)
    dr.scatter(rows, mi.Vector4u(*words, last), dr.arange(mi.UInt32, capacity))
    return rows


def unpack_normal_light(row: mi.Vector4u) -> tuple[NormalLight, mi.Float]:
    """Return what `pack_normal_light` stored: numbers, whose horizon is h, and what they are to be multiplied with.

    Times that, they are right within 2e-5 of the largest of the six.
    """
    words = [mi.Int32(word) for word in (row.x, row.y, row.z)]
    low = mi.Color3f(*(mi.Float((word << 16) >> 16) for word in words))
    high = mi.Color3f(*(mi.Float(word >> 16) for word in words))
    horizon = mi.Float(row.w & 0xFFFF) * (HORIZON_MAX / HORIZON_STEPS)
    return NormalLight(low, high, horizon), dr.reinterpret_array(mi.Float, row.w & 0xFFFF0000) * (1.0 / STEPS)


def add_normal_light(
    total: NormalLightSum, rows: mi.UInt32, surfel: mi.UInt32, n: mi.Vector3f, n_light: mi.Normal3f,
    weight: mi.Float, active: mi.Bool,
) -> NormalLightSum:  # fmt: skip
    """Return the sum with a surfel of unpacked normal `n` added, for points whose normal is `n_light`.

    `weight` must be zero where it is not `active`.
    """
    light, scale = unpack_normal_light(dr.gather(mi.Vector4u, rows, surfel, active))
    wanted = mi.Vector3f(n_light)
    s, t = along_axes(n, wanted)
    scale *= weight
    return NormalLightSum(
        total.turned + (light.along_s * s + light.along_t * t) * scale,
        dr.fma(dr.dot(wanted, n), weight, total.cosine),
        dr.fma(light.horizon, weight, total.horizon),
    )


def light_for_normal(
    irradiance: mi.Color3f, found: NormalLightSum, weights: mi.Float, to_geometric: mi.Float
) -> mi.Color3f:
    """Return the irradiance under the normal of `found`, whose sums are over `weights`, by the equation above.

    `to_geometric` is that normal's cosine to the point's geometric normal.
    """
    inverse = 1.0 / dr.fmax(weights, 1e-20)
    off = dr.clip(1.0 - found.cosine * inverse, 0.0, 2.0)
    horizon = found.horizon * inverse
    gained = dr.clip(to_geometric - 1.0 + off, 0.0, off)
    # Beyond a right angle the first term alone may be less than nothing.
    even = irradiance * dr.fmax(1.0 - off + 0.5 * (off + gained) * horizon, 0.0)
    one_sided = 1.0 - gained / dr.fmax(off, 1e-6)
    slope = 1.0 - _angle_over_pi(off) * one_sided * dr.fmin(horizon, HORIZON_SLOPE_MAX)
    return dr.fmax(even + found.turned * (inverse * slope), LEAST_SHARE * even)


def _angle_over_pi(off: mi.Float) -> mi.Float:
    """Return a / pi for the angle a of cosine 1 - `off`, within 3e-3 up to a right angle."""
    return dr.sqrt(off) * dr.fma(off, 0.0498, 0.4502)
