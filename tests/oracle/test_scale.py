"""A room has the same light however large it is, wherever its vertices are, and whatever lies far outside of it.

One reference by `mi.render`, of the room as written; luxel's truth of it scaled, moved, and beside a stray triangle.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from luxel.render.truth import render_truth
from luxel.scene import load
from luxel.scene.model import Mesh, Object, SceneData

WIDTH, HEIGHT, FINER = 48, 32, 4
"""Luxel's rays go through pixel centres, so its image is `FINER` times as large."""
LIMIT = 0.02
"""Of the mean: direct and indirect light each, over the image and over its quarters."""
WALLS = (
    ("white", '<rotate x="1" angle="-90"/><translate y="-1"/>'),
    ("white", '<rotate x="1" angle="90"/><translate y="1"/>'),
    ("white", '<translate z="-1"/>'),
    ("white", '<rotate y="1" angle="180"/><translate z="1"/>'),
    ("red", '<rotate y="1" angle="90"/><translate x="-1"/>'),
    ("green", '<rotate y="1" angle="-90"/><translate x="1"/>'),
)
COLORS = {"white": "0.75, 0.75, 0.75", "red": "0.65, 0.1, 0.1", "green": "0.1, 0.5, 0.1"}
ROOM = (
    "".join(
        f'<bsdf type="diffuse" id="{name}"><rgb name="reflectance" value="{color}"/></bsdf>'
        for name, color in COLORS.items()
    )
    + "".join(
        f'<shape type="rectangle"><transform name="to_world">{step}</transform><ref id="{name}"/></shape>'
        for name, step in WALLS
    )
    + """<shape type="cube"><transform name="to_world"><scale x="0.3" y="0.4" z="0.3"/><rotate y="1" angle="25"/>
    <translate x="-0.35" y="-0.6" z="-0.3"/></transform><ref id="white"/></shape>
    <shape type="rectangle"><transform name="to_world"><scale value="0.3"/><rotate x="1" angle="90"/>
    <translate y="0.99"/></transform><emitter type="area"><rgb name="radiance" value="9, 8, 7"/></emitter>
    <bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf></shape>"""
)
"""Closed, two metres wide, a block inside, and a lamp a centimetre under the ceiling."""
CAMERA = f"""<sensor type="perspective"><float name="fov" value="70"/>
  <transform name="to_world"><lookat origin="0.2, -0.1, 0.95" target="-0.1, -0.25, -1" up="0, 1, 0"/></transform>
  <film type="hdrfilm"><integer name="width" value="{WIDTH}"/><integer name="height" value="{HEIGHT}"/>
  <rfilter type="box"/></film></sensor>"""


def quarters(image: np.ndarray) -> np.ndarray:
    """Return the means (5,) of the whole image (H, W, 3) and its quarters."""
    tall, wide = image.shape[0] // 2, image.shape[1] // 2
    parts = [image, image[:tall, :wide], image[:tall, wide:], image[tall:, :wide], image[tall:, wide:]]
    return np.array([part.mean() for part in parts])


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("room") / "room.xml"
    path.write_text(f'<scene version="3.0.0"><integrator type="path"/>{CAMERA}{ROOM}</scene>')
    return path


@pytest.fixture(scope="module")
def reference(room: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return Mitsuba's direct and indirect light, as `quarters`."""
    load(room)
    scene: Any = mi.load_file(str(room))
    images = []
    for depth in (2, 32):
        integrator: Any = mi.load_dict({"type": "path", "max_depth": depth, "rr_depth": 20})
        images.append(np.array(mi.render(scene, integrator=integrator, spp=256, seed=depth), float)[..., :3])
    return quarters(images[0]), quarters(images[1] - images[0])


def moved(data: SceneData, change: Callable[[np.ndarray], np.ndarray]) -> SceneData:
    """Return the scene with all of its vertices and its camera changed."""
    objects = [
        Object(item.name, [replace(mesh, positions=change(mesh.positions).astype(np.float32)) for mesh in item.meshes])
        for item in data.objects
    ]
    camera = data.cameras[0]
    eye, target = (tuple(change(np.array(point))) for point in (camera.eye, camera.target))
    return replace(data, objects=objects, cameras=[replace(camera, eye=eye, target=target)])


def expect_light(data: SceneData, reference: tuple[np.ndarray, np.ndarray], limit: float = LIMIT) -> None:
    layers = render_truth(
        data, camera=data.cameras[0], size=(WIDTH * FINER, HEIGHT * FINER), spp=32, cache=False
    ).layers
    whole = layers.image()
    layers.indirect = np.zeros_like(layers.indirect)
    direct = layers.image()
    for name, found, wanted in zip(("direct", "indirect"), (direct, whole - direct), reference, strict=True):
        off = quarters(found) / wanted - 1.0
        assert np.abs(off).max() < limit, f"{name}: whole and quarters are off by {np.round(off, 4)}"


def test_the_room_as_written(room: Path, reference: tuple[np.ndarray, np.ndarray]) -> None:
    expect_light(load(room), reference)


@pytest.mark.parametrize("size", [1e-5, 1e-3, 1e3])
def test_a_room_of_another_size(room: Path, reference: tuple[np.ndarray, np.ndarray], size: float) -> None:
    """From ten micrometres to a kilometre. Its lamps are surfaces, so its light is the same."""
    expect_light(moved(load(room), lambda p: p * size), reference)


@pytest.mark.parametrize("away", [100.0, 1e3, 1e4])
def test_a_room_moved_in_its_vertices(room: Path, reference: tuple[np.ndarray, np.ndarray], away: float) -> None:
    """At 10 km single precision knows millimetres: walls stand where they should by a half, and so does the camera."""
    way = np.array([1.0, 0.3, -0.6]) * away
    expect_light(moved(load(room), lambda p: p + way), reference, LIMIT if away < 1e4 else 0.03)


@pytest.mark.parametrize("step", [(300.0, 0.0, 0.0), (0.0, -300.0, 0.0), (0.0, 0.0, 3e4)])
def test_a_stray_triangle_changes_nothing(
    room: Path, reference: tuple[np.ndarray, np.ndarray], step: tuple[float, float, float]
) -> None:
    data = load(room)
    corners = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]]) + step
    data.objects.append(Object("stray", [Mesh(corners.astype(np.float32), np.array([[0, 1, 2]], np.uint32), 0)]))
    expect_light(data, reference)
