"""The probes for other programs: a header in words and numbers, and the atlases as EXR pictures.

docs/probe-files.md documents both; `read_probes` is the reader in plain NumPy.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from luxel.errors import LuxelError
from luxel.files import write_bytes
from luxel.methods.ddgi.planes import LEAST_DEVIATION
from luxel.methods.ddgi.query import (
    FIT_REACH,
    MAX_CHANGE,
    MIN_CAGE_WEIGHT,
    MIN_CHANGE,
    MIN_VISIBILITY,
    RIDGE_ACROSS,
    RIDGE_ALONG,
)
from luxel.methods.ddgi.reader import FORMAT_NAME, FORMAT_VERSION, SavedProbes, read_probes
from luxel.methods.ddgi.sheets import box_grid, depth_blocks, held_back_grid, irradiance_blocks, lay_out, scale_of
from luxel.methods.ddgi.state import STATE_NAMES, DdgiState
from luxel.methods.ddgi.volume import Volume
from luxel.methods.ddgi.weights import CRUSH_THRESHOLD
from luxel.methods.persistence import read_arrays

MOMENTS = ("mean", "deviation")
PLANES = ("plane.X", "plane.Y", "plane.Z", "deviation")


def make_header(state: DdgiState) -> str:
    """Return the JSON text that says how to read a saved state; `read_probes` needs nothing else to know."""
    return json.dumps(describe(state), allow_nan=False)


def counts_in(path: Path) -> list[tuple[int, int, int]]:
    """Return the probes an axis of each box of a saved state, finest first.

    Raises LuxelError for another file, or a damaged one.
    """
    try:
        boxes = json.loads(str(read_arrays("ddgi", path)["header"]))["boxes"]
        return [(int(x), int(y), int(z)) for x, y, z in (box["counts"] for box in boxes)]
    except (KeyError, TypeError, ValueError):
        raise LuxelError(f"'{path}' is not a saved luxel state, or is damaged") from None


def describe(state: DdgiState) -> dict[str, Any]:
    """Return the header as plain lists and dictionaries."""
    s = state.settings
    boxes, row = [], 0
    for volume in state.volumes:
        boxes.append(_describe_box(volume, row, s.origin))
        row += volume.nz
    return {
        "format": FORMAT_NAME,
        "version": FORMAT_VERSION,
        "units": {
            "length": "metre",
            "irradiance": "W/m^2 a colour channel, linear Rec. 709, indirect light, without albedo",
            "axes": "right-handed, +Y up",
        },
        "measured_from": list(s.origin),
        "boxes": boxes,
        "probes": {
            "total": s.total,
            "in_boxes": s.probe_count,
            "held_back": s.extra_count,
            "order": "id = first + sx + nx * (sy + ny * sz), where s = node modulo counts; those held back come last",
            "node": "whole numbers from 'low' to 'low' + counts - 1, finest box first; its place is "
            "origin + x * step_x + y * step_y + z * step_z",
            "position": "rows[id] = x, y, z, usable: the probe may have moved from its node; "
            "add 'measured_from' to x, y, z",
        },
        "states": {str(index): name for index, name in enumerate(STATE_NAMES)},
        "octahedral": {
            "gutter": 1,
            "texel": "texels[id, row, column], 1 <= row, column <= resolution; "
            "u = (column - 0.5) / resolution * 2 - 1, v = (row - 0.5) / resolution * 2 - 1",
            "to_direction": "z = 1 - |u| - |v|; f = max(-z, 0); "
            "direction = normalize(u - f * sign(u), v - f * sign(v), z); sign(0) = 1",
            "to_square": "d / (|dx| + |dy| + |dz|); (u, v) = (dx, dy) where dz >= 0, "
            "else ((1 - |dy|) * sign(dx), (1 - |dx|) * sign(dy)); sign(0) = 1",
        },
        "irradiance": {
            "resolution": s.irradiance_resolution,
            "stored_as": "float16" if s.half_irradiance else "float32",
            "channels": ["R", "G", "B", "1"],
            "scale": scale_of(state),
            "meaning": "irradiance of a surface whose normal is the texel's direction; times 'scale' it is in W/m^2",
        },
        "depth": _describe_depth(state),
        "lookup": {
            "crush": CRUSH_THRESHOLD,
            "enough": MIN_CAGE_WEIGHT,
            "least": MIN_VISIBILITY,
            "least_deviation": LEAST_DEVIATION,
            "corrected_weights": s.corrected_weights,
            "power": 0.25 if s.roots else 1.0,
            "to_point": [RIDGE_ACROSS, RIDGE_ALONG, MIN_CHANGE, MAX_CHANGE, FIT_REACH] if s.roots else None,
        },
        "sheet": {
            "block": "of a box's probe: column = (id - first) modulo (nx * ny), "
            "row = sheet_row + (id - first) // (nx * ny); each is resolution + 2 texels wide and high",
            "held_back_columns": max(volume.nx * volume.ny for volume in state.volumes),
            "held_back_row": row,
        },
    }


def _describe_box(volume: Volume, row: int, origin: tuple[float, float, float]) -> dict[str, Any]:
    return {
        "origin": (np.array(_numbers(volume.origin)) + origin).tolist(),
        "step_x": _numbers(volume.step_x),
        "step_y": _numbers(volume.step_y),
        "step_z": _numbers(volume.step_z),
        "counts": [volume.nx, volume.ny, volume.nz],
        "first": volume.first,
        "low": [int(v) for v in _numbers(volume.low)],
        "shortest_side": _numbers(volume.side)[0],
        "reach": _numbers(volume.reach)[0],
        "sheet_row": row,
    }


def _describe_depth(state: DdgiState) -> dict[str, Any]:
    s = state.settings
    moments = "mean and standard deviation of the distance, metres; a mean of 'reach' and deviation 0: nothing was near"
    planes = (
        "the plane a . w = 1 / distance that rays w about the texel's direction hit, 1/m, and the standard deviation "
        "of 1 / distance from it over its mean"
    )
    return {
        "resolution": s.depth_resolution,
        "stored_as": "float16" if s.half_depth else "float32",
        "model": "planes" if s.planes else "moments",
        "channels": list(PLANES if s.planes else MOMENTS),
        "meaning": planes if s.planes else moments,
    }


def write_atlases(state: DdgiState, folder: str | Path) -> list[Path]:
    """Write irradiance_atlas.exr, depth_atlas.exr and probes.json into `folder`; return their paths.

    EXR values are 32-bit floats: irradiance in W/m^2, depth as in the atlas. probes.json is the header with `p`
    (metres) and `status` of each probe by id. Each file appears whole or not at all. Raises LuxelError where one cannot
    be written.
    """
    folder = Path(folder)
    grids = [box_grid(volume) for volume in state.volumes]
    s = state.settings
    if s.extra_count:
        grids.append(held_back_grid(s.probe_count, s.extra_count, max(grid.shape[1] for grid in grids)))
    header = describe(state)
    places = np.array(state.probes.p, np.float64).T + s.origin
    lists = {"p": places.tolist(), "status": np.array(state.probes.status).tolist()}
    header["probes"] = {**header["probes"], **lists}
    files = {
        "irradiance_atlas.exr": _encode_exr(lay_out(irradiance_blocks(state), grids), ("R", "G", "B")),
        "depth_atlas.exr": _encode_exr(lay_out(depth_blocks(state), grids), PLANES if s.planes else MOMENTS),
        "probes.json": json.dumps(header, allow_nan=False).encode(),
    }
    # The description comes last: where it is, the pictures are.
    for name, data in files.items():
        write_bytes(folder / name, data)
    return [folder / name for name in files]


def _encode_exr(picture: np.ndarray, channels: tuple[str, ...]) -> bytes:
    """Return a picture (H, W, C) as an EXR file whose channels have these names."""
    stream = mi.MemoryStream()
    bitmap = mi.Bitmap(np.ascontiguousarray(picture, np.float32), mi.Bitmap.PixelFormat.MultiChannel, list(channels))
    bitmap.write(stream, mi.Bitmap.FileFormat.OpenEXR)
    return stream.raw_buffer()


def _numbers(value: Any) -> list[float]:
    return [float(v) for v in np.array(value).reshape(-1)]


__all__ = ["SavedProbes", "describe", "make_header", "read_probes", "write_atlases"]
