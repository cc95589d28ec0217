"""What a texel gets: direct light sampled at its points, the method's indirect light, the surface's own colours."""

from __future__ import annotations

import hashlib
import time as clock
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel import __version__
from luxel.bake.layout import Layout
from luxel.kernels.direct import direct_irradiance, shadow_ray_count
from luxel.kernels.material import metallic_share, opacity, transmitted_share
from luxel.kernels.records import Surface
from luxel.kernels.triangle import fetch_triangle, interpolate
from luxel.methods.base import Method
from luxel.methods.lightmap.bake.checkpoint import read_checkpoint, write_checkpoint
from luxel.methods.lightmap.bake.fingerprint import HASH_LENGTH
from luxel.methods.lightmap.flatten.nearest import find_nearest
from luxel.scene.device import Scene
from luxel.scene.diffuse import as_diffuse
from luxel.scene.gloss import is_glass
from luxel.scene.model import Material

POINTS_AT_ONCE = 1 << 19
"""Points in flight: bounds memory."""
LEAST = 1e-6
"""Share of a surface's albedo below which it has none."""
CHECKPOINT_EVERY = 10.0
"""Seconds between two writings of what a stopped bake goes on from."""

Progress = Callable[[float], None] | None


@dataclass
class TexelLight:
    """Light and colour of M texels. Irradiance in W/m^2, emission in W/(m^2 sr), linear Rec. 709."""

    direct: np.ndarray
    """(M, 3)."""
    indirect: np.ndarray
    """(M, 3)."""
    albedo: np.ndarray
    """(M, 3)."""
    emission: np.ndarray
    """(M, 3)."""
    opacity: np.ndarray
    """(M,) share of the texel that is no hole of a cut-out; alpha of a blended surface."""
    shadow_rays: int
    """Cast for direct light at most."""

    @property
    def irradiance(self) -> np.ndarray:
        """Direct and indirect light, (M, 3)."""
        return self.direct + self.indirect

    @property
    def radiance(self) -> np.ndarray:
        """What a viewer sees of the diffuse surface, (M, 3): emission + albedo / pi * irradiance."""
        return self.emission + self.albedo * self.irradiance / np.pi


def light_texels(
    scene: Scene, method: Method, state: Any, layout: Layout, *, samples: int, seed: int, direct: bool = True,
    workdir: Path | None = None, progress: Progress = None,
) -> TexelLight:  # fmt: skip
    """Return each texel's light: a mean over its points, of `samples` samples each. Without `direct`, that is black.

    Samples are kept in `workdir`, where a stopped bake goes on.
    """
    count = len(layout.face)
    rows = np.zeros((count, 13), np.float32)
    texels = method.texels(state)
    spread = method.progressive
    mark = "" if workdir is None else fingerprint_light(scene, layout, method.name if spread else "", seed, direct)
    for first in range(0, count, POINTS_AT_ONCE):
        last = min(count, first + POINTS_AT_ONCE)
        surface = layout.points(first, last, scene)
        dr.eval(surface)
        file = None if workdir is None else Path(workdir) / f"light-{mark}-{first}.npz"

        def tell(share: float, first: int = first, last: int = last) -> None:
            if progress is not None:
                progress((first + (last - first) * share) / count)

        sums = _sum_samples(scene, method if spread else None, state, surface, samples, seed, first, direct, file, tell)
        rows[first:last, :6] = sums / samples
        if texels is None and not spread:
            rows[first:last, 3:6] = _rows(method.query(scene, state, surface).irradiance)
        stopped, scattered = _opacity(scene, surface)
        rows[first:last, 6:9] = _rows(surface.albedo) / np.maximum(scattered, LEAST)[:, None]
        rows[first:last, 9:12], rows[first:last, 12] = _rows(surface.emission), stopped
    mean = average_points(layout, rows)
    _colour_by_solid(layout, rows, mean)
    mean = mean[layout.source]
    if texels is not None:
        mean[:, 3:6] = texels[layout.slot]
    rays = count * samples * shadow_ray_count(scene) if direct else 0
    return TexelLight(mean[:, :3], mean[:, 3:6], mean[:, 6:9], mean[:, 9:12], mean[:, 12], rays)


def _sum_samples(
    scene: Scene, method: Method | None, state: Any, surface: Surface, samples: int, seed: int, first: int,
    direct: bool, file: Path | None, tell: Callable[[float], None],
) -> np.ndarray:  # fmt: skip
    """Return sums (P, 6) over `samples` of direct light and of a method's paths at the points, the `first` one's on.

    `method` None has no paths. Every so often the sums are written to `file`, and what that holds is not sampled again.
    """
    count = dr.width(surface.p)
    sums, done = _resume(file, count, samples)
    written_at = clock.monotonic()
    for sample in range(done, samples):
        start = dr.opaque(mi.UInt32, (seed * 0x9E3779B1 + first + sample * 0x2545F491 + 5) & 0xFFFFFFFF)
        if direct:
            sums[:, :3] += _direct(scene, surface, start, count)
        if method is not None:
            state.seed = start
            sums[:, 3:] += _rows(method.query(scene, state, surface).irradiance)
        is_last = sample + 1 == samples
        if is_last or clock.monotonic() - written_at > CHECKPOINT_EVERY:
            write_checkpoint(file, sums=sums, done=np.array(sample + 1))
            written_at = clock.monotonic()
        tell((sample + 1) / samples)
    return sums


def _resume(file: Path | None, count: int, samples: int) -> tuple[np.ndarray, int]:
    """Return the sums (`count`, 6) of direct light and of paths that an earlier bake left, and of how many samples."""
    held = read_checkpoint(file, "sums", "done")
    if held is None or held[0].shape != (count, 6) or int(held[1]) > samples:
        return np.zeros((count, 6), np.float32), 0
    return held[0], int(held[1])


def fingerprint_light(scene: Scene, layout: Layout, paths: str, seed: int, direct: bool) -> str:
    """Return a hash of all that samples of light at the layout's points depend on."""
    digest = hashlib.sha256(repr((__version__, paths, seed, direct)).encode())
    for part in (scene.geometry, scene.materials, scene.lights):
        for item in fields(part):
            value = getattr(part, item.name)
            _hash_value(digest, value)
    for array in (layout.prim, layout.back, layout.face, layout.weights, layout.inside):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:HASH_LENGTH]


def _hash_value(digest: Any, value: Any) -> None:
    """Add a value of the device's tables to a hash, arrays by their bytes: their texts leave out the middle."""
    if dr.is_array_v(value):
        digest.update(np.array(value).tobytes())
    elif is_dataclass(value):
        # The BSDF's tables are worked out from the others.
        for item in fields(value):
            if not item.name.startswith("bsdf"):
                _hash_value(digest, getattr(value, item.name))
    else:
        digest.update(repr(value).encode())


def average_points(layout: Layout, rows: np.ndarray) -> np.ndarray:
    """Return means (M, C) float64 of rows (P, C) over each texel's points; 0 where it has none."""
    counts = np.diff(layout.starts)
    owner = np.repeat(np.arange(len(counts)), counts)
    columns = [np.bincount(owner, weights=rows[:, c], minlength=len(counts)) for c in range(rows.shape[1])]
    return np.stack(columns, axis=1) / np.maximum(counts, 1)[:, None]


def _colour_by_solid(layout: Layout, rows: np.ndarray, mean: np.ndarray) -> None:
    """Give texels of cut-outs the albedo and emission of what is solid there; all hole, those of the nearest other.

    A picture's colour inside holes is arbitrary, often black, and would show along every outline.
    """
    texel = np.flatnonzero(np.diff(layout.starts) > 0)
    solidity = mean[texel, 12]
    if solidity.min() == 1.0:
        return
    solid, hole = texel[solidity > 0.0], texel[solidity == 0.0]
    colours = average_points(layout, rows[:, 6:12] * rows[:, 12:])
    mean[solid, 6:12] = colours[solid] / mean[solid, 12:]
    places = np.column_stack([layout.slot % layout.width, layout.slot // layout.width])
    chart = np.zeros(len(places), np.int64)
    chart[texel] = layout.chart[layout.face[layout.starts[texel]]]
    index = find_nearest(places[solid], chart[solid], places[hole], chart[hole])[:, 0]
    mean[hole[index >= 0], 6:12] = mean[solid[index[index >= 0]], 6:12]


def passes_light(material: Material) -> bool:
    """Return whether the diffuse condition lets light pass straight through a material because it is glass."""
    return is_glass(material) and as_diffuse(material).alpha_mode == "blend"


def _opacity(scene: Scene, surface: Surface) -> tuple[np.ndarray, np.ndarray]:
    """Return how much of the light each point stops, (P,): not by one draw where rays pass by chance.

    Beside it the share of its albedo (P,) that full materials leave of that under the diffuse condition, which counts
    glass among the holes: what is shown does so.
    """
    triangle = fetch_triangle(scene, surface.prim_id, surface.active)
    point = interpolate(scene, triangle, surface.barycentric, surface.active)
    stopped = np.array(opacity(scene, point, surface.active))
    if not scene.features.transmission:
        return stopped, np.ones_like(stopped)
    clear = np.array([*map(passes_light, scene.host.data.materials)])[np.array(point.material)]
    glass = np.where(clear, np.array(transmitted_share(scene, point, surface.active)), 0.0)
    return stopped * (1.0 - glass * (1.0 - np.array(metallic_share(scene, point, surface.active)))), 1.0 - glass


def _direct(scene: Scene, surface: Surface, seed: mi.UInt32, count: int) -> np.ndarray:
    light = direct_irradiance(scene, surface, seed, dr.arange(mi.UInt32, count), mi.Bool(True))
    return _rows(light)


def _rows(color: mi.Color3f) -> np.ndarray:
    return np.array(color).T
