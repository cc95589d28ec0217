"""Small bakes that several tests look at."""

from __future__ import annotations

import numpy as np
import pytest

from luxel.bake.core import Baked, bake_scene
from luxel.scene import load
from luxel.scene.library.shapes import quad
from luxel.scene.model import Camera, Light, Material, Mesh, Object, SceneData, Sky, Texture

SMALL = {"texel_target": 2048, "surfel_target": 256, "rays_per_texel": 128, "probe_target": 8}


@pytest.fixture(scope="session")
def cornell() -> Baked:
    """The Cornell box, baked small."""
    return bake_scene(load("cornell-box"), "lightmap", dict(SMALL), frames=12, samples=8)


def two_lamps() -> SceneData:
    """The Cornell box with its lamp out and two bulbs in."""
    data = load("cornell-box")
    data.materials[3].emission = (0.0, 0.0, 0.0)
    data.lights = [
        Light("point", (3.0, 3.0, 3.0), position=(-0.6, 0.6, 0.5), name="left"),
        Light("point", (1.0, 2.0, 4.0), position=(0.7, 0.2, -0.4), name="right"),
    ]
    return data


def cut_floor() -> SceneData:
    """A floor in two halves that the file's second coordinates lay apart, beside a wall, under a lamp at the cut."""
    halves = []
    for index, (low, high) in enumerate(((-1.0, 0.0), (0.0, 1.0))):
        p = np.array([[low, 0, -1], [low, 0, 1], [high, 0, 1], [high, 0, -1]], np.float32)
        uv2 = np.array([[0, 0], [0, 1], [0.45, 1], [0.45, 0]], np.float32) + [0.55 * index, 0.0]
        # The second half lies turned, so that its border meets other texels.
        uv2 = uv2 if index == 0 else np.stack([uv2[:, 0], 1.0 - uv2[:, 1]], axis=1)
        faces = np.array([[0, 1, 2], [0, 2, 3]], np.uint32)
        halves.append(Mesh(p, faces, 0, uv2=uv2.astype(np.float32)))
    wall = np.array([[-1, 0, -1], [1, 0, -1], [1, 1, -1], [-1, 1, -1]], np.float32)
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    objects = [
        Object("floor", halves),
        Object("wall", [Mesh(wall, np.array([[0, 1, 2], [0, 2, 3]], np.uint32), 1, uv2=square)]),
    ]
    return SceneData(
        "cut-floor",
        objects,
        [Material("grey", (0.5, 0.5, 0.5)), Material("red", (0.8, 0.1, 0.1))],
        lights=[Light("point", (2.0, 2.0, 2.0), position=(0.2, 0.5, 0.1), name="bulb")],
        cameras=[Camera((0.0, 1.0, 3.0), (0.0, 0.0, 0.0))],
    )


LEAF = (0.25, 0.75)
"""Where along the leaf's card, both ways, the leaf lies; the rest is hole."""


def leaf() -> SceneData:
    """A floor, and on it a square card with a leaf in its middle: white, in a hole whose colour is black."""
    image = np.zeros((64, 64, 4), np.uint8)
    low, high = (int(64 * part) for part in LEAF)
    image[low:high, low:high] = 255
    ground = quad((-2, 0, 2), (2, 0, 2), (2, 0, -2), (-2, 0, -2), 0)
    card = quad((-0.5, 0.2, 0), (0.5, 0.2, 0), (0.5, 1.2, 0), (-0.5, 1.2, 0), 1)
    # One object of both kinds, and one of the first alone.
    objects = [Object("ground", [ground]), Object("plant", [card, quad((1, 0, 1), (1, 0, 0), (1, 1, 0), (1, 1, 1), 0)])]
    materials = [
        Material("soil", (0.1, 0.1, 0.1)),
        Material("leaf", (0.8, 0.8, 0.8), base_color_texture=Texture(image, nearest=True), alpha_mode="mask"),
    ]
    camera = Camera((0.0, 1.0, 3.0), (0.0, 0.5, 0.0))
    return SceneData("leaf", objects, materials, sky=Sky((1.0, 1.0, 1.0)), cameras=[camera])
