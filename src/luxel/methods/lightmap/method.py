"""The relightable surfel lightmap: bake the transport once, relight it every frame.

Source: a developer's account of 25 April 2017, "Real Time Global Illumination" (lightmap UVs, surfel creation, surfel
clustering, visibility sampling, realtime update), itself after an article of the Journal of Computer Graphics
Techniques on clustered surfels.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import drjit as dr
import numpy as np

from luxel.kernels.gbuffer import GBuffer
from luxel.kernels.records import Light, Surface
from luxel.methods.base import CHECKS, Frame, Method, NoScreen, Progress, stay_silent
from luxel.methods.inspect import Inspector
from luxel.methods.lightmap.bake.bake import bake_scene
from luxel.methods.lightmap.flatten.flat_scene import FlatScene
from luxel.methods.lightmap.inspector import LightmapInspector
from luxel.methods.lightmap.params import SOURCE, LightmapParams
from luxel.methods.lightmap.run.query import query_lightmap
from luxel.methods.lightmap.run.relight import (
    average_direct,
    count_alike,
    fingerprint_lights,
    light_surfels,
    start_radiosity,
    sum_clusters,
    sum_texels,
)
from luxel.methods.lightmap.run.state import LightmapState, bake_of
from luxel.methods.lightmap.run.storage import load_lightmap, save_lightmap
from luxel.methods.lightmap.run.upload import bounce_gain, upload_bake
from luxel.methods.lightmap.workload import LightmapWorkload
from luxel.methods.workload import Workload
from luxel.scene.device import Scene
from luxel.stages import stage


class Lightmap(Method):
    """Light baked as transport between clusters of surfels and texels: any light may change, surfaces stand still."""

    name: ClassVar[str] = "lightmap"
    Params: ClassVar[type] = LightmapParams
    presets: ClassVar[dict[str, dict[str, Any]]] = {"source": SOURCE}
    # A moving object is lit by the probes and shades direct light, but it is no part of the bake.
    claims: ClassVar[frozenset[str]] = CHECKS - {"follows"}
    bakes: ClassVar[frozenset[str]] = frozenset({"geometry", "reflectance", "sky"})
    bakeable: ClassVar[bool] = True
    workload: ClassVar[Workload | None] = LightmapWorkload()
    inspector: ClassVar[Inspector | None] = LightmapInspector()

    def build(
        self, scene: Scene, params: LightmapParams, seed: int, *, workdir: Path | None = None,
        progress: Progress | None = None, flat: FlatScene | None = None,
    ) -> LightmapState:  # fmt: skip
        """Bake the scene; batches of rays are kept in `workdir`, where a stopped bake goes on.

        `flat` is the scene laid flat, where that has been done already.

        Raises LuxelError for bad parameters, an atlas too small for its charts, a mesh that cannot be unwrapped.
        """
        params.check()
        bake = bake_scene(scene, params, seed, flat=flat, workdir=workdir, report=progress or stay_silent)
        return upload_bake(scene, bake, seed)

    def update(self, scene: Scene, state: LightmapState, frame: Frame) -> LightmapState:
        """Relight: surfels, then clusters, then texels."""
        # Light the surfels: shadow rays, and the bounces that the last frame's lightmap holds.
        with stage("lightmap/surfels") as current:
            seen = fingerprint_lights(scene)
            current.keep(seen)
            count = count_alike(scene, state, seen)
            fresh, bounced = light_surfels(scene, state, frame, count)
            direct, count = average_direct(state, fresh, count), count + 1
            radiosity = start_radiosity(scene, state, direct + bounced)
            current.keep(direct, count, radiosity)

        # Sum the clusters, small ones first.
        with stage("lightmap/clusters") as current:
            for step in state.clusters.passes:
                radiosity = sum_clusters(radiosity, step)
                current.keep(radiosity)

        # Sum the texels, and the probes' directions.
        with stage("lightmap/texels") as current:
            light = sum_texels(state.transport, radiosity, dr.width(state.light) // 4)
            current.keep(light)
        return replace(state, light=light, radiosity=radiosity, direct=direct, direct_count=count, lights_seen=seen)

    def query(self, scene: Scene, state: LightmapState, surface: Surface) -> Light:
        return query_lightmap(scene, state, surface)

    def shade(
        self, scene: Scene, state: LightmapState, screen: NoScreen, frame: Frame, gbuffer: GBuffer
    ) -> tuple[Light, NoScreen]:
        with stage("lightmap/lookup") as current:
            light = query_lightmap(scene, state, gbuffer.surface, free=False)
            current.keep(light)
        return light, screen

    def texels(self, state: LightmapState) -> np.ndarray:
        return np.array(state.light).reshape(-1, 4)[:, :3]

    def cache(self, state: LightmapState) -> dict[str, int | float]:
        bake = bake_of(state)
        return {
            "texel_count": len(bake.texel_slot),
            "surfel_count": len(bake.surfel_p),
            "cluster_count": len(bake.tree_low),
            "clusters_per_texel": float((bake.words != 0).sum(axis=1).mean()),
            "probe_count": len(bake.probe_fine),
            "atlas_width": bake.width,
            "atlas_height": bake.height,
            "texel_size": float(bake.texel_size),
            "texels_filled": int((~bake.texel_fine).sum()),
            "bounce_gain": bounce_gain(bake),
        }

    def warnings(self, state: LightmapState) -> list[str]:
        return [str(note) for note in bake_of(state).notes]

    def save(self, state: LightmapState, path: Path) -> None:
        save_lightmap(self.name, state, path)

    def load(self, scene: Scene, params: LightmapParams, path: Path) -> LightmapState:
        params.check()
        return load_lightmap(self.name, scene, params, path)
