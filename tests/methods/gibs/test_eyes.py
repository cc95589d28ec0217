"""Several views of one cache: the smallest radius wins, nobody's turn changes anything, and all share one budget."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from luxel.kernels.camera import make_pinhole
from luxel.kernels.gbuffer import trace_gbuffer
from luxel.methods import make_params
from luxel.methods.gibs import eyes, view
from luxel.methods.gibs.budget import plan_rays
from luxel.methods.gibs.surfels import Eyes, GibsState
from luxel.methods.gibs.trace import trace_surfels
from luxel.render.frame import make_film
from luxel.render.renderer import Renderer
from luxel.render.shared import Cache, CameraView
from luxel.scene import load
from luxel.scene.device import upload
from luxel.scene.library.shapes import quad
from luxel.scene.model import Camera, Material, Object, SceneData, Sky

TARGET = 3000
NEAR, FAR = Camera((0.0, 0.0, 1.5), (0.0, 0.0, 0.0), fov=60.0), Camera((0.0, 0.0, 6.0), (0.0, 0.0, 0.0), fov=60.0)


def wall_scene() -> SceneData:
    """A wall of 8 x 8 m in the plane z = 0 under an even sky."""
    wall = quad((-4, -4, 0), (4, -4, 0), (4, 4, 0), (-4, 4, 0), 0)
    return SceneData("wall", [Object("wall", [wall])], [Material(base_color=(0.5, 0.5, 0.5))], sky=Sky((1.0, 1.0, 1.0)))


def start(**params: Any) -> Cache:
    return Cache(
        upload(wall_scene()),
        "gibs",
        make_params("gibs", None, {"surfel_target": TARGET, "depth_texels": 0, **params}),
        1,
    )


def pixels_of(view: CameraView) -> float:
    return float(np.array(view.screen.pixels)[0])


def share_of(cache: Cache, camera: Camera, size: tuple[int, int]) -> float:
    """Return the sum over the pixels of 1 / cosine."""
    pinhole = make_pinhole(camera, *size)
    surface = trace_gbuffer(cache.scene, make_film(size), pinhole, pinhole).surface
    hit = np.array(surface.active)
    cosine = np.abs(np.array(surface.wo).T[hit][:, 2])
    return float((1.0 / np.maximum(cosine, eyes.LEAST_COSINE)).sum())


def test_each_view_has_its_own_radius_and_they_share_the_surfels() -> None:
    """r^2 = 1.6 x (sum of 1 / cosine) / (0.6 surfel_target / views), whatever the size of the other one's film."""
    cache = start()
    sizes, cameras = ((96, 96), (32, 32)), (NEAR, FAR)
    views = [CameraView(cache, size) for size in sizes]
    for frame in range(120):
        cache.advance()
        for at in (0, 1) if frame % 2 else (1, 0):
            views[at].look(cameras[at])
    wanted = [
        np.sqrt(2.0 * 1.6 * share_of(cache, camera, size) / (0.6 * TARGET))
        for camera, size in zip(cameras, sizes, strict=True)
    ]
    assert wanted[0] > eyes.LEAST_PIXELS
    assert pixels_of(views[0]) == pytest.approx(wanted[0], rel=0.01)
    assert pixels_of(views[1]) == pytest.approx(max(wanted[1], eyes.LEAST_PIXELS), rel=0.01)


@pytest.mark.parametrize("by_turns", [False, True], ids=["in each frame", "every other frame"])
def test_two_cameras_do_not_fight(by_turns: bool) -> None:
    """What the near one sees has the size that it wants, by arithmetic; then nothing changes and nobody is born."""
    size, radius = (48, 48), 1.5
    cache = start(radius_pixels=radius, surfel_target=4000)
    views = {camera.eye[2]: (CameraView(cache, size), camera) for camera in (NEAR, FAR)}
    seen = []
    for frame in range(160):
        cache.advance()
        for number, (one, camera) in enumerate(views.values()):
            if not by_turns or frame % 2 == number:
                one.look(camera)
        if frame >= 140:
            seen.append((np.array(cache.state.surfels.size), np.array(cache.state.surfels.object_id)))
    changed = [((a[0] != b[0]) | (a[1] != b[1])).sum() for a, b in pairwise(seen)]
    sizes, alive = seen[-1][0], seen[-1][1] != 0
    p = np.array(cache.state.surfels.p).T
    # Half of the view's width is tan(30 degrees) times the distance of the wall from the eye.
    around = alive & (np.abs(p[:, :2]).max(axis=1) < 0.8 * 1.5 * np.tan(np.pi / 6))
    largest = float(np.array(cache.state.dials.radius)[0])
    for distance, which in ((1.5, around), (6.0, alive & (np.abs(p[:, :2]).max(axis=1) > 1.5))):
        steps = 2.0 * np.log2(largest / (radius * 2.0 * distance * np.tan(np.pi / 6) / size[0]))
        wanted = max(round(steps), 0)
        assert which.sum() > 50 and np.abs(sizes[which].astype(int) - wanted).max() <= view.TOO_LARGE, distance
    assert sum(changed) <= 0.01 * len(changed), "surfels come and go, or change their size"


def test_looks_add_up_in_any_order_and_rare_ones_count_for_the_frames_between() -> None:
    cache = start()
    state = cache.state
    wishes = [eyes.Wish(*(mi.Float(value) for value in row)) for row in ((4.0, 900.0, 1.0), (2.5, 300.0, 2.0))]
    sums = []
    for order in (wishes, wishes[::-1]):
        noted = state.eyes
        for wish in order:
            noted = eyes.note_look(noted, wish)
        sums.append([float(np.array(value)[0]) for value in (noted.looks, noted.asked, noted.pixels)])
    assert sums[0] == sums[1] == [3.0, 900.0 + 2.0 * 300.0, 2.5]


@pytest.mark.parametrize(("asked", "views"), [(900.0, 1.0), (1500.0, 2.0), (0.0, 0.0)])
def test_what_views_leave_goes_to_the_rays(asked: float, views: float) -> None:
    """Of 3,000 surfels 0.4 are the rays' at the largest radius; each size down needs twice as many."""
    cache = start()
    state: GibsState = cache.state
    nothing = mi.Float(0.0)
    before = Eyes(mi.Float(views), mi.Float(asked), mi.Float(3.0), nothing, nothing, mi.UInt32(7))
    after = eyes.settle_eyes(replace(state, eyes=before))
    expected = np.floor(np.log2(max((TARGET - asked) / (0.4 * TARGET), 1.0))) if views else 7
    assert np.array(after.ray_size)[0] == expected
    assert np.array(after.looks)[0] == 0.0 and np.array(after.views)[0] == views
    # Smoothed from then on, by a tenth a frame.
    more = eyes.note_look(after, eyes.Wish(mi.Float(3.0), mi.Float(500.0), mi.Float(1.0)))
    again = eyes.settle_eyes(replace(state, eyes=more))
    assert np.array(again.views)[0] == pytest.approx(0.9 * views + 0.1 if views else 1.0)


def advance_and_look_twice(cache: Cache, view: CameraView) -> None:
    cache.advance()
    view.look(NEAR)
    view.look(NEAR, (0.01, 0.0))


def test_a_second_look_at_a_frame_asks_for_nothing_more() -> None:
    cache = start()
    one = CameraView(cache, (32, 32))
    for _ in range(3):
        advance_and_look_twice(cache, one)
        assert np.array(cache.state.eyes.looks)[0] == 1.0


def test_a_view_that_takes_too_many_leaves_what_only_rays_see_its_share() -> None:
    """Nothing unseen was left of it: half of all rays met bare ground, and the atrium was a tenth too bright."""
    params = {"surfel_target": 700, "capacity": 2800, "depth_texels": 0, "normal_light": False}
    renderer = Renderer(load("atrium"), "gibs", params, size=(96, 64), seed=1)
    renderer.run(72)
    state, surfels = renderer.state, renderer.state.surfels
    alive, size = np.array(surfels.object_id) != 0, np.array(surfels.size)
    assert (alive & (size > 0)).sum() > 1.1 * 700, "the view alone takes more than all may"
    assert (alive & (size == 0)).sum() >= 0.9 * 0.4 * 700
    plan = plan_rays(state, mi.UInt32(72))
    results = trace_surfels(renderer.scene, state, plan)
    coverage = np.array(results.coverage)[: int(np.array(plan.total)[0])]
    assert (coverage[np.isfinite(coverage)] <= 0.0).mean() < 0.1


def test_views_leave_the_rays_room_in_the_pool() -> None:
    """However small their surfels; and the pool counts as full all the same."""
    renderer = Renderer(
        load("cornell-box"), "gibs", {"surfel_target": 400, "radius_pixels": 1.0}, size=(96, 96), seed=1
    )
    renderer.run(12)
    cache, size = renderer.cache(), np.array(renderer.state.surfels.size)
    alive = np.array(renderer.state.surfels.object_id) != 0
    assert (alive & (size > 0)).sum() <= cache["surfel_capacity"] - 0.4 * 400
    assert any("pool is full" in line for line in renderer.method.warnings(renderer.state))


def test_a_second_look_at_a_frame_records_nothing_anew() -> None:
    cache = start()
    one = CameraView(cache, (32, 32))
    for _ in range(4):
        advance_and_look_twice(cache, one)
    cache.advance()
    cache.advance()
    assert cache.recordings == 2, "the world's step and the look, once each"
