"""What can be shown of the probes: spheres in the scene, sheets of their texels, and numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.errors import LuxelError
from luxel.methods.ddgi.atlas import texel_direction
from luxel.methods.ddgi.blend import reach_of
from luxel.methods.ddgi.params import MAX_OFFSET
from luxel.methods.ddgi.sheets import (
    depth_blocks,
    held_back_grid,
    irradiance_blocks,
    lay_out,
    node_positions,
    window_nodes,
)
from luxel.methods.ddgi.state import ASLEEP, AWAKE, DEAD, STATE_NAMES, UNUSED, DdgiState
from luxel.methods.inspect import CacheView, LazyViews

RADIUS = 0.1
"""Of the spheres, in shortest cell sides of the finest box."""
YOUNG = 8
"""Frames for which a probe counts as newly moved."""
YELLOW = (0.95, 0.8, 0.1)
STATE_COLORS = {
    UNUSED: (0.0, 0.0, 0.0),
    DEAD: (0.85, 0.1, 0.1),
    ASLEEP: (0.5, 0.5, 0.5),
    AWAKE: (0.1, 0.7, 0.2),
}

Names = tuple[tuple[str, tuple[float, float, float]], ...]
_NAMES: Names = (
    *((STATE_NAMES[value], STATE_COLORS[value]) for value in (AWAKE, ASLEEP, DEAD)),
    ("newly moved", YELLOW),
)
_WAYS: Names = (
    ("at its node", (0.5, 0.5, 0.5)),
    ("moved +X", (1.0, 0.5, 0.5)),
    ("-X", (0.0, 0.5, 0.5)),
    ("+Y", (0.5, 1.0, 0.5)),
    ("-Y", (0.5, 0.0, 0.5)),
    ("+Z", (0.5, 0.5, 1.0)),
    ("-Z", (0.5, 0.5, 0.0)),
)
"""Names of the colours of `state` and `offsets`."""


def probe_views(state: DdgiState) -> Mapping[str, CacheView]:
    """Return all views; those of kind `spheres` leave out the probes that are held back.

    Raises LuxelError where `show_debug_layer` names a layer that no box has.
    """
    grids = _shown_grids(state)

    def spheres(texels: Callable[[DdgiState], np.ndarray], doc: str, names: Names = ()) -> Callable[[], CacheView]:
        return lambda: _spheres(state, texels(state), doc, names)

    def sheet(texels: Callable[[DdgiState], np.ndarray], doc: str) -> Callable[[], CacheView]:
        return lambda: _image(texels(state), grids, doc)

    return LazyViews(
        {
            "irradiance": spheres(_light, "E of each probe, W/m^2, by direction"),
            "depth": spheres(_depth, "distance seen by direction: black 0, white the cage's reach"),
            "state": spheres(_status, "red dead, grey asleep, green awake, yellow newly moved", _NAMES),
            "irradiance_atlas": sheet(_light, "E, W/m^2: layers along Y side by side"),
            "depth_atlas": sheet(_depth, "distance: black 0, white the cage's reach"),
            "certainty": sheet(_certainty, "certainty that a probe is inside something or too near to it, 0..1"),
            "offsets": lambda: _offsets(state),
            "dead_share": lambda: CacheView("number", {"value": _dead_share(state)}, "dead probes over those placed"),
            "mean_offset": lambda: CacheView(
                "number", {"value": _mean_offset(state)}, "metres from the node, of the probes that moved"
            ),
        }
    )


def _light(state: DdgiState) -> np.ndarray:
    return irradiance_blocks(state)[:, 1:-1, 1:-1]


def _depth(state: DdgiState) -> np.ndarray:
    return _grey(relative_depth(state))


def _status(state: DdgiState) -> np.ndarray:
    return state_colors(state)[:, None, None, :]


def _certainty(state: DdgiState) -> np.ndarray:
    """Return the certainty by which each probe moves, over blocks as large as those of its light."""
    side = state.settings.irradiance_resolution
    unfit = np.array(state.probes.unfit)
    return _grey(np.broadcast_to(unfit[:, None, None], (len(unfit), side, side)))


def relative_depth(state: DdgiState) -> np.ndarray:
    """Return the distance that each texel sees over its cage's reach: (total, R, R) float32 in 0..1.

    Where depth is kept as planes it is 1 / (a . d) along the texel's own direction d.
    """
    resolution = state.settings.depth_resolution
    texels = depth_blocks(state)[:, 1:-1, 1:-1]
    if state.settings.planes:
        d = np.array(texel_direction(dr.arange(mi.UInt32, resolution**2), resolution)).T
        inverse = np.einsum("pijc,ijc->pij", texels[..., :3], d.reshape(resolution, resolution, 3))
        distance = 1.0 / np.maximum(inverse, 1e-6)
    else:
        distance = texels[..., 0]
    reach = np.array(reach_of(state, dr.arange(mi.UInt32, state.settings.total)))
    return np.clip(distance / reach[:, None, None], 0.0, 1.0).astype(np.float32)


def state_colors(state: DdgiState) -> np.ndarray:
    """Return a colour a probe by its state, (total, 3) float32: yellow for awake ones that are new where they are."""
    status = np.array(state.probes.status)
    table = np.array([STATE_COLORS[value] for value in sorted(STATE_COLORS)], np.float32)
    young = (status == AWAKE) & (np.array(state.probes.age) < YOUNG)
    return np.where(young[:, None], np.array(YELLOW, np.float32), table[status])


def _spheres(state: DdgiState, atlas: np.ndarray, doc: str, names: Names) -> CacheView:
    placed = np.array(state.probes.status) != UNUSED
    atlas = atlas[placed]
    data = {
        "p": np.array(state.probes.p).T[placed],
        "radius": RADIUS * float(np.array(state.volumes[0].side)[0]),
        "color": atlas.mean(axis=(1, 2)),
        "atlas": atlas,
        "names": names,
    }
    return CacheView("spheres", data, doc)


def _offsets(state: DdgiState) -> CacheView:
    """Return the nodes of all boxes, with the way to each probe from its node."""
    p = np.array(state.probes.p).T
    moved = (np.array(state.probes.offset) != 0.0).any(axis=0)
    starts, ways, colors = [], [], []
    for volume in state.volumes:
        nodes, ids = window_nodes(volume)
        start = node_positions(volume, nodes).reshape(-1, 3)
        own = ids.reshape(-1)
        way = (p[own] - start) * moved[own][:, None]
        starts.append(start)
        ways.append(way)
        # Grey where the probe is at its node; else red, green, blue by the way along X, Y, Z.
        colors.append(np.clip(0.5 + 0.5 * way / (MAX_OFFSET * float(np.array(volume.side)[0])), 0.0, 1.0))
    color = np.concatenate(colors).astype(np.float32)
    data = {
        "p": np.concatenate(starts).astype(np.float32),
        "radius": 0.4 * RADIUS * float(np.array(state.volumes[0].side)[0]),
        "color": color,
        "atlas": color[:, None, None, :],
        "offset": np.concatenate(ways).astype(np.float32),
        "names": _WAYS,
    }
    return CacheView("spheres", data, "nodes, and the vector from each to its probe, metres")


@dataclass(frozen=True)
class Grids:
    """The ids of the probes shown, as rows and columns of blocks."""

    sheet: list[np.ndarray]
    """Each box's window, its layers along Y side by side, and the extras placed: one below the other."""
    tiles: list[np.ndarray]
    """The same, each layer for itself, the extras near a square."""


def _shown_grids(state: DdgiState) -> Grids:
    """Return the ids that the sheets show: of all layers, or of one of them and then without the extras."""
    layer, sheet, tiles = state.settings.debug_layer, [], []
    for volume in state.volumes:
        _, ids = window_nodes(volume)
        shown = range(volume.ny) if layer < 0 else [layer] if layer < volume.ny else []
        if shown:
            tiles += [ids[:, number] for number in shown]
            sheet.append(ids[:, list(shown)].reshape(volume.nz, -1))
    if not sheet:
        most = max(volume.ny for volume in state.volumes)
        raise LuxelError(
            f"ddgi: parameter 'show_debug_layer' is {layer}, but the layers along Y go from 0 to {most - 1}"
        )
    extra = int(np.array(state.extras.count)[0])
    if layer < 0 and extra:
        first = state.settings.probe_count
        sheet.append(held_back_grid(first, extra, max(grid.shape[1] for grid in sheet)))
        tiles.append(held_back_grid(first, extra, math.ceil(math.sqrt(extra))))
    return Grids(sheet, tiles)


def _image(blocks: np.ndarray, grids: Grids, doc: str) -> CacheView:
    """Return the sheet, and `tiles`: each layer of each box as a picture of its own, and the probes held back."""
    return CacheView(
        "image", {"image": lay_out(blocks, grids.sheet), "tiles": [lay_out(blocks, [g]) for g in grids.tiles]}, doc
    )


def _grey(values: np.ndarray) -> np.ndarray:
    return np.repeat(values[..., None], 3, axis=-1)


def _dead_share(state: DdgiState) -> float:
    status = np.array(state.probes.status)
    placed = int((status != UNUSED).sum())
    return float((status == DEAD).sum() / placed) if placed else 0.0


def _mean_offset(state: DdgiState) -> float:
    lengths = np.linalg.norm(_offsets(state).data["offset"], axis=1)
    moved = lengths > 0.0
    return float(lengths[moved].mean()) if moved.any() else 0.0
