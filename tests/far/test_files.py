"""What is written of a room far away lies where its file lay: bakes, copied commands, what the browser is sent."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pygltflib
import pytest

from luxel.bake.core import bake_scene
from luxel.bake.files import relight, transport_of, write_bake
from luxel.bake.solve import texels_near
from luxel.errors import LuxelError
from luxel.methods.inspect import Discs
from luxel.render.exposure import Exposure
from luxel.scene import load
from luxel.scene.edit import parse_camera
from luxel.scene.model import Camera
from luxel.viewer import share

PLACE = np.array([70_000.1, 3.0, -70_000.9])
SMALL = {"texel_target": 1024, "surfel_target": 128, "rays_per_texel": 32, "probe_target": 8}
SIZE = 5.0
"""Metres: the room's longest side."""


def matrix_of(node: Any) -> np.ndarray:
    """The (4, 4) float64 matrix of a node without rotation and scale."""
    if node.matrix is not None:
        return np.array(node.matrix, np.float64).reshape(4, 4).T
    assert node.rotation in (None, [0, 0, 0, 1]) and node.scale in (None, [1, 1, 1])
    matrix = np.eye(4)
    matrix[:3, 3] = node.translation or (0.0, 0.0, 0.0)
    return matrix


def read_corners(path: Path) -> dict[str, np.ndarray]:
    """World positions (N, 3) float64 of a .glb's vertices, by the mesh's name, as the specification places them."""
    file: Any = pygltflib.GLTF2().load(str(path))
    found: dict[str, np.ndarray] = {}
    waiting = [(number, np.eye(4)) for number in file.scenes[file.scene or 0].nodes]
    while waiting:
        number, above = waiting.pop()
        node = file.nodes[number]
        world = above @ matrix_of(node)
        waiting += [(child, world) for child in node.children or []]
        if node.mesh is None:
            continue
        for part in file.meshes[node.mesh].primitives:
            accessor = file.accessors[part.attributes.POSITION]
            view = file.bufferViews[accessor.bufferView]
            start = (view.byteOffset or 0) + (accessor.byteOffset or 0)
            own = np.frombuffer(file.binary_blob(), np.float32, 3 * accessor.count, start).reshape(-1, 3)
            found[file.meshes[node.mesh].name] = own.astype(np.float64) @ world[:3, :3].T + world[:3, 3]
    return found


@pytest.mark.parametrize("kind", ["gltf", "xml"])
def test_a_bake_lies_where_its_file_lay(room: Any, tmp_path: Path, kind: str) -> None:
    data = load(room.file(kind, PLACE))
    baked = bake_scene(data, "lightmap", dict(SMALL), frames=2, samples=2)
    path = tmp_path / "room.glb"
    write_bake(baked, path)
    corners = read_corners(path)
    for name in ("floor", "left", "back", "table"):
        wanted = np.unique(np.array(room.parts[name][0], np.float64), axis=0) + PLACE
        distance = np.linalg.norm(corners[name][:, None] - wanted, axis=2)
        # Backs of single walls stand a hair off their fronts.
        on_front = distance.min(axis=1) < 1e-6 * SIZE
        assert on_front.sum() >= 4 and (distance[on_front].min(axis=0) < 1e-6 * SIZE).all()
        assert (distance.min(axis=1) < 1e-3 * SIZE).all()
    floor = texels_near(baked, np.array([[1.0, 0.0, 1.0], [-1.0, 0.0, 2.0]]) + PLACE)
    assert (baked.layout.normal[baked.layout.face[baked.layout.starts[floor]]] == (0.0, 1.0, 0.0)).all()
    with pytest.raises(LuxelError, match="nearest texel"):
        texels_near(baked, np.array([[1.0, 0.0, 1.0]]))
    again = load(path)
    assert np.allclose(again.origin, data.origin, atol=SIZE)
    lit = relight(transport_of(path), data, frames=2)
    assert lit.light.irradiance == pytest.approx(baked.light.irradiance, rel=0.5, abs=0.05)


def test_a_view_is_copied_with_the_digits_that_its_place_needs(room: Any) -> None:
    data = load(room.gltf(PLACE))
    text = share.camera_text(data.cameras[0])
    camera = parse_camera(text, data)
    assert np.allclose(camera.eye, data.cameras[0].eye, rtol=0.0, atol=1e-5)
    assert np.allclose(camera.target, data.cameras[0].target, rtol=0.0, atol=1e-5)
    near = Camera((1.0, 2.0, 3.123456789), (0.0, 0.0, 0.0), fov=60.0)
    assert share.camera_text(near) == "1,2,3.123457;0,0,0;60"


@pytest.fixture
def served(room: Any) -> Iterator[Any]:
    from luxel.viewer.app import App
    from luxel.viewer.session import Session
    from luxel.viewer.world import Choice

    path = str(room.gltf(PLACE))
    session = Session(load(path), Choice("gibs", settings={"surfel_target": 2000}), size=(96, 72), text=path).start()
    app = App(session, port=0)
    yield app
    app.stop()
    session.stop(20.0)


def test_a_browser_is_sent_what_single_precision_holds(room: Any, served: Any) -> None:
    """The browser measures from amid the room, and the session hears of the file's coordinates."""
    import time as clock

    from luxel.viewer.headless_client import HeadlessClient

    start = served.server.initial_camera
    assert np.linalg.norm(start.position) < 10.0
    origin = served.session.facts.origin
    assert np.allclose(np.asarray(start.position) + origin, room.eye + PLACE, rtol=0.0, atol=1e-4)
    with HeadlessClient(served.url, window=(96, 72)) as client:
        own = Camera((0.5, 1.0, 0.7), (0.0, 1.0, 0.0), fov=60.0)
        client.look(own)
        client.listen(60.0, until_picture=True)
        (visitor,) = served.session.visitors()
        end = clock.perf_counter() + 30.0
        while not np.allclose(visitor.camera.eye, own.eye + origin, rtol=0.0, atol=1e-4):
            assert clock.perf_counter() < end, visitor.camera
            client.look(own)
            client.listen(0.2)
        assert client.pictures > 0
    view = share.SharedView(visitor.camera, (96, 72), 0.0, Exposure())
    words = shlex.split(share.write_command(served.session.launch, served.session.facts, view))
    text = next(word.partition("=")[2] for word in words if word.startswith("--camera="))
    assert np.allclose(parse_camera(text, load(room.gltf(PLACE))).eye, own.eye + origin, rtol=0.0, atol=1e-4)
    assert not served.session.faults, served.session.faults


def test_the_eye_in_the_files_coordinates_sees_discs_of_the_device(room: Any) -> None:
    from luxel.scene.device import upload
    from luxel.viewer.markers import find_visible

    scene = upload(load(room.gltf(PLACE)))
    places = np.array([[0.0, 0.0, 1.0], [-0.5, 0.0, -0.6]]) + PLACE - scene.host.origin
    up = np.tile([0.0, 1.0, 0.0], (2, 1))
    discs = Discs(np.arange(2), places, up, np.full(2, 0.05))
    x, y, z = np.array([-0.5, 2.0, -0.6]) + PLACE
    # The second one lies under the table.
    assert find_visible(scene, (x, y, z), discs).tolist() == [True, False]
