"""All light sources as tables: delta lights, a tree over what is sampled, and the sky."""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.scene.arrays import copy_array, from_numpy, to_floats
from luxel.scene.colours import luminance
from luxel.scene.emitters import Emitters, bound_emitters
from luxel.scene.light_tree import LightBounds, empty_bounds, fit_nodes, join_bounds, order_leaves, tree_depth
from luxel.scene.model import Light, SceneData
from luxel.scene.sky_table import SkyTable, build_sky_table

DELTA_EACH_LIMIT = 8
"""Up to so many delta lights get a shadow ray of their own each frame. Where there are more, only directional ones
do: a sun outshines the lamps of a room that it does not reach, and would take their rays. Others are sampled with the
triangles."""
KINDS = {"directional": 0.0, "point": 1.0, "spot": 2.0}
ENTRY_IS_DELTA = 0x80000000
NO_ENTRY = 0xFFFFFFFF
REORDER_BELOW = 4096
"""Leaves of a tree that is small enough to be made anew at each edit."""
MOVED_SHARE = 0.01
"""Share of the leaves of a larger one that may move at an edit before it is made anew."""


@dataclass
class LightTables:
    """What the light sampler and the sky read."""

    delta: mi.Float
    """(L, 16): position, kind | unit direction, range | colour, 1 where the sky shows its disc | cos inner, cos outer,
    and where the fall-off is linear in the angle: inner, outer (radians; else 0, 0). Of a directional light the last
    four are 1 - cos of its disc's angular radius, 0, 0, 0."""
    soft_suns: bool
    """Whether a directional light is wider than one direction."""
    discs: mi.Float
    """(D, 8), of each sun that the sky shows: unit vector to it, 1 - cos of its angular radius | radiance,
    its row of `delta`."""
    disc_count: int
    delta_each: int
    """How many delta lights are evaluated each; the others are among `entries`."""
    each_rows: mi.UInt32
    """Their rows of `delta`, at least one number."""
    delta_count: int
    entries: mi.UInt32
    """Sampled sources, one a leaf of the tree: a triangle, a delta light with the high bit set, or `NO_ENTRY`."""
    leaves: mi.UInt32
    """(`entry_count`, 2): the entries in ascending order, and the leaf of each: where a source is in the tree."""
    nodes: mi.Float
    """(2 `entry_count`, 16): the tree, as `fit_nodes` lays it out."""
    entry_count: int
    """Leaves of the tree, a power of two; 0 where nothing is sampled."""
    has_triangles: bool
    """Some of the sampled sources are triangles, or were before an edit."""
    has_cones: bool
    """Some of them shine into a part of all directions only, or did."""
    has_far: bool
    """Some of them are infinitely far away, or were."""
    sky_color: mi.Color3f
    sky_image: mi.Float
    """(H, W, 4) latitude-longitude radiance, or one row of ones."""
    sky_width: int
    sky_height: int
    sky_rotation: mi.Float
    """Radians about +Y."""
    sky_table: SkyTable
    """How the sky's image is sampled."""
    has_sky: bool
    scale: mi.Float
    """Multiplies every source, sky and emission included: a run-time value."""


class LightSources:
    """What the tables were made of, on the host, so that they can follow what moves. Opaque to Dr.Jit."""

    def __init__(self, emitters: Emitters, delta: np.ndarray, sampled: np.ndarray) -> None:
        self.emitters = emitters
        self.delta = delta
        """(L, 16) rows of the delta lights at the present time."""
        self.sampled = sampled
        """Which delta lights are in the tree, behind the triangles."""
        self.leaves = np.zeros(0, np.int64)
        """Which source each leaf holds: a triangle of `emitters`, then one of `sampled`; -1 for none."""

    def holds(self, kind: str) -> bool:
        """Return whether a delta light of this kind is in the tree."""
        return bool((self.delta[self.sampled, 3] == KINDS[kind]).any())

    def bounds(self, matrices: np.ndarray) -> LightBounds:
        """Return a row of bounds a source, with objects placed by `matrices` (ids, 4, 4)."""
        return join_bounds(bound_emitters(self.emitters, matrices), _bound_deltas(self.delta[self.sampled]))


def build_light_tables(
    data: SceneData,
    emitters: Emitters,
    matrices: np.ndarray,
    time: float = 0.0,
    before: tuple[LightTables, LightSources] | None = None,
) -> tuple[LightTables, LightSources]:
    """Return the tables at `time` seconds, and what they were made of; `matrices` (ids, 4, 4) place the objects.

    Tables that replace those of `before` are at least as wide, so that a light that goes out records nothing.
    """
    delta = _delta_rows(data.lights, time)
    each = _choose_each(data.lights)
    # Lamps that are out are not sampled.
    lit = np.flatnonzero(luminance(delta[: len(data.lights), 8:11]) > 0.0)
    sources = LightSources(emitters, delta, np.setdiff1d(lit, each))
    count = len(emitters.triangles) + len(sources.sampled)
    width = max(1 << tree_depth(count) if count else 0, before[0].entry_count if before else 0)
    nodes, entries = np.zeros((1, 16)), np.full(1, NO_ENTRY)
    if width:
        nodes, entries = _plant(sources, matrices, width, before[1] if before else None)
    image = data.sky.image
    sky_height, sky_width = image.shape[:2] if image is not None else (1, 1)
    pixels = np.ones((sky_height, sky_width, 4), np.float32)
    if image is not None:
        pixels[..., :3] = np.nan_to_num(image[..., :3], posinf=65504.0)
    tables = LightTables(
        delta=to_floats(delta),
        soft_suns=any(light.kind == "directional" and light.angular_diameter > 0.0 for light in data.lights),
        discs=to_floats(_disc_rows(data.lights, time)),
        disc_count=sum(map(_has_disc, data.lights)),
        delta_each=len(each),
        each_rows=copy_array(from_numpy(mi.UInt32, np.array(each or [0]))),
        delta_count=len(data.lights),
        entries=copy_array(from_numpy(mi.UInt32, entries)),
        leaves=_list_leaves(entries),
        nodes=to_floats(nodes),
        entry_count=width,
        has_triangles=bool(len(emitters.triangles)),
        has_cones=bool(len(emitters.triangles)) or sources.holds("spot"),
        has_far=sources.holds("directional"),
        sky_color=mi.Color3f(*(dr.opaque(mi.Float, float(c)) for c in data.sky.color)),
        sky_image=from_numpy(mi.Float, pixels),
        sky_width=sky_width,
        sky_height=sky_height,
        sky_rotation=dr.opaque(mi.Float, float(np.deg2rad(data.sky.rotation))),
        sky_table=build_sky_table(image),
        has_sky=max(data.sky.color) > 0.0,
        scale=dr.opaque(mi.Float, 1.0),
    )
    if before is not None:
        # What the kernels can do already they need not learn anew.
        for name in ("has_triangles", "has_cones", "has_far"):
            setattr(tables, name, getattr(tables, name) or getattr(before[0], name))
    return tables, sources


def _choose_each(lights: list[Light]) -> list[int]:
    """Return the indices of the delta lights that get a shadow ray each."""
    if len(lights) <= DELTA_EACH_LIMIT:
        return list(range(len(lights)))
    return [index for index, light in enumerate(lights) if light.kind == "directional"][:DELTA_EACH_LIMIT]


def _plant(
    sources: LightSources, matrices: np.ndarray, width: int, before: LightSources | None
) -> tuple[np.ndarray, np.ndarray]:
    """Order the sources into `width` leaves; return the nodes (2 width, 16) and the leaves' entries (width,)."""
    bounds = sources.bounds(matrices)
    if before is not None and len(before.leaves) == width and _are_alike(sources, before):
        sources.leaves = before.leaves
    else:
        sources.leaves = order_leaves(bounds, width.bit_length() - 1)
    names = np.concatenate([sources.emitters.triangles, sources.sampled | ENTRY_IS_DELTA, [NO_ENTRY]])
    return fit_nodes(bounds, sources.leaves), names[sources.leaves]


def _list_leaves(entries: np.ndarray) -> mi.UInt32:
    """Return `LightTables.leaves` for the leaves' entries (width,)."""
    order = np.argsort(entries, kind="stable")
    return copy_array(from_numpy(mi.UInt32, np.column_stack([entries[order], order])))


def _are_alike(sources: LightSources, before: LightSources) -> bool:
    """Return whether an order of many sources, most of which are where they were, may stay."""
    same = sources.emitters is before.emitters and np.array_equal(sources.sampled, before.sampled)
    if not same or len(before.leaves) < REORDER_BELOW:
        return False
    moved = (sources.delta[sources.sampled, :4] != before.delta[before.sampled, :4]).any(axis=1)
    return moved.sum() <= MOVED_SHARE * len(before.leaves)


def refit_lights(tables: LightTables, sources: LightSources, matrices: np.ndarray) -> None:
    """Let the tree follow what it samples, now placed by `matrices` (ids, 4, 4); sources keep their leaves."""
    if tables.entry_count:
        tables.nodes = to_floats(fit_nodes(sources.bounds(matrices), sources.leaves))


def move_delta_lights(tables: LightTables, sources: LightSources, lights: list[Light], time: float) -> None:
    """Move the delta lights to `time` seconds; `refit_lights` has to follow."""
    moving = [index for index, light in enumerate(lights) if light.motion is not None]
    # All at once: a step of NumPy for each of 10,000 lights would take a frame's time and more.
    if moving:
        sources.delta[moving] = _delta_rows([lights[index] for index in moving], time)
    tables.delta = to_floats(sources.delta)
    tables.discs = to_floats(_disc_rows(lights, time))


def _delta_rows(lights: list[Light], time: float) -> np.ndarray:
    """Return the rows of `LightTables.delta`, at least one, float64."""
    rows = np.zeros((max(len(lights), 1), 16))
    if not lights:
        return rows
    positions = np.array([light.position for light in lights], np.float64)
    directions = np.array([light.direction for light in lights], np.float64)
    for index, light in enumerate(lights):
        if light.motion is not None:
            matrix = light.motion(time)
            positions[index] = matrix[:3, :3] @ positions[index] + matrix[:3, 3]
            directions[index] = matrix[:3, :3] @ directions[index]
    length = np.linalg.norm(directions, axis=1, keepdims=True)
    rows[:, :3], rows[:, 4:7] = positions, directions / np.maximum(length, 1e-12)
    rows[:, 3] = [KINDS[light.kind] for light in lights]
    rows[:, 7] = np.minimum([light.range for light in lights], 1e18)
    rows[:, 8:11] = [light.color for light in lights]
    rows[:, 11] = [_has_disc(light) for light in lights]
    cosines = np.array([(light.cos_inner, light.cos_outer) for light in lights])
    by_angle = np.array([light.spot_falloff == "linear-angle" for light in lights])[:, None]
    rows[:, 12:14] = cosines
    rows[:, 14:16] = np.where(by_angle, np.arccos(np.clip(cosines, -1.0, 1.0)), 0.0)
    for row, light in zip(rows, lights, strict=True):
        if light.kind == "directional":
            row[12:16] = _versine(light), 0.0, 0.0, 0.0
    return rows


def _has_disc(light: Light) -> bool:
    return light.kind == "directional" and light.in_sky and light.angular_diameter > 0.0


def _versine(light: Light) -> float:
    """Return 1 - cos of a sun's angular radius."""
    return 2.0 * math.sin(0.25 * math.radians(light.angular_diameter)) ** 2


def _disc_rows(lights: list[Light], time: float) -> np.ndarray:
    places = [index for index, light in enumerate(lights) if _has_disc(light)]
    suns = [lights[index] for index in places]
    rows = np.zeros((max(len(suns), 1), 8), np.float32)
    for row, place, sun, delta in zip(rows, places, suns, _delta_rows(suns, time), strict=False):
        row[:4], row[7] = [*-delta[4:7], delta[12]], place
        # E = pi L sin^2 r.
        row[4:7] = np.asarray(sun.color) / (math.pi * math.sin(0.5 * math.radians(sun.angular_diameter)) ** 2)
    return rows


def _bound_deltas(rows: np.ndarray) -> LightBounds:
    """Return a row of bounds for each of the delta lights `rows` (L, 16)."""
    bounds = empty_bounds(len(rows))
    is_far, is_spot = rows[:, 3] == KINDS["directional"], rows[:, 3] == KINDS["spot"]
    bounds.lower, bounds.upper = rows[:, :3].copy(), rows[:, :3].copy()
    brightness = luminance(rows[:, 8:11])
    bounds.intensity, bounds.far = np.where(is_far, 0.0, brightness), np.where(is_far, brightness, 0.0)
    bounds.axis = np.where((is_far | is_spot)[:, None], rows[:, 4:7], bounds.axis)
    # A lamp shines all round; a spot within its outer cone; what is far away from its disc.
    edge = np.arccos(np.clip(np.where(is_far, 1.0 - rows[:, 12], rows[:, 13]), -1.0, 1.0))
    bounds.spread = np.where(is_far | is_spot, edge, np.pi)
    bounds.range = rows[:, 7].copy()
    return bounds
