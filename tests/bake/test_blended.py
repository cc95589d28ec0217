"""A bake of a blended pane and of what moves: the pane stays as clear as it was, and what is left out is named."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pygltflib
import pytest
from PIL import Image

from luxel import Camera, Light, Material, Object, SceneData
from luxel.bake.core import bake_scene
from luxel.bake.files import write_bake
from luxel.scene.library.shapes import quad

from .conftest import SMALL

ALPHA = 0.3


def pane_over_floor() -> SceneData:
    floor = Object("floor", [quad((-1, 0, 1), (1, 0, 1), (1, 0, -1), (-1, 0, -1), 0)])
    pane = Object("pane", [quad((-1, 0.5, 1), (1, 0.5, 1), (1, 0.5, -1), (-1, 0.5, -1), 1)])
    fan = Object("fan", [quad((3, 0, 1), (4, 0, 1), (4, 0, -1), (3, 0, -1), 0)], motion=lambda time: np.eye(4))
    materials = [
        Material("ground", (0.8, 0.4, 0.2)),
        Material("glass", (0.1, 0.5, 0.9), alpha_mode="blend", alpha=ALPHA),
    ]
    camera = Camera((0.0, 3.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, -1.0), fov=25.0)
    return SceneData("pane", [floor, pane, fan], materials, [Light("directional", (2.0, 2.0, 2.0))], [camera])


@pytest.fixture(scope="module")
def baked(tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, Path, float]:
    path = tmp_path_factory.mktemp("pane") / "baked.glb"
    bake = bake_scene(pane_over_floor(), "lightmap", dict(SMALL), frames=8, samples=16)
    return bake, path, write_bake(bake, path)["exposure"]


def test_a_blended_pane_stays_blended(baked: tuple[Any, Path, float]) -> None:
    file: Any = pygltflib.GLTF2().load(str(baked[1]))
    (pane,) = [node for node in file.nodes if node.name == "pane"]
    material = file.materials[file.meshes[pane.mesh].primitives[0].material]
    assert (material.name, material.alphaMode, material.alphaCutoff or 0.5) == ("glass", "BLEND", 0.5)
    view = file.bufferViews[
        file.images[file.textures[material.pbrMetallicRoughness.baseColorTexture.index].source].bufferView
    ]
    blob = file.binary_blob()[view.byteOffset : view.byteOffset + view.byteLength]
    alpha = np.asarray(Image.open(io.BytesIO(blob)))[..., 3]
    # The pane lies in the atlas on both sides, the rest is solid or empty.
    assert np.isclose(alpha, ALPHA * 255.0, atol=1.0).mean() > 0.1
    assert set(np.unique(alpha)) <= {0, 76, 77, 255}


def test_what_moves_is_named(baked: tuple[Any, Path, float]) -> None:
    assert "What moves is left out of the bake: 'fan'." in baked[0].notes
