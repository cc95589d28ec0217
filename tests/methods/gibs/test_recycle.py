"""Recycling: every id is in the pool or in use, a full pool leaves room where a camera looks, what is gone is freed."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.methods.gibs.recycle import choose_recycled, give_back
from luxel.methods.gibs.surfels import FreeList, GibsState
from luxel.render.renderer import Renderer
from luxel.scene import load
from luxel.scene.arrays import from_numpy
from luxel.scene.model import Camera


def turning(frame: int) -> Camera:
    """Return a camera in the middle of the atrium that looks round."""
    angle = 0.2 * frame
    return Camera(eye=(0.0, 2.0, 0.0), target=(float(np.cos(angle)), 2.1, float(np.sin(angle))), fov=70.0)


def is_whole(state: GibsState) -> bool:
    """Return whether every id is in the pool or in use, once."""
    free = np.array(state.free.ids)[: int(np.array(state.free.count)[0])]
    used = np.flatnonzero(np.array(state.surfels.object_id))
    return sorted([*free.tolist(), *used.tolist()]) == list(range(state.settings.capacity))


@pytest.fixture(scope="module")
def full() -> Renderer:
    """One radius, far too small for the pool, and a camera that has looked round."""
    params = {"radius": 0.15, "surfel_target": 600, "recycle": True, "depth_texels": 0}
    renderer = Renderer(load("atrium"), "gibs", params, size=(48, 32), seed=1)
    for frame in range(96):
        renderer.step(camera=turning(frame))
        assert frame % 12 or is_whole(renderer.state)
    return renderer


def test_ids_come_back_by_rank(full: Renderer) -> None:
    """Against NumPy: on top of the stack, in the order of their ids."""
    capacity = full.state.settings.capacity
    freed = np.random.default_rng(2).random(capacity) < 0.3
    free = FreeList(from_numpy(mi.UInt32, np.arange(capacity, dtype=np.uint32)), mi.UInt32(5))
    found = give_back(replace(full.state, free=free), from_numpy(mi.Bool, freed))
    assert int(np.array(found.count)[0]) == 5 + freed.sum()
    np.testing.assert_array_equal(np.array(found.ids)[:5], np.arange(5))
    room = capacity - 5
    np.testing.assert_array_equal(np.array(found.ids)[5 : 5 + freed.sum()], np.flatnonzero(freed)[:room])


def test_a_full_pool_leaves_room_where_a_camera_looks(full: Renderer) -> None:
    """Without recycling, the first place seen has all surfels, and later ones none."""
    assert is_whole(full.state)
    stuck = Renderer(load("atrium"), "gibs", {**vars(full.params), "recycle": False}, size=(48, 32), seed=1)
    for frame in range(96):
        stuck.step(camera=turning(frame))
    # Without a ray yet: placed in this frame.
    born = [np.array(one.state.surfels.ray_index)[np.array(one.state.surfels.object_id) != 0] for one in (full, stuck)]
    assert (born[0] == 0).sum() >= 20, "nearly each of the 24 tiles"
    assert not (born[1] == 0).any()


def test_those_unseen_for_longest_go_by_chance(full: Renderer) -> None:
    state, capacity = full.state, full.state.settings.capacity
    ages = np.repeat([0, 4, 100, 400], capacity // 4 + 1)[:capacity]
    sight = replace(
        state.surfels.sight,
        seen=from_numpy(mi.UInt32, (1000 - ages).astype(np.uint32)),
        near=dr.full(mi.Float, 3.0, capacity),
    )
    surfels = replace(state.surfels, object_id=dr.full(mi.UInt32, 1, capacity), sight=sight)
    state = replace(state, surfels=surfels, free=FreeList(state.free.ids, mi.UInt32(0)))
    rows = [np.array(choose_recycled(full.scene, state, dr.opaque(mi.UInt32, 1000))) for _ in range(2)]
    np.testing.assert_array_equal(rows[0], rows[1])
    share = [rows[0][ages == age].mean() for age in (0, 4, 100, 400)]
    assert share[0] == share[1] == 0.0 < share[3] < 1.0 and share[2] < share[3]


def test_surfels_of_an_object_that_is_gone_are_free_in_the_next_frame() -> None:
    def vanishing(seconds: float) -> np.ndarray:
        return np.diag([1e-6, 1e-6, 1e-6, 1.0]) if seconds > 0.5 else np.eye(4)

    data = load("cornell-box")
    data.objects[1].motion = vanishing
    renderer = Renderer(data, "gibs", {"surfel_target": 800, "recycle": True}, size=(32, 32), seed=1)
    for _ in range(8):
        renderer.step(time=0.0)
    placed = np.bincount(np.array(renderer.state.surfels.object_id))
    gone = int(np.argsort(placed[1:])[-2]) + 1
    assert placed[gone] > 20, "the large box has surfels"
    for _ in range(2):
        renderer.step(time=1.0)
    after = np.bincount(np.array(renderer.state.surfels.object_id), minlength=len(placed))
    assert after[gone] == 0 and after.sum() == renderer.state.settings.capacity and is_whole(renderer.state)


def test_tiles_that_show_less_than_a_surfel_spawn_more_seldom() -> None:
    """Close to a wall a tile is a small part of a surfel: the chance falls by the square."""
    born = []
    for by_size in (False, True):
        params = {"radius": 0.2, "surfel_target": 4000, "spawn_by_size": by_size, "spawn_once_a_cell": False}
        close = Camera(eye=(0.0, 0.0, -0.6), target=(0.0, 0.0, -1.0), fov=60.0)
        renderer = Renderer(load("furnace"), "gibs", {**params, "hit_spawn_threshold": 0.0}, size=(256, 256), seed=1)
        renderer.step(camera=close)
        born.append(renderer.cache()["surfel_count"])
    # A tile's side is 2 * 0.4 * tan(30) * 8 / 256 m.
    expected = (2 * 0.4 * np.tan(np.radians(30.0)) * 8 / 256 / 0.4) ** 2
    assert born[0] == 1024 and born[1] == pytest.approx(1024 * expected, abs=5.0)
