"""The light sampler against closed forms and quadrature."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy.integrate import dblquad

from luxel.kernels.direct import direct_irradiance, shadow_ray_count
from luxel.kernels.surface import free_surface
from luxel.scene.device import Scene, upload
from luxel.scene.library.shapes import box, quad
from luxel.scene.model import Light, Material, Mesh, Object, SceneData, Texture

FAR = quad((90, 90, 90), (91, 90, 90), (91, 91, 90), (90, 91, 90), 0)
"""Something to trace that is in nobody's way; it makes the scene 150 m wide, which must change nothing."""
UP = (0.0, 1.0, 0.0)


def scene_with(lights: Sequence[Light] = (), meshes: Sequence[Mesh] = (), materials: Sequence[Material] = ()) -> Scene:
    objects = [Object("all", [FAR, *meshes])]
    return upload(SceneData("lit", objects, [Material(), *materials], lights=list(lights)))


def irradiance(scene: Scene, point: Sequence[float], normal: Sequence[float] = UP, samples: int = 1, seed: int = 1):
    """Return the mean (3,) and its standard error over `samples` lanes at one point."""
    p, n = np.tile(point, (samples, 1)), np.tile(normal, (samples, 1))
    lane = dr.arange(mi.UInt32, samples)
    surface = free_surface(p, n)
    found = np.array(direct_irradiance(scene, surface, dr.opaque(mi.UInt32, seed), lane, surface.active)).T
    found = np.broadcast_to(found, (samples, 3)).astype(float)
    return found.mean(axis=0), found.std(axis=0) / np.sqrt(samples)


def expect_mean(scene: Scene, point: Sequence[float], normal: Sequence[float], expected: float, samples: int) -> None:
    """The estimate's mean is `expected` within four standard errors, which are under 1 %."""
    mean, error = irradiance(scene, point, normal, samples)
    assert error.max() < 0.01 * expected
    np.testing.assert_allclose(mean, expected, atol=4.0 * float(error.max()) + 1e-5 * expected)


# ---------------------------------------------------------------------------------------------------- delta lights


def test_point_light_falls_with_the_square_and_the_cosine() -> None:
    scene = scene_with([Light("point", (3.0, 6.0, 9.0), position=(0.0, 2.0, 0.0))])
    for point in ((0.0, 0.0, 0.0), (1.5, 0.0, 0.0), (-3.0, 1.0, 4.0), (0.0, -8.0, 0.0)):
        offset = np.array([0.0, 2.0, 0.0]) - point
        expected = np.array([3.0, 6.0, 9.0]) * offset[1] / np.linalg.norm(offset) ** 3
        np.testing.assert_allclose(irradiance(scene, point)[0], expected, rtol=1e-4)
    assert not irradiance(scene, (0.0, 3.0, 0.0))[0].any(), "it is below the surface"


def test_directional_light_has_the_cosine_only() -> None:
    direction = np.array([0.5, -1.0, 0.2])
    scene = scene_with([Light("directional", (2.0, 4.0, 8.0), direction=tuple(3.0 * direction))])
    cosine = 1.0 / np.linalg.norm(direction)
    for point in ((0.0, 0.0, 0.0), (40.0, -60.0, 0.0)):
        np.testing.assert_allclose(irradiance(scene, point)[0], np.array([2.0, 4.0, 8.0]) * cosine, rtol=1e-4)
    assert not irradiance(scene, (0, 0, 0), (0.0, -1.0, 0.0))[0].any()


def test_spot_light_ramps_between_its_cones() -> None:
    """KHR_lights_punctual: the squared ramp of the cosine between the outer and the inner angle."""
    inner, outer = np.cos(0.3), np.cos(0.6)
    spot = Light("spot", (10.0, 10.0, 10.0), (0.0, 1.0, 0.0), (0.0, -2.0, 0.0), inner, outer)
    scene = scene_with([spot])
    for angle in (0.0, 0.29, 0.35, 0.45, 0.55, 0.61, 1.2):
        x = np.tan(angle)
        ramp = np.clip((np.cos(angle) - outer) / (inner - outer), 0.0, 1.0) ** 2
        expected = 10.0 * ramp * np.cos(angle) ** 3
        np.testing.assert_allclose(irradiance(scene, (x, 0.0, 0.0))[0], expected, rtol=1e-3, atol=1e-6)


def test_range_is_a_window() -> None:
    scene = scene_with([Light("point", (5.0, 5.0, 5.0), position=(0.0, 0.0, 0.0), range=4.0)])
    for distance in (0.5, 2.0, 3.5, 3.99, 4.0, 7.0):
        window = np.clip(1.0 - (distance / 4.0) ** 4, 0.0, 1.0) ** 2
        found = irradiance(scene, (0.0, -distance, 0.0))[0]
        np.testing.assert_allclose(found, 5.0 * window / distance**2, rtol=2e-3, atol=1e-7)


def test_each_delta_light_has_its_own_shadow() -> None:
    """Two lights, a blocker between one of them and the point; eight cost eight rays and no noise."""
    blocker = quad((-1, 1, -1), (1, 1, -1), (1, 1, 1), (-1, 1, 1), 0)
    lights = [Light("point", (4.0, 4.0, 4.0), (0.0, 2.0, 0.0)), Light("point", (1.0, 1.0, 1.0), (5.0, 0.5, 0.0))]
    scene = scene_with(lights, [blocker])
    offset = np.array([5.0, 0.5, 0.0])
    only_second = 0.5 / np.linalg.norm(offset) ** 3
    np.testing.assert_allclose(irradiance(scene, (0.0, 0.0, 0.0))[0], only_second, rtol=1e-4)
    assert shadow_ray_count(scene) == 2
    # A blocker behind the light blocks nothing.
    np.testing.assert_allclose(irradiance(scene, (0.0, 1.5, 0.0))[0], 4.0 / 0.25, rtol=1e-2)


def test_a_light_on_the_other_side_of_the_triangle_gives_nothing() -> None:
    """A shading normal may lean towards a light that the geometric normal cannot see."""
    scene = scene_with([Light("directional", (1.0, 1.0, 1.0), direction=(-1.0, 0.1, 0.0))])
    surface = free_surface(np.zeros((1, 3)), np.array([UP]))
    surface.n_shading = mi.Normal3f(0.8, 0.6, 0.0)
    found = direct_irradiance(scene, surface, mi.UInt32(0), mi.UInt32(0), mi.Bool(True))
    assert not np.array(found).any()


@pytest.mark.parametrize("suns", [0, 1, 10])
def test_many_delta_lights_are_sampled_without_bias(suns: int) -> None:
    """Suns have a ray each, eight at most; those beyond and all lamps share one."""
    rng = np.random.default_rng(1)
    lights = [
        Light("point", tuple(rng.uniform(0.1, 6.0) * np.ones(3)), tuple(rng.uniform((-3, 0.5, -3), (3, 4, 3))))
        for _ in range(20)
    ]
    for index in range(suns):
        lights[3 + index] = Light("directional", (2.0, 2.0, 2.0), direction=(0.2, -1.0, 0.1 * (index + 3)))
    lights[17] = Light("spot", (9.0, 9.0, 9.0), (1.0, 3.0, 0.0), (0.0, -1.0, 0.0), 0.9, 0.7)
    scene = scene_with(lights)
    assert shadow_ray_count(scene) == min(suns, 8) + 1
    alone = sum(irradiance(scene_with([light]), (0.3, 0.0, -0.2))[0][0] for light in lights)
    expect_mean(scene, (0.3, 0.0, -0.2), UP, float(alone), 1 << 20)


# ------------------------------------------------------------------------------------------------------ area lights

LAMP = Material(emission=(3.0, 3.0, 3.0))
LAMP_SIDES = (0.8, 0.5)


def lamp(height: float, material: int = 1) -> Mesh:
    """Return a rectangle around (0, height, 0) that faces down."""
    x, z = LAMP_SIDES
    return quad((-x, height, -z), (x, height, -z), (x, height, z), (-x, height, z), material)


def quadrature(point: Sequence[float], normal: Sequence[float], height: float, left: float = -LAMP_SIDES[0]) -> float:
    """Return the integral of L cos cos' / r^2 over the lamp's part right of x = `left`."""

    def integrand(z: float, x: float) -> float:
        offset = np.array([x, height, z]) - point
        squared = offset @ offset
        return 3.0 * max(offset @ np.asarray(normal), 0.0) * max(offset[1], 0.0) / squared**2

    x, z = LAMP_SIDES
    return float(dblquad(integrand, left, x, -z, z, epsabs=1e-6, epsrel=1e-5)[0])


@pytest.mark.parametrize(
    ("point", "normal"),
    [
        ((0.0, 0.0, 0.0), UP),
        ((2.0, 0.0, 1.0), UP),
        ((0.5, 0.8, 0.1), UP),
        ((1.4, 0.5, 0.2), (-1.0, 0.0, 0.0)),
        ((0.3, 0.2, 0.2), (0.6, 0.8, 0.0)),
    ],
)
def test_a_rectangle_gives_its_form_factor(point: tuple[float, ...], normal: tuple[float, ...]) -> None:
    scene = scene_with([], [lamp(1.0)], [LAMP])
    expect_mean(scene, point, normal, quadrature(point, normal, 1.0), 1 << 18)


def test_the_estimates_are_independent_of_the_seed() -> None:
    scene = scene_with([], [lamp(1.0)], [LAMP])
    point = (2.0, 0.0, 1.0)
    means = [irradiance(scene, point, UP, 1 << 14, seed)[0][0] for seed in range(8)]
    error = irradiance(scene, point, UP, 1 << 14)[1][0]
    assert 0.2 * error < np.std(means) < 3.0 * error
    assert np.mean(means) == pytest.approx(quadrature(point, UP, 1.0), abs=4.0 * error / np.sqrt(8))


def test_emitters_of_unlike_power_and_distance_sum_up() -> None:
    """A dim near one and a bright far one: candidates by power alone would be noisy, never wrong."""
    dim = Material(emission=(0.3, 0.3, 0.3))
    scene = scene_with([], [lamp(0.4, 2), lamp(6.0)], [LAMP, dim])
    point = (1.2, 0.0, 0.0)
    # The near one shadows nothing of the far one from there.
    expected = 0.1 * quadrature(point, UP, 0.4) + quadrature(point, UP, 6.0)
    expect_mean(scene, point, UP, expected, 1 << 18)


def test_emission_is_one_sided_unless_asked() -> None:
    above = (0.2, 2.0, 0.0)
    down = (0.0, -1.0, 0.0)
    mirrored = quadrature((0.2, 0.0, 0.0), UP, 1.0)
    assert not irradiance(scene_with([], [lamp(1.0)], [LAMP]), above, down, 4096)[0].any()
    both = Material(emission=(3.0, 3.0, 3.0), emit_back=True)
    scene = scene_with([], [lamp(1.0)], [both])
    expect_mean(scene, above, down, mirrored, 1 << 17)
    expect_mean(scene, (0.2, 0.0, 0.0), UP, mirrored, 1 << 17)


def test_a_blocker_hides_half_the_lamp() -> None:
    """A sheet that meets the lamp's middle line and ends at the point's plane hides what is left of it."""
    sheet = quad((0.0, -1.0, -9.0), (0.0, 0.999, -9.0), (0.0, 0.999, 9.0), (0.0, -1.0, 9.0), 0)
    scene = scene_with([], [lamp(1.0), sheet], [LAMP])
    point = (0.6, 0.0, 0.1)
    expect_mean(scene, point, UP, quadrature(point, UP, 1.0, left=0.0), 1 << 18)
    closed = box((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5), 0)
    assert not irradiance(scene_with([], [lamp(1.0), closed], [LAMP]), (0.0, -0.2, 0.0), UP, 4096)[0].any()


def test_an_emission_texture_lights_by_its_pixels() -> None:
    """The right half of the texture is black: what comes is the left half of the lamp."""
    image = np.zeros((1, 2, 3), np.uint8)
    image[:, 1] = 255
    glow = Material(
        emission=(3.0, 3.0, 3.0), emission_texture=Texture(image, nearest=True, wrap_u="clamp", wrap_v="clamp")
    )
    scene = scene_with([], [lamp(1.0)], [glow])
    point = (0.4, 0.0, 0.0)
    expect_mean(scene, point, UP, quadrature(point, UP, 1.0, left=0.0), 1 << 18)


def test_light_scale_multiplies_everything() -> None:
    scene = scene_with([Light("point", (1.0, 1.0, 1.0), (0.0, 3.0, 0.0))], [lamp(1.0)], [LAMP])
    plain = irradiance(scene, (1.0, 0.0, 0.0), UP, 64)[0]
    scene.lights.scale = dr.opaque(mi.Float, 7.0)
    np.testing.assert_allclose(irradiance(scene, (1.0, 0.0, 0.0), UP, 64)[0], 7.0 * plain, rtol=1e-5)
