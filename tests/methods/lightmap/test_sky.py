"""The sky's cells: their solid angles, and the light that an image brings to them, however small its sun."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.kernels.sky import sky_radiance
from luxel.methods.lightmap.bake.sky import cell_of_direction, make_sky_tree
from luxel.methods.lightmap.run.sky import average_sky
from luxel.scene.device import Scene, upload
from luxel.scene.library.shapes import quad
from luxel.scene.model import Material, Object, SceneData, Sky

RESOLUTION = 12


def under(image: np.ndarray, rotation: float = 0.0) -> Scene:
    plain = Object("plain", [quad((-5, 0, 5), (5, 0, 5), (5, 0, -5), (-5, 0, -5), 0)])
    # Bright spots stay in the image, as if they had been looked for: what is tested here is the sky alone.
    sky = Sky((2.0, 2.0, 2.0), image, rotation, suns=[])
    return upload(SceneData("field", [plain], [Material()], sky=sky))


@pytest.mark.parametrize("shape", [(16, 32), (128, 256), (1000, 2000)])
def test_a_sun_of_one_pixel_brings_what_it_brings(shape: tuple[int, int]) -> None:
    height, width = shape
    random = np.random.default_rng(5)
    _, _, angle = make_sky_tree(RESOLUTION)
    for _ in range(4):
        image = np.full((height, width, 3), 0.1, np.float32)
        row, column = int(random.integers(height // 8, height - height // 8)), int(random.integers(width))
        image[row, column] = 1e4
        theta = (np.arange(height) + 0.5) * np.pi / height
        pixel = np.sin(theta)[:, None] * (np.pi / height) * (2.0 * np.pi / width)
        wanted = float((image[..., 0] * pixel).sum())
        mean = np.array(average_sky(under(image), RESOLUTION)).T
        assert float((mean[:, 0] * angle).sum()) == pytest.approx(wanted, rel=0.02)


def test_an_image_lies_where_it_is_seen() -> None:
    """The brightest cell is the one that the sun's direction falls into, turned images included."""
    image = np.zeros((64, 128, 3), np.float32)
    image[20, 90] = 100.0
    for rotation in (0.0, 75.0):
        scene = under(image, rotation)
        lane = dr.arange(mi.UInt32, 200_000)
        z, phi = 1.0 - 2.0 * (mi.Float(lane) + 0.5) / 200_000, mi.Float(lane) * 2.399963
        r = dr.sqrt(1.0 - z * z)
        direction = mi.Vector3f(r * dr.cos(phi), z, r * dr.sin(phi))
        seen = np.array(sky_radiance(scene, direction, mi.Bool(True)).x)
        cell = np.array(cell_of_direction(direction, RESOLUTION))[seen.argmax()]
        assert np.array(average_sky(scene, RESOLUTION))[0].argmax() == cell


def test_a_sky_without_an_image_is_one() -> None:
    scene = under(np.ones((1, 1, 3), np.float32))
    np.testing.assert_allclose(np.array(average_sky(scene, RESOLUTION)), 1.0, rtol=1e-5)
