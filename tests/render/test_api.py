"""The one call from a scene to an image, and what it shows unless told otherwise."""

from __future__ import annotations

import numpy as np
import pytest

import luxel
from luxel.scene.library.shapes import quad

SIZE = (16, 16)


def mirror_under_a_sky() -> luxel.SceneData:
    """A mirror that reflects half of the light straight back, seen from straight above under an even sky of 1."""
    plate = luxel.Object("plate", [quad((-1, 0, 1), (1, 0, 1), (1, 0, -1), (-1, 0, -1), 0)])
    metal = luxel.Material("metal", (0.5, 0.5, 0.5), metallic=1.0, roughness=0.0)
    above = luxel.Camera((0.0, 2.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), orthographic_width=1.0)
    return luxel.SceneData("mirror", [plate], [metal], cameras=[above], sky=luxel.Sky((1.0, 1.0, 1.0)))


def test_a_picture_shows_all_that_materials_do() -> None:
    """As `luxel render` does; methods that light the diffuse part alone show that, where a metal is black."""
    scene = mirror_under_a_sky()
    assert luxel.render_image(scene, "path", size=SIZE, frames=4) == pytest.approx(0.5, abs=1e-3)
    assert luxel.render_image(scene, "path", size=SIZE, frames=4, materials="diffuse").max() == 0.0
    assert luxel.render_image(scene, "none", size=SIZE, frames=1).max() == 0.0


def test_a_renderer_is_a_laboratory() -> None:
    """Methods are compared by what all of them light; full materials are asked for."""
    scene = mirror_under_a_sky()
    plain = luxel.Renderer(scene, "path", size=SIZE)
    full = luxel.Renderer(scene, "path", size=SIZE, materials="full")
    for renderer, expected in ((plain, 0.0), (full, 0.5)):
        renderer.run(4)
        np.testing.assert_allclose(renderer.image(), expected, atol=1e-3)
