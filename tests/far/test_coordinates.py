"""Whoever uses luxel speaks the file's coordinates, however far away the file puts things."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from luxel.cli import main
from luxel.cli.app import app
from luxel.errors import LuxelError
from luxel.inspect.explain import explain_pixel
from luxel.render.renderer import Renderer
from luxel.scene import load
from luxel.scene.digest import hash_scene
from luxel.scene.model import Camera, Light

from .conftest import free_irradiance

PLACE = np.array([70_000.1, 3.0, -70_000.9])
NEAR = 2e-5
"""Metres: single precision within the room."""


def above_the_table(room: Any) -> Camera:
    """A camera that looks straight down on the middle of the table."""
    x, y, z = np.mean(room.parts["table"][0], axis=0) + PLACE
    return Camera((x, y + 1.0, z), (x, y, z), up=(0.0, 0.0, -1.0), fov=20.0)


@pytest.mark.parametrize("kind", ["gltf", "xml"])
def test_cameras_and_lights_stand_where_the_file_puts_them(room: Any, kind: str) -> None:
    data = load(room.file(kind, PLACE))
    (camera,), (light,) = data.cameras, data.lights
    forward = np.subtract(room.target, room.eye) / np.linalg.norm(np.subtract(room.target, room.eye))
    assert np.allclose(camera.eye, room.eye + PLACE, rtol=0.0, atol=NEAR)
    assert np.allclose(np.subtract(camera.target, camera.eye), forward, atol=NEAR)
    assert np.allclose(light.position, room.lamp + PLACE, rtol=0.0, atol=NEAR)
    places = {item.name: item for item in data.objects}
    table = places["table"]
    corners = table.meshes[0].positions.astype(np.float64) @ table.to_world[:3, :3].T + table.to_world[:3, 3]
    low, high = np.min(room.parts["table"][0], axis=0) + PLACE, np.max(room.parts["table"][0], axis=0) + PLACE
    assert np.allclose([corners.min(axis=0), corners.max(axis=0)], [low, high], rtol=0.0, atol=NEAR)


@pytest.mark.parametrize("kind", ["gltf", "xml"])
def test_a_pixel_is_explained_where_the_file_has_it(room: Any, kind: str) -> None:
    renderer = Renderer(load(room.file(kind, PLACE)), "gibs", size=(16, 16), camera=above_the_table(room))
    renderer.run(8)
    found = explain_pixel(renderer, 8, 8)
    assert found.object_name == "table" and found.distance == pytest.approx(1.0, rel=1e-3)
    middle = np.mean(room.parts["table"][0], axis=0) + PLACE
    assert found.position is not None and np.allclose(found.position, middle, rtol=0.0, atol=0.02)
    assert abs(found.position[1] - (0.8 + PLACE[1])) < NEAR
    places = np.array([item.p for item in found.contributions if item.p is not None])
    assert len(places) and (np.abs(places - middle) < 5.0).all()


def test_lights_are_set_and_added_in_the_files_coordinates(room: Any) -> None:
    data = load(room.gltf(PLACE))
    for material in data.materials:
        material.emission = (0.0, 0.0, 0.0)
    renderer = Renderer(data, "none", size=(17, 17), camera=above_the_table(room))
    below = np.mean(room.parts["table"][0], axis=0) + PLACE
    for position, intensity in (((0.3, 1.2, 0.2), 5.0), ((-0.2, 0.9, 0.0), 2.0)):
        x, y, z = below + position
        renderer.set_light(0, position=(x, y, z), color=(intensity,) * 3)
        renderer.step()
        square = float(np.square(position).sum())
        wanted = intensity * position[1] / square**1.5
        assert renderer.layers().direct[8, 8] == pytest.approx(np.full(3, wanted), rel=1e-3)
    renderer.remove_light(0)
    x, y, z = below + (0.0, 1.0, 0.0)
    renderer.add_light(Light("point", (3.0, 3.0, 3.0), position=(x, y, z)))
    renderer.step()
    assert renderer.layers().direct[8, 8] == pytest.approx(np.full(3, 3.0), rel=1e-3)
    assert renderer.data.lights[0].position == (x, y, z)


def test_an_object_of_far_vertices_moves_without_losing_more(room: Any) -> None:
    data = load(room.gltf(PLACE, by="vertices"))
    renderer = Renderer(data, "none", size=(16, 16), camera=above_the_table(room))
    # What single precision makes of the height, whatever is done to it.
    height = float(np.float32(0.8 + PLACE[1]))
    for rise in (0.0, 0.25):
        matrix = np.eye(4)
        matrix[1, 3] = rise
        renderer.move_object("table", matrix)
        renderer.step()
        found = explain_pixel(renderer, 8, 8)
        assert found.object_name == "table" and found.position is not None
        assert abs(found.position[1] - (height + rise)) < NEAR


@pytest.mark.parametrize("kind", ["gltf", "xml"])
def test_objects_are_moved_in_the_files_coordinates(room: Any, kind: str) -> None:
    data = load(room.file(kind, PLACE))
    renderer = Renderer(data, "none", size=(16, 16), camera=above_the_table(room))
    index = [item.name for item in data.objects].index("table")
    for rise in (0.25, 0.5):
        matrix = data.objects[index].to_world.copy()
        matrix[1, 3] += rise
        renderer.move_object("table", matrix)
        renderer.step()
        found = explain_pixel(renderer, 8, 8)
        assert found.object_name == "table" and found.position is not None
        assert abs(found.position[1] - (0.8 + rise + PLACE[1])) < NEAR
        assert np.array_equal(renderer.data.objects[index].motion(0.0), matrix)  # type: ignore[misc]


def test_what_moves_far_away_moves_by_its_track(room: Any) -> None:
    times, lift = np.array([0.0, 1.0], np.float32), np.array([[0, 0, 0], [0, 0.5, 0]], np.float32)
    path = room.gltf(PLACE)
    file = json.loads(path.read_text())
    file["buffers"].append(
        {"byteLength": 32, "uri": "data:application/octet-stream;base64," + to_text(times.tobytes() + lift.tobytes())}
    )
    file["bufferViews"] += [{"buffer": 1, "byteLength": 8}, {"buffer": 1, "byteOffset": 8, "byteLength": 24}]
    count = len(file["accessors"])
    file["accessors"] += [
        {"bufferView": 1, "componentType": 5126, "count": 2, "type": "SCALAR", "min": [0.0], "max": [1.0]},
        {"bufferView": 2, "componentType": 5126, "count": 2, "type": "VEC3"},
    ]
    nodes = [list(room.parts).index("table"), len(room.parts), len(room.parts) + 1]
    lifts = [[0.0, 0.0, 0.0], list(file["nodes"][nodes[1]]["matrix"][12:15]), list(room.lamp)]
    channels = [{"sampler": i, "target": {"node": node, "path": "translation"}} for i, node in enumerate(nodes)]
    del file["nodes"][nodes[1]]["matrix"]
    file["nodes"][nodes[1]]["rotation"] = [-0.7071067811865476, 0.0, 0.0, 0.7071067811865476]
    samplers = []
    for start in lifts:
        track = (lift + np.array(start, np.float32)).astype(np.float32)
        file["buffers"].append(
            {"byteLength": 24, "uri": "data:application/octet-stream;base64," + to_text(track.tobytes())}
        )
        file["bufferViews"].append({"buffer": len(file["buffers"]) - 1, "byteLength": 24})
        file["accessors"].append(
            {"bufferView": len(file["bufferViews"]) - 1, "componentType": 5126, "count": 2, "type": "VEC3"}
        )
        samplers.append({"input": count, "output": len(file["accessors"]) - 1})
    file["animations"] = [{"channels": channels, "samplers": samplers}]
    path.write_text(json.dumps(file))
    data = load(path)
    renderer = Renderer(data, "none", size=(16, 16), camera=above_the_table(room))
    for time in (0.0, 0.5, 1.0):
        renderer.step(time=time)
        found = explain_pixel(renderer, 8, 8)
        assert found.object_name == "table" and found.position is not None
        assert abs(found.position[1] - (0.8 + 0.5 * time + PLACE[1])) < NEAR
        # The lamp rises with it, so what it sends straight down stays what it is.
        offset = np.asarray(found.position) - (np.asarray(room.lamp) + (0.0, 0.5 * time, 0.0) + PLACE)
        wanted = 2.4 * -offset[1] / np.linalg.norm(offset) ** 3
        # The glowing panel adds to it.
        assert found.direct[2] >= 0.98 * wanted
    moving = Renderer(data, "none", size=(17, 17))
    heights = []
    for time in (0.0, 1.0):
        moving.step(time=time)
        found = explain_pixel(moving, 8, 8)
        assert found.distance is not None and found.position is not None
        heights.append(found.position[1] + found.distance)
    assert heights[1] - heights[0] == pytest.approx(0.5, abs=1e-3)


def to_text(data: bytes) -> str:
    import base64

    return base64.b64encode(data).decode()


POINTS = np.array([[0.0, 1.5, 0.0], [1.2, 0.4, -1.0], [-1.0, 2.0, 1.5]])
NORMALS = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
ROUGHLY = 0.15
"""What a few probes differ by from Mitsuba at free points; elsewhere in the room there is twice or half as much."""


@pytest.mark.parametrize("kind", ["gltf", "xml"])
def test_light_is_asked_for_in_the_files_coordinates(room: Any, kind: str) -> None:
    wanted = free_irradiance(room.mitsuba(kind), POINTS, NORMALS)
    renderer = Renderer(load(room.file(kind, PLACE)), "ddgi", {"probe_target": 500}, size=(32, 24))
    renderer.run(32)
    assert renderer.irradiance_at(POINTS + PLACE, NORMALS) == pytest.approx(wanted, rel=ROUGHLY)
    with pytest.raises(LuxelError, match="1e\\+30"):
        renderer.irradiance_at(np.array([[1e30, 0.0, 0.0]]), NORMALS[:1])


def test_probes_are_written_in_the_files_coordinates(room: Any, tmp_path: Path) -> None:
    from luxel.methods.ddgi.export import write_atlases
    from luxel.methods.ddgi.reader import read_probes

    renderer = Renderer(load(room.gltf(PLACE)), "ddgi", {"probe_target": 500}, size=(32, 24))
    renderer.run(16)
    renderer.method.save(renderer.state, tmp_path / "probes.npz")
    probes = read_probes(tmp_path / "probes.npz")
    low, high = np.array([-2.0, 0.0, -2.0]) + PLACE, np.array([2.0, 3.0, 3.0]) + PLACE
    awake = probes.p[probes.usable]
    assert (awake > low - 1.0).all() and (awake < high + 1.0).all()
    floor, up = np.array([[1.0, 0.0, 1.0]]) + PLACE, np.array([[0.0, 1.0, 0.0]])
    assert probes.irradiance(floor, up) == pytest.approx(renderer.irradiance_at(floor, up), rel=0.05)
    write_atlases(renderer.state, tmp_path / "atlases")
    header = json.loads((tmp_path / "atlases" / "probes.json").read_text())
    written = np.array(header["probes"]["p"])[probes.usable]
    assert np.allclose(written, awake, rtol=0.0, atol=1e-6)
    assert np.allclose(header["boxes"][0]["origin"], probes.header["boxes"][0]["origin"], rtol=0.0, atol=1e-6)


def test_boxes_of_probes_are_placed_in_the_files_coordinates(room: Any) -> None:
    wanted = free_irradiance(room.mitsuba("gltf"), POINTS, NORMALS)
    middle = ",".join(repr(float(axis)) for axis in PLACE + (0.0, 1.5, 0.5))
    params = {"boxes": f"{middle} size 3.6,2.6,4.6 probes 6,5,7"}
    renderer = Renderer(load(room.gltf(PLACE)), "ddgi", params, size=(32, 24))
    renderer.run(32)
    assert renderer.irradiance_at(POINTS + PLACE, NORMALS) == pytest.approx(wanted, rel=ROUGHLY)


def test_a_flight_passes_through_the_room(room: Any) -> None:
    from luxel.render.flight import find_flight, fly_through

    renderer = Renderer(load(room.gltf(PLACE)), "gibs", size=(32, 24))
    low, high = np.array([-2.0, 0.0, -2.0]) + PLACE, np.array([2.0, 3.0, 3.0]) + PLACE
    eyes = np.array([view.eye for view in find_flight(renderer.scene)])
    assert (eyes > low).all() and (eyes < high).all()
    fly_through(renderer, 2)
    assert np.allclose(renderer.camera.eye, room.eye + PLACE, rtol=0.0, atol=NEAR)


def test_a_picture_has_one_key_wherever_it_is_carried(room: Any) -> None:
    step = np.array([65_536.0, 0.0, -131_072.0])
    near, far = load(room.gltf()), load(room.gltf(step))
    assert far.origin != near.origin and hash_scene(far) == hash_scene(near)
    shifted = replace(far, objects=[*far.objects[:-1], replace(far.objects[-1])])
    moved = shifted.objects[-1].to_world.copy()
    moved[0, 3] += 1e-3
    shifted.objects[-1].to_world = moved
    assert hash_scene(shifted) != hash_scene(far)


def test_the_command_line_takes_and_gives_the_files_coordinates(room: Any, tmp_path: Path) -> None:
    camera = above_the_table(room)
    text = ";".join(",".join(repr(axis) for axis in vector) for vector in (camera.eye, camera.target)) + ";20"
    words = ["explain", str(room.gltf(PLACE)), "--pixel", "8,8", "--size", "17x17", "--frames", "4", f"--camera={text}"]
    result = CliRunner().invoke(app, [*words, "--json"])
    assert result.exit_code == 0, result.output
    found = json.loads(result.output)
    assert found["object_name"] == "table"
    assert abs(found["position"][1] - (0.8 + PLACE[1])) < NEAR
    printed = CliRunner().invoke(app, words).output
    assert "69999.600" in printed and "-70001.500" in printed


@pytest.mark.parametrize("number", ["1e30", "inf", "nan", "1e300"])
def test_a_camera_beyond_all_numbers_is_refused(room: Any, number: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["render", str(room.gltf()), f"--camera={number},0,0;0,0,0", "--size", "16x16", "--frames", "1"]
    assert main([*words, "-o", str(room.folder / "never.png")]) == 2
    error = capsys.readouterr().err.strip()
    assert len(error.splitlines()) == 1 and "amera" in error
    assert not (room.folder / "never.png").exists()


@pytest.mark.parametrize("kind", ["gltf", "xml"])
@pytest.mark.parametrize("far", [1e30, 1e12])
def test_a_room_beyond_all_numbers_is_refused(
    room: Any, kind: str, far: float, capsys: pytest.CaptureFixture[str]
) -> None:
    path = room.file(kind, (far, 0.0, 0.0))
    words = ["render", str(path), "--size", "16x16", "--frames", "1", "-o", str(room.folder / "never.png")]
    assert main(words) == 2
    error = capsys.readouterr().err.strip()
    assert len(error.splitlines()) == 1 and "Traceback" not in error
    assert not (room.folder / "never.png").exists()
