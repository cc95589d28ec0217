"""The probe grid: where in open space light is gathered, for what moves and for free points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from luxel.scene.device import Scene

AXES = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], np.float64)
"""Directions of a probe's six rows."""
INSIDE = 0.25
"""Share of rays that meet the inside of things from which a probe does not count."""


@dataclass
class ProbeGrid:
    """Where the probes stand: in the middles of cubes."""

    lower: np.ndarray
    size: float
    counts: tuple[int, int, int]

    @property
    def total(self) -> int:
        """Number of probes."""
        return int(np.prod(self.counts))

    def positions(self) -> np.ndarray:
        """Return (P, 3), x fastest."""
        z, y, x = np.meshgrid(*(np.arange(n) for n in reversed(self.counts)), indexing="ij")
        index = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
        return self.lower + (index + 0.5) * self.size


def make_probe_grid(scene: Scene, target: int) -> ProbeGrid:
    """Return a grid of at most about `target` probes over the scene's bounds."""
    extent = np.maximum(scene.host.upper - scene.host.lower, 1e-6)
    size = float((np.prod(extent) / target) ** (1.0 / 3.0))
    while np.prod(np.maximum(np.round(extent / size), 1)) > target:
        size *= 1.05
    counts = np.maximum(np.round(extent / size), 1).astype(int)
    size = float((extent / counts).max())
    lower = 0.5 * (scene.host.lower + scene.host.upper) - 0.5 * counts * size
    return ProbeGrid(lower, size, (int(counts[0]), int(counts[1]), int(counts[2])))
