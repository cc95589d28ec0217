"""Where the rays of surfels go, and how much each counts: one mixture of all that chooses directions.

Directions follow the cosine, a share of them spread evenly where surfels keep light for other normals. Maps of where
light comes from bend that spread (`guiding.py`). Where the sky has bright places, a share of the rays looks for them
instead, and each ray counts by how much likelier the cosine alone was to take its direction than the mixture
(one-sample balance heuristic, Veach and Guibas 1995).
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from luxel.kernels.sampling import cosine_hemisphere, to_unit, to_world
from luxel.kernels.sky import is_sky_sampled, sample_sky, sky_density
from luxel.kernels.square_maps import ONE_BELOW, cell_of_point, map_density, warp_by_map
from luxel.methods.gibs.guiding import GuidedCell, SharedMap
from luxel.methods.gibs.normal_light import square_of_widened, widened_density, widened_hemisphere
from luxel.methods.gibs.surfels import GibsState
from luxel.scene.device import Scene


@dataclass
class ChosenDirection:
    """Directions, and what they count for."""

    direction: mi.Vector3f
    """Unit, world space."""
    weight: mi.Float
    """Cosine over pi and over the density of the direction; 0 under the horizon."""
    control: mi.Float
    """1 on average: what the control variate of the irradiance goes by. It leaves out the weights that maps bring: they
    follow the light, so that the mean of `weight` times light varies less than its two factors."""
    guided: GuidedCell | None
    """Where maps can learn from the rays; None: no map was asked."""


def looks_for_sky(scene: Scene, state: GibsState) -> bool:
    """Return whether some of the surfels' rays look for the sky's bright places."""
    return state.settings.looks_for_sky and is_sky_sampled(scene)


def choose_direction(
    scene: Scene, state: GibsState, n: mi.Normal3f, word_a: mi.UInt32, word_b: mi.UInt32, active: mi.Bool,
    guide: SharedMap | None = None,
) -> ChosenDirection:  # fmt: skip
    """Return each ray's direction about the unit normal `n`, from a point of 32-bit coordinates.

    `guide` says whose maps rays follow; None: those of none.
    """
    sample = mi.Point2f(to_unit(word_a), to_unit(word_b))
    sky = looks_for_sky(scene, state)
    share = state.dials.sky_share * scene.lights.sky_table.focus if sky else mi.Float(0.0)
    if sky:
        # The first coordinate chooses who chooses; stretched, it serves again, so the points keep their spread.
        to_sky = sample.x < share
        stretched = dr.fmin(mi.Float(word_a) * 2.0**-32 / dr.fmax(share, 1e-9), ONE_BELOW)
        sought, _ = sample_sky(scene, mi.Point2f(stretched, sample.y), active & to_sky)
        sample = mi.Point2f(dr.select(to_sky, sample.x, (sample.x - share) / (1.0 - share)), sample.y)

    # Follow a map, and the cosine with what is spread evenly.
    gain, cell = mi.Float(1.0), mi.UInt32(0)
    if guide is not None:
        sample, gain = warp_by_map(guide.maps, guide.index, sample, active)
        cell = cell_of_point(sample)
    even = state.dials.even_share if state.settings.normal_light else mi.Float(0.0)
    local = widened_hemisphere(sample, even) if state.settings.normal_light else cosine_hemisphere(sample)
    direction = to_world(n, local) if guide is None else guide.s * local.x + guide.t * local.y + guide.n * local.z
    # The world's cosine, by which `moments_of_ray` divides: next to the horizon the local one is another number.
    cosine = dr.dot(direction, mi.Vector3f(n))
    sky_chance = mi.Float(0.0)
    if sky:
        direction = dr.select(to_sky, sought, direction)
        cosine = dr.select(to_sky, dr.dot(sought, mi.Vector3f(n)), cosine)
        sky_chance = share * sky_density(scene, direction, active)
        if guide is not None:
            place = mi.Vector3f(dr.dot(sought, guide.s), dr.dot(sought, guide.t), cosine)
            there = cell_of_point(square_of_widened(place, even))
            cell = dr.select(to_sky, there, cell)
            gain = dr.select(to_sky, map_density(guide.maps, guide.index, there, active & to_sky), gain)
    return _weigh(cosine, (1.0 - share) * widened_density(cosine, even), sky_chance, gain, direction, guide, cell)


def _weigh(
    cosine: mi.Float, spread: mi.Float, sky: mi.Float, gain: mi.Float, direction: mi.Vector3f, guide: SharedMap | None,
    cell: mi.UInt32,
) -> ChosenDirection:  # fmt: skip
    """Return directions with their weights, from the densities with which the spread and the sky took them.

    `gain` is by how much a map made the spread take them the more often.
    """
    blind, mixture = spread + sky, dr.fmax(spread * gain + sky, 1e-30)
    weight = dr.select(cosine > 0.0, cosine * dr.inv_pi / mixture, 0.0)
    if guide is None:
        return ChosenDirection(direction, weight, weight, None)
    likelier = dr.select(cosine > 0.0, mixture / dr.fmax(blind, 1e-30), 1.0)
    control = 1.0 + weight - 1.0 / dr.fmax(likelier, 1e-30)
    return ChosenDirection(direction, weight, control, GuidedCell(guide.index, cell, likelier))
