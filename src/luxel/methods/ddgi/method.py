"""DDGI, step by step: share out rays, trace, blend, relocate, pack; look up at the pixels; learn from the view.

Sources: Majercik et al. 2019, "Dynamic Diffuse Global Illumination with Ray-Traced Irradiance Fields" (JCGT 8.2);
Roháček 2022, "Improving probes in dynamic diffuse global illumination" (Charles University), chapters 3 and 4.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.kernels.gbuffer import GBuffer
from luxel.kernels.mean_estimator import new_estimate
from luxel.kernels.records import Light, Surface
from luxel.methods.base import Frame, Method, NoScreen
from luxel.methods.ddgi.activity import (
    mark_octants_read,
    place_extra_probes,
    request_placements,
    reset_probes,
    sample_view,
    scroll_volumes,
    update_sleep,
)
from luxel.methods.ddgi.allocate import make_dials, make_settings, new_atlas, new_depth, new_probes, new_requests
from luxel.methods.ddgi.atlas import pack_depth, pack_irradiance
from luxel.methods.ddgi.blend import blend, reach_of
from luxel.methods.ddgi.cascades import ProbePlan, chooses_cascades, guide, new_guide, plan_probes, replan
from luxel.methods.ddgi.inspector import DdgiInspector
from luxel.methods.ddgi.memory import check_memory, describe_memory
from luxel.methods.ddgi.params import MAJERCIK, MAX_OFFSET, ROHACEK, DdgiParams
from luxel.methods.ddgi.planes import pack_planes
from luxel.methods.ddgi.query import MIN_CAGE_WEIGHT, query_probes
from luxel.methods.ddgi.relocate import gather_probe_hits, update_hit_shares, update_probes
from luxel.methods.ddgi.sky_rays import sky_rays_of
from luxel.methods.ddgi.state import (
    ASLEEP,
    AWAKE,
    DEAD,
    DdgiState,
    ExtraProbes,
    PlaneSums,
    ProbeRayResults,
    Probes,
    Rays,
)
from luxel.methods.ddgi.trace import plan_rays, trace_probes
from luxel.methods.ddgi.volume import make_volume, node_of_probe, world_position
from luxel.methods.ddgi.workload import DdgiWorkload, atlas_bytes
from luxel.methods.inspect import Inspector
from luxel.methods.retune import carry_over
from luxel.methods.workload import Workload
from luxel.scene.device import Scene
from luxel.stages import stage

OUTSIDE_LIMIT = 0.05
"""Share of the rays' hits outside all boxes from which the user is warned."""


class Ddgi(Method):
    """Probe GI: irradiance and depth around each point of a grid, updated by a few rays a frame."""

    name: ClassVar[str] = "ddgi"
    Params: ClassVar[type] = DdgiParams
    presets: ClassVar[dict[str, dict[str, Any]]] = {"majercik": MAJERCIK, "rohacek": ROHACEK}
    bakeable: ClassVar[bool] = True
    workload: ClassVar[Workload | None] = DdgiWorkload()
    inspector: ClassVar[Inspector | None] = DdgiInspector()
    # Measured in `two-rooms`: 0.001 % through 1 cm, nothing through 5 and 20 cm.
    max_leak: ClassVar[float] = 0.0005

    def build(self, scene: Scene, params: DdgiParams, seed: int, *, workdir=None, progress=None) -> DdgiState:
        """Plan the boxes and allocate everything. Raises LuxelError for bad parameters and for more than fits."""
        return self._allocate(scene, params, seed, plan_probes(scene, params))

    def _allocate(self, scene: Scene, params: DdgiParams, seed: int, plan: ProbePlan) -> DdgiState:
        check_memory(params, plan.boxes)
        volumes, first = [], 0
        for box in plan.boxes:
            volumes.append(make_volume(box, first, MAX_OFFSET))
            first += box.probe_count
        settings = make_settings(params, first, plan.guided, scene.features.surrounded)
        settings = replace(settings, origin=scene.host.data.origin)
        state = DdgiState(
            volumes=tuple(volumes),
            probes=new_probes(settings),
            rows=dr.zeros(mi.Float, 4 * settings.total),
            irradiance=new_estimate(settings.total * settings.irradiance_resolution**2),
            depth=new_depth(settings),
            irradiance_atlas=new_atlas(settings.total, settings.irradiance_resolution, 4, settings.half_irradiance),
            depth_atlas=new_atlas(
                settings.total, settings.depth_resolution, 4 if settings.planes else 2, settings.half_depth
            ),
            extras=ExtraProbes(dr.zeros(mi.UInt32, 8 * first if settings.extra_count else 1), dr.opaque(mi.UInt32, 0)),
            wishes=new_requests(settings),
            read=dr.zeros(mi.UInt32, 8 * first if settings.sleep_after else 1),
            rays=Rays(
                first=dr.zeros(mi.UInt32, settings.total),
                count=dr.zeros(mi.UInt32, settings.total),
                sky=dr.opaque(mi.UInt32, 0),
            ),
            guide=new_guide(scene, float(plan.boxes[0].spacing.min()), params.follow_camera or plan.guided > 0),
            scale=dr.opaque(mi.Float, 0.0),
            drift=dr.opaque(mi.Float, 0.0),
            outside=dr.opaque(mi.Float, 0.0),
            backs=dr.opaque(mi.Float, -1.0),
            seed=dr.opaque(mi.UInt32, (seed * 0x85EBCA6B + 11) & 0xFFFFFFFF),
            dials=make_dials(params),
            settings=settings,
        )
        state = replace(state, probes=_at_their_nodes(state))
        state = replace(state, rows=_pack_rows(state.probes))
        dr.make_opaque(state)
        return state

    def plan(self, scene: Scene, params: DdgiParams) -> list[str]:
        """Return one sentence on the memory that `build` would take."""
        return [describe_memory(params, plan_probes(scene, params).boxes)]

    def retune(self, scene: Scene, state: DdgiState, params: DdgiParams) -> DdgiState | None:
        new = self.build(scene, params, 0)
        if new.settings.guided == state.settings.guided > 0:
            # The view has put the cascades where they are.
            new = replace(new, volumes=(*state.volumes[: new.settings.guided], *new.volumes[new.settings.guided :]))
        return carry_over(state, new, places=("volumes",))

    def update(self, scene: Scene, state: DdgiState, frame: Frame) -> DdgiState:
        """Cast this frame's rays, blend them in, look after the probes' places, and pack what look-ups read."""
        settings = state.settings

        # Share out the frame's rays.
        if settings.variance_budget:
            with stage("ddgi/budget") as current:
                first, count = plan_rays(state)
                state = replace(state, rays=replace(state.rays, first=first, count=count))
                current.keep(state.rays)

        # Cast them, and light what they hit.
        with stage("ddgi/trace") as current:
            results = trace_probes(scene, state, frame)
            looked = dr.opaque(mi.UInt32, sky_rays_of(scene, state))
            state = replace(state, rays=replace(state.rays, sky=looked))
            current.keep(results)

        # Blend what they brought into the texels.
        with stage("ddgi/blend") as current:
            blended = blend(scene, state, results, frame)
            current.keep(blended.irradiance, blended.depth, blended.noise)

        # Look after the probes: who is dead, who moves, who is read, who is needed.
        with stage("ddgi/relocate") as current:
            probe_hits = gather_probe_hits(state, results)
            backs, outside = update_hit_shares(scene, state, probe_hits)
            state = replace(state, backs=backs, outside=outside)
            state = replace(state, probes=update_probes(state, results, probe_hits, frame))
            state = replace(state, probes=update_sleep(state), read=_marks_of_rays(state, results))
            if settings.extra_count > 0:
                probes, extras = place_extra_probes(state, results)
                nobody = replace(state.wishes, wanted=dr.full(mi.Bool, False, settings.request_count))
                state = replace(state, probes=probes, extras=extras, wishes=nobody)
            state = replace(state, probes=replace(state.probes, noise=blended.noise), scale=blended.scale)
            state = replace(state, irradiance=blended.irradiance, depth=blended.depth, drift=blended.drift)
            state = replace(state, rows=_pack_rows(state.probes, everyone=not settings.detect_dead))
            current.keep(state.probes, state.rows, state.extras, state.read)
            current.keep(state.scale, state.drift, state.backs, state.outside)

        # Pack what look-ups read.
        with stage("ddgi/pack") as current:
            state = pack_atlases(state)
            current.keep(state.irradiance_atlas, state.depth_atlas)
        return state

    def query(self, scene: Scene, state: DdgiState, surface: Surface) -> Light:
        found = query_probes(state, surface.p, surface.n_geometric, surface.n_shading, surface.wo, surface.active)
        weight = dr.select(
            surface.active & (found.coverage > 1e-6), dr.clip(found.seen / MIN_CAGE_WEIGHT, 1e-3, 1.0), 0.0
        )
        return Light(found.irradiance, mi.Color3f(0.0), weight)

    def shade(
        self, scene: Scene, state: DdgiState, screen: NoScreen, frame: Frame, gbuffer: GBuffer
    ) -> tuple[Light, NoScreen]:
        with stage("ddgi/gather") as current:
            light = self.query(scene, state, gbuffer.surface)
            current.keep(light)
        return light, screen

    def observe(self, scene: Scene, state: DdgiState, frame: Frame, gbuffer: GBuffer, light: Light) -> DdgiState:
        """Note which probes the view reads and where it wants some, and let the boxes follow the camera."""
        settings, surface = state.settings, gbuffer.surface
        with stage("ddgi/observe") as current:
            view = sample_view(frame, surface, gbuffer.eye, light.weight)
            if settings.sleep_after > 0:
                eye_shift = mi.Vector3f(view.n) * (state.dials.normal_bias * state.volumes[0].side)
                state = replace(
                    state, read=mark_octants_read(state, mi.UInt32(state.read), view.p + eye_shift, view.seen)
                )
            if settings.extra_count > 0:
                state = replace(state, wishes=request_placements(state, view))
            if settings.follow_camera or settings.guided > 0:
                if settings.guided > 0:
                    volumes, guided, entering, probes = guide(scene, state, frame, gbuffer.eye, view)
                    state = replace(state, guide=guided)
                else:
                    volumes, entering, probes = scroll_volumes(state, gbuffer.eye)
                new = reset_probes(probes, entering)
                state = replace(state, volumes=volumes, probes=new, rows=_pack_rows(new))
                current.keep(state.rows, state.volumes, state.guide)
            current.keep(state.probes, state.wishes, state.read)
        return state

    def cache(self, state: DdgiState) -> dict[str, int | float]:
        status = np.array(state.probes.status)
        return {
            "probe_count": state.settings.probe_count,
            "dead_probes": int((status == DEAD).sum()),
            "asleep_probes": int((status == ASLEEP).sum()),
            "moved_probes": int((np.abs(np.array(state.probes.offset)).max(axis=0) > 0.0).sum()),
            "extra_probes": int(np.array(state.extras.count)[0]),
            "atlas_bytes": atlas_bytes(state),
            "atlas_bytes_a_probe": atlas_bytes(state) // state.settings.total,
            "outside_share": float(np.array(state.outside)[0]),
        }

    def warnings(self, state: DdgiState) -> list[str]:
        said = []
        outside = float(np.array(state.outside)[0])
        if outside > OUTSIDE_LIMIT and state.settings.feedback and not state.settings.paths_outside:
            said.append(
                f"{outside:.0%} of what the probes' rays hit is outside the probe box and gets light from its "
                "border; a larger 'probe_box_size' takes it in"
            )
        count = state.settings.extra_count
        if count and int(np.array(state.extras.count)[0]) >= count:
            said.append(
                f"all {count} probes held back are placed, so places that no probe sees get the mean of their cage; "
                "raise 'extra_probes'"
            )
        return said

    def load(self, scene: Scene, params: DdgiParams, path: Path) -> DdgiState:
        """Read what `save` wrote. Where luxel chooses cascades, those of the file stand, whatever the cameras want."""
        from luxel.methods.ddgi.export import counts_in
        from luxel.methods.persistence import load_state

        plan = plan_probes(scene, params)
        if chooses_cascades(params):
            plan = replan(plan, counts_in(path))
        return load_state(self.name, self._allocate(scene, params, 0, plan), path)

    def save(self, state: DdgiState, path: Path) -> None:
        """Write the state to `path` (.npz) with the header that docs/probe-files.md documents."""
        from luxel.methods.ddgi.export import make_header
        from luxel.methods.persistence import save_state

        save_state(self.name, state, path, header=make_header(state))


def pack(state: DdgiState) -> DdgiState:
    """Return the state with all that look-ups read written from what it knows."""
    return pack_atlases(replace(state, rows=_pack_rows(state.probes, everyone=not state.settings.detect_dead)))


def pack_atlases(state: DdgiState) -> DdgiState:
    """Return the state with the atlases written from its means."""
    settings, total = state.settings, state.settings.total
    unit = dr.fmax(state.scale, 1e-30)
    light = pack_irradiance(
        state.irradiance.mean, unit, settings.irradiance_resolution, total, settings.half_irradiance
    )
    resolution, half = settings.depth_resolution, settings.half_depth

    def reach(probe: mi.UInt32) -> mi.Float:
        return reach_of(state, probe)

    if isinstance(state.depth, PlaneSums):
        depth = pack_planes(state.depth, reach, resolution, total, half)
    else:
        depth = pack_depth(state.depth.mean, state.depth.variance, state.depth.weight, reach, resolution, total, half)
    return replace(state, irradiance_atlas=light, depth_atlas=depth)


def _pack_rows(probes: Probes, everyone: bool = False) -> mi.Float:
    """Return (total, 4) rows of position and whether a look-up may use the probe, `everyone`: dead ones too."""
    usable = (probes.status == AWAKE) | (probes.status == ASLEEP)
    if everyone:
        usable |= probes.status == DEAD
    count = dr.width(probes.status)
    rows = dr.empty(mi.Float, 4 * count)
    # Who has just come to its place knows nothing of it yet.
    flag = dr.select(usable & (probes.age > 0), mi.Float(1.0), 0.0)
    dr.scatter(rows, mi.Vector4f(probes.p.x, probes.p.y, probes.p.z, flag), dr.arange(mi.UInt32, count))
    return rows


def _marks_of_rays(state: DdgiState, results: ProbeRayResults) -> mi.UInt32:
    """Return fresh marks: where this frame's rays read the probes."""
    read = dr.zeros(mi.UInt32, dr.width(state.read))
    return mark_octants_read(state, read, results.p, results.hit) if state.settings.sleep_after else read


def _at_their_nodes(state: DdgiState) -> Probes:
    """Return the probes placed at their nodes."""
    index = dr.arange(mi.UInt32, state.settings.total)
    p = mi.Point3f(state.probes.p)
    for volume in state.volumes:
        mine = volume.owns(index)
        node = node_of_probe(volume, index - volume.first, volume.low)
        p = dr.select(mine, world_position(volume, mi.Point3f(node)), p)
    return replace(state.probes, p=p)
