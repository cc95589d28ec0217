"""Cascades by themselves: where the fitted box is too coarse for the view, finer boxes go where it looks.

How many there are is settled at the build, from the scene's cameras. Where they stand and how wide their cells are
follows the first view of each frame: the finest cell covers a fixed angle at the distance of what is seen, and each
further box is coarser by the same factor until the fitted box, which holds everything, takes over.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.kernels.camera import camera_axes
from luxel.kernels.mean_estimator import Estimate
from luxel.kernels.reduce import sum_columns
from luxel.kernels.trace import trace_closest
from luxel.methods.base import Frame
from luxel.methods.ddgi.activity import ViewSamples, scene_nodes
from luxel.methods.ddgi.boxes import MARGIN, ProbeBox, plan_boxes
from luxel.methods.ddgi.params import DdgiParams, check_params
from luxel.methods.ddgi.query import MIN_CAGE_WEIGHT, query_probes
from luxel.methods.ddgi.state import DdgiState, Guide, Probes
from luxel.methods.ddgi.volume import Volume, grid_coordinates, node_of_probe, world_position
from luxel.scene.arrays import vectors_from_numpy
from luxel.scene.device import Scene
from luxel.scene.edit import default_camera, scene_bounds
from luxel.scene.model import Camera

ANGLE = 0.08
"""Cell side that a view needs, over the geometric mean of the distances of what it shows."""
TOO_COARSE = 2.5
"""Times that a cell of the fitted box may be wider than that."""
LEVELS = 2
SHARE = 1.0
"""Probes of a cascade, over those of the fitted box."""
MIN_STEP, MAX_STEP = 1.5, 4.0
"""Factor between the cells of one box and those of the next."""
HEIGHT = 0.6
"""Probes of a cascade along Y, over those along X and Z: pictures, and rooms, are wider than high."""
AHEAD = 0.75
"""How far a cascade's middle lies ahead of the eye, in half its size: what is behind the camera needs less detail."""
SLACK = 1.0
"""Cells that the middle may be off before a cascade moves: a view at rest must not move it to and fro."""
CHANGE = 1.0
"""Octaves that the cells must be off the view's need before they change: then all cascades start anew."""
MEMORY = 0.1
"""Share of a frame in the running distance."""
INHERITED = 4.0
"""Samples that the answer of the boxes around counts for, where a probe starts anew."""
MIN_PROBES = 3
"""Probes along an axis of a cascade."""
LOOK_RAYS, MAX_LOOK_CAMERAS = (32, 18), 4
"""Rays of a look through one of the scene's cameras, and how many cameras are looked through."""
NEVER = 0xFFFFFFFF


@dataclass(frozen=True)
class ProbePlan:
    """Where the probes stand."""

    boxes: list[ProbeBox]
    """Finest first."""
    guided: int
    """How many of them, from the first on, go where the view looks."""


def plan_probes(scene: Scene, params: DdgiParams) -> ProbePlan:
    """Return the boxes of `scene`. Raises LuxelError for bad parameters, and as `plan_boxes`."""
    check_params(params)
    boxes = plan_boxes(params, scene.host.lower, scene.host.upper, scene.host.origin)
    if not chooses_cascades(params):
        return ProbePlan(boxes, 0)
    (fitted,) = boxes
    need = ANGLE * view_distance(scene)
    if not fitted.spacing.min() > TOO_COARSE * need:
        return ProbePlan(boxes, 0)
    counts = _cascade_counts(SHARE * params.probe_target)
    # A place for the first frame; the first view puts them where it looks.
    sides = _sides(fitted.spacing.min(), need)
    middle = tuple(float(v) for v in camera_axes(_cameras(scene)[0])[0])
    cascades = [ProbeBox(middle, tuple(side * (n - 1) for n in counts), counts) for side in sides]  # type: ignore[arg-type]
    return ProbePlan([*cascades, fitted], LEVELS)


def replan(plan: ProbePlan, counts: list[tuple[int, int, int]]) -> ProbePlan:
    """Return `plan` with the cascades of a saved state that has boxes of `counts`; itself for another scene's."""
    fitted = plan.boxes[-1]
    if counts[-1] != fitted.counts or len(counts) not in (1, 1 + LEVELS):
        return plan
    # Where they stand is in the file.
    return ProbePlan([*(replace(fitted, counts=numbers) for numbers in counts[:-1]), fitted], len(counts) - 1)


def chooses_cascades(params: DdgiParams) -> bool:
    """Return whether cascades are left to luxel: `cascades` is 0, and nothing else says where probes stand."""
    numbers = (params.num_probes_x, params.num_probes_y, params.num_probes_z)
    said = params.boxes.strip() or params.follow_camera or any(numbers)
    return params.cascades == 0 and not said and not any(params.probe_box_size)


def view_distance(scene: Scene) -> float:
    """Return the geometric mean distance, metres, of what the nearest-looking of the scene's cameras sees.

    Infinite where none sees anything.
    """
    least = math.inf
    for camera in _cameras(scene)[:MAX_LOOK_CAMERAS]:
        eye, right, up, forward = camera_axes(camera)
        half = math.tan(math.radians(min(camera.fov, 120.0)) / 2.0)
        across, upwards = LOOK_RAYS
        x, y = np.meshgrid((np.arange(across) + 0.5) / across * 2 - 1, (np.arange(upwards) + 0.5) / upwards * 2 - 1)
        wide = camera.orthographic_width / 2.0
        slide = (x.ravel()[:, None] * right + y.ravel()[:, None] * up * upwards / across) * (
            wide if wide > 0.0 else half
        )
        direction = forward + (slide if wide == 0.0 else 0.0 * slide)
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        origin = np.broadcast_to(eye, slide.shape) + (slide if wide > 0.0 else 0.0)
        hit = trace_closest(scene, _points(mi.Point3f, origin), _points(mi.Vector3f, direction), mi.Bool(True))
        seen = np.array(hit.valid)
        if seen.any():
            least = min(least, float(np.exp(np.log(np.maximum(np.array(hit.t)[seen], 1e-6)).mean())))
    return least


def _cameras(scene: Scene) -> list[Camera]:
    return list(scene.host.local.cameras) or [default_camera(scene.host.local)]


def _points(kind: type, rows: np.ndarray):
    return vectors_from_numpy(kind, rows)


def _cascade_counts(target: float) -> tuple[int, int, int]:
    """Return probes an axis of one cascade of about `target`."""
    wide = max(round((target / HEIGHT) ** (1.0 / 3.0)), MIN_PROBES)
    return wide, max(round(HEIGHT * wide), MIN_PROBES), wide


def _sides(coarsest: float, need: float) -> list[float]:
    """Return the cell sides of the cascades, finest first, where the fitted box has `coarsest`."""
    side = min(max(need, coarsest / MAX_STEP**LEVELS), coarsest / MIN_STEP)
    step = min(max((coarsest / side) ** (1.0 / LEVELS), MIN_STEP), MAX_STEP)
    return [side * step**level for level in range(LEVELS)]


def new_guide(scene: Scene, side: float, moves: bool) -> Guide:
    """Return the guide of a state that no view has guided yet; the scene is looked over only where boxes move."""
    bounds = scene_bounds(scene.host.local, (0.0,)) if moves else (scene.host.lower, scene.host.upper)
    lower, upper = (mi.Point3f(*(dr.opaque(mi.Float, float(v)) for v in corner)) for corner in bounds)
    return Guide(dr.opaque(mi.Float, side), dr.opaque(mi.Float, 0.0), dr.opaque(mi.UInt32, NEVER), lower, upper)


def guide(
    scene: Scene, state: DdgiState, frame: Frame, eye: mi.Point3f, view: ViewSamples
) -> tuple[tuple[Volume, ...], Guide, mi.Bool, Probes]:
    """Bring the cascades to where the view looks; return boxes, guide, entering probes, probes.

    Of several views of one frame the first one guides: two visitors of a viewer would throw the boxes to and fro.
    """
    settings, before = state.settings, state.guide
    count, distance, heading = _look(eye, view)
    leads = (frame.index != before.frame) & (count > 0.0)
    unled = before.frame == NEVER
    running = dr.select(leads, dr.select(unled, distance, dr.lerp(before.distance, distance, MEMORY)), before.distance)
    coarsest = state.volumes[-1].side
    wanted = _side_of_view(coarsest, running)
    changes = leads & (unled | (dr.abs(dr.log2(wanted / before.side)) > CHANGE))
    side = dr.select(changes, wanted, before.side)
    step = dr.clip(dr.power(coarsest / side, 1.0 / LEVELS), MIN_STEP, MAX_STEP)
    index = dr.arange(mi.UInt32, settings.total)
    entering, p, volumes = mi.Bool(False), mi.Point3f(state.probes.p), []
    for level, volume in enumerate(state.volumes[: settings.guided]):
        spaced = _space(volume, side * step**level, scene.lower)
        half = 0.5 * mi.Vector3f(volume.nx - 1.0, volume.ny - 1.0, volume.nz - 1.0)
        wish = grid_coordinates(spaced, eye) + (AHEAD * heading - 1.0) * half
        lower, upper = scene_nodes(state, spaced)
        span = 2.0 * mi.Point3f(half)
        wish = dr.clip(wish, dr.minimum(lower, upper - span), dr.maximum(lower, upper - span))
        stays = ~changes & (dr.abs(wish - mi.Point3f(volume.low)) < SLACK)
        low = dr.select(stays | ~leads, volume.low, mi.Vector3i(dr.round(wish)))
        mine = volume.owns(index)
        was = node_of_probe(volume, index - volume.first, volume.low)
        now = node_of_probe(volume, index - volume.first, low)
        new = mine & (changes | dr.any(was != now))
        p = dr.select(new, world_position(spaced, mi.Point3f(now)), p)
        entering |= new
        volumes.append(replace(spaced, low=low))
    after = replace(before, side=side, distance=running, frame=dr.select(leads, frame.index, before.frame))
    return (*volumes, *state.volumes[settings.guided :]), after, entering, replace(state.probes, p=p)


def inherit(state: DdgiState, before: Estimate, probe: mi.UInt32, direction: mi.Vector3f) -> Estimate:
    """Return the texels `before` of each `probe` facing `direction`, of which newborn ones start from what others say.

    That counts as few samples: a first frame of its own is noisier still, and later ones soon outweigh it.
    """
    newborn = (before.count < 0.5) & (
        probe < sum(volume.probe_count for volume in state.volumes[: state.settings.guided])
    )
    p = dr.gather(mi.Point3f, state.probes.p, probe, newborn)
    n = mi.Normal3f(direction)
    answer = query_probes(state, p, n, n, direction, newborn)
    known = newborn & (answer.seen > MIN_CAGE_WEIGHT)
    light = answer.irradiance
    return replace(
        before,
        mean=dr.select(known, light, before.mean),
        short=dr.select(known, light, before.short),
        # As unsure as it is bright: else the first own sample would be an alarm.
        variance=dr.select(known, dr.square(light), before.variance),
        reduction=dr.select(known, 0.0, before.reduction),
        inconsistency=dr.select(known, 1.0, before.inconsistency),
        count=dr.select(known, INHERITED, before.count),
    )


def _look(eye: mi.Point3f, view: ViewSamples) -> tuple[mi.Float, mi.Float, mi.Vector3f]:
    """Return how many samples show something, the mean logarithm of their distances, and their mean direction."""
    away = mi.Vector3f(view.p - eye)
    distance = dr.fmax(dr.norm(away), 1e-6)
    one = dr.select(view.seen, mi.Float(1.0), 0.0)
    logarithm = dr.select(view.seen, dr.log2(distance), 0.0)
    x, y, z = (dr.select(view.seen, axis / distance, 0.0) for axis in away)
    count, far, x, y, z = sum_columns([one, logarithm, x, y, z])
    share = 1.0 / dr.fmax(count, 1.0)
    return count, far * share, mi.Vector3f(x, y, z) * share


def _side_of_view(coarsest: mi.Float, distance: mi.Float) -> mi.Float:
    """Return the finest cell side for a view whose mean distance is 2^`distance` metres.

    In quarters of octaves below the fitted box's: the last bits of a sum must not move probes.
    """
    octaves = dr.log2(coarsest) - math.log2(ANGLE) - distance
    octaves = dr.clip(dr.round(4.0 * octaves) * 0.25, math.log2(MIN_STEP), LEVELS * math.log2(MAX_STEP))
    return coarsest * dr.exp2(-octaves)


def _space(volume: Volume, side: mi.Float, lower: mi.Point3f) -> Volume:
    """Return an upright box with cells of `side` metres, whose nodes keep off the scene's `lower` walls as those of a
    fitted box do."""
    inverse, zero = 1.0 / side, mi.Float(0.0)
    origin = mi.Point3f(lower - MARGIN * side)
    shift = mi.Vector3f(MARGIN - lower * inverse)
    return replace(
        volume,
        to_grid_x=mi.Vector4f(inverse, zero, zero, shift.x),
        to_grid_y=mi.Vector4f(zero, inverse, zero, shift.y),
        to_grid_z=mi.Vector4f(zero, zero, inverse, shift.z),
        origin=origin,
        step_x=mi.Vector3f(side, zero, zero),
        step_y=mi.Vector3f(zero, side, zero),
        step_z=mi.Vector3f(zero, zero, side),
        side=mi.Float(side),
        reach=side * (volume.reach / volume.side),
    )
