"""Saved probes in plain NumPy: a reader that needs neither Dr.Jit nor Mitsuba, for other engines to copy.

It follows docs/probe-files.md. What a look-up of luxel does beyond it: probes held back for places that no probe of
their cage sees, and neighbouring cages where all eight probes are dead.
"""

from __future__ import annotations

import json
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from luxel.errors import LuxelError

FORMAT_NAME = "luxel-ddgi"
FORMAT_VERSION = 2
CORNERS = np.array([(c & 1, (c >> 1) & 1, c >> 2) for c in range(8)])


@dataclass(frozen=True)
class SavedProbes:
    """Probes as read from a file; T of them, those held back included."""

    header: dict[str, Any]
    p: np.ndarray
    """(T, 3) world positions in the file's coordinates, metres."""
    status: np.ndarray
    """(T,) states; the header names them."""
    usable: np.ndarray
    """(T,) bool: a look-up may ask this probe."""
    irradiance_texels: np.ndarray
    """(T, R + 2, R + 2, 3) float32, W/m^2, with the gutter."""
    depth_texels: np.ndarray
    """(T, R + 2, R + 2, C) float32: mean and deviation in metres, or a plane (1/m) and the relative deviation."""
    normal_bias: float
    view_bias: float
    backface_offset: float

    def irradiance(self, p: np.ndarray, n: np.ndarray, visibility: bool = True) -> np.ndarray:
        """Return irradiance (N, 3), W/m^2, at world points `p` (N, 3) with unit normals `n` (N, 3), seen from above.

        `visibility` False leaves the depth out: trilinear and back-face weights alone, quicker, and light leaks.
        """
        p, n = np.asarray(p, np.float64), np.asarray(n, np.float64)
        total, left = np.zeros_like(p), np.ones((len(p), 1))
        guess, guessed = np.zeros_like(p), np.zeros((len(p), 1), bool)
        boxes = self.header["boxes"]
        holds = [self._holds(box, p) for box in boxes]
        for index, box in enumerate(boxes):
            light, weight, seen = self._sum_cage(box, p, n, visibility)
            light = light / np.maximum(weight, 1e-30)
            later = np.any(holds[index + 1 :], axis=0) if index < len(boxes) - 1 else np.zeros((len(p), 1), bool)
            # A box leaves its last cell to the next one, bit by bit, and so does a cage that does not see the point.
            away = self._to_grid(box, p) - box["low"]
            edge = np.clip(np.minimum(away, np.asarray(box["counts"]) - 1 - away), 0.0, 1.0)
            share = np.where(later, edge.prod(axis=1, keepdims=True), holds[index] | (index == len(boxes) - 1))
            asked = (left * share > 0.0) & (weight > 0.0)
            sees = np.clip(seen / self.header["lookup"]["enough"], 0.0, 1.0)
            share = np.where(asked, left * share * np.where(later | guessed, sees, 1.0), 0.0)
            # If none sees it, the finest one guesses.
            guess = np.where(asked & later & ~guessed, light, guess)
            guessed |= asked & later
            total += light * share
            left -= share
        total += np.where(guessed, guess * left, 0.0)
        left = np.where(guessed, 0.0, left)
        return (total / np.maximum(1.0 - left, 1e-6)) ** (1.0 / self._power)

    def _holds(self, box: dict[str, Any], p: np.ndarray) -> np.ndarray:
        """Return (N, 1) bool: the points lie in the box."""
        away = self._to_grid(box, p) - box["low"]
        return ((away >= 0.0) & (away <= np.asarray(box["counts"]) - 1.0)).all(axis=1, keepdims=True)

    @property
    def _power(self) -> float:
        """The power of light whose mean over the probes makes the answer; files before it was named: 1."""
        return float(self.header["lookup"].get("power", 1.0))

    def _sum_cage(
        self, box: dict[str, Any], p: np.ndarray, n: np.ndarray, visibility: bool
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the weighted light (N, 3), the sum of weights (N, 1) and the part of it that sees the point (N, 1)."""
        lookup, counts, low = self.header["lookup"], np.asarray(box["counts"]), np.asarray(box["low"])
        x = p + n * (self.normal_bias + self.view_bias) * box["shortest_side"]
        g = self._to_grid(box, x)
        base = np.clip(np.floor(g).astype(np.int64) - low, 0, counts - 2) + low
        inner = np.clip(g - base, 0.0, 1.0)
        nodes = base[:, None] + CORNERS
        slot = nodes % counts
        probe = box["first"] + slot[..., 0] + counts[0] * (slot[..., 1] + counts[1] * slot[..., 2])
        q = self.p[probe]

        # How near: a tent along each axis, its top where the probe is.
        t = inner[:, None] - CORNERS
        o = self._to_grid(box, q) - nodes if lookup["corrected_weights"] else np.zeros(3)
        tent = np.where(t < o, (1.0 + t) / (1.0 + o), (1.0 - t) / (1.0 - o))
        near = np.maximum(np.maximum(tent, 0.0).prod(axis=2), 1e-4)

        # On which side of the surface, and whether it sees the point.
        to_probe = q - p[:, None]
        cosine = np.einsum("nci,ni->nc", to_probe, n) / np.maximum(np.linalg.norm(to_probe, axis=2), 1e-10)
        weight = self.usable[probe] * near * ((0.5 + 0.5 * cosine) ** 2 + self.backface_offset)
        sight = self._sight(probe, x[:, None] - q) if visibility else np.ones_like(weight)
        seen = (weight * sight).sum(axis=1, keepdims=True)
        weight = weight * np.maximum(sight, lookup["least"])
        color = read_bilinear(self.irradiance_texels, probe, np.broadcast_to(n[:, None], q.shape))
        color = np.maximum(color, 0.0) ** self._power
        total, weights = np.einsum("nc,nci->ni", weight, color), weight.sum(axis=1, keepdims=True)
        if lookup.get("to_point"):
            far = lookup["to_point"][4]
            place = np.clip(to_probe / box["shortest_side"], -far, far)
            total = total * self._change_to_point(weight / np.maximum(weights, 1e-30), place, color.sum(axis=2), n)
        return total, weights, seen

    def _change_to_point(self, share: np.ndarray, place: np.ndarray, value: np.ndarray, n: np.ndarray) -> np.ndarray:
        """Return the factor (N, 1) from the mean of `value` (N, 8) to what a linear fit over `place` has at the point.

        `share` (N, 8) are the weights, one in all; `place` (N, 8, 3) is seen from the point.
        """
        across, along, least, most, _ = self.header["lookup"]["to_point"]
        middle, mean = np.einsum("nc,nci->ni", share, place), np.einsum("nc,nc->n", share, value)[:, None]
        spread = np.einsum("nc,nci,ncj->nij", share, place, place) - middle[:, :, None] * middle[:, None]
        spread += along * np.eye(3) + (across - along) * n[:, :, None] * n[:, None]
        slope = np.einsum("nc,nci,nc->ni", share, place, value) - middle * mean
        step = np.einsum("ni,ni->n", np.linalg.solve(spread, middle[..., None])[..., 0], slope)[:, None]
        return np.where(mean > 0.0, np.clip((mean - step) / np.maximum(mean, 1e-30), least, most), 1.0)

    def _to_grid(self, box: dict[str, Any], p: np.ndarray) -> np.ndarray:
        """Return the lattice coordinates (..., 3) of world points (..., 3)."""
        steps = np.stack([box["step_x"], box["step_y"], box["step_z"]])
        return (p - box["origin"]) @ np.linalg.inv(steps)

    def _sight(self, probe: np.ndarray, away: np.ndarray) -> np.ndarray:
        """Return how far each probe sees the point `away` (..., 3) from it, 0..1, by Chebyshev's inequality."""
        lookup = self.header["lookup"]
        distance = np.maximum(np.linalg.norm(away, axis=-1), 1e-6)
        direction = away / distance[..., None]
        if self.header["depth"]["model"] == "planes":
            sight = np.zeros_like(distance)
            for texel, weight in bilinear_texels(self.depth_texels, probe, direction):
                wall, s = np.einsum("...i,...i->...", texel[..., :3], direction), 1.0 / distance
                deviation = (texel[..., 3] + lookup["least_deviation"]) * np.maximum(wall, s)
                sight += weight * _chebyshev(deviation**2, wall - s)
        else:
            mean, square = np.zeros_like(distance), np.zeros_like(distance)
            for texel, weight in bilinear_texels(self.depth_texels, probe, direction):
                mean += weight * texel[..., 0]
                square += weight * (texel[..., 0] ** 2 + texel[..., 1] ** 2)
            sight = _chebyshev(np.maximum(square - mean**2, 0.0), distance - mean)
        return np.where(sight < lookup["crush"], sight**3 / lookup["crush"] ** 2, sight)


def _chebyshev(variance: np.ndarray, beyond: np.ndarray) -> np.ndarray:
    bound = variance / np.maximum(variance + beyond**2, 1e-20)
    return np.where(beyond > 0.0, bound**3, 1.0)


def direction_to_square(d: np.ndarray) -> np.ndarray:
    """Return the points (..., 2) of [-1, 1]^2 that stand for unit directions `d` (..., 3) (Cigolle et al. 2014)."""
    d = d / np.abs(d).sum(axis=-1, keepdims=True)
    folded = (1.0 - np.abs(d[..., 1::-1])) * np.where(d[..., :2] >= 0.0, 1.0, -1.0)
    return np.where(d[..., 2:] >= 0.0, d[..., :2], folded)


def bilinear_texels(texels: np.ndarray, probe: np.ndarray, d: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the four texels (..., C) around directions `d` (..., 3) in blocks `probe` (...), and their weights."""
    resolution = texels.shape[1] - 2
    t = (direction_to_square(d) * 0.5 + 0.5) * resolution + 0.5
    i = np.clip(np.floor(t).astype(np.int64), 0, resolution)
    f = t - i
    u, v = i[..., 0], i[..., 1]
    fu, fv = f[..., 0], f[..., 1]
    return [
        (texels[probe, v, u], (1.0 - fu) * (1.0 - fv)),
        (texels[probe, v, u + 1], fu * (1.0 - fv)),
        (texels[probe, v + 1, u], (1.0 - fu) * fv),
        (texels[probe, v + 1, u + 1], fu * fv),
    ]


def read_bilinear(texels: np.ndarray, probe: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Return the interpolated texel (..., C) in directions `d` (..., 3) of the blocks of `probe` (...)."""
    return sum((texel * weight[..., None] for texel, weight in bilinear_texels(texels, probe, d)), np.zeros(1))


def read_probes(path: str | Path) -> SavedProbes:
    """Read what `Method.save` of ddgi wrote (.npz). Raises LuxelError where it is damaged or something else."""
    try:
        with Path(path).open("rb") as stream, np.load(stream) as file:
            if "header" not in file.files:
                raise LuxelError(f"'{path}' holds no probes: save it with method 'ddgi'")
            header = json.loads(str(file["header"]))
            if (header["format"], header["version"]) != (FORMAT_NAME, FORMAT_VERSION):
                raise LuxelError(
                    f"'{path}' is {header['format']} {header['version']}, not {FORMAT_NAME} {FORMAT_VERSION}"
                )
            return _from_arrays(header, file)
    except (OSError, ValueError, KeyError, TypeError, EOFError, AttributeError, IndexError, zipfile.BadZipFile):
        raise LuxelError(f"'{path}' is not a file of saved probes, or is damaged") from None


def _from_arrays(header: dict[str, Any], file: Any) -> SavedProbes:
    """Return the probes; KeyError or ValueError where an array lacks or has another size than the header says."""
    total = int(header["probes"]["total"])

    def blocks(name: str, resolution: int, channels: int) -> np.ndarray:
        return file[name].reshape(total, resolution + 2, resolution + 2, channels).astype(np.float32)

    light, depth = header["irradiance"], header["depth"]
    rows = file["rows"].reshape(total, 4)
    return SavedProbes(
        header=header,
        p=rows[:, :3].astype(np.float64) + header.get("measured_from", 0.0),
        status=file["probes.status"].reshape(total),
        usable=rows[:, 3] > 0.5,
        irradiance_texels=blocks("irradiance_atlas", light["resolution"], 4)[..., :3] * np.float32(light["scale"]),
        depth_texels=blocks("depth_atlas", depth["resolution"], len(depth["channels"])),
        normal_bias=float(file["dials.normal_bias"][0]),
        view_bias=float(file["dials.view_bias"][0]),
        backface_offset=float(file["dials.backface_offset"][0]),
    )
