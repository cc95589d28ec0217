"""GIBS, step by step: follow, sort, trace, integrate, spawn; gather at the pixels; spawn on screen.

Source: Ekberg 2022, "Diffuse Global Illumination using Surfels" (Chalmers), chapter 4, after Brinck et al. 2021,
"Global Illumination Based on Surfels".
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.errors import LuxelError
from luxel.kernels.film import Film
from luxel.kernels.gbuffer import GBuffer
from luxel.kernels.grid import Grid, build_grid, new_masks
from luxel.kernels.mean_estimator import EstimatorDials
from luxel.kernels.records import Light, Surface
from luxel.kernels.square_maps import new_square_maps
from luxel.methods.base import Frame, Method
from luxel.methods.gibs.budget import plan_rays
from luxel.methods.gibs.depth import read_maps, update_depth
from luxel.methods.gibs.depth_maps import DepthFormat, new_depth_maps
from luxel.methods.gibs.directions import looks_for_sky
from luxel.methods.gibs.eyes import GibsScreen, SeenLight, measure_view, new_eyes, new_screen, note_look, settle_eyes
from luxel.methods.gibs.fill import fill_uncovered
from luxel.methods.gibs.gather import gather_irradiance
from luxel.methods.gibs.guiding import map_count, refresh
from luxel.methods.gibs.inspector import GibsInspector
from luxel.methods.gibs.lattice import fit_lattice
from luxel.methods.gibs.normal_light import has_own_normals, pack_normal_light
from luxel.methods.gibs.params import EKBERG, MOST_RAYS, VIEW_SHARE, GibsParams
from luxel.methods.gibs.recycle import choose_recycled, rays_lack, recycle
from luxel.methods.gibs.sizes import even_radius, level_of_size, radius_of_size
from luxel.methods.gibs.spawn import candidates_at_hits, candidates_on_screen, spawn
from luxel.methods.gibs.surfels import (
    GibsDials,
    GibsSettings,
    GibsState,
    count_items,
    count_surfels,
    follow_objects,
    forget_by_travel,
    new_free_list,
    new_surfels,
    pack_geometry,
    pack_light,
    turn_with_objects,
)
from luxel.methods.gibs.trace import integrate, trace_surfels
from luxel.methods.gibs.view import largest_served, observe_surfels, pixel_sizes, resize
from luxel.methods.gibs.workload import GibsWorkload
from luxel.methods.inspect import Inspector
from luxel.methods.retune import carry_over
from luxel.methods.workload import Workload
from luxel.scene.device import Scene
from luxel.stages import stage

SPARE, FULL = 1.1, 0.95
"""Surfels beyond which unseen ones are given back, over the target and over the pool."""


class Gibs(Method):
    """Surfel GI: irradiance cached on discs that are placed where the camera and the rays need them."""

    name: ClassVar[str] = "gibs"
    Params: ClassVar[type] = GibsParams
    presets: ClassVar[dict[str, dict[str, Any]]] = {"ekberg": EKBERG}
    workload: ClassVar[Workload | None] = GibsWorkload()
    inspector: ClassVar[Inspector | None] = GibsInspector()
    # Through walls of 1 cm, measured 0.002 % (without depth maps 1.2 %).
    max_leak: ClassVar[float] = 0.0001

    def build(self, scene: Scene, params: GibsParams, seed: int, *, workdir=None, progress=None) -> GibsState:
        """Allocate the pool and the grid. Raises LuxelError for bad parameters."""
        check_params(params)
        radius = params.largest_radius(scene.host.area)
        capacity = params.capacity_for()
        lattice = fit_lattice(scene, params, radius)
        item_capacity = capacity * params.items_per_surfel
        depth = DepthFormat(params.depth_texels) if params.depth_texels > 0 else None
        normal_light = params.normal_light and has_own_normals(scene)
        state = GibsState(
            surfels=new_surfels(capacity, normal_light, params.recycle),
            free=new_free_list(capacity),
            lattice=lattice,
            grid=Grid(
                dr.zeros(mi.UInt32, lattice.slot_count + 1),
                dr.zeros(mi.UInt32, item_capacity),
                dr.opaque(mi.UInt32, 0),
                new_masks(lattice),
            ),
            geometry=dr.zeros(mi.Float, 4 * capacity),
            light=dr.zeros(mi.Float, 4 * capacity),
            normal_light=dr.zeros(mi.UInt32, 4 * capacity) if normal_light else None,
            luminance=dr.opaque(mi.Float, 0.0),
            eyes=new_eyes(),
            drift=dr.opaque(mi.Float, 0.0),
            cast=dr.zeros(mi.UInt32, capacity),
            seed=dr.opaque(mi.UInt32, (seed * 0x85EBCA6B + 7) & 0xFFFFFFFF),
            dials=make_dials(params, radius),
            settings=GibsSettings(
                rays_per_surfel=params.rays_per_surfel,
                ray_lanes=params.most_rays(),
                share_rays=params.share_rays,
                recycle=params.recycle,
                spawn_by_size=params.spawn_by_size,
                capacity=capacity,
                item_capacity=item_capacity,
                tile_size=params.tile_size,
                normal_power=params.normal_power,
                spawn_once_a_cell=params.spawn_once_a_cell,
                spawn_at_hits=params.hit_spawn_threshold > 0.0,
                low_discrepancy=params.low_discrepancy,
                fill_bare=params.fill_bare,
                looks_for_sky=params.sky_share > 0.0,
                cell_surfels=params.cell_surfels,
                normal_light=normal_light,
                depth=depth,
                by_view=params.by_view,
            ),
            depth=new_depth_maps(capacity, depth) if depth is not None else None,
            guide=new_square_maps(map_count(capacity)) if params.guide_share > 0.0 else None,
        )
        dr.make_opaque(state)
        return state

    def retune(self, scene: Scene, state: GibsState, params: GibsParams) -> GibsState | None:
        new = self.build(scene, params, 0)
        # Where cells begin may differ, as objects have moved since: the grid is sorted anew each frame anyway.
        new.lattice.shift = state.lattice.shift
        return carry_over(state, new, places=("lattice",))

    def fits(self, scene: Scene, state: GibsState, params: GibsParams) -> bool:
        # With a scene's first normal map there are normals that the surfels keep no light for. Where its last one goes,
        # what they keep does no harm.
        return state.settings.normal_light or not (params.normal_light and scene.materials.has_normal)

    def update(self, scene: Scene, state: GibsState, frame: Frame) -> GibsState:
        """Follow the objects, sort, cast this frame's rays, blend them in, and spawn where they met bare ground."""
        settings, dials = state.settings, state.dials

        # Take the sizes that views wanted, and give back what is in the way.
        if settings.by_view or settings.recycle:
            with stage("gibs/resize") as current:
                if settings.by_view:
                    state = replace(state, eyes=settle_eyes(state))
                recycled = choose_recycled(scene, state, frame.index) if settings.recycle else None
                surfels, free = resize(state, frame.index, recycled) if settings.by_view else recycle(state, recycled)
                state = replace(state, surfels=surfels, free=free)
                current.keep(state.eyes, surfels, free)

        # Follow the objects that the surfels lie on.
        with stage("gibs/follow") as current:
            p, n = follow_objects(scene, state.surfels)
            geometry = pack_geometry(p, n, state.surfels.size, settings.capacity)
            radius = radius_of_size(state, state.surfels.size)
            surfels = replace(state.surfels, p=p, n=n)
            if scene.features.moving or scene.features.deforming:
                surfels = replace(surfels, normal_light=turn_with_objects(state.surfels, n))
                surfels = replace(surfels, estimate=forget_by_travel(state, p, n, even_radius(state)))
            state = replace(state, surfels=surfels, geometry=geometry)
            current.keep(state.surfels, geometry)

        # Sort them into the grid: count, prefix sum, fill.
        with stage("gibs/sort") as current:
            alive = state.surfels.object_id != 0
            grid = build_grid(
                state.lattice, p, n, radius, radius * dials.flatness, alive, settings.item_capacity,
                state.surfels.seed, settings.cell_surfels, level_of_size(state, state.surfels.size),
            )  # fmt: skip
            state = replace(state, grid=grid)
            current.keep(grid)

        # See how far the surroundings of each surfel are.
        if settings.depth is not None:
            with stage("gibs/depth") as current:
                state = replace(state, depth=update_depth(scene, state, frame))
                current.keep(state.depth)

        # Cast rays, and light what they hit by lamps and by the surfels there.
        with stage("gibs/trace") as current:
            plan = plan_rays(state, frame.index)
            results = trace_surfels(scene, state, plan)
            state = replace(state, guide=results.guide)
            current.keep(results)

        # Blend what they brought into the surfels.
        with stage("gibs/integrate") as current:
            surfels, luminance, drift = integrate(
                state, plan, results, looks_for_sky(scene, state) or settings.normal_light
            )
            known, near = surfels.ray_index, None
            if settings.depth is not None:
                # A surfel without a map is as one without a sample: nobody knows how far its light may reach.
                mapped, near = read_maps(state)
                known = dr.select(mapped, known, 0)
            fade_in = dr.fmax(dials.fade_in, 1.0) * settings.rays_per_surfel
            light = pack_light(surfels.estimate.mean, known, fade_in, settings.capacity, near)
            beside = None
            if surfels.normal_light is not None:
                beside = pack_normal_light(surfels.normal_light, surfels.estimate.mean, settings.capacity)
            state = replace(state, surfels=surfels, luminance=luminance, drift=drift, light=light, normal_light=beside)
            state = replace(state, cast=plan.count)
            current.keep(surfels, luminance, drift, light, beside)

        # Fold what the rays have found into the maps that say where the next ones go.
        if state.guide is not None:
            with stage("gibs/guide") as current:
                state = replace(state, guide=refresh(state, state.guide))
                current.keep(state.guide)

        # Place surfels where rays hit uncovered ground.
        if settings.spawn_at_hits:
            with stage("gibs/spawn_hits") as current:
                surfels, free = spawn(scene, state, candidates_at_hits(state, plan, frame, results), frame.index)
                state = replace(state, surfels=surfels, free=free)
                current.keep(surfels, free)
        return state

    def query(self, scene: Scene, state: GibsState, surface: Surface) -> Light:
        found = gather_irradiance(state, surface.p, surface.n_geometric, surface.active, surface.n_shading)
        return Light(found.irradiance, mi.Color3f(0.0), found.coverage)

    def screen(self, scene: Scene, state: GibsState, film: Film) -> GibsScreen:
        return new_screen()

    def shade(
        self, scene: Scene, state: GibsState, screen: GibsScreen, frame: Frame, gbuffer: GBuffer
    ) -> tuple[Light, GibsScreen]:
        surface, wish, largest = gbuffer.surface, None, None
        # Ask for a radius in pixels.
        if state.settings.by_view:
            with stage("gibs/measure") as current:
                wish, screen = measure_view(state, screen, frame.index, gbuffer)
                largest = largest_served(pixel_sizes(state, gbuffer, wish.pixels))
                current.keep(wish, screen)

        with stage("gibs/gather") as current:
            found = gather_irradiance(state, surface.p, surface.n_geometric, surface.active, surface.n_shading, largest)
            current.keep(found)

        # What no surfel answers takes the nearest answer around it.
        light = found.irradiance
        if state.settings.fill_bare:
            with stage("gibs/fill") as current:
                light = fill_uncovered(scene, state, frame, gbuffer, found)
                current.keep(light)
        return SeenLight(light, mi.Color3f(0.0), found.coverage, fine=found.fine, wish=wish), screen

    def observe(self, scene: Scene, state: GibsState, frame: Frame, gbuffer: GBuffer, light: Light) -> GibsState:
        wish = light.wish if isinstance(light, SeenLight) else None
        if wish is not None or state.settings.share_rays or state.settings.recycle:
            with stage("gibs/observe") as current:
                pixels = wish.pixels if wish is not None else mi.Float(1.0)
                sight = observe_surfels(state, frame.index, gbuffer, pixels)
                eyes = note_look(state.eyes, wish) if wish is not None else state.eyes
                state = replace(state, eyes=eyes, surfels=replace(state.surfels, sight=sight))
                current.keep(sight, eyes)
        with stage("gibs/spawn") as current:
            surfels, free = spawn(scene, state, candidates_on_screen(state, frame, gbuffer, light), frame.index)
            current.keep(surfels, free)
        return replace(state, surfels=surfels, free=free)

    def cache(self, state: GibsState) -> dict[str, int | float]:
        return {
            "surfel_count": count_surfels(state),
            "surfel_capacity": state.settings.capacity,
            "surfel_radius": float(np.array(state.dials.radius)[0]),
            "radius_pixels": float(np.array(state.eyes.pixels)[0]),
            "grid_items": count_items(state),
            "grid_slots": state.lattice.slot_count,
        }

    def warnings(self, state: GibsState) -> list[str]:
        settings, found = state.settings, []
        kept = int(np.array(rays_lack(state))[0]) if settings.by_view else 0
        if count_surfels(state) + kept >= settings.capacity:
            found.append(
                f"The pool is full: all {settings.capacity:,} surfels are in use, and newly seen surfaces get none; "
                f"raise 'capacity' (--set capacity={2 * settings.capacity}), or lower 'surfel_target' for larger ones."
            )
        if int(np.array(state.grid.left_out)[0]):
            found.append(
                f"The grid's {settings.item_capacity:,} list entries do not suffice, so some places lack surfels; "
                "raise 'items_per_surfel' or 'cell_size'."
            )
        return found


def make_dials(params: GibsParams, radius: float) -> GibsDials:
    """Return the parameters that may change while it runs."""

    def opaque(value: float) -> mi.Float:
        return dr.opaque(mi.Float, float(value))

    return GibsDials(
        radius=opaque(radius),
        flatness=opaque(1.0 / params.plane_scale),
        plane_stretch=opaque(params.plane_scale**2 - 1.0),
        spawn_threshold=opaque(params.spawn_threshold),
        spawn_chance=opaque(params.spawn_chance),
        hit_spawn_threshold=opaque(params.hit_spawn_threshold),
        fade_in=opaque(params.fade_in),
        birth_samples=opaque(params.birth_samples),
        memory_radii=opaque(params.memory_radii),
        sky_share=opaque(params.sky_share),
        even_share=opaque(params.even_share),
        guide_share=opaque(params.guide_share),
        radius_pixels=opaque(params.radius_pixels),
        surfel_limit=opaque(min(SPARE * params.surfel_target, FULL * params.capacity_for())),
        view_surfels=opaque(VIEW_SHARE * params.surfel_target),
        ray_surfels=opaque((1.0 - VIEW_SHARE) * min(params.surfel_target, params.capacity_for())),
        estimator=EstimatorDials(
            opaque(params.short_blend), opaque(params.warm_samples), opaque(max(params.longest_window, 1))
        ),
    )


def check_params(params: GibsParams) -> None:
    """Raise LuxelError for a value that GIBS cannot run with."""
    rules = (
        ("rays_per_surfel", 1 <= params.rays_per_surfel <= 256, "from 1 to 256"),
        ("ray_budget", 0 <= params.ray_budget <= MOST_RAYS, f"from 0 to {MOST_RAYS}"),
        ("surfel_target", 1 <= params.surfel_target <= 4_000_000, "from 1 to 4000000"),
        ("capacity", 0 <= params.capacity <= 4_000_000, "from 0 to 4000000"),
        ("radius", 0.0 <= params.radius < float("inf"), "0 or more"),
        ("radius_pixels", 0.0 <= params.radius_pixels <= 256.0, "from 0 to 256"),
        ("cell_size", 0.25 <= params.cell_size <= 16.0, "from 0.25 to 16"),
        ("items_per_surfel", 1 <= params.items_per_surfel <= 512, "from 1 to 512"),
        ("cell_surfels", 0 <= params.cell_surfels <= 4096, "from 0 to 4096"),
        ("tile_size", params.tile_size in (4, 8, 16), "4, 8 or 16"),
        ("normal_power", params.normal_power in (1, 2, 4, 8), "1, 2, 4 or 8"),
        ("plane_scale", 1.0 <= params.plane_scale <= 100.0, "from 1 to 100"),
        ("spawn_threshold", 0.0 <= params.spawn_threshold <= 15.0, "from 0 to 15"),
        ("hit_spawn_threshold", 0.0 <= params.hit_spawn_threshold <= 15.0, "from 0 to 15"),
        ("fade_in", 0 <= params.fade_in <= 100_000, "from 0 to 100000"),
        ("birth_samples", 0.0 <= params.birth_samples <= 1000.0, "from 0 to 1000"),
        ("memory_radii", 0.0 <= params.memory_radii < float("inf"), "0 or more"),
        ("longest_window", 1 <= params.longest_window <= 1_000_000, "from 1 to 1000000"),
        ("short_blend", 0.0 < params.short_blend <= 1.0, "above 0, at most 1"),
        ("warm_samples", 0 <= params.warm_samples <= 100_000, "from 0 to 100000"),
        ("depth_texels", params.depth_texels in (0, 4, 8), "0, 4 or 8"),
        ("sky_share", 0.0 <= params.sky_share <= 0.9, "from 0 to 0.9"),
        ("guide_share", 0.0 <= params.guide_share <= 0.9, "from 0 to 0.9"),
        ("even_share", 0.0 <= params.even_share <= 0.9, "from 0 to 0.9"),
        ("spawn_chance", 0.0 <= params.spawn_chance <= 1.0, "from 0 to 1"),
    )
    for name, fine, allowed in rules:
        if not fine:
            raise LuxelError(f"gibs: parameter '{name}' is {getattr(params, name)}, but must be {allowed}")
    least = params.least_rays()
    if params.share_rays and 0 < params.ray_budget < least:
        raise LuxelError(
            f"gibs: parameter 'ray_budget' is {params.ray_budget}, but {params.capacity_for()} surfels need {least} or "
            "more to be served in turn; raise it, or lower 'capacity' or 'surfel_target'"
        )
