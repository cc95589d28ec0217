"""Suns wider than one direction, against closed forms and quadrature."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy.integrate import dblquad

from luxel.kernels.direct import direct_irradiance, shadow_ray_count
from luxel.kernels.sun_disc import disc_radiance
from luxel.kernels.surface import free_surface
from luxel.scene.device import Scene, upload
from luxel.scene.library.shapes import quad
from luxel.scene.model import Light, Material, Object, SceneData

FAR = quad((90, 90, 90), (91, 90, 90), (91, 91, 90), (90, 91, 90), 0)
SAMPLES = 40_000


def scene_with(*lights: Light) -> Scene:
    return upload(SceneData("lit", [Object("all", [FAR])], [Material()], lights=list(lights)))


def irradiance(scene: Scene, normal: Sequence[float], samples: int = SAMPLES) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean (3,) at the origin and its standard error."""
    surface = free_surface(np.zeros((samples, 3)), np.tile(np.asarray(normal, float), (samples, 1)))
    lane = dr.arange(mi.UInt32, samples)
    found = np.array(direct_irradiance(scene, surface, dr.opaque(mi.UInt32, 3), lane, surface.active)).T
    found = np.broadcast_to(found, (samples, 3)).astype(float)
    return found.mean(axis=0), found.std(axis=0) / math.sqrt(samples)


def expected(diameter: float, tilt: float) -> float:
    """The irradiance of a disc that gives 1 on a facing plane, on one tilted by `tilt` degrees from its middle."""
    radius, angle = math.radians(diameter / 2), math.radians(tilt)

    def lit(phi: float, theta: float) -> float:
        cosine = math.cos(theta) * math.cos(angle) + math.sin(theta) * math.sin(angle) * math.cos(phi)
        return max(cosine, 0.0) * math.sin(theta)

    total = dblquad(lit, 0.0, radius, 0.0, 2 * math.pi, epsabs=1e-9, epsrel=1e-5)[0]
    return total / (math.pi * math.sin(radius) ** 2)


@pytest.mark.parametrize("diameter", [0.01, 0.53, 5.0, 20.0, 90.0])
@pytest.mark.parametrize("tilt", [0.0, 60.0, 88.0, 100.0])
def test_irradiance_of_a_disc_on_tilted_planes(diameter: float, tilt: float) -> None:
    """Also where the horizon cuts it."""
    scene = scene_with(Light("directional", (2.0, 4.0, 8.0), direction=(0.0, -1.0, 0.0), angular_diameter=diameter))
    angle = math.radians(tilt)
    mean, error = irradiance(scene, (math.sin(angle), math.cos(angle), 0.0))
    right = expected(diameter, tilt)
    np.testing.assert_allclose(mean / (2.0, 4.0, 8.0), right, atol=4.0 * error[0] / 2.0 + 2e-4 * right + 1e-7)


def test_a_sharp_sun_beside_a_soft_one_stays_sharp() -> None:
    sharp = Light("directional", (1.0, 1.0, 1.0), direction=(0.3, -1.0, 0.2))
    alone, _ = irradiance(scene_with(sharp), (0.0, 1.0, 0.0), 16)
    soft = replace(sharp, color=(1e-20, 1e-20, 1e-20), angular_diameter=30.0)
    both, error = irradiance(scene_with(sharp, soft), (0.0, 1.0, 0.0), 16)
    np.testing.assert_allclose(both, alone, rtol=1e-6)
    assert error.max() < 1e-9 and shadow_ray_count(scene_with(sharp, soft)) == 2


def test_more_than_eight_suns_are_sampled_without_bias() -> None:
    suns = [Light("directional", (1.0, 1.0, 1.0), direction=(0.0, -1.0, 0.0), angular_diameter=40.0) for _ in range(10)]
    mean, error = irradiance(scene_with(*suns), (0.0, 1.0, 0.0))
    np.testing.assert_allclose(mean, 10.0 * expected(40.0, 0.0), atol=4.0 * float(error.max()))


def test_a_soft_shadow_is_the_part_of_the_disc_that_is_seen() -> None:
    """A half plane overhead whose edge crosses the middle of the sun hides half of it."""
    roof = quad((0, 5, -50), (50, 5, -50), (50, 5, 50), (0, 5, 50), 0)
    sun = Light("directional", (1.0, 1.0, 1.0), direction=(0.0, -1.0, 0.0), angular_diameter=10.0)
    scene = upload(SceneData("lit", [Object("all", [FAR, roof])], [Material()], lights=[sun]))
    mean, error = irradiance(scene, (0.0, 1.0, 0.0))
    np.testing.assert_allclose(mean, 0.5, atol=4.0 * float(error.max()) + 1e-3)


def test_rays_that_ask_see_the_discs_of_the_sky_and_no_others() -> None:
    shown = Light("directional", (3.0, 2.0, 1.0), direction=(0.2, -0.8, -0.4), angular_diameter=2.0, in_sky=True)
    hidden = Light("directional", (9.0, 9.0, 9.0), direction=(-0.2, -0.8, -0.4), angular_diameter=2.0)
    scene = scene_with(hidden, shown)
    scene.lights.scale = dr.opaque(mi.Float, 2.0)
    middle = -np.array(shown.direction) / np.linalg.norm(shown.direction)
    side = np.cross(middle, (0.0, 1.0, 0.0))
    side /= np.linalg.norm(side)
    angles = np.radians([0.0, 0.99, 1.01, 90.0])
    rays = np.cos(angles)[:, None] * middle + np.sin(angles)[:, None] * side
    rays = np.concatenate([rays, -np.array([hidden.direction]) / np.linalg.norm(hidden.direction)])
    found = np.array(disc_radiance(scene, mi.Vector3f(*rays.T.astype(np.float32)), mi.Bool(True))).T
    right = 2.0 * np.array([3.0, 2.0, 1.0]) / (math.pi * math.sin(math.radians(1.0)) ** 2)
    np.testing.assert_allclose(found, [right, right, np.zeros(3), np.zeros(3), np.zeros(3)], rtol=1e-4)
