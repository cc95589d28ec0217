"""Surfels whose rays look for the sky: the same light for any share, with less noise."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from luxel.methods.gibs.params import EKBERG
from luxel.render.renderer import Renderer
from luxel.scene.library.shapes import quad
from luxel.scene.model import Camera, Material, Object, SceneData, Sky

SMALL = {"surfel_target": 300, "longest_window": 4096}
ROWS = 64


def sky_directions(rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the directions of a latitude-longitude image's pixels and their solid angles."""
    theta, phi = np.meshgrid((np.arange(rows) + 0.5) / rows, (np.arange(2 * rows) + 0.5) / rows - 1.0, indexing="ij")
    theta, phi = np.pi * theta, np.pi * phi
    d = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi)], axis=-1)
    return d, np.sin(theta) * (np.pi / rows) ** 2


def disc_sky(glow: float = 3.0) -> np.ndarray:
    """A sky that is dim above, of radiance `glow` below the horizon, with a bright disc of 15 degrees."""
    d, _ = sky_directions(ROWS)
    image = np.full((ROWS, 2 * ROWS, 3), 0.2, np.float32)
    image[d[..., 1] < -0.3] = glow
    image[d @ np.array((0.6, 0.8, 0.0)) > np.cos(np.radians(7.5))] = 40.0
    return image


def plain(turn: float = 0.0, glow: float = 3.0) -> SceneData:
    """A floor seen from above; `turn` in degrees about +Z tilts it."""
    floor = Object("floor", [quad((-2, 0, 2), (2, 0, 2), (2, 0, -2), (-2, 0, -2), 0)])
    angle = np.radians(turn)
    floor.to_world[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    up = np.array((-np.sin(angle), np.cos(angle), 0.0))
    camera = Camera(tuple(2.0 * up), (0.0, 0.0, 0.0), (0.0, 0.0, -1.0), fov=60.0)
    return SceneData("plain", [floor], [Material()], cameras=[camera], sky=Sky((1.0, 1.0, 1.0), disc_sky(glow)))


def expected_light(turn: float) -> float:
    """Return the irradiance of the floor: the sum over the image's pixels."""
    d, angle = sky_directions(ROWS * 4)
    up = np.array((-np.sin(np.radians(turn)), np.cos(np.radians(turn)), 0.0))
    fine = np.kron(disc_sky()[..., 0], np.ones((4, 4)))
    return float((fine * angle * np.maximum(d @ up, 0.0)).sum())


@cache
def lit(share: float, turn: float = 0.0, frames: int = 256, glow: float = 3.0, **dials: object) -> np.ndarray:
    dials = {**SMALL, "sky_share": share, **dials}
    renderer = Renderer(plain(turn, glow), "gibs", dials, size=(32, 32), seed=2)
    renderer.run(frames)
    return renderer.layers().indirect.mean(axis=2)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
@pytest.mark.parametrize("turn", [0.0, 50.0])
def test_any_share_brings_the_light_of_the_sky(share: float, turn: float) -> None:
    """A tilted floor has the glow below the horizon before it, and half of the sky behind it."""
    assert lit(share, turn).mean() == pytest.approx(expected_light(turn), rel=0.02)


def test_random_rays_do_too() -> None:
    assert lit(0.5, low_discrepancy=False).mean() == pytest.approx(expected_light(0.0), rel=0.03)


def test_the_default_share_calms_the_light() -> None:
    # Guided rays would find the disc too.
    blind, sought = (lit(share, frames=48, glow=0.1, guide_share=0.0) for share in (0.0, 0.3))
    assert sought.std() < 0.5 * blind.std()


def test_pixels_that_no_surfel_answers_yet_look_for_the_sky_too() -> None:
    """The first frame is the mean of a few rays a tile."""
    blind, sought = (lit(share, frames=1, glow=0.1) for share in (0.0, 0.5))
    # A floor that sees the sky alone has one irradiance.
    d, angle = sky_directions(ROWS)
    expected = float((disc_sky(0.1)[..., 0] * angle * np.maximum(d[..., 1], 0.0)).sum())
    assert sought.mean() == pytest.approx(expected, rel=0.1)
    errors = [np.sqrt(np.mean((image - expected) ** 2)) for image in (blind, sought)]
    assert errors[1] < 0.4 * errors[0]


def test_no_light_is_below_zero() -> None:
    """One ray a surfel, most of them towards a disc behind a wall: what is known already is taken off several times."""
    data = plain(glow=0.1)
    wall = quad((0.3, 0, 2), (0.3, 3, 2), (0.3, 3, -2), (0.3, 0, -2), 0)
    data.objects.append(Object("wall", [wall]))
    assert data.sky.image is not None
    data.sky.image = np.where(data.sky.image > 1.0, np.float32(2000.0), data.sky.image)
    renderer = Renderer(data, "gibs", {**SMALL, "sky_share": 0.9, "rays_per_surfel": 1}, size=(32, 32), seed=3)
    for _ in range(24):
        renderer.run(1)
        assert renderer.layers().indirect.min() >= 0.0


def test_a_far_ground_takes_the_bright_places_of_the_sky() -> None:
    """A sign on a ground of 10 km, which it sees by half: the ground's light is the sky's by its albedo."""
    d, angle = sky_directions(ROWS * 4)
    sky = np.where(disc_sky(0.1) > 1.0, np.float32(1000.0), np.float32(0.1))
    fine = np.kron(sky[..., 0], np.ones((4, 4))) * angle
    above = d[..., 1] > 0.0
    expected = (fine * above * np.maximum(d[..., 0], 0.0)).sum() + 0.25 * (fine * np.maximum(d[..., 1], 0.0)).sum()
    sign = quad((0, 0, 1), (0, 0, -1), (0, 2, -1), (0, 2, 1), 0)
    ground = quad((-5e3, 0, 5e3), (5e3, 0, 5e3), (5e3, 0, -5e3), (-5e3, 0, -5e3), 0)
    half = Material(base_color=(0.5, 0.5, 0.5))
    data = SceneData("sign", [Object("all", [sign, ground])], [half], sky=Sky((1.0, 1.0, 1.0), sky))
    data.cameras = [Camera((1.5, 1.0, 0.0), (0.0, 1.0, 0.0), fov=40.0)]
    renderer = Renderer(data, "gibs", SMALL, size=(32, 32), seed=2)
    renderer.run(192)
    found = renderer.layers().indirect.mean(axis=2)
    # Sums over pixels, where the look-up goes straight between their centres, are right to 1.5 %.
    assert found.mean() == pytest.approx(expected, rel=0.03)
    assert found.std() < 0.08 * expected


def test_the_papers_preset_looks_for_nothing() -> None:
    assert EKBERG["sky_share"] == 0.0
