"""Directions towards the bright places of a sky image, against sums over the image done by NumPy."""

from __future__ import annotations

from dataclasses import replace

import mitsuba as mi
import numpy as np
import pytest
from tests.skies import look_up

from luxel.kernels.sky import is_sky_sampled, sample_sky, sky_density, sky_radiance
from luxel.scene.device import Scene, upload
from luxel.scene.library.shapes import quad
from luxel.scene.model import Material, Object, SceneData, Sky
from luxel.scene.sky_table import build_sky_table

LANES = 1 << 17


def scene_of(image: np.ndarray | None, rotation: float = 0.0) -> Scene:
    floor = Object("floor", [quad((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), 0)])
    # Bright spots stay in the image: what is tested here is the sky alone.
    sky = Sky((1.0, 1.0, 1.0), image, rotation, suns=[])
    return upload(SceneData("sky", [floor], [Material()], sky=sky))


def half_sky() -> np.ndarray:
    """An even sky over a black ground."""
    image = np.zeros((64, 128, 3), np.float32)
    image[:32] = 1.0
    return image


def images() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(3)
    # Not so bright beside the rest that upload cuts them out as suns.
    spots = (rng.random((40, 90, 3)) ** 6 * 5.0 + 0.1).astype(np.float32)
    single = np.zeros((32, 64, 3), np.float32)
    single[9, 0] = 4.0, 0.0, 1.0
    pole = np.zeros((16, 32, 3), np.float32)
    pole[0, 5] = 7.0
    large = np.full((700, 1300, 3), 0.2, np.float32)
    large[333:340, 611:640] = 30.0
    column = np.linspace(0.0, 2.0, 12, dtype=np.float32)[:, None, None] ** 4 * np.ones((1, 1, 3), np.float32)
    row = np.arange(5, dtype=np.float32)[None, :, None] ** 3 * np.ones((1, 1, 3), np.float32)
    return {"spots": spots, "one pixel": single, "pole": pole, "large": large, "column": column, "row": row}


EACH = pytest.mark.parametrize("image", images().values(), ids=images().keys())


def draws(scene: Scene) -> tuple[mi.Vector3f, np.ndarray]:
    """Return directions for random numbers, and their densities."""
    sample = np.random.default_rng(5).random((2, LANES)).astype(np.float32)
    direction, density = sample_sky(scene, mi.Point2f(np.minimum(sample, 1.0 - 2.0**-24)), mi.Bool(True))
    return direction, np.array(density, float)


def even_grid(rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Return directions (N, 3) at the middles of a latitude-longitude grid, and their solid angles (N,)."""
    edges = np.linspace(0.0, np.pi, rows + 1)
    theta, phi = np.meshgrid(0.5 * (edges[1:] + edges[:-1]), (np.arange(2 * rows) + 0.5) * np.pi / rows - np.pi)
    angle = np.broadcast_to((np.cos(edges[:-1]) - np.cos(edges[1:])) * np.pi / rows, theta.shape)
    d = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi)], axis=-1)
    return d.reshape(-1, 3), angle.ravel()


@EACH
def test_density_is_one_in_all_and_positive_wherever_the_sky_shines(image: np.ndarray) -> None:
    scene = scene_of(image)
    assert is_sky_sampled(scene)
    d, angle = even_grid(256)
    directions = mi.Vector3f(d.T.astype(np.float32))
    density = np.array(sky_density(scene, directions, mi.Bool(True)), float)
    assert (density * angle).sum() == pytest.approx(1.0, abs=0.01)
    shines = np.array(sky_radiance(scene, directions, mi.Bool(True))).max(axis=0) > 0.0
    assert shines.any() and (density[shines] > 0.0).all()


@EACH
@pytest.mark.parametrize("rotation", [0.0, 130.0])
def test_samples_have_the_density_that_they_tell(image: np.ndarray, rotation: float) -> None:
    """By the density of each direction, and by how many fall in each part of the sphere."""
    scene = scene_of(image, rotation)
    direction, told = draws(scene)
    found = np.array(sky_density(scene, direction, mi.Bool(True)), float)
    assert (np.abs(found - told) <= 1e-4 * told).mean() > 0.995
    # How many fall into each of 8 x 16 patches.
    d, angle = even_grid(256)
    grid = np.array(sky_density(scene, mi.Vector3f(d.T.astype(np.float32)), mi.Bool(True)), float) * angle
    expected = np.bincount(patch_of(d), weights=grid, minlength=128) * LANES
    counted = np.bincount(patch_of(np.array(direction).T), minlength=128)
    # Slack for patches whose edges run through cells.
    assert (np.abs(counted - expected) < 5.0 * np.sqrt(expected + 1.0) + 0.01 * LANES).all()


def patch_of(d: np.ndarray) -> np.ndarray:
    row = np.minimum((0.5 - 0.5 * d[:, 1]) * 8, 7).astype(int)
    column = np.minimum((np.arctan2(d[:, 0], -d[:, 2]) / (2.0 * np.pi) + 0.5) * 16, 15).astype(int)
    return 16 * row + column


@EACH
def test_light_over_density_is_the_skys_light(image: np.ndarray) -> None:
    scene = scene_of(image, 40.0)
    direction, density = draws(scene)
    light = np.array(sky_radiance(scene, direction, mi.Bool(True)), float) / density
    d, angle = even_grid(1024)
    expected = (look_up(image, d) * angle[:, None]).sum(axis=0)
    error = 5.0 * light.std(axis=1) / np.sqrt(LANES) + 2e-3 * expected.max()
    assert (np.abs(light.mean(axis=1) - expected) < error).all()


def test_a_sky_turns_with_its_samples() -> None:
    image = images()["one pixel"]
    d, _ = draws(scene_of(image))
    turned, _ = draws(scene_of(image, 90.0))
    np.testing.assert_allclose(np.array(turned.x), -np.array(d.z), atol=1e-5)
    np.testing.assert_allclose(np.array(turned.z), np.array(d.x), atol=1e-5)


@pytest.mark.parametrize(
    "image",
    [None, np.zeros((8, 16, 3)), np.full((8, 16, 3), 0.7), np.full((1, 1, 3), 2.0), half_sky()],
    ids=["none", "black", "one value", "one pixel", "half"],
)
def test_even_skies_are_left_to_the_cosine(image: np.ndarray | None) -> None:
    assert not is_sky_sampled(scene_of(None if image is None else image.astype(np.float32)))


def test_a_sky_that_is_out_is_not_sampled() -> None:
    scene = scene_of(images()["spots"])
    scene.lights = replace(scene.lights, has_sky=False)
    assert not is_sky_sampled(scene)


def test_focus_tells_a_spot_from_a_mild_sky() -> None:
    """The share of the light above twice the mean, by arithmetic: a cap of radiance 9 on a sky of 1."""
    mild = np.ones((64, 128, 3), np.float32) + 0.1 * np.linspace(-1, 1, 64, dtype=np.float32)[:, None, None]
    cap = np.ones((64, 128, 3), np.float32)
    cap[:16] = 9.0
    share = 0.5 * (1.0 - np.cos(np.pi / 4.0))
    mean = 1.0 + 8.0 * share
    expected = share * (9.0 - 2.0 * mean) / mean
    focus = [float(np.array(build_sky_table(image).focus)[0]) for image in (mild, half_sky(), cap, images()["pole"])]
    assert max(focus[:2]) < 1e-6 and focus[2] == pytest.approx(expected, abs=0.01) and focus[3] > 0.9
