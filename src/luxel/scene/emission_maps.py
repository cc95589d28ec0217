"""How strongly each triangle emits under its texture and its vertices' colours.

Files that glow in a few places only often have one dark image over all of their triangles. A mean over the whole image
would have the light tree draw the dark ones as often as the others.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from luxel.scene.colours import LUMINANCE
from luxel.scene.model import Material, Texture
from luxel.scene.textures import to_linear

UNIT = 2.0**-24
"""Luminance is counted in whole units of this share of the factor's, rounded up: sums are exact, and 0 means black."""
FARTHEST = 1e6
"""Texture coordinates at most; what lies beyond may read any texel."""
SLACK = 0.25
"""Texels by which the kernels' single precision may read beside a triangle."""


@dataclass
class VertexLooks:
    """What the vertices of all triangles hold beside their places."""

    uv: np.ndarray
    """(V, 2)."""
    uv2: np.ndarray | None
    """(V, 2); None where the scene has none, so that the first set serves."""
    colors: np.ndarray | None
    """(V, 4)."""


def emitted_luminance(material: Material, looks: VertexLooks, vertices: np.ndarray) -> np.ndarray:
    """Return about the mean luminance (E,), W/(m^2 sr), of triangles with `vertices` (E, 3); 0 only where all is black.

    The mean is over the texels in the box around the triangle's texture coordinates.
    """
    factor = np.asarray(material.emission, np.float64)
    found = np.full(len(vertices), float(factor @ LUMINANCE))
    if not factor.any() or not len(vertices):
        return found
    texture = material.emission_texture
    if texture is not None:
        uv = looks.uv2 if texture.uv_set == 1 and looks.uv2 is not None else looks.uv
        found *= _mean_texels(texture, factor / factor.max(), uv[vertices].astype(np.float64))
    if material.emission_uses_colors and looks.colors is not None:
        found *= np.abs(looks.colors[vertices, :3]).max(axis=(1, 2))
    return found


def _mean_texels(texture: Texture, tint: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Return the mean luminance (E,), as a share of that of `tint` (3,), of what `fetch_texture` may read at `uv`."""
    image = to_linear(texture)[..., :3] @ (tint * LUMINANCE / (tint @ LUMINANCE)).astype(np.float32)
    image = np.ceil(np.maximum(image, 0.0) / UNIT).astype(np.int64)
    height, width = image.shape
    broken = ~(np.abs(uv) < FARTHEST).all(axis=(1, 2))
    uv[broken] = 0.0
    # What a triangle may read is a box of texels, which ends before `last`.
    matrix = np.asarray(texture.transform, np.float64)
    place = (uv @ matrix[:2, :2].T + matrix[:2, 2]) * (width, height) - 0.5
    first = np.floor(place.min(axis=1) - SLACK).astype(np.int64)
    last = np.floor(place.max(axis=1) + SLACK).astype(np.int64) + 2
    for axis, wrap, size in ((0, texture.wrap_u, width), (1, texture.wrap_v, height)):
        if wrap == "mirror":
            image = np.concatenate([image, np.flip(image, 1 - axis)], axis=1 - axis)
            size *= 2
        low, high = first[:, axis], last[:, axis]
        if wrap == "clamp":
            low = np.clip(low, 0, size - 1)
            high = np.clip(high, low + 1, size)
        else:
            low, high = low % size, low % size + high - low
        whole = broken | (high - low >= size)
        first[:, axis], last[:, axis] = np.where(whole, 0, low), np.where(whole, size, high)
    sums = np.zeros((image.shape[0] + 1, image.shape[1] + 1), np.int64)
    inner = sums[1:, 1:]
    image.cumsum(axis=0, out=inner).cumsum(axis=1, out=inner)
    (x0, y0), (x1, y1) = first.T, last.T
    total = _sum_to(sums, x1, y1) - _sum_to(sums, x0, y1) - _sum_to(sums, x1, y0) + _sum_to(sums, x0, y0)
    return total * UNIT / ((x1 - x0) * (y1 - y0))


def _sum_to(sums: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the sum of all texels from (0, 0) to below each (x, y), of an image that repeats for ever.

    `sums` (H + 1, W + 1) has these sums within the image (a summed-area table, Crow 1984).
    """
    height, width = sums.shape[0] - 1, sums.shape[1] - 1
    (column, x), (row, y) = np.divmod(x, width), np.divmod(y, height)
    return column * row * sums[-1, -1] + column * sums[y, -1] + row * sums[-1, x] + sums[y, x]
