"""The probes' texels on the host: as blocks, one a probe, and as sheets, pictures of many blocks side by side.

On a sheet a layer of a box along Y is nx times nz blocks, layers stand side by side, and boxes below one another; the
probes held back follow below the last box. A block whose probe does not exist is black.
"""

from __future__ import annotations

import numpy as np

from luxel.methods.ddgi.state import DdgiState
from luxel.methods.ddgi.volume import Volume

NO_PROBE = -1


def irradiance_blocks(state: DdgiState) -> np.ndarray:
    """Return what look-ups read of the light: (total, R + 2, R + 2, 3) float32, W/m^2, with the gutter."""
    side = state.settings.irradiance_resolution + 2
    rows = np.array(state.irradiance_atlas).reshape(state.settings.total, side, side, 4)
    return rows[..., :3].astype(np.float32) * np.float32(scale_of(state))


def depth_blocks(state: DdgiState) -> np.ndarray:
    """Return what look-ups read of the depth: (total, R + 2, R + 2, C) float32, with the gutter.

    C is 2 for moments (mean and deviation, metres) and 4 for planes (a in 1/m, and the relative deviation).
    """
    side = state.settings.depth_resolution + 2
    channels = 4 if state.settings.planes else 2
    return np.array(state.depth_atlas).reshape(state.settings.total, side, side, channels).astype(np.float32)


def scale_of(state: DdgiState) -> float:
    """Return the unit of the irradiance atlas, W/m^2."""
    return float(np.array(state.scale).reshape(-1)[0])


def box_grid(volume: Volume) -> np.ndarray:
    """Return the ids of a box as they are stored: (nz, ny * nx) int64."""
    return (volume.first + np.arange(volume.probe_count)).reshape(volume.nz, volume.ny * volume.nx)


def window_nodes(volume: Volume) -> tuple[np.ndarray, np.ndarray]:
    """Return lattice nodes (nz, ny, nx, 3) of the box's window from its lowest corner on, and their probes' ids."""
    low = np.array(volume.low).reshape(3).astype(np.int64)
    z, y, x = np.meshgrid(*(np.arange(n) for n in (volume.nz, volume.ny, volume.nx)), indexing="ij")
    nodes = np.stack([x, y, z], axis=-1) + low
    slot = nodes % (volume.nx, volume.ny, volume.nz)
    return nodes, volume.first + slot[..., 0] + volume.nx * (slot[..., 1] + volume.ny * slot[..., 2])


def node_positions(volume: Volume, nodes: np.ndarray) -> np.ndarray:
    """Return the world positions (..., 3) of lattice nodes (..., 3), metres."""
    steps = np.stack([np.array(step).reshape(3) for step in (volume.step_x, volume.step_y, volume.step_z)])
    return np.array(volume.origin).reshape(3) + nodes @ steps


def held_back_grid(first: int, count: int, columns: int) -> np.ndarray:
    """Return the ids of `count` probes from id `first` on, `columns` in a row, padded with NO_PROBE."""
    rows = -(-count // columns)
    ids = np.full(rows * columns, NO_PROBE, np.int64)
    ids[:count] = first + np.arange(count)
    return ids.reshape(rows, columns)


def lay_out(blocks: np.ndarray, grids: list[np.ndarray]) -> np.ndarray:
    """Return one picture (height, width, C) of `blocks` (total, h, w, C), the `grids` of ids below one another."""
    columns = max(grid.shape[1] for grid in grids)
    ids = np.concatenate(
        [np.pad(grid, ((0, 0), (0, columns - grid.shape[1])), constant_values=NO_PROBE) for grid in grids]
    )
    _, height, width, channels = blocks.shape
    shown = np.where((ids == NO_PROBE)[..., None, None, None], np.float32(0.0), blocks[np.maximum(ids, 0)])
    return shown.transpose(0, 2, 1, 3, 4).reshape(ids.shape[0] * height, columns * width, channels)
