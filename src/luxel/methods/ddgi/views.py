"""What can be shown of the probes: spheres in the scene, sheets of their texels, and numbers."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.errors import LuxelError
from luxel.methods.base import View
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
from luxel.methods.ddgi.state import ASLEEP, AWAKE, DEAD, UNUSED, DdgiState

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


def probe_views(state: DdgiState) -> dict[str, View]:
    """Return all views; those of kind `spheres` leave out the probes that are held back.

    Raises LuxelError where `show_debug_layer` names a layer that no box has.
    """
    placed = np.array(state.probes.status) != UNUSED
    light = irradiance_blocks(state)[:, 1:-1, 1:-1]
    depth = relative_depth(state)
    status = state_colors(state)[:, None, None, :]
    certainty = np.broadcast_to(np.array(state.probes.dead)[:, None, None, None], (*light.shape[:3], 1))
    grids = _shown_grids(state)
    return {
        "irradiance": _spheres(state, placed, light, "E of each probe, W/m^2, by direction"),
        "depth": _spheres(state, placed, _grey(depth), "distance seen by direction: black 0, white the cage's reach"),
        "state": _spheres(state, placed, status, "red dead, grey asleep, green awake, yellow newly moved"),
        "irradiance_atlas": _image(light, grids, "E, W/m^2: layers along Y side by side"),
        "depth_atlas": _image(_grey(depth), grids, "distance: black 0, white the cage's reach"),
        "certainty": _image(_grey(certainty[..., 0]), grids, "certainty that a probe is dead, 0..1"),
        "offsets": _offsets(state),
        "dead_share": View("number", {"value": _dead_share(state)}, "dead probes over those placed"),
        "mean_offset": View("number", {"value": _mean_offset(state)}, "metres from the node, of the probes that moved"),
    }


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


def _spheres(state: DdgiState, placed: np.ndarray, atlas: np.ndarray, doc: str) -> View:
    atlas = atlas[placed]
    data = {
        "p": np.array(state.probes.p).T[placed],
        "radius": RADIUS * float(np.array(state.volumes[0].side)[0]),
        "color": atlas.mean(axis=(1, 2)),
        "atlas": atlas,
    }
    return View("spheres", data, doc)


def _offsets(state: DdgiState) -> View:
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
        "radius": 0.25 * RADIUS * float(np.array(state.volumes[0].side)[0]),
        "color": color,
        "atlas": color[:, None, None, :],
        "offset": np.concatenate(ways).astype(np.float32),
    }
    return View("spheres", data, "nodes, and the vector from each to its probe, metres")


def _shown_grids(state: DdgiState) -> list[np.ndarray]:
    """Return the ids on a sheet: each box's window by its layers, or by one of them, and the extras placed."""
    layer, grids = state.settings.debug_layer, []
    for volume in state.volumes:
        _, ids = window_nodes(volume)
        if layer < 0:
            grids.append(ids.reshape(volume.nz, volume.ny * volume.nx))
        elif layer < volume.ny:
            grids.append(ids[:, layer])
    if not grids:
        most = max(volume.ny for volume in state.volumes)
        raise LuxelError(
            f"ddgi: parameter 'show_debug_layer' is {layer}, but the layers along Y go from 0 to {most - 1}"
        )
    extra = int(np.array(state.extras.count)[0])
    if layer < 0 and extra:
        grids.append(held_back_grid(state.settings.probe_count, extra, max(grid.shape[1] for grid in grids)))
    return grids


def _image(blocks: np.ndarray, grids: list[np.ndarray], doc: str) -> View:
    return View("image", {"image": lay_out(blocks, grids)}, doc)


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
