"""Flights that are found for scenes without one, judged by Mitsuba's own rays."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from luxel.cli import main
from luxel.errors import LuxelError
from luxel.render.flight import find_flight
from luxel.render.flight_plan import VIEWS, free_ways
from luxel.scene import load
from luxel.scene.device import upload
from luxel.scene.library.shapes import box, make_mesh, merge, sphere
from luxel.scene.model import Camera, Material, Object, SceneData

SIDE = 48


class Judge:
    """A still scene in Mitsuba alone, and what cameras see of it."""

    def __init__(self, data: SceneData) -> None:
        corners = []
        for item in data.objects:
            matrix = np.asarray(item.to_world if item.motion is None else item.motion(0.0), float)
            for mesh in item.meshes:
                corners.append((mesh.positions @ matrix[:3, :3].T + matrix[:3, 3])[mesh.faces])
        points = np.concatenate(corners).reshape(-1, 3).astype(np.float32)
        mesh: Any = mi.Mesh("all", len(points), len(points) // 3)
        params = mi.traverse(mesh)
        params["vertex_positions"] = points.ravel()
        params["faces"] = np.arange(len(points), dtype=np.uint32)
        params.update()
        self.scene: Any = mi.load_dict({"type": "scene", "all": mesh})

    def cast(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return distance (infinite: a miss), points and normals on the side of the origin, (N,) and (N, 3)."""
        found = self.scene.ray_intersect(mi.Ray3f(mi.Point3f(origins.T), mi.Vector3f(directions.T)))
        normals = np.array(found.n).T
        normals *= -np.sign((normals * directions).sum(axis=1, keepdims=True))
        return np.where(np.array(found.is_valid()), np.array(found.t), np.inf), np.array(found.p).T, normals

    def look(self, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
        """Return points and normals (N, 3) of what a square picture shows."""
        eye, right, up, forward = axes_of(camera)
        middles = (np.arange(SIDE) + 0.5) / SIDE * 2.0 - 1.0
        x, y = (part.reshape(-1, 1) for part in np.meshgrid(middles, middles))
        directions = forward + np.tan(np.deg2rad(camera.fov) / 2.0) * (x * right + y * up)
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        t, p, n = self.cast(np.tile(eye, (len(directions), 1)), directions)
        return p[np.isfinite(t)], n[np.isfinite(t)]

    def shown(self, p: np.ndarray, n: np.ndarray, views: list[Camera]) -> np.ndarray:
        """Return which of the points (N, 3) some square picture shows."""
        found = np.zeros(len(p), bool)
        for view in views:
            eye, right, up, forward = axes_of(view)
            lifted = p + 1e-3 * n
            away, half = lifted - eye, np.tan(np.deg2rad(view.fov) / 2.0)
            depth = away @ forward
            framed = (depth > 0.0) & (abs(away @ right) <= half * depth) & (abs(away @ up) <= half * depth)
            distance = np.linalg.norm(away, axis=1)
            reach = mi.Float(distance * 0.9999)
            ray = mi.Ray3f(mi.Point3f(lifted.T), mi.Vector3f((-away / distance[:, None]).T), reach, 0.0, [])
            found |= framed & ((n * away).sum(axis=1) < 0.0) & ~np.array(self.scene.ray_test(ray))
        return found


def axes_of(camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return eye, right, up, forward of a camera at rest."""
    eye = np.array(camera.eye, np.float32)
    forward = np.array(camera.target) - np.array(camera.eye)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, camera.up)
    right /= np.linalg.norm(right)
    return eye, right, np.cross(right, forward), forward


def around(count: int, seed: int = 0) -> np.ndarray:
    directions = np.random.default_rng(seed).normal(size=(count, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


@pytest.mark.parametrize(
    "name", ["cornell-box", "two-rooms", "opening", "moving", "furnace", "sphere", "attic", "atrium", "glossy"]
)
def test_it_sees_what_the_scenes_own_flight_sees(name: str) -> None:
    data = load(name)
    own, data.flight = data.flight, []
    judge, scene = Judge(data), upload(data)
    views = find_flight(scene)
    p, n = (np.concatenate(part) for part in zip(*(judge.look(view) for view in own), strict=True))
    if name == "attic":  # its loft is sealed: no way leads there from the camera
        below = p[:, 1] < 2.5
        p, n = p[below], n[below]
    assert judge.shown(p, n, views).mean() >= 0.9
    assert len(views) <= VIEWS
    # One view does not do, or the figure above would show nothing.
    assert judge.shown(p, n, views[:1]).mean() < 0.9


def test_it_is_the_same_every_time_and_starts_at_the_first_camera() -> None:
    data = load("two-rooms")
    data.flight = []
    first, again = (find_flight(upload(data)) for _ in range(2))
    assert first == again
    assert first[0].eye == data.cameras[0].eye and first[0].fov == data.cameras[0].fov


def test_eyes_stand_in_free_air() -> None:
    """Each eye but the scene's own is some way off all surfaces, and in the closed room that the camera stands in."""
    walls = [box((-3.0, 0.0, -2.0), (3.0, 3.0, 2.0), 0, inward=True), box((-3.2, -0.2, -2.2), (3.2, 3.2, 2.2), 0)]
    shelf = box((-1.0, 0.0, -0.2), (1.0, 2.0, 0.2), 0)
    data = SceneData(
        "room", [Object("room", [*walls, shelf])], [Material()], cameras=[Camera((-2.5, 1.5, 1.5), (0, 1, 0))]
    )
    views, judge = find_flight(upload(data)), Judge(data)
    for view in views[1:]:
        t, _, _ = judge.cast(np.tile(np.array(view.eye, np.float32), (256, 1)), around(256))
        assert np.isfinite(t).all() and t.min() > 0.05
        assert (np.abs(view.eye) < (3.0, 3.0, 2.0)).all()
    t, p, n = judge.cast(np.tile(np.array(views[0].eye, np.float32), (2000, 1)), around(2000))
    assert judge.shown(p, n, views).mean() > 0.95
    behind = np.array([[0.0, 1.0, -0.2]]), np.array([[0.0, 0.0, -1.0]])
    assert judge.shown(*behind, views).all() and not judge.shown(*behind, views[:1]).any()


def alone(*, stray: bool) -> SceneData:
    """Return a thing in empty space, without any camera; with a stray triangle a hundred kilometres off."""
    thing = [merge([box((-1, 0, -0.4), (1, 1.5, 0.4), 0), box((-0.3, 1.5, -0.3), (0.3, 2.4, 0.3), 0)])]
    if stray:
        far = np.array([(1e5, 2e4, -7e4), (1e5 + 1, 2e4, -7e4), (1e5, 2e4 + 1, -7e4)])
        thing.append(make_mesh(far, [(0, 1, 2)], 0))
    return SceneData("alone", [Object("thing", thing)], [Material()])


@pytest.mark.parametrize("stray", [False, True])
def test_it_goes_round_a_thing_that_stands_alone(stray: bool) -> None:
    views, judge = find_flight(upload(alone(stray=stray))), Judge(alone(stray=False))
    assert all(np.linalg.norm(view.eye) < 100.0 for view in views)
    ring = around(3000)
    t, p, n = judge.cast((np.array((0.0, 1.0, 0.0)) + 8.0 * ring).astype(np.float32), -ring)
    shown = judge.shown(p[np.isfinite(t)], n[np.isfinite(t)], views)
    assert len(shown) > 2000 and shown.mean() > 0.9


def test_a_dome_of_500_m_is_as_good_as_sky() -> None:
    """Half of all rays end on it; the flight still goes round the thing, not about the dome."""
    data = alone(stray=False)
    data.objects.append(Object("dome", [sphere((0.0, 0.0, 0.0), 500.0, 0)]))
    data.cameras = [Camera((3.0, 1.5, 4.0), (0.0, 1.0, 0.0))]
    views, judge = find_flight(upload(data)), Judge(alone(stray=False))
    assert all(np.linalg.norm(view.eye) < 30.0 for view in views)
    p, n = np.array([[0.0, 0.7, 0.4], [0.0, 0.7, -0.4]]), np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    assert judge.shown(p, n, views).all()


def test_a_camera_that_sees_nothing_is_no_start() -> None:
    data = alone(stray=False)
    data.cameras = [Camera((0.0, 500.0, 0.0), (0.0, 900.0, 0.0), up=(0.0, 0.0, -1.0))]
    judge = Judge(data)
    p, n = np.array([[0.0, 0.7, 0.4], [0.0, 0.7, -0.4]]), np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    assert judge.shown(p, n, find_flight(upload(data))).all()


def test_a_way_through_a_wall_is_known() -> None:
    data = load("two-rooms")
    lit, dark = data.cameras[:2]
    across = Camera((-1.0, 1.5, 1.0), (-2.0, 1.0, 0.0))
    assert free_ways(upload(data), [lit, across, dark, dark]).tolist() == [True, False, True]


def test_a_file_is_flown_through(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paint = '<bsdf type="twosided"><bsdf type="diffuse"/></bsdf>'
    wall = f'<shape type="{{}}"><transform name="to_world">{{}}</transform>{paint}</shape>'
    shapes = wall.format("cube", '<scale value="2"/>') + wall.format("cube", '<scale value="0.4"/>')
    lamp = '<emitter type="point"><point name="position" x="0" y="1.5" z="0"/></emitter>'
    look = '<transform name="to_world"><lookat origin="1.5,0,1.5" target="0,0,0" up="0,1,0"/></transform>'
    film = '<film type="hdrfilm"><integer name="width" value="32"/><integer name="height" value="32"/></film>'
    sensor = f'<sensor type="perspective"><float name="fov" value="70"/>{look}{film}</sensor>'
    file = tmp_path / "room.xml"
    file.write_text(f'<scene version="3.0.0">{sensor}{shapes}{lamp}</scene>')
    words = [str(file), "--size", "24x24", "--frames", "2", "--set", "surfel_target=400", "--json"]
    assert main(["render", *words, "-o", str(tmp_path / "plain.png")]) == 0
    plain = capsys.readouterr().out
    assert main(["render", *words, "-o", str(tmp_path / "flown.png"), "--flight"]) == 0
    flown = capsys.readouterr().out
    assert json.loads(flown)["cache"]["surfel_count"] > 1.5 * json.loads(plain)["cache"]["surfel_count"]


def test_nothing_to_see_is_said() -> None:
    data = alone(stray=False)
    data.cameras = [Camera((0.0, 0.0, 50.0), (0.0, 0.0, 90.0))]
    assert len(find_flight(upload(data))) > 1  # from the default camera instead
    flat = SceneData("dot", [Object("", [make_mesh([(0, 0, 0), (0, 0, 0), (0, 0, 0)], [(0, 1, 2)], 0)])], [Material()])
    with pytest.raises(LuxelError, match="dot: none of its triangles has an area"):
        find_flight(upload(flat))


@pytest.mark.parametrize("height", [100.0, 1e4])
def test_a_far_camera_that_meets_little_is_a_start(height: float) -> None:
    """A few rays meet the floor, and no free place on them lies near it: the process must not end."""
    data = SceneData("floor", [Object("floor", [box((-4, -0.1, -4), (4, 0, 4), 0)])], [Material()])
    data.cameras = [Camera((0.0, height, 0.0), (0.0, 2.0 * height, 0.1))]
    views = find_flight(upload(data))
    assert 1 <= len(views) <= VIEWS and np.isfinite([view.eye for view in views]).all()
