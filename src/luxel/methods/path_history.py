"""What `path` keeps of a moving view: each pixel's irradiance goes on with the point that it shows.

Irradiance has no albedo and no view in it, so a point keeps its own however the camera moves. Where it was in the last
frame, motion vectors say; taps that show something else are rejected (`kernels/reproject.py`). In motion a pixel is the
mean of its last `longest` frames, faded exponentially. At rest it is the plain mean of the rest, beside which all that
came before fades out: light may have changed since.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi

from luxel.kernels.bsdf import ALPHA_FLOOR, BSDF
from luxel.kernels.gbuffer import GBuffer
from luxel.kernels.history import frames_kept, running_mean
from luxel.kernels.records import PathLight
from luxel.kernels.reproject import Taps
from luxel.methods.base import Frame

FADES_WITHIN = 2.0
"""Histories of rest after which nothing counts that came before it."""
LEAST_ALBEDO = 1e-3
"""Diffuse albedo below which light is not divided by it."""


@dataclass
class Kept:
    """Means over frames, in tile order: colours, or records of colours."""

    mean: Any
    """What is shown, and goes on with the points."""
    count: mi.Float
    """Frames that it counts as; 0 where a pixel has nothing to pass on."""
    old: Any
    """What was there before camera, scene or light last changed."""
    old_count: mi.Float
    rest: Any
    """Mean of the frames since then, that of the change included."""
    rested: mi.UInt32
    """How many they are."""


@dataclass
class DiffuseLight:
    """What the diffuse part of full materials is lit by, W/m^2."""

    direct: mi.Color3f
    indirect: mi.Color3f


def keep_nothing(kind: type, lanes: int) -> Kept:
    """Return the history of no frames: means are of `kind`, for `lanes` pixels."""
    means = [dr.zeros(kind, lanes) for _ in range(3)]
    counts = [dr.zeros(mi.Float, lanes) for _ in range(2)]
    kept = Kept(means[0], counts[0], means[1], counts[1], means[2], mi.UInt32(0))
    dr.make_opaque(kept)
    return kept


def take_along(kept: Kept, fresh: Any, frame: Frame, taps: Taps, longest: mi.UInt32) -> Kept:
    """Return the history with the frame `fresh` in it; `longest` is how many frames count in motion, 1 or more."""
    # Where anything has changed, what was shown becomes the past of the points that moved through the picture.
    limit = mi.Float(longest)
    old = _choose(frame.still, kept.old, taps.gather(kept.mean))
    old_count = dr.select(frame.still, kept.old_count, dr.fmin(taps.gather(kept.count), limit - 1.0))

    # The past weighs less and less beside the frames since then; with none, those are all there is.
    rested = frames_kept(frame.still, kept.rested)
    rest = running_mean(kept.rest, fresh, rested)
    weight = old_count * dr.fmax(1.0 - mi.Float(rested) / (FADES_WITHIN * limit), 0.0)
    count = weight + mi.Float(rested) + 1.0
    mean = running_mean(old, rest, weight, 1.0 - weight / count)
    return Kept(mean, count, old, old_count, rest, rested + 1)


def take_paths_along(
    kept: Kept, fresh: PathLight, mean: PathLight, frame: Frame, gbuffer: GBuffer, longest: mi.UInt32
) -> tuple[Kept, PathLight]:
    """Return the history of full materials' diffuse light, and the picture with it: `mean` is that of a still view.

    Only what no mirror, glass or smooth coat stands before has a history, and glossy light has none: both move in
    other ways than the surface does.
    """
    assert gbuffer.taps is not None
    albedo = fresh.albedo
    rough = gbuffer.surface.active & has_no_delta(gbuffer.surface.bsdf) & (dr.max(albedo) > LEAST_ALBEDO)
    factor = dr.select(albedo > LEAST_ALBEDO, dr.pi / dr.fmax(albedo, LEAST_ALBEDO), 0.0)
    lit = DiffuseLight(fresh.direct * factor, fresh.indirect * factor)
    kept = take_along(kept, lit, frame, gbuffer.taps.among(kept.count > 0.0), longest)
    kept = replace(kept, count=dr.select(rough, kept.count, 0.0))

    def shown(light: mi.Color3f, plain: mi.Color3f) -> mi.Color3f:
        return dr.select(rough & (albedo > LEAST_ALBEDO), light * albedo * dr.inv_pi, plain)

    light = kept.mean
    picture = replace(mean, direct=shown(light.direct, mean.direct), indirect=shown(light.indirect, mean.indirect))
    return kept, picture


def has_no_delta(bsdf: BSDF) -> mi.Bool:
    """Return whether every path that meets the surface is scattered there: nothing is mirrored or let through."""
    features = bsdf.features
    if not features.gloss:
        return mi.Bool(True)
    rough = mi.Float(bsdf.alpha) >= ALPHA_FLOOR
    rough |= (mi.Float(bsdf.metallic) == 0.0) & (mi.Float(bsdf.specular) == 0.0)
    if features.transmission:
        rough &= mi.Float(bsdf.transmission) == 0.0
    if features.clearcoat:
        rough &= (mi.Float(bsdf.clearcoat) == 0.0) | (mi.Float(bsdf.clearcoat_alpha) >= ALPHA_FLOOR)
    return rough


def _choose(still: mi.Bool, own: Any, taken: Any) -> Any:
    if isinstance(own, DiffuseLight):
        return DiffuseLight(dr.select(still, own.direct, taken.direct), dr.select(still, own.indirect, taken.indirect))
    return dr.select(still, own, taken)
