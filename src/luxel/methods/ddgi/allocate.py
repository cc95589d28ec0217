"""A new state, part by part: the constants of its parameters, and arrays that know nothing yet."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from luxel.kernels.mean_estimator import EstimatorDials
from luxel.methods.ddgi.atlas import block_size
from luxel.methods.ddgi.memory import extra_count
from luxel.methods.ddgi.params import FAR_DEPTHS, DdgiParams
from luxel.methods.ddgi.planes import new_sums
from luxel.methods.ddgi.state import (
    AWAKE,
    UNUSED,
    DdgiDials,
    DdgiSettings,
    DepthMoments,
    PlacementRequests,
    PlaneSums,
    Probes,
)


def make_settings(params: DdgiParams, probe_count: int, guided: int = 0, surrounded: bool = False) -> DdgiSettings:
    """Return the constants of a state with `probe_count` probes in its boxes, of which `guided` go with the view.

    `surrounded`: something lies beyond the scene's bounds.
    """
    return DdgiSettings(
        probe_count=probe_count,
        extra_count=extra_count(params),
        rays_per_probe=params.num_samples_per_probe,
        irradiance_resolution=params.irradiance_resolution,
        depth_resolution=params.depth_resolution,
        half_irradiance=params.irradiance_format == "float16",
        half_depth=params.depth_format == "float16",
        planes=params.depth_model == "planes",
        depth_sharpness=params.depth_sharpness,
        far_depth=FAR_DEPTHS.index(params.far_depth),
        adaptive=params.adaptive_hysteresis,
        detect_dead=params.detect_dead_probes,
        offset_dead=params.offset_dead_probes and params.detect_dead_probes,
        thesis_backs=params.backface_rule == "rohacek",
        step_through=params.offset_pattern == "backface",
        corrected_weights=params.corrected_weights,
        roots=params.interpolation == "root",
        variance_budget=params.ray_budget == "variance",
        feedback=params.bounces == "feedback",
        paths_outside=surrounded and params.bounces == "feedback" and params.outside == "path",
        sky_rays=params.sky_rays,
        follow_camera=params.follow_camera,
        guided=guided,
        sleep_after=params.sleep_after,
        debug_layer=params.show_debug_layer,
    )


def make_dials(params: DdgiParams) -> DdgiDials:
    """Return the parameters that may change while it runs."""

    def opaque(value: float) -> mi.Float:
        return dr.opaque(mi.Float, float(value))

    return DdgiDials(
        hysteresis=opaque(params.hysteresis),
        backface_offset=opaque(params.backface_offset),
        normal_bias=opaque(params.normal_bias),
        view_bias=opaque(params.view_bias),
        dead_hysteresis=opaque(params.dead_probes_hysteresis),
        dead_threshold=opaque(params.dead_probe_threshold),
        estimator=EstimatorDials(opaque(0.08), opaque(64), opaque(2048)),
    )


def new_requests(settings: DdgiSettings) -> PlacementRequests:
    """Return no placement requests: one entry a request of a frame, at least one."""
    count = max(settings.request_count, 1)
    return PlacementRequests(
        dr.zeros(mi.Point3f, count), dr.zeros(mi.Normal3f, count), dr.zeros(mi.UInt32, count), dr.zeros(mi.Bool, count)
    )


def new_probes(settings: DdgiSettings) -> Probes:
    """Return probes that know nothing, at the origin; those of the boxes awake, those held back unused."""
    count = settings.total
    index = dr.arange(mi.UInt32, count)
    return Probes(
        p=dr.zeros(mi.Point3f, count),
        offset=dr.zeros(mi.Vector3f, count),
        status=dr.select(index < settings.probe_count, mi.UInt32(AWAKE), UNUSED),
        dead=dr.zeros(mi.Float, count),
        unfit=dr.zeros(mi.Float, count),
        age=dr.zeros(mi.UInt32, count),
        unread=dr.zeros(mi.UInt32, count),
        tries=dr.zeros(mi.UInt32, count),
        part=dr.zeros(mi.UInt32, count),
        noise=dr.full(mi.Float, 1.0, count),
    )


def new_depth(settings: DdgiSettings) -> DepthMoments | PlaneSums:
    """Return empty sums for each depth texel (total * resolution^2)."""
    count = settings.total * settings.depth_resolution**2
    return new_sums(count) if settings.planes else DepthMoments(*(dr.zeros(mi.Float, count) for _ in range(3)))


def new_atlas(count: int, resolution: int, channels: int, half: bool) -> mi.Float | mi.Float16:
    """Return a black atlas of `count` blocks (resolution + 2)^2 of `channels` words, in half floats if `half`."""
    return dr.zeros(mi.Float16 if half else mi.Float, count * block_size(resolution) * channels)
