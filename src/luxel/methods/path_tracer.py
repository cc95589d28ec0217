"""The path tracer: truth, and the progressive competitor.

One integrator, one rule: direct light by the shared sampler at every vertex, the sky by rays that miss, so direct and
indirect light come apart on the same paths and nothing is counted twice. Where the sky has bright places, each vertex
sends one ray towards them too, and the two share each direction by the balance heuristic. Every surface is diffuse
with the g-buffer's albedo; paths end by Russian roulette alone.

A scene uploaded with full materials is followed whole, at the pixels and for the irradiance at other points
(`kernels/full_path.py`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.errors import LuxelError
from luxel.kernels.direct import direct_irradiance
from luxel.kernels.film import Film
from luxel.kernels.full_path import trace_full, trace_full_irradiance
from luxel.kernels.gbuffer import GBuffer
from luxel.kernels.history import frames_kept, running_mean
from luxel.kernels.records import Light, PathLight, Surface
from luxel.kernels.sampling import cosine_hemisphere, hash_pair, random_2d, to_unit, to_world
from luxel.kernels.side_by_side import sum_samples, take_lanes
from luxel.kernels.sky import SKY_DISTANCE, is_sky_sampled, sample_sky, sky_density, sky_radiance
from luxel.kernels.surface import surface_at_hit
from luxel.kernels.surface_bsdf import prepare_bsdf
from luxel.kernels.trace import offset_origin, trace_closest
from luxel.kernels.transmittance import trace_transmittance
from luxel.methods.base import Frame, Method
from luxel.methods.inspect import Inspector
from luxel.methods.path_history import DiffuseLight, Kept, keep_nothing, take_along, take_paths_along
from luxel.scene.device import Scene
from luxel.stages import stage

SAMPLE_LIMIT = 4096
HISTORY_LIMIT = 4096
ROULETTE_START = 3
"""Bounces before Russian roulette may end a path."""
DIMENSIONS = 16
"""Counter values that one bounce may use."""


@dr.syntax
def trace_indirect(
    scene: Scene, surface: Surface, seed: mi.UInt32, lane: mi.UInt32, active: mi.Bool, look_for_sky: bool = True
) -> mi.Color3f:
    """Return a one-path estimate of the indirect irradiance at `surface`, W/m^2, without depth limit.

    `look_for_sky` False: the sky comes by rays that miss alone.
    """
    seeks = look_for_sky and is_sky_sampled(scene)
    p = mi.Point3f(offset_origin(scene, surface.p, surface.n_geometric))
    direction = to_world(surface.n_shading, cosine_hemisphere(random_2d(seed, lane)))
    # A shading normal may send the ray under the surface; such light does not exist.
    going = active & surface.active & (dr.dot(direction, surface.n_geometric) > 0.0)
    throughput = mi.Color3f(dr.pi)
    irradiance = mi.Color3f(0.0)
    cosine = dr.dot(direction, surface.n_shading)
    if dr.hint(seeks, mode="scalar"):
        irradiance = throughput * _seek_sky(scene, surface, seed + 9, lane, active & surface.active)
    depth = mi.UInt32(0)
    counter = mi.UInt32(seed)
    while going:
        # Light that the ray brings: the sky if it misses, what the hit reflects of the lamps if it does not.
        hit = trace_closest(scene, p, direction, going)
        sky = sky_radiance(scene, direction, going & ~hit.valid)
        if dr.hint(seeks, mode="scalar"):
            sky *= weight_of_cosine(scene, direction, cosine, going & ~hit.valid)
        irradiance += throughput * sky
        going &= hit.valid
        vertex = surface_at_hit(scene, hit, direction)
        throughput *= vertex.albedo
        counter += DIMENSIONS
        direct = direct_irradiance(scene, vertex, counter, lane, going)
        irradiance += throughput * direct * dr.inv_pi
        if dr.hint(seeks, mode="scalar"):
            irradiance += throughput * _seek_sky(scene, vertex, counter + 9, lane, going)

        # Russian roulette on what the path can still carry.
        depth += 1
        carried = dr.max(throughput) * dr.inv_pi
        survive = dr.select(depth >= ROULETTE_START, dr.fmin(carried, 0.95), 1.0)
        word_a, _ = hash_pair(counter + 7, lane)
        going &= (carried > 0.0) & (to_unit(word_a) < survive)
        throughput /= dr.fmax(survive, 1e-6)

        # Go on in a cosine-distributed direction; albedo is all that remains of BRDF times cosine over density.
        direction = to_world(vertex.n_shading, cosine_hemisphere(random_2d(counter + 8, lane)))
        going &= dr.dot(direction, vertex.n_geometric) > 0.0
        p = offset_origin(scene, vertex.p, vertex.n_geometric)
        cosine = dr.dot(direction, vertex.n_shading)
    return irradiance


def _seek_sky(scene: Scene, surface: Surface, seed: mi.UInt32, lane: mi.UInt32, active: mi.Bool) -> mi.Color3f:
    """Return the sky's light by one ray towards its bright places, in the units of a cosine ray's radiance.

    Weighted so that a cosine ray from the same place brings the rest (`weight_of_cosine`).
    """
    direction, density = sample_sky(scene, random_2d(seed, lane), active)
    cosine = dr.dot(direction, surface.n_shading)
    above = active & (cosine > 0.0) & (dr.dot(direction, surface.n_geometric) > 0.0)
    origin = offset_origin(scene, surface.p, surface.n_geometric)
    passes = trace_transmittance(scene, origin, direction, mi.Float(SKY_DISTANCE), above)
    even, sought = cosine * dr.inv_pi, density * scene.lights.sky_table.focus
    weight = scene.lights.sky_table.focus * even / (even + sought)
    above &= dr.max(passes) > 0.0
    return sky_radiance(scene, direction, above) * passes * dr.select(above, weight, 0.0)


def weight_of_cosine(scene: Scene, direction: mi.Vector3f, cosine: mi.Float, active: mi.Bool) -> mi.Float:
    """Return what a cosine ray that meets the sky counts for, where a ray towards its bright places is cast as well.

    The other ray counts as the share of one that the sky's bright places have in its light: on a mild sky it would
    bring noise.
    """
    even = dr.fmax(cosine, 0.0) * dr.inv_pi
    sought = sky_density(scene, direction, active) * scene.lights.sky_table.focus
    return even / dr.fmax(even + sought, 1e-30)


@dataclass
class PathState:
    """The path tracer keeps nothing of the world but its seed."""

    seed: mi.UInt32
    samples: int
    history: mi.UInt32 | None = None
    """Frames of a moving view that count; None: any motion starts anew."""


@dataclass
class PathScreen:
    """The running mean of a still view."""

    irradiance: mi.Color3f
    count: mi.UInt32
    seen: PathLight | None = None
    """With full materials: the mean of all that paths have found."""
    kept: Kept | None = None
    """What goes along with the points that move through the picture."""


class PathTracer(Method):
    """Progressive path tracing: `samples` paths a pixel and frame, averaged while camera and scene are still."""

    @dataclass
    class Params:
        """Dials of the progressive path tracer."""

        samples: int = 1
        """Paths a pixel and frame: time grows in proportion, noise falls with its root."""
        history: int = 0
        """Frames that a moving view's pixels are means of, along motion vectors; 0: any motion starts anew. Longer:
        less noise, but more blur, and light that changes is followed later (by 90 % after 1.7 histories)."""

    name: ClassVar[str] = "path"
    presets: ClassVar[dict[str, dict[str, Any]]] = {"reproject": {"history": 32}}
    shows_gloss: ClassVar[bool] = True
    progressive: ClassVar[bool] = True
    bakeable: ClassVar[bool] = True
    # No workload: roulette leaves the number of rays to chance.
    inspector: ClassVar[Inspector | None] = Inspector()

    def build(self, scene: Scene, params: Any, seed: int, *, workdir=None, progress=None) -> PathState:
        if not 1 <= params.samples <= SAMPLE_LIMIT:
            raise LuxelError(f"path: parameter 'samples' is {params.samples}, but must be from 1 to {SAMPLE_LIMIT}")
        if not 0 <= params.history <= HISTORY_LIMIT:
            raise LuxelError(f"path: parameter 'history' is {params.history}, but must be from 0 to {HISTORY_LIMIT}")
        prepare_bsdf(scene)
        history = dr.opaque(mi.UInt32, params.history) if params.history else None
        return PathState(dr.opaque(mi.UInt32, (seed * 7919 + 101) & 0xFFFFFFFF), int(params.samples), history)

    def retune(self, scene: Scene, state: PathState, params: Any) -> PathState | None:
        built = self.build(scene, params, 0)
        return replace(built, seed=state.seed) if self.reprojects(built) == self.reprojects(state) else None

    def load(self, scene: Scene, params: Any, path: Path) -> PathState:
        # A history is a dial: the file's own would stand in the way of `params`.
        return replace(self.build(scene, params, 0), seed=super().load(scene, params, path).seed)

    def reprojects(self, state: PathState) -> bool:
        return state.history is not None

    def screen(self, scene: Scene, state: PathState, film: Film) -> PathScreen:
        screen = PathScreen(dr.zeros(mi.Color3f, film.lane_count), dr.opaque(mi.UInt32, 0))
        if scene.features.gloss:
            screen.seen = dr.zeros(PathLight, film.lane_count)
            dr.make_opaque(screen.seen)
        if state.history is not None:
            kind = DiffuseLight if scene.features.gloss else mi.Color3f
            screen.kept = keep_nothing(kind, film.lane_count)
        dr.eval(screen)
        return screen

    def query(self, scene: Scene, state: PathState, surface: Surface) -> Light:
        return _sample(scene, surface, state.seed, state.samples)

    def shade(
        self, scene: Scene, state: PathState, screen: PathScreen, frame: Frame, gbuffer: GBuffer
    ) -> tuple[Light, PathScreen]:
        if scene.features.gloss:
            return self._shade_full(scene, state, screen, frame, gbuffer)
        with stage("path/trace") as current:
            light = _sample(scene, gbuffer.surface, state.seed + frame.seed + frame.index * 4099, state.samples)
            current.keep(light)
        if state.history is not None:
            assert screen.kept is not None and gbuffer.taps is not None
            kept = take_along(screen.kept, light.irradiance, frame, gbuffer.taps, state.history)
            return replace(light, irradiance=kept.mean), replace(screen, kept=kept)
        count = frames_kept(frame.still, screen.count)
        mean = running_mean(screen.irradiance, light.irradiance, count)
        return Light(mean, light.radiance, light.weight), PathScreen(mean, count + 1)

    def _shade_full(
        self, scene: Scene, state: PathState, screen: PathScreen, frame: Frame, gbuffer: GBuffer
    ) -> tuple[Light, PathScreen]:
        with stage("path/trace") as current:
            fresh = _sample_full(scene, gbuffer, state.seed + frame.seed + frame.index * 4099, state.samples)
            current.keep(fresh)
        before = fresh if screen.seen is None else screen.seen
        count = frames_kept(frame.still, screen.count)
        mean = running_mean(before, fresh, count)
        screen = replace(screen, count=count + 1, seen=mean)
        if state.history is not None:
            assert screen.kept is not None
            kept, mean = take_paths_along(screen.kept, fresh, mean, frame, gbuffer, state.history)
            screen = replace(screen, kept=kept)
        covered = dr.select(gbuffer.surface.active, mi.Float(1.0), 0.0)
        return Light(screen.irradiance, mi.Color3f(0.0), covered, seen=mean), screen


def _sample(scene: Scene, surface: Surface, seed: mi.UInt32, samples: int) -> Light:
    mean = _mean_irradiance if scene.features.gloss else _mean_diffuse
    covered = dr.select(surface.active, mi.Float(1.0), 0.0)
    return Light(mean(scene, surface, seed, samples), mi.Color3f(0.0), covered)


@dr.syntax
def _mean_diffuse(scene: Scene, surface: Surface, seed: mi.UInt32, samples: int) -> mi.Color3f:
    # One after the other: these paths are short and of one kind, so that side by side they are no faster.
    lane = dr.arange(mi.UInt32, dr.width(surface.p))
    total = mi.Color3f(0.0)
    sample = mi.UInt32(0)
    while sample < samples:
        sample += 1
        start, _ = hash_pair(seed, sample)
        total += trace_indirect(scene, surface, start, lane, surface.active)
    return total / samples


def _mean_irradiance(scene: Scene, surface: Surface, seed: mi.UInt32, samples: int) -> mi.Color3f:
    def trace_sample(lane: mi.UInt32, number: mi.UInt32) -> mi.Color3f:
        start = Surface.at(
            take_lanes(surface.p, lane),
            take_lanes(surface.n_shading, lane),
            n_geometric=take_lanes(surface.n_geometric, lane),
            wo=take_lanes(surface.wo, lane),
            active=take_lanes(surface.active, lane),
        )
        return trace_full_irradiance(scene, start, hash_pair(seed, number)[0], lane, start.active)

    return sum_samples(mi.Color3f(0.0), dr.width(surface.p), samples, trace_sample) / samples


def _sample_full(scene: Scene, gbuffer: GBuffer, seed: mi.UInt32, samples: int) -> PathLight:
    def trace_sample(lane: mi.UInt32, number: mi.UInt32) -> PathLight:
        return trace_full(scene, gbuffer, hash_pair(seed, number)[0], lane)

    zero = dr.zeros(PathLight, dr.width(gbuffer.lane))
    return sum_samples(zero, dr.width(gbuffer.lane), samples, trace_sample).times(1.0 / samples)


def estimate_ambient(scene: Scene, seed: int, size: int = 64, spp: int = 16) -> tuple[float, float, float]:
    """Return pi times indirect radiance over albedo, summed over a small image of the scene's default camera."""
    from luxel.kernels.camera import make_pinhole
    from luxel.kernels.film import Film
    from luxel.kernels.gbuffer import trace_gbuffer
    from luxel.scene.edit import default_camera

    film = Film(size, size)
    pinhole = make_pinhole(default_camera(scene.host.data), size, size, origin=scene.host.origin)
    surface = trace_gbuffer(scene, film, pinhole, pinhole).surface
    total = np.zeros(3)
    lane = dr.arange(mi.UInt32, film.lane_count)
    for sample in range(spp):
        start = dr.opaque(mi.UInt32, (seed * 131 + 17 + sample * 4099) & 0xFFFFFFFF)
        light = trace_indirect(scene, surface, start, lane, surface.active) * surface.albedo
        total += np.array([float(dr.sum(channel)[0]) for channel in light]) / spp
    albedo = np.array([float(dr.sum(channel)[0]) for channel in surface.albedo])
    scale = float(np.array(scene.lights.scale)[0])
    ambient = total / np.maximum(albedo, 1e-9) / max(scale, 1e-30)
    return float(ambient[0]), float(ambient[1]), float(ambient[2])
