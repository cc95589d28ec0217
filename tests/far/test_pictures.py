"""A room carried away gives the picture that Mitsuba makes of it where it is near."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from luxel.render.renderer import Renderer
from luxel.render.truth import render_truth
from luxel.report.compare import compare
from luxel.scene import load
from luxel.scene.device import upload

EAST, DOWN, ASIDE = (100_000.3, 0.0, 0.0), (0.0, -10_000.7, 0.0), (70_000.1, 3.0, -70_000.9)
SETTINGS: dict[str, dict[str, Any]] = {"lightmap": {"texel_target": 4096, "rays_per_texel": 128}}
BIAS = 0.03
BLOCKS = 0.025
"""Of 12 x 12 pixels, RMS over the mean; measured: 0.005 to 0.012, and 0.055 to 0.4 where nothing is re-centred."""


def block_error(image: np.ndarray, wanted: np.ndarray) -> float:
    """RMS over the mean of blocks of 12 x 12 pixels, without the panel, whose edges one ray a pixel cuts hard."""
    kept = wanted.max(axis=2) < 2.0

    def means(picture: np.ndarray) -> np.ndarray:
        picture = np.where(kept[..., None], picture, 0.0)
        return (
            picture.reshape(3, 12, 4, 12, 3).sum(axis=(1, 3)) / kept.reshape(3, 12, 4, 12).sum(axis=(1, 3))[..., None]
        )

    return float(np.sqrt(((means(image) - means(wanted)) ** 2).mean()) / wanted[kept].mean())


@pytest.mark.parametrize(
    ("kind", "method", "place"),
    [
        ("gltf", "path", EAST),
        ("gltf", "gibs", EAST),
        ("gltf", "ddgi", DOWN),
        ("gltf", "lightmap", ASIDE),
        ("xml", "path", DOWN),
        ("xml", "gibs", ASIDE),
        ("xml", "ddgi", EAST),
    ],
)
def test_a_room_far_away_looks_as_it_does_near(
    room: Any, oracle: Callable[[str], np.ndarray], kind: str, method: str, place: Any
) -> None:
    renderer = Renderer(load(room.file(kind, place)), method, SETTINGS.get(method), size=room.size)
    renderer.run(32)
    image, wanted = renderer.image(), oracle(kind)
    kept = wanted.max(axis=2) < 2.0
    assert image[kept].mean() == pytest.approx(wanted[kept].mean(), rel=BIAS)
    assert block_error(image, wanted) < BLOCKS
    # No dark dots where light comes.
    lit = wanted.min(axis=2) > 0.1 * np.median(wanted)
    assert image[lit].min() > 1e-4 * np.median(image)


def test_methods_that_know_nothing_fail_this(room: Any, oracle: Callable[[str], np.ndarray]) -> None:
    for method in ("none", "ambient"):
        renderer = Renderer(load(room.gltf(EAST)), method, size=room.size)
        renderer.run(8)
        assert block_error(renderer.image(), oracle("gltf")) > 2.0 * BLOCKS


def test_the_same_room_without_an_origin_fails_this(room: Any, oracle: Callable[[str], np.ndarray]) -> None:
    data = load(room.gltf(EAST))
    data.origin = (0.0, 0.0, 0.0)
    renderer = Renderer(upload(data), "gibs", size=room.size)
    renderer.run(8)
    assert block_error(renderer.image(), oracle("gltf")) > 2.0 * BLOCKS


def test_a_scene_made_in_python_is_recentred_too(room: Any, oracle: Callable[[str], np.ndarray]) -> None:
    data = load(room.gltf())
    away = np.eye(4)
    away[:3, 3] = ASIDE
    for item in data.objects:
        item.to_world = away @ item.to_world
    x, y, z = data.lights[0].position + np.array(ASIDE)
    data.lights[0].position = (x, y, z)
    x, y, z = data.cameras[0].eye + np.array(ASIDE)
    u, v, w = data.cameras[0].target + np.array(ASIDE)
    data.cameras[0].eye, data.cameras[0].target = (x, y, z), (u, v, w)
    renderer = Renderer(data, "path", size=room.size)
    renderer.run(32)
    assert block_error(renderer.image(), oracle("gltf")) < BLOCKS
    assert renderer.camera.eye == data.cameras[0].eye and data.origin == (0.0, 0.0, 0.0)


def test_far_vertices_keep_their_own_rounding_and_it_is_named(room: Any, oracle: Callable[[str], np.ndarray]) -> None:
    data = load(room.gltf(EAST, by="vertices"))
    assert [text for text in data.warnings if "7.8 mm" in text and "100 km" in text]
    assert not load(room.gltf(EAST)).warnings and not load(room.xml(EAST)).warnings
    renderer = Renderer(data, "path", size=room.size)
    renderer.run(32)
    assert renderer.image().mean() == pytest.approx(oracle("gltf").mean(), rel=BIAS)
    assert block_error(renderer.image(), oracle("gltf")) < BLOCKS


@pytest.mark.parametrize("kind", ["gltf", "xml"])
def test_the_truth_is_that_of_the_near_room(room: Any, oracle: Callable[[str], np.ndarray], kind: str) -> None:
    truth = render_truth(load(room.file(kind, ASIDE)), size=room.size, spp=64, cache=False)
    assert block_error(truth.layers.image(), oracle(kind)) < BLOCKS


@pytest.mark.parametrize("kind", ["gltf", "xml"])
def test_full_materials_are_seen_from_the_same_place(room: Any, oracle: Callable[[str], np.ndarray], kind: str) -> None:
    from luxel.render.oracle import render_full

    data = load(room.file(kind, EAST))
    for material in data.materials:
        material.specular = 0.0  # the judge has no coats, and Mitsuba's rough plastic keeps little light
    image = render_full(data, data.cameras[0], size=room.size, spp=64)
    assert block_error(image, oracle(kind)) < BLOCKS


def test_a_stray_triangle_or_the_cameras_place_do_not_decide(room: Any, write_gltf: Callable[..., Any]) -> None:
    away = np.array([[[1e6, 0, 0], [1e6, 1, 0], [1e6, 0, 1]]])
    grey = {"pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.5, 0.5, 1.0]}}
    parts = [(name, room.corners(name), grey) for name in room.parts]
    near = load(write_gltf("near.gltf", [*parts, ("stray", away, grey)]))
    assert near.origin == (0.0, 0.0, 0.0)
    view = {"name": "view", "camera": 0, "translation": [0.0, 5e4, 0.0]}
    nodes = [*({"mesh": index, "name": name} for index, name in enumerate(room.parts)), view]
    lens = {"type": "perspective", "perspective": {"yfov": 0.001, "znear": 1.0}}
    seen = load(write_gltf("seen.gltf", parts, nodes=nodes, scenes=[{"nodes": list(range(9))}], cameras=[lens]))
    assert seen.origin == (0.0, 0.0, 0.0)
    assert seen.cameras[0].eye == (0.0, 5e4, 0.0)


def test_an_ordinary_scene_is_measured_from_where_its_file_measures(room: Any) -> None:
    assert load("cornell-box").origin == load(room.gltf()).origin == load(room.xml()).origin == (0.0, 0.0, 0.0)
    assert load(room.gltf((40.0, 0.0, 9.0))).origin == (0.0, 0.0, 0.0)


def test_a_comparison_of_a_far_scene_made_in_python_is_recentred_too(tmp_path: Path) -> None:
    """All of the indirect light is missing from `none`; where nothing is re-centred there is none to miss."""
    data, place = load("cornell-box"), np.eye(4)
    place[:3, 3] = (1e6, 0.0, -1e6)
    for item in data.objects:
        item.to_world = place @ item.to_world

    def carried(point: tuple[float, float, float]) -> tuple[float, float, float]:
        x, y, z = (np.array(point) + place[:3, 3]).tolist()
        return x, y, z

    data.cameras = [replace(camera, eye=carried(camera.eye), target=carried(camera.target)) for camera in data.cameras]
    found = compare([data], [], reference_spp=16, size=(16, 16), frames=1, peers=False, out=tmp_path)
    assert found["scenes"]["cornell-box"]["methods"]["none"]["bias"] == pytest.approx(-1.0)
