"""Probes inside things are found dead and come out; those in the open stay where they are."""

from __future__ import annotations

import numpy as np
import pytest

from luxel.methods.ddgi.state import AWAKE, DEAD
from luxel.render.renderer import Renderer
from luxel.scene.library.shapes import box, make_mesh, quad, translation
from luxel.scene.model import Camera, Light, Material, Mesh, Object, SceneData, Sky

CELL = 1.0
GRID = "0,0,0 size 2,2,2 probes 3,3,3"
CENTRE = 13
"""The probe at the origin, in the middle of the grid."""


def room(*things: Mesh, materials: list[Material] | None = None, inward: bool = True, half: float = 3.0) -> SceneData:
    shell = box((-half, -half, -half), (half, half, half), 0, inward=inward)
    meshes = [Object("shell", [shell]), *(Object(f"thing{i}", [mesh]) for i, mesh in enumerate(things))]
    lamp = Light("point", (5.0, 5.0, 5.0), (0.0, 0.8 * half, 0.0))
    camera = Camera((0.8 * half, 0.5 * half, 0.8 * half), (0.0, 0.0, 0.0), fov=90.0)
    return SceneData("room", meshes, materials or [Material(), Material()], [lamp], [camera])


def run(data: SceneData, frames: int, **settings: object) -> Renderer:
    params = {"boxes": GRID, "extra_probes": 0, "sleep_after": 0, "num_samples_per_probe": 64, **settings}
    renderer = Renderer(data, "ddgi", params, size=(16, 16), seed=1)
    renderer.run(frames)
    return renderer


def status(renderer: Renderer) -> np.ndarray:
    return np.array(renderer.state.probes.status)


def places(renderer: Renderer) -> np.ndarray:
    return np.array(renderer.state.probes.p).T


def crate(size: float, middle: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Mesh:
    lo, hi = (tuple(m + sign * size for m in middle) for sign in (-1, 1))
    return box(lo, hi, 1)


def test_a_probe_inside_a_box_is_found_dead() -> None:
    renderer = run(room(crate(0.4)), 6, offset_dead_probes=False)
    found = status(renderer)
    assert found[CENTRE] == DEAD and (np.delete(found, CENTRE) == AWAKE).all()
    assert renderer.cache()["dead_probes"] == 1


def test_one_sided_insides_count_alike() -> None:
    renderer = run(room(crate(0.4), materials=[Material(), Material(reflect_back=False)]), 6, offset_dead_probes=False)
    assert status(renderer)[CENTRE] == DEAD


@pytest.mark.parametrize("pattern", ["backface", "axes"])
def test_it_comes_out_and_keeps_its_distance(pattern: str) -> None:
    """The box reaches to 0.3 cells from the node on two sides, farther than a probe may go on the others."""
    thing = box((-0.3, -0.6, -0.6), (0.3, 0.6, 0.6), 1)
    renderer = run(room(thing), 140, offset_pattern=pattern)
    p = places(renderer)[CENTRE]
    assert status(renderer)[CENTRE] == AWAKE
    outside = abs(p[0]) - 0.3
    assert outside >= 0.07 * CELL, f"it is {outside:.3f} m off the box, should keep a tenth of the cell"
    assert np.abs(p).max() <= 0.45 * CELL + 1e-5
    assert renderer.cache()["moved_probes"] == 1
    others = np.delete(places(renderer), CENTRE, axis=0)
    assert np.abs(others - np.round(others)).max() == 0.0, "probes in the open never move"
    # And once out, it stays.
    renderer.run(20)
    np.testing.assert_array_equal(places(renderer)[CENTRE], p)


def test_where_there_is_no_way_out_it_stays_dead() -> None:
    renderer = run(room(crate(0.8)), 60)
    assert status(renderer)[CENTRE] == DEAD
    assert np.abs(places(renderer)[CENTRE]).max() <= 0.45 * CELL + 1e-5


def test_too_near_to_a_wall_it_keeps_the_least_distance() -> None:
    wall = quad((-0.02, -2, 2), (-0.02, -2, -2), (-0.02, 2, -2), (-0.02, 2, 2), 1)
    back = quad((-0.03, -2, -2), (-0.03, -2, 2), (-0.03, 2, 2), (-0.03, 2, -2), 1)
    renderer = run(room(wall, back), 80, dead_probe_threshold=0.2, num_samples_per_probe=128)
    p = places(renderer)[CENTRE]
    assert p[0] + 0.02 >= 0.7 * 0.2 - 0.02 and np.abs(p).max() < 0.45


def test_nobody_moves_in_the_open() -> None:
    renderer = run(room(), 40)
    p = places(renderer)
    assert np.abs(p - np.round(p)).max() == 0.0 and (status(renderer) == AWAKE).all()


def test_without_detection_nothing_changes() -> None:
    renderer = run(room(crate(0.4)), 30, detect_dead_probes=False)
    assert (status(renderer) == AWAKE).all()
    p = places(renderer)
    assert np.abs(p - np.round(p)).max() == 0.0 and not np.array(renderer.state.probes.dead).any()


@pytest.mark.parametrize("half", [1.4, 3.0])
@pytest.mark.parametrize("color", [0.8, 0.0])
def test_a_room_whose_walls_face_outwards_is_lit_all_the_same(color: float, half: float) -> None:
    """Both sides reflect, so a room modelled as a plain cube must not lose its probes, whatever its colour."""
    materials = [Material(base_color=(color, color, color)), Material()]
    found = {}
    for inward in (True, False):
        renderer = run(room(materials=materials, inward=inward, half=half), 40)
        assert (status(renderer) == AWAKE).all(), f"walls inward: {inward}"
        found[inward] = renderer.irradiance_at(np.array([[0.0, -1.0, 0.3]]), np.array([[0.0, 1.0, 0.0]]))
    np.testing.assert_allclose(found[False], found[True], rtol=0.1, atol=1e-6)


SHEET = quad((-1.5, -1.2, -1.5), (1.5, -1.2, -1.5), (1.5, -1.2, 1.5), (-1.5, -1.2, 1.5), 1)
"""It faces down, away from the probes."""


@pytest.mark.parametrize("material", [Material(), Material(metallic=1.0)])
def test_the_back_of_a_black_cloth_is_not_the_inside_of_something(material: Material) -> None:
    """Two-sided black or metal sheets have no diffuse albedo: they are not one-sided for that."""
    renderer = run(room(SHEET, materials=[Material(), material], half=1.8), 20, offset_dead_probes=False)
    assert (status(renderer) == AWAKE).all()


def test_the_back_of_a_lone_sheet_kills_nobody() -> None:
    """Far from all walls the sheet's back is all that is near, and what is farther are fronts."""
    assert (status(run(room(SHEET), 20, offset_dead_probes=False)) == AWAKE).all()


def test_a_freed_probe_comes_back() -> None:
    """A thing passes through: its probe dies, moves or not, and is of use again after."""
    shift = np.eye(4)

    def motion(time: float) -> np.ndarray:
        matrix = shift.copy()
        matrix[0, 3] = 2.2 * min(time, 1.0)
        return matrix

    data = room()
    data.objects.append(Object("visitor", [crate(0.7)], motion=motion))
    data.duration = 1.0
    renderer = run(data, 8)
    assert status(renderer)[CENTRE] == DEAD
    for _ in range(100):
        renderer.step(time=1.0)
    assert status(renderer)[CENTRE] == AWAKE


def test_probes_go_on_moving_in_a_scene_that_goes_on() -> None:
    """`tries` is a bound on one search, not on a life: after calm frames a probe may search again."""
    renderer = run(room(), 4)
    state = renderer.state
    import drjit as dr
    import mitsuba as mi

    from luxel.methods.ddgi.relocate import MAX_MOVES

    state.probes.tries = dr.full(mi.UInt32, MAX_MOVES, state.settings.total)
    dr.make_opaque(state.probes.tries)
    renderer.run(200)
    assert np.array(renderer.state.probes.tries).max() < MAX_MOVES


def test_a_broken_mesh_is_no_inside() -> None:
    """A single triangle that is seen from its back by few rays kills nobody."""
    flake = make_mesh([(0.5, 0.1, 0.0), (0.5, 0.3, 0.0), (0.5, 0.1, 0.2)], [(0, 2, 1), (0, 1, 2)], 1)
    assert (status(run(room(flake), 10)) == AWAKE).all()


def test_who_was_inside_what_has_left_into_the_open_comes_back_to_life() -> None:
    """In open sky every ray is a miss: that is an answer, not silence."""

    def motion(time: float) -> np.ndarray:
        return translation(50.0 if time > 0.5 else 0.0, 0.0, 0.0)

    cube = Object("cube", [box((-1, -1, -1), (1, 1, 1), 0)], motion=motion)
    material = Material(base_color=(0.7, 0.7, 0.7), reflect_back=False)
    sky = Sky(color=(1.0, 1.0, 1.0))
    data = SceneData("cube", [cube], [material], cameras=[Camera((0, 0, 8), (0, 0, 0))], sky=sky)
    params = {"boxes": "0,0,0 size 4,4,4 probes 6,6,6", "sleep_after": 0, "offset_dead_probes": False}
    renderer = Renderer(data, "ddgi", params, size=(16, 16), seed=1)
    renderer.run(30, time_of=lambda _: 0.0)
    assert renderer.cache()["dead_probes"] == 8
    renderer.run(100, time_of=lambda _: 1.0)
    assert renderer.cache()["dead_probes"] == 0
