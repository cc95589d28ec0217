"""The built-in scenes: closed where they must be, the Cornell box equal to Mitsuba's, facts equal to theory."""

from __future__ import annotations

import math
from collections import Counter

import mitsuba as mi
import numpy as np
import pytest

from luxel.scene import list_scenes, load
from luxel.scene.edit import scene_bounds
from luxel.scene.library import BUILT_IN
from luxel.scene.library.shapes import arch, box, cloth, cylinder, merge, rotation, sphere, transformed, translation
from luxel.scene.model import Mesh, Object, SceneData

NAMES = list(BUILT_IN)


def area_of(mesh: Mesh) -> float:
    corners = mesh.positions[mesh.faces].astype(float)
    return (
        float(np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()) / 2
    )


def volume_of(meshes: list[Mesh]) -> float:
    """Signed volume: positive where a closed shape faces outwards."""
    corners = np.concatenate([mesh.positions[mesh.faces] for mesh in meshes]).astype(float)
    return float(np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum()) / 6


def open_edges(meshes: list[Mesh]) -> int:
    """Edges without exactly one partner that runs the other way; corners are compared to the last bit."""
    corners = np.concatenate([mesh.positions[mesh.faces] for mesh in meshes])
    edges: Counter[tuple[bytes, bytes]] = Counter()
    for triangle in corners:
        points = [(corner + 0.0).tobytes() for corner in triangle]
        for i in range(3):
            edges[points[i], points[(i + 1) % 3]] += 1
    return sum(count != 1 or edges[end, start] != 1 for (start, end), count in edges.items())


def named(data: SceneData, name: str) -> Object:
    return next(item for item in data.objects if item.name == name)


@pytest.mark.parametrize("name", NAMES)
def test_every_scene_is_sound(name: str) -> None:
    data = load(name)
    assert data.name == name
    assert data.cameras
    assert data.flight
    assert not data.warnings
    for item in data.objects:
        for mesh in item.meshes:
            assert mesh.positions.dtype == np.float32 and mesh.faces.dtype == np.uint32
            assert mesh.faces.max() < len(mesh.positions)
            assert np.isfinite(mesh.positions).all()
            assert mesh.material < len(data.materials)
            corners = mesh.positions[mesh.faces].astype(float)
            doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            assert np.linalg.norm(doubled, axis=1).min() > 1e-9, "a triangle without area"
            if mesh.normals is not None:
                assert np.allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-4)
                agreement = np.einsum("fkj,fj->fk", mesh.normals[mesh.faces], doubled)
                assert (agreement > 0).mean() > 0.99, "normals point to the back"
    for material in data.materials:
        scatters = (1.0 - material.metallic) * (1.0 - material.transmission)
        assert scatters * max(material.base_color) <= 0.9 or material.base_color_texture is not None


@pytest.mark.parametrize("name", NAMES)
def test_every_scene_has_light_and_cameras_off_the_walls(name: str) -> None:
    data = load(name)
    used = {mesh.material for item in data.objects for mesh in item.meshes}
    assert data.lights or max(data.sky.color) > 0 or any(max(data.materials[i].emission) > 0 for i in used)
    low, high = scene_bounds(data)
    outside = [camera for camera in data.flight if not (low < camera.eye).all() or not (camera.eye < high).all()]
    assert len(outside) <= 2


def test_list_scenes_names_docs_and_dials() -> None:
    rows = {name: (doc, dials) for name, doc, dials in list_scenes()}
    assert set(rows) >= {
        "cornell-box", "furnace", "sphere", "two-rooms", "opening", "attic", "atrium", "moving", "glossy",
    }  # fmt: skip
    assert rows["two-rooms"][1]["wall"] == 0.05
    assert all(doc and "\n" not in doc for doc, _ in rows.values())


def test_cornell_box_is_mitsubas() -> None:
    scene = mi.load_dict({key: value for key, value in mi.cornell_box().items() if key != "integrator"}, optimize=False)
    data = load("cornell-box")
    shapes = {shape.id(): shape for shape in scene.shapes()}
    ours = {item.name: item.meshes[0] for item in data.objects if item.name != "room"}
    for name, identity in (("large-box", "large-box"), ("small-box", "small-box"), ("lamp", "light")):
        bounds = shapes[identity].bbox()
        assert np.allclose(ours[name].positions.min(axis=0), np.array(bounds.min).ravel(), atol=1e-5)
        assert np.allclose(ours[name].positions.max(axis=0), np.array(bounds.max).ravel(), atol=1e-5)
        assert area_of(ours[name]) == pytest.approx(
            float(np.array(shapes[identity].surface_area()).ravel()[0]), rel=1e-5
        )
    assert area_of(ours["lamp"]) == pytest.approx(0.1748, rel=1e-5)
    theirs = np.unique(np.array(shapes["large-box"].vertex_positions_buffer()).reshape(-1, 3).round(4), axis=0)
    assert np.allclose(np.unique(ours["large-box"].positions.round(4), axis=0), theirs, atol=2e-4)
    white, red, green = named(data, "room").meshes
    assert (red.positions[:, 0] == -1).all() and (green.positions[:, 0] == 1).all()
    assert area_of(white) == pytest.approx(12.0)


def test_cornell_box_camera_and_colours_are_mitsubas() -> None:
    description = mi.cornell_box()
    data = load("cornell-box")
    matrix = np.array(description["sensor"]["to_world"].matrix).reshape(4, 4)
    camera = data.cameras[0]
    forward = np.subtract(camera.target, camera.eye) / np.linalg.norm(np.subtract(camera.target, camera.eye))
    assert np.allclose(camera.eye, matrix[:3, 3]) and np.allclose(forward, matrix[:3, 2], atol=1e-6)
    assert camera.fov == pytest.approx(description["sensor"]["fov"])
    # Mitsuba's camera has +X of its matrix on the left; ours has forward x up on the right.
    assert np.allclose(np.cross(forward, camera.up), -matrix[:3, 0], atol=1e-6)
    by_name = {material.name: material for material in data.materials}
    for name in ("white", "red", "green"):
        assert np.allclose(by_name[name].base_color, description[name]["reflectance"]["value"])
        assert not by_name[name].reflect_back
    assert np.allclose(by_name["lamp"].emission, description["light"]["emitter"]["radiance"]["value"])
    normal = named(data, "lamp").meshes[0]
    corners = normal.positions[normal.faces]
    assert (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 1] < 0).all()


def test_furnace_is_closed_and_inward() -> None:
    data = load("furnace")
    assert open_edges(data.objects[0].meshes) == 0
    assert volume_of(data.objects[0].meshes) == pytest.approx(-8.0)
    assert data.facts == {"radiance": 2.0, "direct_irradiance": math.pi, "indirect_irradiance": math.pi}
    assert data.materials[0].base_color == (0.5, 0.5, 0.5) and data.materials[0].emission == (1.0, 1.0, 1.0)


@pytest.mark.parametrize(("cap", "albedo"), [(20.0, 0.6), (7.0, 0.9), (90.0, 0.0)])
def test_sphere_is_closed_and_its_facts_are_theory(cap: float, albedo: float) -> None:
    data = load("sphere", cap=cap, albedo=albedo)
    lamp, wall = data.objects[0].meshes
    assert len(lamp.faces) + len(wall.faces) >= 5000
    assert open_edges([lamp, wall]) == 0
    assert volume_of([lamp, wall]) == pytest.approx(-4 / 3 * math.pi, rel=0.01)
    ideal = math.pi * data.materials[0].emission[0] * (1 - math.cos(math.radians(cap))) / 2
    direct, indirect = data.facts["direct_irradiance"], data.facts["indirect_irradiance"]
    assert direct == pytest.approx(ideal, rel=0.01)
    # Energy: what leaves the walls by emission is what they absorb.
    emitted = math.pi * data.materials[0].emission[0] * area_of(lamp)
    absorbed = (1 - albedo) * (direct + indirect) * (area_of(lamp) + area_of(wall))
    assert absorbed == pytest.approx(emitted, rel=1e-5)


@pytest.mark.parametrize("wall", [0.01, 0.05, 0.3])
def test_two_rooms_are_sealed_shells_a_wall_apart(wall: float) -> None:
    data = load(f"two-rooms:wall={wall}")
    lit, dark = named(data, "lit-room").meshes, named(data, "dark-room").meshes
    assert open_edges(lit) == 0 and open_edges(dark) == 0
    assert volume_of(lit) < 0 and volume_of(dark) < 0
    gap = min(mesh.positions[:, 0].min() for mesh in dark) - max(mesh.positions[:, 0].max() for mesh in lit)
    assert gap == pytest.approx(wall, abs=1e-6)
    low = np.array([data.facts[f"sealed_lo_{axis}"] for axis in "xyz"])
    high = np.array([data.facts[f"sealed_hi_{axis}"] for axis in "xyz"])
    assert np.allclose(low, dark[0].positions.min(axis=0)) and np.allclose(high, dark[0].positions.max(axis=0))
    view, second = data.cameras
    assert view.name == "default" and second.name == "dark"
    assert (low < second.eye).all() and (second.eye < high).all()
    assert all(camera.eye[0] < 0 for camera in data.flight)


def test_opening_is_closed_but_for_the_mouth_of_its_hole() -> None:
    for hole in (0.1, 0.5, 1.5):
        shell = named(load("opening", hole=hole), "shell").meshes
        assert open_edges(shell) == 4
        assert all(area_of(mesh) > 0 for mesh in shell)
    small, large = (sum(area_of(m) for m in named(load("opening", hole=h), "shell").meshes) for h in (0.2, 0.4))
    # A larger hole takes its square out of the wall and adds to the tunnel's sides.
    assert large - small == pytest.approx(-(0.4**2 - 0.2**2) + 4 * 0.2 * 0.2, abs=1e-5)


def test_opening_lets_the_sun_through_to_the_floor() -> None:
    data = load("opening")
    travel = np.array(data.lights[0].direction) / -data.lights[0].direction[1]
    landing = np.array((2.0, 1.9, 0.0)) + travel * 1.9
    assert -2 < landing[0] < 2 and -2 < landing[2] < 2


def test_attic_timbers_run_through_ceiling_and_slopes() -> None:
    for count in (1, 6):
        data = load(f"attic:beams={count},beam=0.2")
        timbers = named(data, "timbers").meshes[0]
        assert len(timbers.faces) == count * 3 * 12
        assert open_edges([timbers]) == 0 if count == 1 else True
    heights = timbers.positions[:, 1]
    assert ((heights > 2.3) & (heights < 2.5)).any() and ((heights > 2.56) & (heights < 2.7)).any()
    assert "timbers" not in {item.name for item in load("attic:beams=0").objects}
    assert open_edges(named(load("attic"), "shell").meshes) == 4


def test_atrium_is_a_light_stand_in_for_sponza() -> None:
    data = load("atrium")
    low, high = scene_bounds(data)
    assert np.allclose(high - low, (30, 12, 18), atol=0.8)
    assert 5_000 < sum(len(mesh.faces) for item in data.objects for mesh in item.meshes) < 50_000
    texture = data.materials[3].base_color_texture
    assert texture is not None and texture.image.shape == (256, 256, 3) and texture.image.max() <= 230


def test_moving_objects_are_rigid_and_return() -> None:
    data = load("moving")
    movers = [item for item in data.objects if item.motion is not None]
    assert len(movers) == 3 and data.duration == 4.0
    for item in movers:
        assert item.motion is not None
        assert np.allclose(item.motion(0.0), item.to_world)
        assert np.allclose(item.motion(4.0)[:3, 3], item.to_world[:3, 3])
        assert not np.allclose(item.motion(1.0), item.to_world)
        for time in np.linspace(0, 4, 9):
            linear = item.motion(float(time))[:3, :3]
            assert np.allclose(linear @ linear.T, np.eye(3)) and np.linalg.det(linear) == pytest.approx(1.0)
    lamp = data.lights[0]
    assert lamp.motion is not None
    places = [(lamp.motion(t) @ np.array([*lamp.position, 1.0]))[:3] for t in (0.0, 1.0, 2.0)]
    assert np.allclose(places[0], lamp.position) and np.linalg.norm(places[1] - places[0]) > 0.5
    low, high = scene_bounds(data)
    assert np.allclose(low, (-2.5, 0, -2.5), atol=1e-6) and np.allclose(high, (2.5, 3, 2.5), atol=1e-6)


def test_shapes_are_closed_and_face_outwards() -> None:
    cube = box((0, 0, 0), (1, 2, 3), 0)
    assert open_edges([cube]) == 0 and volume_of([cube]) == pytest.approx(6.0)
    assert volume_of([box((0, 0, 0), (1, 2, 3), 0, inward=True)]) == pytest.approx(-6.0)
    ball = sphere((1, 2, 3), 0.5, 0, rings=24, sectors=48)
    assert open_edges([ball]) == 0 and volume_of([ball]) == pytest.approx(math.pi / 6, rel=0.02)
    column = cylinder((1, 0, 0), 0.5, 2.0, 0, sides=64, capped=True)
    assert open_edges([column]) == 0 and volume_of([column]) == pytest.approx(math.pi / 2, rel=0.01)
    cone = cylinder((0, 0, 0), 1.0, 1.0, 0, top_radius=0.5, sides=64, capped=True)
    assert volume_of([cone]) == pytest.approx(math.pi * (1 + 0.5 + 0.25) / 3, rel=0.01)


def test_transformed_keeps_fronts_and_normals() -> None:
    ball = sphere((0, 0, 0), 1.0, 0)
    for matrix in (translation(1, 2, 3) @ rotation("x", 30.0), np.diag([1.0, 1.0, -1.0, 1.0])):
        moved = transformed(ball, matrix)
        centre = matrix[:3, 3]
        assert volume_of([moved]) == pytest.approx(volume_of([ball]), rel=1e-5)
        assert moved.normals is not None
        assert np.allclose(moved.normals, moved.positions - centre, atol=1e-5)


def test_arch_leaves_a_half_round_opening() -> None:
    panel = arch(4.0, 4.0, 1.0, 1.5, 0.5, 0, segments=64)
    front = panel.positions[panel.faces].astype(float)
    front = front[(front[:, :, 2] > 0.249).all(axis=1)]
    area = np.linalg.norm(np.cross(front[:, 1] - front[:, 0], front[:, 2] - front[:, 0]), axis=1).sum() / 2
    assert area == pytest.approx(4.0 * 3.0 - math.pi * 1.5**2 / 2, rel=1e-3)


def test_cloth_and_merge_keep_normals_and_uv() -> None:
    sheet = cloth(lambda u, v: np.stack([u, v, 0 * u], axis=1), 3, 2, 0)
    assert sheet.normals is not None and np.allclose(sheet.normals, (0, 0, 1))
    assert area_of(sheet) == pytest.approx(1.0)
    both = merge([sheet, box((0, 0, 0), (1, 1, 1), 0)])
    assert both.normals is not None and both.uv is not None
    assert len(both.faces) == 12 + 12 and area_of(both) == pytest.approx(7.0)
    assert np.allclose(np.linalg.norm(both.normals, axis=1), 1.0)


def test_glossy_has_every_roughness_as_metal_and_as_plastic() -> None:
    data = load("glossy")
    for shape in ("sphere", "plank"):
        for kind, metallic in (("metal", 1.0), ("plastic", 0.0)):
            shown = [data.materials[named(data, f"{kind}-{shape}-{r}").meshes[0].material] for r in ROUGH]
            assert [material.roughness for material in shown] == [float(r) for r in ROUGH]
            assert {material.metallic for material in shown} == {metallic}
    assert all(material.interface == "plastic" and not material.compensate for material in shown)


ROUGH = ("0", "0.1", "0.2", "0.4", "0.6", "1")


def test_glossy_is_a_room_with_one_window_and_a_solid_ball() -> None:
    data = load("glossy")
    assert open_edges(named(data, "room").meshes) == 4
    ball = named(data, "glass-ball").meshes
    assert open_edges(ball) == 0 and volume_of(ball) == pytest.approx(4 / 3 * math.pi * 0.32**3, rel=0.01)
    glass, pane = (data.materials[named(data, name).meshes[0].material] for name in ("glass-ball", "pane"))
    assert glass.transmission == pane.transmission == 1.0 and pane.thin and not glass.thin
    bodies = [item for item in data.objects if "sphere" in item.name or item.name == "glass-ball"]
    boxes = [np.array((item.meshes[0].positions.min(axis=0), item.meshes[0].positions.max(axis=0))) for item in bodies]
    for index, (low, high) in enumerate(boxes):
        assert all((low > other[1]).any() or (high < other[0]).any() for other in boxes[:index]), "bodies touch"


def test_the_sun_of_glossy_falls_through_its_window_on_the_floor() -> None:
    data = load("glossy")
    mouth = named(data, "room").meshes[0].positions
    outer = mouth[mouth[:, 0] < mouth[:, 0].max() - 4.9]
    travel = np.array(data.lights[0].direction)
    landing = outer.mean(axis=0) + travel * (outer[:, 1].mean() / -travel[1])
    low, high = scene_bounds(data)
    assert (low[[0, 2]] + 0.5 < landing[[0, 2]]).all() and (landing[[0, 2]] < high[[0, 2]] - 0.5).all()


@pytest.mark.parametrize("opacity", [0.0, 0.3, 0.6, 1.0])
def test_dials_of_glossy(opacity: float) -> None:
    data = load("glossy", curtain=opacity, ior=1.8, lamp=2.0)
    materials = {material.name: material for material in data.materials}
    texture = materials["curtain"].base_color_texture
    assert texture is not None and texture.image[..., 3].mean() / 255 == pytest.approx(opacity, abs=0.003)
    assert materials["glass"].ior == materials["pane"].ior == materials["plastic 0.1"].ior == 1.8
    plain = {material.name: material for material in load("glossy").materials}
    assert materials["lamp"].emission == tuple(2.0 * channel for channel in plain["lamp"].emission)
