"""One relighting step: light the surfels, sum the clusters, sum the texels.

Direct light falls on each surfel's sample points, last frame's irradiance adds the bounces before it, and albedo makes
radiosity of the two. A cluster's radiosity is a mean of its parts'. A texel's irradiance is the sum of weight times
radiosity over its clusters. So a changed light shows its first bounce in the same frame, and each frame adds one.

The document reads last frame's irradiance from the lightmap. Here each surfel sums a row of its own, as a texel does:
where a roof runs through a texel, half of it sees the sun, and the surfels in the room took that for their own.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from luxel.kernels.direct import direct_irradiance
from luxel.kernels.records import Surface
from luxel.kernels.sampling import mix
from luxel.methods.base import Frame
from luxel.methods.lightmap.bake.words import HIT_BITS
from luxel.methods.lightmap.run.sky import light_sky
from luxel.methods.lightmap.run.state import BLOCK, WORDS, LightmapState, LitSurfels, Pass, Transport
from luxel.scene.device import Scene


@dr.syntax
def light_surfels(scene: Scene, state: LightmapState, frame: Frame, count: mi.UInt32) -> tuple[mi.Color3f, mi.Color3f]:
    """Return this frame's direct irradiance on each surfel, a mean over its samples, and last frame's indirect one.

    `count` frames before this one had the same lights: each takes the next of the surfel's sets of samples, and while
    lights change every frame takes the first, so that nothing flickers.
    """
    surfels = state.surfels
    surfel = dr.arange(mi.UInt32, surfels.count)
    direct = mi.Color3f(0.0)
    chosen = count % surfels.sets
    sample = mi.UInt32(0)
    while sample < surfels.samples:
        lane = (surfel * surfels.samples + sample) * surfels.sets + chosen
        surface = _sample_surface(surfels, lane)
        direct += direct_irradiance(scene, surface, state.seed + frame.index * 0x6C8E9CF5, lane, mi.Bool(True))
        sample += 1
    row = dr.gather(mi.Vector4f, state.light, surfels.first + surfel)
    return direct * (1.0 / surfels.samples), mi.Color3f(row.x, row.y, row.z)


def _sample_surface(surfels: LitSurfels, lane: mi.UInt32) -> Surface:
    p = dr.gather(mi.Point3f, surfels.p, lane)
    n = dr.gather(mi.Normal3f, surfels.n_geometric, lane)
    return Surface.at(p, n, n_shading=dr.gather(mi.Normal3f, surfels.n_shading, lane))


@dr.syntax
def fingerprint_lights(scene: Scene) -> mi.UInt32:
    """Return a hash of everything that can change direct light from frame to frame, one lane."""
    word = mix(dr.reinterpret_array(mi.UInt32, scene.lights.scale) + 0x9E3779B9)
    tables = [scene.lights.delta, scene.materials.factors]
    if scene.features.moving:
        tables.append(scene.geometry.to_world)
    for table in tables:
        index = mi.UInt32(0)
        end = dr.opaque(mi.UInt32, dr.width(table))
        while index < end:
            word = mix(word ^ dr.reinterpret_array(mi.UInt32, dr.gather(mi.Float, table, index)))
            index += 1
    return word


def count_alike(scene: Scene, state: LightmapState, seen: mi.UInt32) -> mi.UInt32:
    """Return how many frames before this one had the lights of fingerprint `seen`."""
    if scene.features.deforming:
        return mi.UInt32(0)
    return mi.UInt32(dr.select(seen == state.lights_seen, state.direct_count, 0))


def average_direct(state: LightmapState, fresh: mi.Color3f, count: mi.UInt32) -> mi.Color3f:
    """Return direct light averaged with the `count` frames before, in which nothing changed."""
    mean = dr.lerp(state.direct, fresh, 1.0 / (mi.Float(count) + 1.0))
    return mi.Color3f(dr.select(count == 0, fresh, mean))


def start_radiosity(scene: Scene, state: LightmapState, irradiance: mi.Color3f) -> mi.Float:
    """Return rows of radiosity with the leaves filled in: surfels and the sky; the void is black."""
    clusters = state.clusters
    rows = dr.zeros(mi.Float, 4 * clusters.node_count)
    value = state.surfels.albedo * irradiance
    dr.scatter(rows, mi.Vector4f(value.x, value.y, value.z, 0.0), clusters.surfel_leaf)
    if clusters.sky_resolution:
        sky = light_sky(scene, clusters.sky_mean)
        dr.scatter(rows, mi.Vector4f(sky.x, sky.y, sky.z, 0.0), clusters.sky_leaf)
    return rows


@dr.syntax
def sum_clusters(rows: mi.Float, step: Pass) -> mi.Float:
    """Fill in the rows of one pass: flux over area, as a mean of radiosity by area."""
    lane = dr.arange(mi.UInt32, dr.width(step.node))
    index = dr.gather(mi.UInt32, step.starts, lane)
    end = dr.gather(mi.UInt32, step.starts, lane + 1)
    total = mi.Vector4f(0.0)
    while index < end:
        item = dr.gather(mi.UInt32, step.item, index)
        total = dr.fma(dr.gather(mi.Vector4f, rows, item), dr.gather(mi.Float, step.share, index), total)
        index += 1
    dr.scatter(rows, total, step.node)
    return rows


@dr.syntax
def sum_texels(transport: Transport, radiosity: mi.Float, row_count: int) -> mi.Float:
    """Return rows of light (`row_count`, 4): each texel's and probe direction's irradiance, w = 1."""
    light = dr.zeros(mi.Float, 4 * row_count)
    row = dr.arange(mi.UInt32, transport.row_count)
    total = mi.Color3f(0.0)
    # Rows stand in blocks, each step of a block side by side.
    steps = transport.budget // WORDS
    place = (row // BLOCK) * (BLOCK * steps) + row % BLOCK
    end = place + BLOCK * steps
    words = dr.gather(mi.Vector4u, transport.words, place)
    filled = words.x != 0
    while words.x != 0:
        # Four words a step: empty ones bring no hits of cluster 0.
        for word in (words.x, words.y, words.z, words.w):
            hits = mi.Float(word & ((1 << HIT_BITS) - 1))
            value = dr.gather(mi.Vector4f, radiosity, word >> HIT_BITS)
            total = dr.fma(mi.Color3f(value.x, value.y, value.z), hits, total)
        place += BLOCK
        words = dr.gather(mi.Vector4u, transport.words, place, place < end)
    total *= transport.inverse_rays
    slot = dr.gather(mi.UInt32, transport.slot, row)
    dr.scatter(light, mi.Vector4f(total.x, total.y, total.z, dr.select(filled, 1.0, 0.0)), slot)
    return light
