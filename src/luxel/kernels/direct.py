"""Direct light at any point: the one light sampler of every method and of the truth.

Up to eight delta lights get a shadow ray each, of more only the suns. Emissive triangles and the rest share one more:
a few candidates are drawn from a tree by about what they would bring (`light_tree.py`), one is kept in proportion to
what it would bring unshadowed, and its estimate is weighted by the candidates' mean (resampled importance sampling,
Talbot et al. 2005).

Sampling (`sample_each`, `choose_light`) stands apart from what a surface makes of it, and from the shadow ray
(`shadow_light`). `emitter_density` and `sun_light` say how likely a draw was to take what another sampler's ray met.
"""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi

from luxel.kernels.emitter import point_density, sample_emitter
from luxel.kernels.light_sample import FAR, LightSample, no_sample, sample_delta
from luxel.kernels.light_tree import choose_source, source_probability
from luxel.kernels.records import Surface
from luxel.kernels.sampling import hash_pair, random_2d, sequence_3d
from luxel.kernels.sun_disc import meet_disc
from luxel.kernels.trace import offset_origin
from luxel.kernels.transmittance import trace_transmittance
from luxel.scene.colours import LUMINANCE
from luxel.scene.device import Scene
from luxel.scene.lights import ENTRY_IS_DELTA
from luxel.scene.rounding import STEP

FEW_CANDIDATES, MANY_CANDIDATES = 2, 4
"""Candidates a shadow ray, among few and among more than `FEW_ENTRIES` sources: more cost arithmetic, fewer cost
noise near large or many lights."""
FEW_ENTRIES = 4
SHORT_OF = 1.0 - 2.0 * STEP
"""Share of the way to a light that its shadow ray goes."""


def direct_irradiance(
    scene: Scene,
    surface: Surface,
    seed: mi.UInt32,
    lane: mi.UInt32,
    active: mi.Bool,
    turn: tuple[mi.UInt32, mi.UInt32] | None = None,
) -> mi.Color3f:
    """Return an unbiased estimate of the direct irradiance (W/m^2) on the side of `surface.wo`.

    `seed` and `lane` are the counters of this estimate's random numbers. Where estimates of one lane are averaged,
    `turn` is the number of this one and a seed that all share: they then go through a low-discrepancy sequence.
    """
    active = active & surface.active
    # Light is weighed at the surface itself; shadow rays go from just above it to the very point of the light.
    origin = offset_origin(scene, surface.p, surface.n_geometric)

    def cosine(direction: mi.Vector3f) -> mi.Float:
        above = dr.dot(surface.n_geometric, direction) > 0.0
        return dr.select(above, dr.fmax(dr.dot(surface.n_shading, direction), 0.0), 0.0)

    total = mi.Color3f(0.0)
    for sample in sample_lights(scene, surface, seed, lane, active, cosine, turn):
        total += shadow_light(scene, origin, sample, cosine(sample.direction), active)
    return total


def sample_lights(
    scene: Scene,
    surface: Surface,
    seed: mi.UInt32,
    lane: mi.UInt32,
    active: mi.Bool,
    respond: Callable[[mi.Vector3f], mi.Float | mi.Color3f],
    turn: tuple[mi.UInt32, mi.UInt32] | None = None,
) -> list[LightSample]:
    """Return one sample for each shadow ray: all direct light is the sum over them, as `shadow_light` takes it.

    `respond` returns what a surface makes of radiance from a unit direction: BRDF times cosine, or the cosine alone.
    """
    samples = [sample_each(scene, surface, index, seed, lane, active) for index in range(scene.lights.delta_each)]
    if scene.lights.entry_count > 0:
        samples.append(choose_light(scene, surface, seed, lane, active, respond, turn))
    return samples


def shadow_ray_count(scene: Scene) -> int:
    """Return the shadow rays that `direct_irradiance` casts at most a point."""
    return scene.lights.delta_each + (1 if scene.lights.entry_count else 0)


def luminance(color: mi.Color3f) -> mi.Float:
    """Return the Rec. 709 luminance of a colour."""
    return color.x * LUMINANCE[0] + color.y * LUMINANCE[1] + color.z * LUMINANCE[2]


def shadow_light(
    scene: Scene, origin: mi.Point3f, sample: LightSample, response: mi.Float | mi.Color3f, active: mi.Bool
) -> mi.Color3f:
    """Return what a sample brings to a surface of this response: one shadow ray from `origin`, if any is needed.

    `origin` lies on the side of the surface that the light comes from (`offset_origin`).
    """
    value = sample.radiance * (response * sample.weight)
    lit = active & (luminance(value) > 0.0)
    direction, distance = shadow_ray(origin, sample)
    return value * trace_transmittance(scene, origin, direction, distance, lit)


def shadow_ray(origin: mi.Point3f, sample: LightSample) -> tuple[mi.Vector3f, mi.Float]:
    """Return unit direction and length of the ray from `origin` to just before the sampled place."""
    offset = sample.point - origin
    distance = dr.sqrt(dr.fmax(dr.squared_norm(offset), 1e-24))
    direction = dr.select(sample.is_far, sample.direction, mi.Vector3f(offset / distance))
    return direction, SHORT_OF * dr.select(sample.is_far, FAR, distance)


def sample_each(
    scene: Scene, surface: Surface, index: int, seed: mi.UInt32, lane: mi.UInt32, active: mi.Bool
) -> LightSample:
    """Return delta light number `index` of those that get a shadow ray each."""
    lights = scene.lights
    on_disc = random_2d(seed + mi.UInt32(0x68BC21EB + index), lane) if lights.soft_suns else mi.Point2f(0.0)
    row = dr.gather(mi.UInt32, lights.each_rows, mi.UInt32(index), active)
    return sample_delta(scene, row, surface.p, on_disc, active)


def choose_light(
    scene: Scene,
    surface: Surface,
    seed: mi.UInt32,
    lane: mi.UInt32,
    active: mi.Bool,
    respond: Callable[[mi.Vector3f], mi.Float | mi.Color3f],
    turn: tuple[mi.UInt32, mi.UInt32] | None = None,
) -> LightSample:
    """Return one of a few draws from the tree, kept in proportion to what it would bring unshadowed.

    Its weight is that of the estimate; its density stays that of one draw, which is what `emitter_density` knows.
    """
    count = FEW_CANDIDATES if scene.lights.entry_count <= FEW_ENTRIES else MANY_CANDIDATES
    kept, kept_target, weight_sum = no_sample(), mi.Float(0.0), mi.Float(0.0)
    for candidate in range(count):
        pick, point, keep_below = _numbers(seed, lane, turn, candidate)
        drawn = draw_light(scene, surface, (pick + candidate) / count, point, active)
        target = luminance(drawn.radiance * respond(drawn.direction))
        weight = target * drawn.weight
        weight_sum += weight
        keep = keep_below * weight_sum < weight
        kept, kept_target = dr.select(keep, drawn, kept), dr.select(keep, target, kept_target)
    kept.weight = weight_sum / (count * dr.fmax(kept_target, 1e-30))
    return kept


def _numbers(
    seed: mi.UInt32, lane: mi.UInt32, turn: tuple[mi.UInt32, mi.UInt32] | None, candidate: int
) -> tuple[mi.Float, mi.Point2f, mi.Float]:
    """Return the numbers in [0, 1) that choose a candidate's source, its point there, and whether it is kept.

    Sources are chosen by one number that the candidates share, each in its part of the unit interval, so that they
    are seldom the same one.
    """
    source, own = mi.UInt32(0x9E3779B8), mi.UInt32(0x9E3779B9 + 2 * candidate)
    if turn is None:
        point = random_2d(seed + (own + 1), lane)
        return random_2d(seed + source, lane).x, point, random_2d(seed + own, lane).y
    index, common = turn
    shift = hash_pair(common + source, lane)[0], *hash_pair(common + own, lane)
    pick, x, y = sequence_3d(index, shift)
    return pick, mi.Point2f(x, y), random_2d(seed + own, lane).y


def draw_light(
    scene: Scene, surface: Surface, pick: mi.Float, point: mi.Point2f, active: mi.Bool
) -> LightSample:  # fmt: skip
    """Return one draw from the tree: `pick` chooses the source, `point` a place of it; all are in [0, 1)."""
    lights = scene.lights
    source, probability = choose_source(scene, surface.p, surface.n_shading, pick, active)
    active = active & (probability > 0.0)
    row = source & ~mi.UInt32(ENTRY_IS_DELTA)
    if not lights.has_triangles:
        drawn = sample_delta(scene, row, surface.p, point, active)
    else:
        is_delta = (source & ENTRY_IS_DELTA) != 0
        drawn = sample_emitter(scene, source, surface.p, point, active & ~is_delta)
        if lights.delta_count > lights.delta_each:
            of_delta = sample_delta(scene, row, surface.p, point, active & is_delta)
            drawn = dr.select(is_delta, of_delta, drawn)
    drawn.density *= probability
    drawn.weight = dr.select(active, drawn.weight / probability, 0.0)
    return drawn


def emitter_density(
    scene: Scene, surface: Surface, prim_id: mi.UInt32, point: mi.Point3f, active: mi.Bool
) -> mi.Float:  # fmt: skip
    """Return the density per steradian with which `draw_light` at `surface` takes `point` of triangle `prim_id`.

    0 for a triangle that is not sampled, and on the light's own plane.
    """
    if not scene.lights.has_triangles:
        return mi.Float(0.0)
    chance = source_probability(scene, surface.p, surface.n_shading, prim_id, active)
    return chance * point_density(scene, prim_id, surface.p, point, active & (chance > 0.0))


def sun_light(
    scene: Scene, surface: Surface, index: int, direction: mi.Vector3f, active: mi.Bool
) -> tuple[mi.Color3f, mi.Float]:
    """Return what disc `index` of the sky's suns sends along `direction`, and the density with which that is sampled.

    By `sample_each` where the sun has a shadow ray of its own, else by `draw_light`; `surface` is where the ray begins.
    """
    radiance, row, solid_angle = meet_disc(scene, index, direction, active)
    chance = mi.Float(1.0)
    if scene.lights.delta_count > scene.lights.delta_each:
        entry = row | ENTRY_IS_DELTA
        own = mi.Bool(False)
        for number in range(scene.lights.delta_each):
            own |= dr.gather(mi.UInt32, scene.lights.each_rows, mi.UInt32(number), active) == row
        in_tree = source_probability(scene, surface.p, surface.n_shading, entry, active & ~own)
        chance = dr.select(own, 1.0, in_tree)
    met = luminance(radiance) > 0.0
    return radiance, dr.select(met, chance / dr.fmax(solid_angle, 1e-30), 0.0)
