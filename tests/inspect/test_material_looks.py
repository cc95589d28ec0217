"""Looks of materials: the numbers of the file at each pixel, whatever the scene was uploaded with."""

from __future__ import annotations

import numpy as np
import pytest

from luxel.inspect.looks import Shot, draw_look, take_shot
from luxel.inspect.looks.frame import NOTHING
from luxel.inspect.looks.materials import read_fact
from luxel.inspect.ramps import colorize
from luxel.render.renderer import Renderer
from luxel.scene.device import Scene, upload
from luxel.scene.host import Looks
from luxel.scene.model import Camera, Light, Material, Mesh, Object, SceneData, Texture

SIZE = 32
QUAD = np.array([[0, 1, 2], [0, 2, 3]], np.uint32)
BACK = Material("back", (0.5, 0.5, 0.5), metallic=0.25, roughness=0.6)


def sheet(z: float, material: int, half: float = 1.0, alphas: tuple[float, float] | None = None) -> Mesh:
    """A square around (0, 0, z); u runs to the right and v down, `alphas` are those of the corners left and right."""
    x = half
    positions = np.array([[-x, -x, z], [x, -x, z], [x, x, z], [-x, x, z]], np.float32)
    uv = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)
    colors = None
    if alphas is not None:
        colors = np.ones((4, 4), np.float32)
        colors[[0, 3], 3], colors[[1, 2], 3] = alphas
    return Mesh(positions, QUAD, material, uv=uv, colors=colors)


def look_at(material: Material, looks: Looks, alphas: tuple[float, float] | None = None, half: float = 1.0) -> Shot:
    """A sheet that fills the picture, before a larger one: seen straight on, so that pixels are places of its image."""
    objects = [Object("sheet", [sheet(0.0, 0, half, alphas)]), Object("back", [sheet(-1.0, 1, 4.0)])]
    camera = Camera((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), fov=90.0)
    sun = Light("directional", (1.0, 1.0, 1.0), direction=(0.0, 0.0, -1.0))
    scene: Scene = upload(SceneData("sheets", objects, [material, BACK], [sun], cameras=[camera]), materials=looks)
    renderer = Renderer(scene, "none", size=(SIZE, SIZE))
    renderer.step()
    return take_shot(renderer)


def quarters(*texels: tuple[int, ...]) -> Texture:
    """An image of 2 x 2 texels, by rows, read without a blend between them."""
    image = np.array(texels, np.uint8).reshape(2, 2, -1)
    return Texture(image, srgb=False, nearest=True)


def at_quarters(image: np.ndarray) -> np.ndarray:
    """Return the values amid the picture's four quarters, by rows."""
    near, far = SIZE // 4, 3 * SIZE // 4
    return np.array([image[near, near], image[near, far], image[far, near], image[far, far]])


CONDITIONS: tuple[Looks, ...] = ("diffuse", "full")


@pytest.mark.parametrize("looks", CONDITIONS)
def test_factors_times_textures(looks: Looks) -> None:
    rough_metal = quarters((0, 255, 0), (0, 51, 255), (0, 102, 51), (0, 0, 204))
    glass = quarters((255, 0, 0), (0, 255, 255), (51, 0, 0), (204, 9, 9))
    material = Material(metallic=0.5, roughness=0.8, metallic_roughness_texture=rough_metal, specular=1.0)
    material.transmission, material.transmission_texture = 0.6, glass
    shot = look_at(material, looks)
    for name, expected in (
        ("roughness", 0.8 * np.array([1.0, 0.2, 0.4, 0.0])),
        ("metallic", 0.5 * np.array([0.0, 1.0, 0.2, 0.8])),
        ("transmission", 0.6 * np.array([1.0, 0.0, 0.2, 0.8])),
        ("opacity", np.ones(4)),
    ):
        values, hit = read_fact(shot, name)
        np.testing.assert_allclose(at_quarters(values), expected, atol=1e-5, err_msg=name)
        assert hit.all()
        drawing = draw_look(name, shot)
        np.testing.assert_allclose(at_quarters(drawing.image), colorize(expected), atol=0.01, err_msg=name)
        assert drawing.legend is not None and drawing.legend.scale is not None
        assert (drawing.legend.scale.low, drawing.legend.scale.high) == (0.0, 1.0)


@pytest.mark.parametrize("looks", CONDITIONS)
def test_blended_surfaces_are_shown_where_they_are(looks: Looks) -> None:
    """Their alpha is factor times texture times vertex colour; rays of the picture pass most of them by chance."""
    alpha = quarters((9, 9, 9, 255), (9, 9, 9, 51), (9, 9, 9, 0), (9, 9, 9, 102))
    material = Material(base_color_texture=alpha, alpha=0.5, alpha_mode="blend", roughness=0.3)
    shot = look_at(material, looks, alphas=(1.0, 0.2))
    values, _ = read_fact(shot, "opacity")
    # Vertex alpha falls along the sheet: at pixel 8 of 32 it is 1 - 0.8 * 8.5 / 32.
    left, right = 1.0 - 0.8 * 8.5 / 32, 1.0 - 0.8 * 24.5 / 32
    np.testing.assert_allclose(at_quarters(values), 0.5 * np.array([left, 0.2 * right, 0.0, 0.4 * right]), atol=1e-4)
    np.testing.assert_allclose(read_fact(shot, "roughness")[0], 0.3, atol=1e-6)


@pytest.mark.parametrize("looks", CONDITIONS)
def test_holes_are_looked_through(looks: Looks) -> None:
    alpha = quarters((9, 9, 9, 255), (9, 9, 9, 51), (9, 9, 9, 0), (9, 9, 9, 200))
    shot = look_at(Material(base_color_texture=alpha, alpha_mode="mask", roughness=0.1), looks)
    np.testing.assert_allclose(at_quarters(read_fact(shot, "roughness")[0]), [0.1, 0.6, 0.6, 0.1], atol=1e-6)
    np.testing.assert_allclose(at_quarters(read_fact(shot, "metallic")[0]), [0.0, 0.25, 0.25, 0.0], atol=1e-6)
    np.testing.assert_allclose(at_quarters(read_fact(shot, "opacity")[0]), 1.0)


@pytest.mark.parametrize("looks", CONDITIONS)
def test_edits_are_seen(looks: Looks) -> None:
    material = Material("sheet", roughness=0.2, metallic=0.1)
    objects = [Object("sheet", [sheet(0.0, 0)])]
    data = SceneData("one", objects, [material], [Light("directional", (1.0, 1.0, 1.0), direction=(0, 0, -1))])
    data.cameras = [Camera((0.0, 0.0, 2.0), (0.0, 0.0, 0.0), fov=90.0)]
    renderer = Renderer(upload(data, materials=looks), "none", size=(SIZE, SIZE))
    renderer.step()
    assert read_fact(take_shot(renderer), "roughness")[0][16, 16] == pytest.approx(0.2)
    renderer.set_material("sheet", roughness=0.7, metallic=0.4)
    renderer.step()
    shot = take_shot(renderer)
    assert read_fact(shot, "roughness")[0][16, 16] == pytest.approx(0.7)
    assert read_fact(shot, "metallic")[0][16, 16] == pytest.approx(0.4)
    # The sheet is half as wide as the picture: beside it there is nothing.
    np.testing.assert_array_equal(draw_look("metallic", shot).image[2, 2], NOTHING)
