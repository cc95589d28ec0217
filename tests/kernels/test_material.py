"""What a material emits and lets through: seen and sampled alike, against sums over the surface by NumPy."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.kernels.direct import direct_irradiance
from luxel.kernels.surface import free_surface, surface_at
from luxel.kernels.trace import trace_closest, trace_occluded
from luxel.kernels.transmittance import trace_transmittance
from luxel.scene.device import choose_layer, upload
from luxel.scene.model import Material, Mesh, Object, SceneData, Texture

SIDE = np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]], np.float32)
FACES = np.array([[0, 2, 1], [0, 3, 2]], np.uint32)
"""A square of 2 m in the plane y = 0; its front is up."""
UV = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
POINT = np.array([[0.3, 0.8, -0.2]])
"""Where the light is measured, facing down."""


def bright_corner(channels: int = 3) -> np.ndarray:
    """Return a 2 x 2 image whose first texel alone is bright; the fourth channel is that texel alone, too."""
    image = np.zeros((2, 2, channels), np.float32)
    image[0, 0] = 1.0
    return image


def square(**more: object) -> Mesh:
    return Mesh(SIDE, FACES, 0, uv=UV, **more)  # type: ignore[arg-type]


def cell_colours() -> np.ndarray:
    return np.array([[1, 1, 1], [0, 0, 0], [0, 0, 0], [0, 0, 0]], np.float32)


FLIPPED = np.array([[-1, 0, 1], [0, -1, 1], [0, 0, 1]], np.float32)
"""uv' = 1 - uv."""
BRIGHT = Texture(bright_corner(), srgb=False, nearest=True)
HOLES = Texture(bright_corner(4), srgb=False, nearest=True)


def in_first_quarter(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return ((u < 0.5) & (v < 0.5)).astype(float)


def in_last_quarter(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return ((u > 0.5) & (v > 0.5)).astype(float)


def first_corner(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The first corner's weight: the square is cut along its diagonal from the first to the third corner."""
    return 1.0 - np.maximum(u, v)


def shines(**more: object) -> Material:
    return Material(base_color=(0, 0, 0), emission=(3.0, 2.0, 1.0), **more)  # type: ignore[arg-type]


GLOWING = {
    "plain": (shines(), square(), lambda u, v: np.ones_like(u)),
    "texture": (shines(emission_texture=BRIGHT), square(), in_first_quarter),
    "second uv set": (shines(emission_texture=replace(BRIGHT, uv_set=1)), square(uv2=1 - UV), in_last_quarter),
    "moved texture": (shines(emission_texture=replace(BRIGHT, transform=FLIPPED)), square(), in_last_quarter),
    "cut-out": (shines(base_color_texture=HOLES, alpha_mode="mask"), square(), in_first_quarter),
    "unlit vertex colours": (shines(emission_uses_colors=True), square(colors=cell_colours()), first_corner),
    "lit vertex colours": (shines(), square(colors=cell_colours()), lambda u, v: np.ones_like(u)),
    "blended": (shines(alpha=0.25, alpha_mode="blend"), square(), lambda u, v: np.full_like(u, 0.25)),
}


def irradiance_by_sum(pattern) -> np.ndarray:  # noqa: ANN001
    """Return the irradiance (3,) at POINT as a sum over 400 x 400 cells of the square."""
    at = (np.arange(400) + 0.5) / 400
    u, v = np.meshgrid(at, at, indexing="ij")
    x, z = 2 * u - 1, 2 * v - 1
    offset = np.stack([x - POINT[0, 0], np.full_like(x, -POINT[0, 1]), z - POINT[0, 2]], axis=-1)
    squared = (offset**2).sum(axis=-1)
    cosines = (POINT[0, 1] / np.sqrt(squared)) ** 2
    weight = pattern(u, v) * cosines / squared * (2 / 400) ** 2
    return weight.sum() * np.array([3.0, 2.0, 1.0])


def sampled_irradiance(scene, normal: float, count: int = 1 << 17) -> np.ndarray:  # noqa: ANN001
    points = np.repeat(POINT * (1, -normal, 1), count, axis=0)
    surface = free_surface(points, np.repeat([[0.0, normal, 0.0]], count, axis=0))
    light = direct_irradiance(scene, surface, mi.UInt32(7), dr.arange(mi.UInt32, count), mi.Bool(True))
    return np.array(light).mean(axis=1)


@pytest.mark.parametrize("name", GLOWING)
def test_sampled_light_is_the_sum_over_what_is_seen(name: str) -> None:
    material, mesh, pattern = GLOWING[name]
    scene = upload(SceneData(name, [Object("lamp", [mesh])], [material]))
    np.testing.assert_allclose(sampled_irradiance(scene, -1.0), irradiance_by_sum(pattern), rtol=0.01)
    # The back emits nothing unless it is told to.
    assert sampled_irradiance(scene, 1.0).max() == 0.0
    material = replace(material, emit_back=True)
    scene = upload(SceneData(name, [Object("lamp", [mesh])], [material]))
    np.testing.assert_allclose(sampled_irradiance(scene, 1.0), irradiance_by_sum(pattern), rtol=0.01)


@pytest.mark.parametrize("name", [name for name in GLOWING if name not in ("cut-out", "blended")])
def test_seen_emission_follows_its_pattern(name: str) -> None:
    material, mesh, pattern = GLOWING[name]
    scene = upload(SceneData(name, [Object("lamp", [mesh])], [material]))
    at = np.random.default_rng(4).uniform(0.05, 0.95, (500, 2))
    # The second triangle has the corners 0, 3, 2: u = weight of the third, v = both weights.
    upper = at[:, 1] > at[:, 0]
    second = np.where(upper, at[:, 1] - at[:, 0], at[:, 1])
    third = np.where(upper, at[:, 0], at[:, 0] - at[:, 1])
    barycentric = mi.Point2f(mi.Float(second), mi.Float(third))
    prim = mi.UInt32(upper.astype(np.uint32))
    seen = surface_at(scene, prim, barycentric, mi.Bool(True)).emission
    expected = pattern(at[:, 0], at[:, 1])[:, None] * (3.0, 2.0, 1.0)
    np.testing.assert_allclose(np.array(seen).T, expected, atol=2e-2)


@pytest.mark.parametrize("one_accel", [None, True])
def test_blended_sheets_stop_their_share_of_the_rays(one_accel: bool | None) -> None:
    """Three sheets of alpha 0.3: 0.7^3 of the rays pass, by either query, and another layer lets others by."""
    meshes = [replace(square(), positions=SIDE + np.array([0, -0.1 * i, 0], np.float32)) for i in range(3)]
    material = Material(alpha=0.3, alpha_mode="blend")
    scene = upload(SceneData("sheets", [Object("sheets", meshes)], [material]), one_accel)
    count = 1 << 16
    at = np.random.default_rng(5).uniform(-0.9, 0.9, (2, count)).astype(np.float32)
    origin = mi.Point3f(mi.Float(at[0]), mi.Float(1.0), mi.Float(at[1]))
    down = mi.Vector3f(0.0, -1.0, 0.0)
    passed = []
    for seed in (1, 2):
        layer = choose_layer(scene, mi.UInt32(seed))
        hit = trace_closest(layer, origin, down, dr.full(mi.Bool, True, count))
        blocked = trace_occluded(layer, origin, down, mi.Float(5.0), dr.full(mi.Bool, True, count))
        np.testing.assert_array_equal(np.array(blocked), np.array(hit.valid))
        passes = trace_transmittance(layer, origin, down, mi.Float(5.0), dr.full(mi.Bool, True, count))
        np.testing.assert_array_equal(np.array(passes), np.tile(~np.array(hit.valid), (3, 1)))
        assert float(np.array(passes).mean()) == pytest.approx(0.343, abs=0.008)
        passed.append(~np.array(hit.valid))
        sheets = [float(np.mean(np.abs(np.array(hit.t) - 1.0 - 0.1 * i) < 0.05)) for i in range(3)]
        np.testing.assert_allclose(sheets, [0.3, 0.7 * 0.3, 0.49 * 0.3], atol=0.008)
        assert float(np.mean(passed[-1])) == pytest.approx(0.343, abs=0.008)
    assert np.mean(passed[0] & passed[1]) == pytest.approx(0.343**2, abs=0.008)
    # The same ray in another layer is another draw, and neighbouring rays are, too.
    assert np.mean(passed[0][1:] & passed[0][:-1]) == pytest.approx(0.343**2, abs=0.008)
