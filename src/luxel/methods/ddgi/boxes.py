"""Where the probes stand: boxes planned on the host, from the parameters and the scene."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace

import numpy as np

from luxel.errors import LuxelError
from luxel.methods.ddgi.params import DdgiParams

MARGIN = 0.75
"""Cells between the scene's outermost surfaces and the border of a fitted box. A whole cell would put a plane of probes
exactly into those walls (measured in the Cornell box: three times the error), half a cell keeps probes too far off."""
_BOX = re.compile(
    r"^(?P<middle>\S+)\s+size\s+(?P<size>\S+)\s+probes\s+(?P<probes>\S+)(?:\s+turn\s+(?P<turn>\S+))?$", re.IGNORECASE
)


@dataclass(frozen=True)
class ProbeBox:
    """One grid of probes; its corner probes are the corners of the box."""

    middle: tuple[float, float, float]
    size: tuple[float, float, float]
    """Metres along the box's own axes."""
    counts: tuple[int, int, int]
    turn: float = 0.0
    """Degrees about Y."""

    @property
    def spacing(self) -> np.ndarray:
        """Cell sides, metres."""
        return np.asarray(self.size) / (np.asarray(self.counts) - 1)

    @property
    def axes(self) -> np.ndarray:
        """(3, 3): the box's unit axes in the world, one a row."""
        c, s = math.cos(math.radians(self.turn)), math.sin(math.radians(self.turn))
        return np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])

    @property
    def probe_count(self) -> int:
        """Probes of this box."""
        return math.prod(self.counts)


FEW = 4
"""Probes an axis from which there is room for a margin."""


def plan_boxes(
    params: DdgiParams, lower: np.ndarray, upper: np.ndarray, origin: np.ndarray | None = None
) -> list[ProbeBox]:
    """Return the boxes, finest first, for a scene between `lower` and `upper`.

    All of them are measured from `origin` (3,), which is where `lower` and `upper` are measured from in the file's
    coordinates; `params.boxes` is in the file's.
    Raises LuxelError for boxes that cannot be read, or contradict other parameters.
    """
    if params.boxes.strip():
        if params.follow_camera or params.cascades > 1:
            raise LuxelError("ddgi: 'boxes' stand still: leave out 'follow_camera' and 'cascades', or 'boxes'")
        stated = [_parse_box(text) for text in params.boxes.split(";") if text.strip()]
        middles = [np.asarray(box.middle) - (0.0 if origin is None else origin) for box in stated]
        found = [replace(box, middle=_three(middle)) for box, middle in zip(stated, middles, strict=True)]
        if not found:
            raise LuxelError("ddgi: 'boxes' holds no box; write 'x,y,z size x,y,z probes nx,ny,nz', or leave it empty")
        return sorted(found, key=lambda box: float(np.prod(box.spacing)))
    extent = np.maximum(np.asarray(upper, float) - lower, 1e-3)
    wanted = np.asarray(params.probe_box_size, float)
    given = np.array([params.num_probes_x, params.num_probes_y, params.num_probes_z])
    size = np.where(wanted > 0.0, wanted, extent)
    counts = _choose_counts(given, size, params.probe_target)
    # A fitted axis gets a margin outside the geometry: bounces are looked up on the outermost walls.
    margin = 2.0 * MARGIN * extent / np.maximum(counts - 1 - 2 * MARGIN, 1)
    # Two or three probes an axis would all stand in the margin: they share out the inside.
    margin = np.where(counts < FEW, -extent / np.maximum(counts, 1), margin)
    size = np.where(wanted > 0.0, wanted, extent + margin)
    # A flat scene gets cells as high as half their width, not planes of probes within a millimetre.
    size = np.where(wanted > 0.0, wanted, np.maximum(size, 0.5 * (size / (counts - 1)).max() * (counts - 1)))
    middle = 0.5 * (np.asarray(lower, float) + upper) + np.asarray(params.world_offset, float)
    return [
        ProbeBox(_three(middle), _three(size * 2.0**level), (int(counts[0]), int(counts[1]), int(counts[2])))
        for level in range(max(params.cascades, 1))
    ]


def _choose_counts(given: np.ndarray, size: np.ndarray, target: int) -> np.ndarray:
    """Return probes an axis: those given, the others so that cells are near cubes and there are `target` in all."""
    low, high = 1e-6 * float(size.max()), 2.0 * float(size.max())
    for _ in range(60):
        cell = math.sqrt(low * high)
        counts = np.where(given > 0, given, np.maximum(np.ceil(size / cell) + 1 + 2 * MARGIN, 4))
        low, high = (cell, high) if np.prod(counts) > target else (low, cell)
    return np.where(given > 0, given, np.maximum(np.ceil(size / high) + 1 + 2 * MARGIN, 4)).astype(int)


def _parse_box(text: str) -> ProbeBox:
    found = _BOX.match(text.strip())
    try:
        if found is None:
            raise ValueError
        middle, size, probes = ([float(v) for v in found[name].split(",")] for name in ("middle", "size", "probes"))
        turn = float(found["turn"] or 0.0)
        if not all(len(part) == 3 and all(map(math.isfinite, part)) for part in (middle, size, probes)):
            raise ValueError
        if not math.isfinite(turn) or min(size) <= 0.0 or not all(n in range(2, 1025) for n in probes):
            raise ValueError
    except ValueError:
        raise LuxelError(
            f"ddgi: box '{text.strip()}' cannot be read; write it as 'x,y,z size x,y,z probes nx,ny,nz turn degrees', "
            "sizes above 0 and 2 to 1024 probes an axis"
        ) from None
    return ProbeBox(_three(middle), _three(size), (int(probes[0]), int(probes[1]), int(probes[2])), turn)


def _three(values: np.ndarray | list[float]) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in values)
    return x, y, z
