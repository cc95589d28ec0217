"""Scenes without extent: one sentence or a right picture by every method, never black in silence."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from luxel.cli import main
from luxel.errors import LuxelError
from luxel.render.renderer import Renderer
from luxel.scene.device import upload
from luxel.scene.model import Camera, Material, Mesh, Object, SceneData, Sky

METHODS = ("none", "ambient", "path", "gibs", "ddgi", "lightmap")
PLANE = np.array([[[-1, 0, -1], [-1, 0, 1], [1, 0, 1]], [[-1, 0, -1], [1, 0, 1], [1, 0, -1]]], float)
LINE = np.array([[[i, 0.1 * i, 0], [i + 1, 0.1 * i + 0.1, 0], [i + 2, 0.1 * i + 0.2, 0]] for i in range(4)], float)
POINT = np.ones((4, 3, 3))
ABOVE = Camera((0.0, 3.0, 0.0), (0.0, 0.0, 0.0), fov=40.0)
AWAY = Camera((0.0, 3.0, 0.0), (0.0, 9.0, 1.0), fov=40.0)
ALBEDO, RADIANCE = 0.7, 0.5


def scene(corners: np.ndarray, *cameras: Camera) -> SceneData:
    mesh = Mesh(corners.reshape(-1, 3).astype(np.float32), np.arange(3 * len(corners), dtype=np.uint32).reshape(-1, 3))
    material = Material(base_color=(ALBEDO, ALBEDO, ALBEDO))
    return SceneData(
        "flat", [Object("all", [mesh])], [material], cameras=list(cameras), sky=Sky((RADIANCE, RADIANCE, RADIANCE))
    )


def picture(data: SceneData, method: str) -> np.ndarray:
    settings = {"ambient": {"irradiance": (np.pi * RADIANCE,) * 3}, "lightmap": {"texel_target": 64}}
    renderer = Renderer(data, method, settings.get(method), size=(16, 16))
    renderer.run(24)
    return renderer.image()


@pytest.mark.parametrize("method", METHODS)
def test_plane_under_a_sky(method: str) -> None:
    """Nothing is above it, so each pixel is albedo times the sky's radiance; without indirect light it is black."""
    image = picture(scene(PLANE, ABOVE), method)
    expected = 0.0 if method == "none" else ALBEDO * RADIANCE
    assert np.allclose(image[4:12, 4:12], expected, rtol=0.05, atol=1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_single_triangle(method: str) -> None:
    image = picture(scene(PLANE[:1]), method)
    lit = np.abs(image[..., 0] - ALBEDO * RADIANCE) < 0.05 * RADIANCE
    sky = np.abs(image[..., 0] - RADIANCE) < 1e-4
    assert sky.any() and (method == "none" or (lit.any() and (lit | sky).all()))


@pytest.mark.parametrize("method", METHODS)
def test_camera_that_looks_away_sees_the_sky(method: str) -> None:
    assert np.allclose(picture(scene(PLANE, AWAY), method), RADIANCE, rtol=1e-4)


@pytest.mark.parametrize("corners", [LINE, POINT, 1e6 * POINT], ids=["line", "point", "far-point"])
def test_nothing_with_an_area_is_said(corners: np.ndarray) -> None:
    with pytest.raises(LuxelError, match="none of its triangles has an area"):
        upload(scene(corners, ABOVE))


def test_positions_beyond_single_precision_are_said() -> None:
    with pytest.raises(LuxelError, match="vertex positions reach 1e\\+30 m"):
        upload(scene(np.concatenate([PLANE, 1e30 * PLANE]), ABOVE))


def test_empty_scene_is_said() -> None:
    with pytest.raises(LuxelError, match="holds no triangles"):
        upload(SceneData("empty", [], [Material()]))


def test_command_line_says_that_a_camera_sees_nothing(
    write_gltf: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = write_gltf("plane.gltf", [("plane", PLANE, {})])
    words = ["render", str(file), "--size", "16x16", "--frames", "1", "--method", "none", "-o", str(tmp_path / "a.png")]
    assert main([*words, "--camera", "0,3,0;0,9,1"]) == 0
    assert "sees no surface" in capsys.readouterr().err
    assert main([*words, "--camera", "0,3,1;0,0,0"]) == 0
    assert "sees no surface" not in capsys.readouterr().err
