"""The light tables: which sources the tree holds, how strongly, and that they follow what moves and what is edited."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from luxel.scene import live
from luxel.scene.device import Scene, set_time, upload
from luxel.scene.library.shapes import quad
from luxel.scene.lights import DELTA_EACH_LIMIT, ENTRY_IS_DELTA, NO_ENTRY
from luxel.scene.model import Light, Material, Mesh, Object, SceneData

FLOOR = quad((0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1), 0)
LAMP = Material("lamp", emission=(2.0, 2.0, 2.0))


def lamps(count: int) -> list[Light]:
    places = [(index % 7, 1.0, index // 7) for index in range(count)]
    return [Light("point", (1.0, 1.0, 1.0 + i), place, name=f"l{i}") for i, place in enumerate(places)]


def panel(material: int = 1) -> Mesh:
    """Return a square metre at y = 2 that faces down."""
    return quad((0, 2, 0), (1, 2, 0), (1, 2, 1), (0, 2, 1), material)


def leaf_rows(scene: Scene) -> dict[int, np.ndarray]:
    """Return the node (16,) of each entry of the tree."""
    lights = scene.lights
    nodes = np.array(lights.nodes).reshape(-1, 16)[lights.entry_count :]
    return {int(entry): row for entry, row in zip(np.array(lights.entries), nodes, strict=True) if entry != NO_ENTRY}


def test_emitters_are_weighed_by_area_and_radiance() -> None:
    """Intensity along the normal is area times radiance; whether both sides shine is kept apart."""
    materials = [
        Material(),
        Material(emission=(1.0, 1.0, 1.0)),
        Material(emission=(0.0, 4.0, 0.0)),
        Material(emission=(1.0, 1.0, 1.0), emit_back=True),
    ]
    meshes = [quad((0, k, 0), (1 + k, k, 0), (1 + k, k, 1), (0, k, 1), k) for k in range(4)]
    scene = upload(SceneData("lamps", [Object("all", meshes)], materials))
    rows = leaf_rows(scene)
    assert len(rows) == 6
    assert scene.lights.entry_count == 8
    material = np.array(scene.geometry.triangles).reshape(-1, 4)[:, 3] & 0xFFFF
    intensity = {1: 2.0, 2: 3.0 * 4.0 * 0.7152, 3: 4.0}
    expected = np.array([intensity[int(material[entry])] / 2.0 for entry in rows])
    found = np.array([row[7] for row in rows.values()])
    np.testing.assert_allclose(found / found.sum(), expected / expected.sum(), rtol=1e-5)
    for entry, row in rows.items():
        np.testing.assert_allclose(row[8:11], (0.0, -1.0, 0.0), atol=1e-6)
        assert bool(row[15]) == (material[entry] == 3)


def test_few_delta_lights_are_evaluated_each_and_many_are_sampled() -> None:
    floor = [Object("floor", [FLOOR])]
    for count in (0, 1, DELTA_EACH_LIMIT, DELTA_EACH_LIMIT + 1, 30):
        scene = upload(SceneData("lamps", floor, [Material()], lights=lamps(count)))
        each = count if count <= DELTA_EACH_LIMIT else 0
        assert scene.lights.delta_each == each
        entries = np.array(sorted(leaf_rows(scene)))
        assert len(entries) == count - each
        np.testing.assert_array_equal(entries, np.arange(count - each) | ENTRY_IS_DELTA)
        assert (scene.lights.entry_count > 0) == (count > each)


def test_suns_keep_a_ray_of_their_own_among_many_lamps() -> None:
    sun = Light("directional", (1.0, 1.0, 1.0))
    for many in ([*lamps(7), sun, *lamps(7), sun], [sun] * (DELTA_EACH_LIMIT + 1)):
        lights = upload(SceneData("suns", [Object("floor", [FLOOR])], [Material()], lights=many)).lights
        suns = [index for index, light in enumerate(many) if light.kind == "directional"][:DELTA_EACH_LIMIT]
        assert lights.delta_each == len(suns)
        np.testing.assert_array_equal(np.array(lights.each_rows), suns)
        sampled = {int(entry) & ~ENTRY_IS_DELTA for entry in np.array(lights.entries) if entry != NO_ENTRY}
        assert sampled == set(range(len(many))) - set(suns)


def test_lamps_that_are_out_are_not_sampled() -> None:
    dark = [*lamps(20), Light("point", (0.0, 0.0, 0.0))]
    scene = upload(SceneData("lamps", [Object("floor", [FLOOR])], [Material()], lights=dark))
    assert len(leaf_rows(scene)) == 20
    unlit = [Light("point", (0.0, 0.0, 0.0))] * 20
    none = upload(SceneData("dark", [Object("floor", [FLOOR])], [Material()], lights=unlit))
    assert none.lights.entry_count == 0


# ------------------------------------------------------------------------------------------------ motion and edits


def lift(height: float) -> Callable[[float], np.ndarray]:
    def motion(time: float) -> np.ndarray:
        matrix = np.eye(4)
        matrix[1, 3] = height * time
        return matrix

    return motion


def test_the_tree_follows_lights_and_objects_that_move() -> None:
    moving = lamps(12)
    moving[4] = Light("point", (1.0, 1.0, 1.0), (0.5, 1.0, 0.5), motion=lift(3.0))
    objects = [Object("floor", [FLOOR]), Object("panel", [panel()], motion=lift(5.0))]
    scene = upload(SceneData("moves", objects, [Material(), LAMP], lights=moving, duration=1.0))
    set_time(scene, 1.0)
    rows = leaf_rows(scene)
    np.testing.assert_allclose(rows[4 | ENTRY_IS_DELTA][:3], (0.5, 4.0, 0.5), rtol=1e-6)
    heights = sorted(row[1] for entry, row in rows.items() if entry < ENTRY_IS_DELTA)
    np.testing.assert_allclose(heights, 7.0, rtol=1e-5)
    top = np.array(scene.lights.nodes).reshape(-1, 16)[1]
    assert top[1] + top[5] >= 7.0


def test_the_tree_follows_a_mesh_that_deforms() -> None:
    """A panel that grows to twice its sides has four times the intensity."""
    flat = panel()

    def deform(time: float) -> list[tuple[np.ndarray, np.ndarray | None]]:
        return [((flat.positions * (1.0 + time, 1.0, 1.0 + time)).astype(np.float32), None)]

    objects = [Object("floor", [FLOOR, panel()]), Object("grows", [flat], deform=deform)]
    scene = upload(SceneData("grows", objects, [Material(), LAMP], duration=1.0))

    def ratio() -> float:
        intensities = sorted(row[7] for row in leaf_rows(scene).values())
        assert len(intensities) == 4
        return intensities[-1] / intensities[0]

    assert ratio() == pytest.approx(1.0, rel=1e-5)
    set_time(scene, 1.0)
    assert ratio() == pytest.approx(4.0, rel=1e-5)
    live.set_light_scale(scene, 2.0)
    live.set_material(scene, 1, Material("lamp", emission=(1.0, 1.0, 1.0)))
    assert ratio() == pytest.approx(4.0, rel=1e-5), "an edit keeps the shape of the moment"


def test_a_panel_that_has_no_area_yet_may_grow_one() -> None:
    flat = panel()

    def deform(time: float) -> list[tuple[np.ndarray, np.ndarray | None]]:
        return [((flat.positions * (time, 1.0, 1.0)).astype(np.float32), None)]

    objects = [Object("floor", [FLOOR]), Object("grows", [flat], deform=deform)]
    scene = upload(SceneData("grows", objects, [Material(), LAMP], duration=1.0))
    set_time(scene, 1.0)
    assert all(row[7] > 0.0 for row in leaf_rows(scene).values())


def test_a_panel_placed_by_hand_takes_its_leaves_with_it() -> None:
    objects = [Object("floor", [FLOOR]), Object("panel", [panel()], motion=lift(0.0))]
    scene = upload(SceneData("placed", objects, [Material(), LAMP]))
    matrix = np.diag((3.0, 1.0, 1.0, 1.0))
    matrix[:3, 3] = 0.0, 4.0, 0.0
    live.place_object(scene, 1, matrix)
    for row in leaf_rows(scene).values():
        assert row[1] == pytest.approx(6.0)
        assert row[4] == pytest.approx(1.5, rel=1e-4)


def test_edits_keep_the_tables_as_wide_as_they_were() -> None:
    """Fewer sources leave empty leaves, and a light that is on again finds its place; what grows does so by halves."""
    scene = upload(SceneData("edits", [Object("floor", [FLOOR, panel()])], [Material(), LAMP], lights=lamps(20)))
    assert scene.lights.entry_count == 32
    live.set_light(scene, "l3", color=(0.0, 0.0, 0.0))
    assert (3 | ENTRY_IS_DELTA) not in leaf_rows(scene)
    assert scene.lights.entry_count == 32
    live.set_light(scene, "l3", color=(0.0, 9.0, 0.0), position=(4.0, 5.0, 6.0))
    np.testing.assert_allclose(leaf_rows(scene)[3 | ENTRY_IS_DELTA][:3], (4.0, 5.0, 6.0))
    live.set_material(scene, 1, Material("lamp"))
    assert len(leaf_rows(scene)) == 20
    assert scene.lights.has_triangles, "kernels stay as they are"
    live.set_lights(scene, lamps(40))
    assert scene.lights.entry_count == 64


def test_small_edits_of_many_lights_keep_their_order_and_large_ones_do_not() -> None:
    many = [Light("point", (1.0, 1.0, 1.0), (float(index), 1.0, 0.0)) for index in range(5000)]
    scene = upload(SceneData("many", [Object("floor", [FLOOR])], [Material()], lights=many))
    leaves = scene.host.sources.leaves
    live.set_light(scene, 7, position=(2500.0, 1.0, 3.0))
    assert scene.host.sources.leaves is leaves
    np.testing.assert_allclose(leaf_rows(scene)[7 | ENTRY_IS_DELTA][:3], (2500.0, 1.0, 3.0))
    live.set_lights(scene, many[::-1])
    assert scene.host.sources.leaves is not leaves


def test_a_hundred_thousand_lights_are_uploaded_and_edited() -> None:
    places = np.random.default_rng(1).uniform(-50.0, 50.0, (100_000, 3))
    many = [Light("point", (1.0, 1.0, 1.0), tuple(place)) for place in places.tolist()]
    scene = upload(SceneData("many", [Object("floor", [FLOOR])], [Material()], lights=many))
    assert scene.lights.entry_count == 1 << 17
    live.set_light(scene, 99_999, color=(0.0, 0.0, 0.0))
    entries = np.array(scene.lights.entries)
    assert np.count_nonzero(entries != NO_ENTRY) == 99_999
