"""The descent of the light tree: probabilities that add up to one, no light left out, sums that are right."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.kernels.direct import direct_irradiance
from luxel.kernels.light_tree import _importance, choose_source
from luxel.kernels.surface import free_surface
from luxel.scene.device import Scene, upload
from luxel.scene.library.shapes import box, quad
from luxel.scene.lights import DELTA_EACH_LIMIT, ENTRY_IS_DELTA, NO_ENTRY
from luxel.scene.model import Light, Material, Mesh, Object, SceneData

FAR = quad((90, 90, 90), (91, 90, 90), (91, 91, 90), (90, 91, 90), 0)
UP = (0.0, 1.0, 0.0)


def scene_with(
    lights: Sequence[Light] = (), meshes: Sequence[Mesh] = (), materials: Sequence[Material] = ()
) -> Scene:  # fmt: skip
    objects = [Object("all", [FAR, *meshes])]
    return upload(SceneData("lit", objects, [Material(), *materials], lights=list(lights)))


def leaf_probabilities(scene: Scene, point: Any, normal: Any) -> dict[int, float]:
    """Return the probability of each entry: the product of shares on its way, every node weighed by the kernel."""
    width = scene.lights.entry_count
    node = dr.arange(mi.UInt32, 2 * width)
    p, n = mi.Point3f(*map(float, point)), mi.Normal3f(*map(float, normal))
    weight = np.array(_importance(scene.lights, node, p, n, mi.Bool(True)), float)
    chance = np.zeros(2 * width)
    chance[1] = 1.0
    for parent in range(1, width):
        total = weight[2 * parent] + weight[2 * parent + 1]
        for child in (2 * parent, 2 * parent + 1):
            chance[child] = chance[parent] * weight[child] / total if total > 0.0 else 0.0
    entries = np.array(scene.lights.entries)
    return {int(entry): float(c) for entry, c in zip(entries, chance[width:], strict=True) if entry != NO_ENTRY}


def unshadowed(light: Light, point: Any, normal: Any) -> float:
    """Return what KHR_lights_punctual says that a grey light brings."""
    power, n = light.color[0], np.asarray(normal, float)
    along = np.asarray(light.direction, float) / np.linalg.norm(light.direction)
    if light.kind == "directional":
        return power * max(float(-along @ n), 0.0)
    offset = np.asarray(light.position, float) - point
    squared = float(offset @ offset)
    if squared == 0.0:
        return 0.0
    to_light = offset / np.sqrt(squared)
    value = power * max(float(to_light @ n), 0.0) / squared
    if np.isfinite(light.range):
        value *= np.clip(1.0 - (squared / light.range**2) ** 2, 0.0, 1.0) ** 2
    if light.kind == "spot":
        cosine = float(-to_light @ along)
        value *= np.clip((cosine - light.cos_outer) / max(light.cos_inner - light.cos_outer, 1e-4), 0.0, 1.0) ** 2
    return value


def mixed_lights(count: int, seed: int) -> list[Light]:
    """Return lamps, short-ranged lamps, narrow and wide spots and suns of powers over four decades."""
    rng = np.random.default_rng(seed)
    lights = []
    for index in range(count):
        kind = ("point", "point", "spot", "spot", "directional")[index % 5]
        power = 10.0 ** rng.uniform(-2.0, 2.0) * (0.05 if kind == "directional" else 1.0)
        inner = float(rng.uniform(-0.2, 0.999))
        outer = float(rng.uniform(-0.5, inner))
        reach = float(rng.uniform(0.5, 5.0)) if index % 3 == 0 else float("inf")
        place, way = rng.uniform(-4.0, 4.0, 3), rng.normal(size=3)
        lights.append(
            Light(kind, (power,) * 3, tuple(place), tuple(way), inner, outer, range=reach)  # type: ignore[arg-type]
        )
    return lights


def random_views(count: int, seed: int) -> list[tuple[np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(count, 3))
    return list(
        zip(rng.uniform(-6.0, 6.0, (count, 3)), normals / np.linalg.norm(normals, axis=1)[:, None], strict=True)
    )


# ------------------------------------------------------------------------------------------------- probabilities


@pytest.mark.parametrize("count", [9, 40, 300])
def test_probabilities_add_up_and_leave_nobody_out(count: int) -> None:
    """No light that lights a point has probability 0, and the others take nothing where their node is known to be
    dark."""
    lights = mixed_lights(count, count)
    scene = scene_with(lights)
    # The first eight suns have a ray each, outside the tree.
    each = [index for index, light in enumerate(lights) if light.kind == "directional"][:DELTA_EACH_LIMIT]
    drawn = [index for index in range(count) if index not in each]
    for point, normal in random_views(12, count):
        chance = leaf_probabilities(scene, point, normal)
        assert not {index | ENTRY_IS_DELTA for index in each} & chance.keys()
        brings = np.array([unshadowed(lights[index], point, normal) for index in drawn])
        found = np.array([chance[index | ENTRY_IS_DELTA] for index in drawn])
        missed = (found <= 0.0) & (brings > 1e-6 * brings.max())
        assert not missed.any(), f"lights {np.flatnonzero(missed)} are never drawn"
        # Some draws end at a node whose box might hold a light for the point, when neither child can.
        assert found.sum() <= 1.0 + 1e-4


def test_probabilities_of_lights_that_all_reach_the_point_sum_to_one() -> None:
    rng = np.random.default_rng(8)
    lights = [Light("point", (10.0 ** rng.uniform(-3, 3),) * 3, tuple(p)) for p in rng.uniform(-3.0, 3.0, (77, 3))]
    lights += [Light("directional", (0.1, 0.1, 0.1), direction=(0.1 * i, -1.0, 0.0)) for i in range(20)]
    scene = scene_with(lights)
    for x, y, z in rng.uniform(-9.0, 9.0, (10, 3)):
        chance = leaf_probabilities(scene, (x, -3.5 - abs(y), z), UP)
        assert len(chance) == 77 + 20 - DELTA_EACH_LIMIT
        assert all(value > 0.0 for value in chance.values())
        assert sum(chance.values()) == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize("count", [9, 40])
def test_draws_follow_the_probability_that_is_returned(count: int) -> None:
    scene = scene_with(mixed_lights(count, count + 1))
    draws = 1 << 15
    sample = (dr.arange(mi.Float, draws) + 0.5) / draws
    for point, normal in random_views(6, count):
        chance = leaf_probabilities(scene, point, normal)
        p, n = mi.Point3f(*map(float, point)), mi.Normal3f(*map(float, normal))
        entry, probability = choose_source(scene, p, n, sample, mi.Bool(True))
        entry, probability = np.array(entry), np.array(probability)
        drawn = probability > 0.0
        for name in np.unique(entry[drawn]):
            here = drawn & (entry == name)
            np.testing.assert_allclose(probability[here], chance[int(name)], rtol=1e-3)
            assert here.sum() == pytest.approx(draws * chance[int(name)], abs=4.0, rel=2e-3)


def test_lights_beyond_their_range_are_never_drawn() -> None:
    near = [Light("point", (1.0, 1.0, 1.0), (0.2 * i, 1.0, 0.0), range=3.0) for i in range(5)]
    away = [Light("point", (1e4, 1e4, 1e4), (50.0 + i, 1.0, 0.0), range=3.0) for i in range(40)]
    chance = leaf_probabilities(scene_with([*near, *away]), (0.0, 0.0, 0.0), UP)
    assert sum(chance[index | ENTRY_IS_DELTA] for index in range(5)) == pytest.approx(1.0, abs=1e-5)
    assert all(chance[index | ENTRY_IS_DELTA] == 0.0 for index in range(5, 45))


def test_lights_within_their_range_are_drawn_wherever_their_node_is() -> None:
    rng = np.random.default_rng(4)
    places, ranges = rng.uniform(-7.0, 7.0, (600, 3)), rng.uniform(1.0, 6.0, 600)
    lights = [Light("point", (1.0, 1.0, 1.0), tuple(p), range=float(r)) for p, r in zip(places, ranges, strict=True)]
    scene = scene_with(lights)
    for point, normal in random_views(12, 1):
        chance = leaf_probabilities(scene, point, normal)
        brings = np.array([unshadowed(light, point, normal) for light in lights])
        found = np.array([chance[index | ENTRY_IS_DELTA] for index in range(600)])
        assert (brings > 0.0).any()
        assert not ((found <= 0.0) & (brings > 1e-6 * brings.max())).any()
        assert not found[np.linalg.norm(places - point, axis=1) > ranges].any()


def test_a_wide_sun_half_below_the_horizon_is_drawn() -> None:
    """Its axis is 10 degrees below, its rim 10 degrees above."""
    low = (0.0, np.sin(np.radians(10.0)), np.cos(np.radians(10.0)))
    suns = [Light("directional", (1.0, 1.0, 1.0), direction=low, angular_diameter=40.0) for _ in range(12)]
    away = [
        Light("directional", (1.0, 1.0, 1.0), direction=(0.0, 1.0, 0.1 * i), angular_diameter=5.0) for i in range(16)
    ]
    # The first eight suns have a ray each.
    chance = leaf_probabilities(scene_with([*away, *suns]), (0.0, 0.0, 0.0), UP)
    assert sum(chance[index | ENTRY_IS_DELTA] for index in range(16, 28)) == pytest.approx(1.0, abs=1e-4)


def test_lights_below_the_horizon_and_triangles_that_face_away_are_never_drawn() -> None:
    below = [Light("point", (100.0, 100.0, 100.0), (0.3 * i, -1.0, 0.0)) for i in range(16)]
    above = [Light("point", (0.1, 0.1, 0.1), (0.0, 3.0, 0.0))]
    glow = Material(emission=(50.0, 50.0, 50.0))
    lid = quad((-1, 2, -1), (-1, 2, 1), (1, 2, 1), (1, 2, -1), 1)
    scene = scene_with([*below, *above], [lid], [glow])
    chance = leaf_probabilities(scene, (0.0, 0.0, 0.0), UP)
    assert chance[16 | ENTRY_IS_DELTA] == pytest.approx(1.0, abs=1e-4)


# ------------------------------------------------------------------------------------------------- sums of light


def expect_sum(scene: Scene, point: Any, normal: Any, expected: float) -> None:
    """The mean of many estimates is `expected` within four standard errors, which are under 2 %."""
    samples = 1 << 18
    surface = free_surface(np.tile(point, (samples, 1)), np.tile(normal, (samples, 1)))
    lane = dr.arange(mi.UInt32, samples)
    found = np.array(direct_irradiance(scene, surface, dr.opaque(mi.UInt32, 5), lane, surface.active))[1].astype(float)
    error = found.std() / np.sqrt(samples)
    assert error < 0.02 * expected
    assert found.mean() == pytest.approx(expected, abs=4.0 * error + 1e-4 * expected)


@pytest.mark.parametrize("count", [9, 200])
def test_lamps_of_all_kinds_sum_up(count: int) -> None:
    lights = mixed_lights(count, count + 2)
    scene = scene_with(lights)
    for point, normal in random_views(4, count):
        expected = sum(unshadowed(light, point, normal) for light in lights)
        expect_sum(scene, point, normal, expected)


PLACES = {
    "one point": [(1.0, 2.0, 0.5)] * 30,
    "one line": [(0.1 * i, 2.0, 0.0) for i in range(30)],
    "a line away from the point": [(0.0, 0.2 + 0.3 * i, 0.0) for i in range(30)],
    "around the point": [(np.cos(i), 0.05 * (i % 5), np.sin(i)) for i in range(30)],
    "one at the point": [(0.0, 0.0, 0.0), *((0.3 * i, 1.0, 0.0) for i in range(29))],
    "in its plane, but one": [*((0.3 * i - 4.0, 0.0, 1.0) for i in range(29)), (0.0, 2.0, 0.0)],
}


@pytest.mark.parametrize("place", PLACES)
def test_lamps_in_odd_places_sum_up(place: str) -> None:
    lights = [
        Light("point", (1.0 + i, 1.0 + i, 1.0 + i), (float(x), float(y), float(z)))
        for i, (x, y, z) in enumerate(PLACES[place])
    ]
    point = (0.0, 0.0, 0.0)
    expect_sum(scene_with(lights), point, UP, sum(unshadowed(light, point, UP) for light in lights))


def form_factor(corners: np.ndarray, point: np.ndarray, normal: np.ndarray) -> float:
    """Return the irradiance of a triangle (3, 3) of radiance 1 that lies above the horizon (Lambert's formula)."""
    unit = (corners - point) / np.linalg.norm(corners - point, axis=1, keepdims=True)
    total = 0.0
    for a, b in zip(unit, np.roll(unit, -1, axis=0), strict=True):
        side = np.cross(a, b)
        length = np.linalg.norm(side)
        if length > 0.0:
            total += np.arctan2(length, a @ b) * (side / length) @ normal
    return 0.5 * abs(total)


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("both_sides", [False, True])
@pytest.mark.parametrize("moving", [False, True])
def test_triangles_and_lamps_sum_up(mirrored: bool, both_sides: bool, moving: bool) -> None:
    """Sixty triangles at random above the point, seen from front or back, and lamps, none in the way of another."""
    rng = np.random.default_rng(3)
    centres = rng.uniform((-3, 1.0, -3), (3, 3.0, 3), (60, 3))
    # Small ones, so that hardly any is hidden.
    corners = (centres[:, None, :] + rng.normal(scale=0.01, size=(60, 3, 3))).astype(np.float32)
    emission = rng.uniform(20.0, 900.0, 3)
    materials = [Material(emission=(e, e, e), emit_back=both_sides) for e in emission]
    meshes = [
        Mesh(corners[k::3].reshape(-1, 3), np.arange(60, dtype=np.uint32).reshape(20, 3), material=k + 1)
        for k in range(3)
    ]
    matrix = np.diag((-1.5, 1.0, 0.7, 1.0)) if mirrored else np.eye(4)
    motion = (lambda time: matrix) if moving else None
    glow = Object("glow", meshes, matrix, motion=motion)
    lamps = [Light("point", (0.01, 0.01, 0.01), tuple(p)) for p in rng.uniform((-3, 1, -3), (3, 3, 3), (12, 3))]
    data = SceneData("lit", [Object("far", [FAR]), glow], [Material(), *materials], lights=lamps)
    scene = upload(data)
    point, normal = np.zeros(3), np.array(UP)
    expected = sum(unshadowed(light, point, normal) for light in lamps)
    for k in range(3):
        for triangle in corners[k::3]:
            world = triangle @ matrix[:3, :3].T
            # A mirror turns the order of the corners, not the side that shines.
            face = np.linalg.det(matrix[:3, :3]) * np.cross(world[1] - world[0], world[2] - world[0])
            if both_sides or face @ (point - world[0]) > 0.0:
                expected += emission[k] * form_factor(world.astype(float), point, normal)
    expect_sum(scene, point, normal, expected)


def test_a_box_of_emitting_walls_lights_its_inside_from_everywhere() -> None:
    """In a closed box of radiance L each point sees L over the whole hemisphere: E = pi L; 24 triangles, two shells."""
    glow = Material(emission=(2.0, 2.0, 2.0), emit_back=True)
    shell = box((-1, -1, -1), (1, 1, 1), 1)
    hidden = box((-3, -3, -3), (3, 3, 3), 1)
    scene = scene_with([], [shell, hidden], [glow])
    expect_sum(scene, (0.3, -0.2, 0.5), UP, 2.0 * np.pi)
