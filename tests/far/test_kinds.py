"""What else a file may carry far away: skins, instances, every way in which Mitsuba places a shape."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from luxel.scene import load
from luxel.scene.device import set_time, upload
from luxel.scene.model import SceneData

PLACE = np.array([70_000.1, 3.0, -70_000.9])
NEAR = 2e-5


def buffer_of(file: dict[str, Any], values: np.ndarray, kind: str, **more: Any) -> int:
    """Add an accessor for `values` with a buffer of its own; return its number."""
    types = {"float32": 5126, "uint8": 5121, "uint16": 5123}
    data = np.ascontiguousarray(values).tobytes()
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    file.setdefault("buffers", []).append({"byteLength": len(data), "uri": uri})
    file.setdefault("bufferViews", []).append({"buffer": len(file["buffers"]) - 1, "byteLength": len(data)})
    entry = {"bufferView": len(file["bufferViews"]) - 1, "componentType": types[values.dtype.name], "type": kind}
    file.setdefault("accessors", []).append({**entry, "count": len(values), **more})
    return len(file["accessors"]) - 1


def world_vertices(data: SceneData, time: float = 0.0) -> np.ndarray:
    """Where the device has the vertices, in the file's coordinates (V, 3)."""
    scene = upload(data)
    set_time(scene, time)
    rows = np.array(scene.geometry.vertices).reshape(-1, 4)[:, :3].astype(np.float64)
    tags = np.array(scene.geometry.triangles).reshape(-1, 4)
    owner = np.zeros(len(rows), np.int64)
    owner[tags[:, :3].astype(np.int64).ravel()] = np.repeat(tags[:, 3].astype(np.int64) >> 16, 3)
    moved = {group.object_id for group in scene.groups}
    placed = [
        scene.host.matrices[number if number in moved else 0] @ (*row, 1.0)
        for number, row in zip(owner, rows, strict=True)
    ]
    return np.array(placed)[:, :3] + scene.host.origin


QUAD = np.array([[0, 0, 0], [1, 0, 0], [1, 2, 0], [0, 2, 0]], np.float32)


def test_a_skin_far_away_bends_where_its_joints_are(tmp_path: Path) -> None:
    file: dict[str, Any] = {"asset": {"version": "2.0"}, "scenes": [{"nodes": [0, 1]}], "scene": 0}
    weights = np.array([[1, 0, 0, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 1, 0, 0]], np.float32)
    attributes = {
        "POSITION": buffer_of(file, QUAD, "VEC3", min=[0, 0, 0], max=[1, 2, 0]),
        "JOINTS_0": buffer_of(file, np.tile(np.array([0, 1, 0, 0], np.uint8), (4, 1)), "VEC4"),
        "WEIGHTS_0": buffer_of(file, weights, "VEC4"),
    }
    indices = buffer_of(file, np.array([0, 1, 2, 0, 2, 3], np.uint16), "SCALAR")
    file["meshes"] = [{"primitives": [{"attributes": attributes, "indices": indices}]}]
    file["nodes"] = [
        {"mesh": 0, "skin": 0},
        {"translation": PLACE.tolist(), "children": [2, 3]},
        {},
        {"translation": [0.0, 0.5, 0.0]},
    ]
    file["skins"] = [{"joints": [2, 3]}]
    times = buffer_of(file, np.array([0.0, 1.0], np.float32), "SCALAR", min=[0.0], max=[1.0])
    lift = buffer_of(file, np.array([[0, 0.5, 0], [0.25, 1.5, 0]], np.float32), "VEC3")
    channel = {"sampler": 0, "target": {"node": 3, "path": "translation"}}
    file["animations"] = [{"channels": [channel], "samplers": [{"input": times, "output": lift}]}]
    path = tmp_path / "skin.gltf"
    path.write_text(json.dumps(file))
    data = load(path)
    for time in (0.0, 1.0):
        wanted = QUAD + PLACE + np.where(weights[:, 1:2] > 0, (0.25 * time, 0.5 + time, 0.0), (0.0, 0.0, 0.0))
        assert np.allclose(world_vertices(data, time), wanted, rtol=0.0, atol=NEAR)


def test_instances_stand_about_their_far_node(room: Any) -> None:
    path = room.gltf(PLACE)
    file = json.loads(path.read_text())
    offsets = np.array([[0, 0, 0], [0, 0.7, 0.25]], np.float32)
    number = list(room.parts).index("table")
    attributes = {"TRANSLATION": buffer_of(file, offsets, "VEC3")}
    file["nodes"][number]["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": attributes}}
    file["extensionsUsed"].append("EXT_mesh_gpu_instancing")
    path.write_text(json.dumps(file))
    found = world_vertices(load(path))
    for offset in offsets:
        for corner in np.array(room.parts["table"][0], np.float64):
            assert np.linalg.norm(found - (corner + offset + PLACE), axis=1).min() < NEAR


def text_of(values: Any) -> str:
    return ",".join(repr(float(value)) for value in values)


def write_scene(path: Path, shapes: str) -> Path:
    path.write_text(f'<scene version="3.0.0">{shapes}<emitter type="constant"/></scene>')
    return path


def move(place: np.ndarray, before: str = "") -> str:
    x, y, z = (repr(float(axis)) for axis in place)
    return f'<transform name="to_world">{before}<translate x="{x}" y="{y}" z="{z}"/></transform>'


CUBE = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
SCALE = '<scale value="2"/>'
SHAPES = {
    "cube": (lambda: f'<shape type="cube">{move(PLACE)}</shape>', (-1, -1, -1), (1, 1, 1)),
    "sphere by its centre": (
        lambda: f'<shape type="sphere"><point name="center" value="{text_of(PLACE)}"/></shape>',
        (-1, -1, -1),
        (1, 1, 1),
    ),
    "sphere by its centre in a scaled space": (
        lambda: (
            f'<shape type="sphere"><point name="center" value="{text_of(0.5 * PLACE)}"/>'
            f"{move(np.zeros(3), SCALE)}</shape>"
        ),
        (-2, -2, -2),
        (2, 2, 2),
    ),
    "cylinder by its ends": (
        lambda: (
            f'<shape type="cylinder"><point name="p0" value="{text_of(PLACE)}"/>'
            f'<point name="p1" value="{text_of(PLACE + (0, 3, 0))}"/></shape>'
        ),
        (-1, 0, -1),
        (1, 3, 1),
    ),
    "instance": (
        lambda: (
            f'<shape type="shapegroup" id="g"><shape type="cube">{move(np.array([0, 1, 0]))}</shape></shape>'
            f'<shape type="instance">{move(PLACE)}<ref id="g"/></shape>'
        ),
        (-1, 0, -1),
        (1, 2, 1),
    ),
}


@pytest.mark.parametrize("name", SHAPES)
def test_mitsuba_places_shapes_in_double_precision(tmp_path: Path, name: str) -> None:
    make, low, high = SHAPES[name]
    found = world_vertices(load(write_scene(tmp_path / "scene.xml", make())))
    # Spheres and cylinders are of triangles, whose corners lie on them.
    assert np.allclose(found.min(axis=0), PLACE + low, rtol=0.0, atol=1e-2 if "by its" in name else NEAR)
    assert np.allclose(found.max(axis=0), PLACE + high, rtol=0.0, atol=1e-2 if "by its" in name else NEAR)
    assert abs(found[:, 1].min() - (PLACE[1] + low[1])) < 1e-2


@pytest.mark.parametrize(("by", "named"), [("vertices", True), ("to_world", False)])
def test_a_mesh_file_that_lies_far_away_itself_is_named(tmp_path: Path, by: str, named: bool) -> None:
    own = PLACE if by == "vertices" else np.zeros(3)
    lines = [f"v {text_of(corner).replace(',', ' ')}" for corner in QUAD.astype(np.float64) + own]
    (tmp_path / "quad.obj").write_text("\n".join([*lines, "f 1 2 3", "f 1 3 4"]))
    data = load(
        write_scene(
            tmp_path / "scene.xml",
            f'<shape type="obj"><string name="filename" value="quad.obj"/>{move(PLACE - own)}</shape>',
        )
    )
    assert bool([text for text in data.warnings if "7.8 mm" in text]) is named
    wanted = QUAD.astype(np.float64) + PLACE
    found = world_vertices(data)
    nearest = np.linalg.norm(found[:, None] - wanted, axis=2).min(axis=1)
    assert nearest.max() < (0.01 if named else NEAR)


def test_lamps_and_cameras_of_mitsuba_files_keep_their_digits(tmp_path: Path) -> None:
    target = text_of(PLACE + (0.0, 0.0, -1.0))
    look = f'<transform name="to_world"><lookat origin="{text_of(PLACE)}" target="{target}" up="0,1,0"/></transform>'
    shapes = (
        f'<shape type="cube">{move(PLACE)}</shape><sensor type="perspective">{look}</sensor>'
        f'<emitter type="spot">{look}</emitter><emitter type="point">{move(PLACE)}</emitter>'
        f'<emitter type="directional">{look}</emitter>'
    )
    data = load(write_scene(tmp_path / "scene.xml", shapes))
    assert np.allclose(data.cameras[0].eye, PLACE, rtol=0.0, atol=NEAR)
    places = {light.kind: light for light in data.lights}
    assert np.allclose(places["spot"].position, PLACE, rtol=0.0, atol=NEAR)
    assert np.allclose(places["point"].position, PLACE, rtol=0.0, atol=NEAR)
    for kind in ("spot", "directional"):
        assert np.allclose(places[kind].direction, (0.0, 0.0, -1.0), atol=1e-6)


def test_a_cylinder_with_one_end_by_default_keeps_its_length(tmp_path: Path) -> None:
    away = PLACE + (7.0, 0.0, 0.0)
    shapes = (
        f'<shape type="cube">{move(PLACE, SCALE)}</shape>'
        f'<shape type="cylinder" id="post"><point name="p0" value="0,0,0.5"/><float name="radius" value="0.1"/>'
        f"{move(away)}</shape>"
    )
    data = load(write_scene(tmp_path / "scene.xml", shapes))
    data.objects = [item for item in data.objects if item.name == "post"]
    found = world_vertices(data) - away
    # Mitsuba: p1 is (0, 0, 1) where the file does not say it.
    assert np.allclose(found.min(axis=0), (-0.1, -0.1, 0.5), rtol=0.0, atol=1e-3)
    assert np.allclose(found.max(axis=0), (0.1, 0.1, 1.0), rtol=0.0, atol=1e-3)


DOT = '<film type="hdrfilm"><integer name="width" value="1"/><integer name="height" value="1"/></film>'
BOX = '<rfilter type="box"/>'
METERS = {
    "in a shape": ('<sensor type="irradiancemeter"/>', ""),
    "of one ray": (
        "",
        f'<sensor type="radiancemeter"><point name="origin" value="0,0,3"/><vector name="direction" value="0,0,-1"/>'
        f"{DOT.replace('</film>', BOX + '</film>')}</sensor>",
    ),
    "of one direction": (
        "",
        f'<sensor type="distant"><vector name="direction" value="0,0,-1"/>'
        f"{DOT.replace('</film>', BOX + '</film>')}</sensor>",
    ),
}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", METERS)
def test_sensors_that_make_no_picture_are_left_out_far_away_too(tmp_path: Path, name: str) -> None:
    inner, beside = METERS[name]
    data = load(write_scene(tmp_path / "scene.xml", f'<shape type="cube">{move(PLACE)}{inner}</shape>{beside}'))
    assert any(data.origin)
    assert any("Sensors of these types are left out" in text for text in data.warnings)
