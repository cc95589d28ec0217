"""Texture look-ups against NumPy: decode, wrap, filter, transform, second coordinates."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from luxel.kernels.texture import fetch_texture
from luxel.scene.library.shapes import quad
from luxel.scene.model import Material, Object, SceneData, Texture
from luxel.scene.textures import build_material_tables

EIGHT_BITS = 0.5 / 255.0
SQUARE_ROOT = 2.0 * EIGHT_BITS + EIGHT_BITS**2
"""Largest error of a colour in 0..1 that is stored as an 8-bit square root."""


def fetch(texture: Texture, uv: np.ndarray, uv2: np.ndarray | None = None, data: bool = False) -> np.ndarray:
    """Return (N, 4) look-ups of `texture` as base colour, or as data (a normal map's slot)."""
    material = Material(normal_texture=texture) if data else Material(base_color_texture=texture)
    floor = Object("floor", [quad((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), 0)])
    tables = build_material_tables(SceneData("textured", [floor], [material]))
    row = mi.UInt32(int(np.array(tables.slots)[2 if data else 0]))
    first, second = (mi.Point2f((uv if a is None else a).T.astype(np.float32)) for a in (uv, uv2))
    return np.array(fetch_texture(tables, row, first, second, mi.Bool(np.ones(len(uv), bool)))).T


def decode(image: np.ndarray) -> np.ndarray:
    """Decode 8-bit sRGB by the standard's curve (IEC 61966-2-1)."""
    c = image.astype(float) / 255.0
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def fold(index: np.ndarray, size: int, wrap: str) -> np.ndarray:
    if wrap == "clamp":
        return np.clip(index, 0, size - 1)
    if wrap == "repeat":
        return index % size
    index = index % (2 * size)
    return np.where(index < size, index, 2 * size - 1 - index)


def look_up(image: np.ndarray, uv: np.ndarray, wrap_u: str, wrap_v: str, nearest: bool) -> np.ndarray:
    """Filter a linear (H, W, C) image at `uv`; texel centres are at (i + 1/2) / size, row 0 at v = 0."""
    height, width = image.shape[:2]
    x, y = uv[:, 0] * width, uv[:, 1] * height
    if nearest:
        return image[fold(np.floor(y).astype(int), height, wrap_v), fold(np.floor(x).astype(int), width, wrap_u)]
    x0, y0 = np.floor(x - 0.5).astype(int), np.floor(y - 0.5).astype(int)
    fx, fy = (x - 0.5 - x0)[:, None], (y - 0.5 - y0)[:, None]
    total = 0.0
    for i, wx in ((0, 1.0 - fx), (1, fx)):
        for j, wy in ((0, 1.0 - fy), (1, fy)):
            total = total + wx * wy * image[fold(y0 + j, height, wrap_v), fold(x0 + i, width, wrap_u)]
    return np.asarray(total)


def image_of(seed: int, height: int = 5, width: int = 8, channels: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (height, width, channels)).astype(np.uint8)


def points_of(seed: int, low: float = -2.3, high: float = 3.3) -> np.ndarray:
    """Return (N, 2) points whose texels are clear in float32."""
    uv = np.random.default_rng(seed).uniform(low, high, (2000, 2))
    edge = np.abs((uv * (8, 5)) - np.round(uv * (8, 5))).min(axis=1)
    return uv[edge > 1e-3]


@pytest.mark.parametrize("nearest", [False, True])
@pytest.mark.parametrize("wrap", ["repeat", "clamp", "mirror"])
def test_wrap_and_filter(wrap: Any, nearest: bool) -> None:
    image, uv = image_of(1), points_of(2)
    other: Any = {"repeat": "mirror", "clamp": "repeat", "mirror": "clamp"}[wrap]
    texture = Texture(image, srgb=False, wrap_u=wrap, wrap_v=other, nearest=nearest)
    expected = look_up(image / 255.0, uv, wrap, other, nearest)
    found = fetch(texture, uv)
    np.testing.assert_allclose(found[:, :3], expected, atol=SQUARE_ROOT + 2e-4)
    np.testing.assert_array_equal(found[:, 3], 1.0)


def test_srgb_is_decoded_before_it_is_filtered() -> None:
    image, uv = image_of(3), points_of(4)
    expected = look_up(decode(image), uv, "repeat", "repeat", False)
    np.testing.assert_allclose(fetch(Texture(image), uv)[:, :3], expected, atol=SQUARE_ROOT + 2e-4)
    # A dark and a bright texel meet: filtering the code values instead would be 0.21 off.
    pair = np.array([[[0] * 3, [255] * 3]], np.uint8)
    middle = fetch(Texture(pair, wrap_u="clamp"), np.array([[0.5, 0.5]]))
    np.testing.assert_allclose(middle[0, :3], 0.5, atol=SQUARE_ROOT)


def test_data_is_read_as_it_is() -> None:
    image, uv = image_of(5), points_of(6)
    expected = look_up(image / 255.0, uv, "repeat", "repeat", False)
    found = fetch(Texture(image, srgb=False), uv, data=True)
    np.testing.assert_allclose(found[:, :3], expected, atol=2e-4)


def test_alpha_and_grey_images() -> None:
    image, uv = image_of(7, channels=4), points_of(8)
    expected = look_up(image[..., 3:] / 255.0, uv, "repeat", "repeat", False)
    np.testing.assert_allclose(fetch(Texture(image), uv)[:, 3:], expected, atol=2e-4)
    grey = image_of(9, channels=1).astype(np.float32) / 255.0
    expected = look_up(grey.astype(float), uv, "repeat", "repeat", False).repeat(3, axis=1)
    np.testing.assert_allclose(fetch(Texture(grey, srgb=False), uv)[:, :3], expected, atol=SQUARE_ROOT + 2e-4)


def test_transform() -> None:
    image, uv = image_of(10), points_of(11, -1.0, 1.0)
    angle = 0.6
    matrix = np.array(
        [[2.0 * np.cos(angle), np.sin(angle), 0.3], [-np.sin(angle), 1.5 * np.cos(angle), -0.7], [0, 0, 1]]
    )
    moved = uv @ matrix[:2, :2].T + matrix[:2, 2]
    expected = look_up(image / 255.0, moved, "repeat", "repeat", False)
    found = fetch(Texture(image, srgb=False, transform=matrix.astype(np.float32)), uv)
    np.testing.assert_allclose(found[:, :3], expected, atol=SQUARE_ROOT + 5e-4)


def test_second_coordinates() -> None:
    image, uv, uv2 = image_of(12), points_of(13)[:1500], points_of(14)[:1500]
    expected = look_up(image / 255.0, uv2, "repeat", "repeat", False)
    found = fetch(Texture(image, srgb=False, uv_set=1), uv, uv2)
    np.testing.assert_allclose(found[:, :3], expected, atol=SQUARE_ROOT + 2e-4)


def test_row_zero_and_inactive_lanes_read_one() -> None:
    floor = Object("floor", [quad((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), 0)])
    texture = Texture(np.zeros((2, 2, 3), np.uint8))
    tables = build_material_tables(SceneData("textured", [floor], [Material(base_color_texture=texture)]))
    row = mi.UInt32([0, 1, 1])
    uv = mi.Point2f([0.2, 0.2, 0.2], [0.2, 0.2, 0.2])
    found = np.array(fetch_texture(tables, row, uv, uv, mi.Bool([True, False, True]))).T
    np.testing.assert_array_equal(found, [[1, 1, 1, 1], [1, 1, 1, 1], [0, 0, 0, 1]])
