"""Textured quantities of Mitsuba as images: sampled on the texels' own grid, with their filter, wrap and transform."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.scene.arrays import vectors_from_numpy
from luxel.scene.model import Texture
from luxel.scene.warnings import Warnings

MAX_TEXTURE_SIZE = 1024
"""Larger images are averaged down to it: diffuse light needs no more, and memory stays bounded."""
PROCEDURAL_SIZE = 512
"""Used where a texture has no resolution of its own, or where several do not lie on one grid."""

Evaluate = Callable[[np.ndarray], np.ndarray]
"""(N, 2) uv -> (N, C) linear values."""


def bake(
    evaluate: Evaluate, varying: list[Any], name: str, warnings: Warnings, finer: int = 1
) -> tuple[np.ndarray, Texture | None]:
    """Evaluate a textured quantity on a grid. Returns (H, W, C) float32 and the texture to put it in, None if constant.

    The grid covers one period of the first texture, in that texture's own coordinates, so that any `to_uv` is exact;
    it is `finer` times as fine as the largest texture.
    """
    transforms = [_to_uv(texture) for texture in varying]
    transform = transforms[0]
    together = all(np.allclose(transform, other) for other in transforms[1:])
    if not together or abs(np.linalg.det(transform)) < 1e-9:
        transform = np.eye(3)
    inverse = np.linalg.inv(transform)

    def in_texture_space(st: np.ndarray) -> np.ndarray:
        return evaluate((st @ inverse[:2, :2].T + inverse[:2, 2]).astype(np.float32))

    width, height = (finer * side for side in _resolution(varying, together))
    over = max(1, -(-max(width, height) // MAX_TEXTURE_SIZE))
    columns, rows = min(width, max(1, width // over)), min(height, max(1, height // over))
    image = _sample_grid(in_texture_space, rows, columns, over)
    if np.ptp(image.reshape(-1, image.shape[-1]), axis=0).max() < 1e-4:
        return image, None
    wraps = [_find_wrap(in_texture_space, axis) for axis in (0, 1)]
    if None in wraps:
        warnings.add("The textures of a material do not repeat together, one tile of them does: {names}.", name)
    return image, Texture(
        image,
        wrap_u=wraps[0] or "repeat",
        wrap_v=wraps[1] or "repeat",
        nearest=over == 1 and _is_nearest(in_texture_space, rows, columns),
        transform=transform.astype(np.float32),
    )


def is_two_valued(alpha: np.ndarray) -> bool:
    """Return whether an image holds, almost everywhere, zeros and ones only: a cut-out rather than a veil."""
    return bool((np.minimum(alpha, 1.0 - alpha) < 0.02).mean() > 0.98)


def encode_srgb(colour: np.ndarray) -> np.ndarray:
    """Return linear values in 0..1 as uint8 on the sRGB curve."""
    bright = 1.055 * np.maximum(colour, 1e-9) ** (1 / 2.4) - 0.055
    return np.round(np.where(colour <= 0.0031308, colour * 12.92, bright) * 255).astype(np.uint8)


def surface_at(uv: np.ndarray) -> Any:
    """Return Mitsuba surface interactions at `uv` (N, 2), seen from straight in front."""
    count = len(uv)
    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.t = mi.Float(0.0)
    si.uv = vectors_from_numpy(mi.Point2f, uv)
    si.wi = mi.Vector3f(0.0, 0.0, 1.0)
    si.n = mi.Normal3f(0.0, 0.0, 1.0)
    si.sh_frame = mi.Frame3f(si.n)
    dr.make_opaque(si.t, si.wi, si.n)
    return si


def colour_rows(spectrum: Any, count: int) -> np.ndarray:
    """Return a Dr.Jit RGB array as (count, 3); one that does not vary has a single entry."""
    return np.broadcast_to(np.array(spectrum).reshape(3, -1).T, (count, 3))


def number_rows(value: Any, count: int) -> np.ndarray:
    """Return a Dr.Jit number as (count, 1)."""
    return np.broadcast_to(np.array(value).reshape(-1, 1), (count, 1))


def textures_below(item: Any) -> list[tuple[str, Any]]:
    """Return (slot, texture) of every texture below a BSDF or an emitter."""
    found: list[tuple[str, Any]] = []
    for name, value in children(item):
        if isinstance(value, mi.Texture):
            found.append((name, value))
        else:
            found += textures_below(value)
    return found


def children(item: Any) -> list[tuple[str, Any]]:
    """Return (slot, object) of the Mitsuba objects directly below `item`."""
    found: list[tuple[str, Any]] = []

    class Finder(mi.TraversalCallback):
        def put(self, name: str, value: Any, *_: Any) -> None:
            if isinstance(value, mi.Object):
                found.append((name, value))

    item.traverse(Finder())
    return found


def _sample_grid(evaluate: Evaluate, rows: int, columns: int, over: int) -> np.ndarray:
    """Return (rows, columns, C) means of `over` x `over` samples a texel; row 0 is v = 0."""
    s = (np.arange(columns * over) + 0.5) / (columns * over)
    bands = []
    for row in range(0, rows, 128):
        count = min(128, rows - row)
        t = (np.arange(row * over, (row + count) * over) + 0.5) / (rows * over)
        st = np.stack(np.meshgrid(s, t), axis=-1).reshape(-1, 2)
        values = np.nan_to_num(evaluate(st))
        bands.append(values.reshape(count, over, columns, over, -1).mean(axis=(1, 3)))
    return np.concatenate(bands).astype(np.float32)


def _find_wrap(evaluate: Evaluate, axis: int) -> Any:
    """Return how the values go on beyond 0..1 along `axis`: "repeat", "mirror", "clamp"; None for none of them."""
    inside = np.random.default_rng(7).uniform(0.05, 0.95, (64, 2))
    beyond, mirrored, edge = inside.copy(), inside.copy(), inside.copy()
    beyond[:, axis] += 1.0
    mirrored[:, axis] = 1.0 - inside[:, axis]
    edge[:, axis] = 1.0 - 1e-5
    seen = evaluate(beyond)
    for wrap, points in (("repeat", inside), ("mirror", mirrored), ("clamp", edge)):
        # A few points may fall on an edge of the pattern, where rounding decides.
        if (np.abs(evaluate(points) - seen).max(axis=1) < 0.02).mean() > 0.9:
            return wrap
    return None


def _is_nearest(evaluate: Evaluate, rows: int, columns: int) -> bool:
    """Return whether values are constant within each texel of the grid, as they are without interpolation."""
    random = np.random.default_rng(11)
    cell = np.stack([random.integers(0, columns, 256), random.integers(0, rows, 256)], axis=1)
    size = np.array([columns, rows], float)
    middle = evaluate((cell + 0.5) / size)
    corners = [evaluate((cell + np.array(offset)) / size) for offset in ((0.1, 0.1), (0.9, 0.9), (0.1, 0.9))]
    same = np.max([np.abs(corner - middle).max(axis=1) for corner in corners], axis=0) < 1e-3
    return bool(same.mean() > 0.98)


def _resolution(varying: list[Any], together: bool) -> tuple[int, int]:
    """Return the largest (width, height) among the textures; procedural ones count as `PROCEDURAL_SIZE`.

    Textures that are mixed but not on one grid are sampled finely too.
    """
    sizes = [] if together else [(PROCEDURAL_SIZE, PROCEDURAL_SIZE)]
    for texture in varying:
        width, height = (int(side) for side in texture.resolution())
        sizes.append((width, height) if width > 1 or height > 1 else (PROCEDURAL_SIZE, PROCEDURAL_SIZE))
    return max(size[0] for size in sizes), max(size[1] for size in sizes)


def _to_uv(texture: Any) -> np.ndarray:
    parameters = mi.traverse(texture)
    for key, value in parameters.items():
        if key.split(".")[-1] == "to_uv":
            return np.array(value.matrix, float).reshape(3, 3)
    return np.eye(3)
