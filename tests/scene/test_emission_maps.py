"""How strongly triangles emit under their textures, by SciPy's filters, by brute force and by arithmetic."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy import ndimage

from luxel.kernels.direct import direct_irradiance
from luxel.kernels.surface import free_surface
from luxel.scene import emission_maps
from luxel.scene.device import Scene, upload
from luxel.scene.emission_maps import VertexLooks, emitted_luminance
from luxel.scene.library.shapes import quad
from luxel.scene.live import set_material
from luxel.scene.model import Material, Mesh, Object, SceneData, Texture

MODES = {"repeat": "grid-wrap", "clamp": "nearest", "mirror": "reflect"}
THREE = np.arange(300).reshape(-1, 3)


def dotted(seed: int, height: int = 12, width: int = 20) -> np.ndarray:
    """Return an image that is black but for a few grey texels, two of them nearly black."""
    rng = np.random.default_rng(seed)
    image = np.zeros((height, width))
    image[rng.integers(0, height, 5), rng.integers(0, width, 5)] = (1.0, 0.7, 0.2, 1e-5, 1e-7)
    return image


def grey(image: np.ndarray, **settings: Any) -> Material:
    texture = Texture(np.repeat(image[..., None], 3, 2).astype(np.float32), srgb=False, **settings)
    return Material(emission=(5.0, 5.0, 5.0), emission_texture=texture)


@pytest.mark.parametrize("wrap_u", MODES)
@pytest.mark.parametrize("wrap_v", MODES)
@pytest.mark.parametrize("size", [0.02, 0.2, 3.0, 4000.0])
def test_no_triangle_that_glows_anywhere_counts_as_black(wrap_u: str, wrap_v: str, size: float) -> None:
    """Read at 500 points each by SciPy's bilinear filter; and what counts is the mean of a box around it."""
    rng = np.random.default_rng(4)
    image = dotted(3)
    corners = rng.uniform(-2.0, 3.0, (100, 1, 2)) + size * rng.normal(size=(100, 3, 2))
    looks = VertexLooks(corners.reshape(-1, 2).astype(np.float32), None, None)
    found = emitted_luminance(grey(image, wrap_u=wrap_u, wrap_v=wrap_v), looks, THREE)
    points = np.einsum("nk,tkj->tnj", rng.dirichlet([0.6] * 3, 500), looks.uv.astype(float)[THREE])
    places = points[..., ::-1] * image.shape - 0.5
    # SciPy knows one way to go on for both axes: the image is widened by whole turns first.
    for axis, wrap in ((0, wrap_v), (1, wrap_u)):
        turns = 2 * image.shape[axis] if wrap == "mirror" else image.shape[axis]
        folded = np.mod(places[..., axis] + 0.5, turns) - 0.5
        places[..., axis] = np.clip(places[..., axis], 0, image.shape[axis] - 1) if wrap == "clamp" else folded
    wide = image
    for axis, wrap in ((0, wrap_v), (1, wrap_u)):
        pad = [(0, 0), (0, 0)]
        pad[axis] = (2, 2 * image.shape[axis] + 2)
        wide = np.pad(wide, pad, mode={"repeat": "wrap", "clamp": "edge", "mirror": "symmetric"}[wrap])  # type: ignore[call-overload]
    read = ndimage.map_coordinates(wide, (places + 2.0).reshape(-1, 2).T, order=1).reshape(100, 500)
    assert (found[read.max(axis=1) > 0.0] > 0.0).all()
    assert (found >= 0.0).all() and found.max() <= 5.0
    if size >= 3.0:
        np.testing.assert_allclose(found[found > 0.0].mean(), 5.0 * image.mean(), rtol=0.5)


def test_the_mean_is_that_of_the_texels_around() -> None:
    """A triangle over 4x4 texels reads 6x6; of another one in the dark nothing is drawn."""
    image = np.zeros((16, 16))
    image[4:8, 8:12] = 1.0
    # Between the centres of texels.
    corners = np.array([[8, 4], [12, 4], [8, 8], [1, 10], [3, 10], [1, 14]]) / 16.0
    looks = VertexLooks(corners, None, None)
    found = emitted_luminance(grey(image), looks, np.arange(6).reshape(2, 3))
    assert found[0] == pytest.approx(5.0 * 16 / 36, rel=1e-6)
    assert found[1] == 0.0


def test_colours_of_factor_and_texture_meet() -> None:
    """A red factor over green texels is black; vertex colours count where the material says so."""
    image = np.zeros((4, 4, 3), np.float32)
    image[..., 1] = 1.0
    looks = VertexLooks(np.zeros((3, 2)), None, np.array([[0.0, 0.0, 0.0, 1.0]] * 3))
    red = Material(emission=(9.0, 0.0, 0.0), emission_texture=Texture(image, srgb=False))
    green = Material(emission=(0.0, 9.0, 0.0), emission_texture=Texture(image, srgb=False))
    colored = Material(emission=(9.0, 9.0, 9.0), emission_uses_colors=True)
    one = np.arange(3).reshape(1, 3)
    assert emitted_luminance(red, looks, one)[0] == 0.0
    assert emitted_luminance(green, looks, one)[0] == pytest.approx(9.0 * 0.7152, rel=1e-6)
    assert emitted_luminance(colored, looks, one)[0] == 0.0


def test_texture_coordinates_that_are_no_numbers_harm_nobody() -> None:
    uv = np.array([[0.5, 0.5]] * 3 + [[np.nan, 0.5], [0.1, np.inf], [1e30, 0.0]])
    found = emitted_luminance(grey(np.ones((4, 4))), VertexLooks(uv, None, None), np.arange(6).reshape(2, 3))
    np.testing.assert_allclose(found, 5.0, rtol=1e-6)


def ceiling_of_small_lamps(count: int = 64) -> tuple[Scene, float]:
    """Return 8,192 triangles, 2 m above the origin, under one image with sixty lamps of 4x4 texels; and the light."""
    line = np.linspace(-2.0, 2.0, count + 1)
    x, z = np.meshgrid(line, line, indexing="ij")
    points = np.stack([x, np.full_like(x, 2.0), z], axis=-1).reshape(-1, 3)
    number = np.arange((count + 1) ** 2).reshape(count + 1, count + 1)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    faces = np.concatenate([np.stack(three, -1).reshape(-1, 3) for three in ((a, b, c), (a, c, d))]).astype(np.uint32)
    image = np.zeros((256, 256))
    rng = np.random.default_rng(1)
    for column, row in rng.integers(0, 252, (60, 2)):
        image[row : row + 4, column : column + 4] = 1.0
    material = grey(image, nearest=True)
    material.emit_back = True
    mesh = Mesh(points.astype(np.float32), faces, uv=(points[:, ::2] / 4.0 + 0.5).astype(np.float32), material=1)
    far = quad((90, 90, 90), (91, 90, 90), (91, 91, 90), (90, 91, 90), 0)
    scene = upload(SceneData("lit", [Object("all", [far, mesh])], [Material(), material]))
    v, u = np.nonzero(image)
    squared = ((u + 0.5) / 64.0 - 2.0) ** 2 + ((v + 0.5) / 64.0 - 2.0) ** 2 + 4.0
    # Each texel: radiance, area, and both cosines over the squared distance.
    return scene, float((5.0 / 64.0**2 * 4.0 / squared**2).sum())


def test_many_triangles_under_one_dark_image_have_little_noise() -> None:
    """Relative noise of 64 frames 0.2 at most: 0.5 where each triangle counts by the mean of the image."""
    scene, expected = ceiling_of_small_lamps()
    samples = 1 << 16
    surface = free_surface(np.zeros((samples, 3)), np.tile((0.0, 1.0, 0.0), (samples, 1)))
    lane = dr.arange(mi.UInt32, samples)
    found = np.array(direct_irradiance(scene, surface, dr.opaque(mi.UInt32, 5), lane, surface.active))[1].astype(float)
    assert found.std() / found.mean() / np.sqrt(64.0) < 0.2
    assert found.mean() == pytest.approx(expected, abs=4.0 * found.std() / np.sqrt(samples))


def test_an_edit_reads_no_image_but_that_of_the_edited_material(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the others shine with stays, and the new glow counts with its place: radiances by arithmetic."""
    square = [(0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1)]
    uv = np.full((4, 2), 0.5, np.float32)
    first, other = (quad(square[0], square[1], square[2], square[3], material) for material in (1, 2))
    first.uv, other.uv = uv, uv
    glow = grey(np.full((4, 4), 0.5))
    scene = upload(SceneData("lit", [Object("all", [first, other])], [Material(), glow, Material()]))
    np.testing.assert_allclose(scene.host.sources.emitters.radiance, [2.5, 2.5], rtol=1e-6)
    held = scene.host.data.materials[1].emission_texture
    monkeypatch.setattr(emission_maps, "to_linear", lambda texture: pytest.fail("read") if texture is held else None)
    set_material(scene, 2, Material(emission=(3.0, 3.0, 3.0)))
    emitters = scene.host.sources.emitters
    np.testing.assert_allclose(emitters.radiance, [2.5, 2.5, 3.0, 3.0], rtol=1e-6)
    np.testing.assert_array_equal(emitters.triangles, [0, 1, 2, 3])
    set_material(scene, 2, Material())
    np.testing.assert_array_equal(scene.host.sources.emitters.triangles, [0, 1])
