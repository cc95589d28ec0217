"""What back faces say, by both rules: light and depth of the rays that meet them, and who is dead by their share.

The shares come from the solid angle of a rectangle seen from above its middle,
4 atan(a b / (d sqrt(a^2 + b^2 + d^2))) of 4 pi, with half sides a and b at the distance d.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.methods.base import Frame
from luxel.methods.ddgi.blend import blend_depth
from luxel.methods.ddgi.method import pack
from luxel.methods.ddgi.relocate import gather_probe_hits, update_probes
from luxel.methods.ddgi.state import AWAKE, DEAD, DdgiState, ProbeRayResults
from luxel.methods.ddgi.trace import MISS, trace_probes
from luxel.methods.ddgi.weights import chebyshev_visibility
from luxel.render.renderer import Renderer
from luxel.scene.device import upload
from luxel.scene.library.shapes import box, make_mesh, quad
from luxel.scene.model import Camera, Light, Material, Mesh, Object, SceneData

GRID = "0,0,0 size 2,2,2 probes 3,3,3"
CENTRE = 13
SILVER = Material(base_color=(0.9, 0.9, 0.9))
ONE_SIDED = Material(base_color=(0.9, 0.9, 0.9), reflect_back=False)


def solid_share(a: float, b: float, d: float) -> float:
    """Return the share of all directions that a rectangle takes."""
    return 4.0 * math.atan(a * b / (d * math.sqrt(a * a + b * b + d * d))) / (4.0 * math.pi)


def distance_of_share(share: float, half: float = 1.5) -> float:
    """Return how far above a square of half side `half` it takes this share of all directions (bisection)."""
    near, far = 1e-3, 100.0
    for _ in range(100):
        middle = 0.5 * (near + far)
        near, far = (middle, far) if solid_share(half, half, middle) > share else (near, middle)
    return near


def backs_of_share(share: float) -> Mesh:
    """Return a mesh around the origin whose backs take `share` of all directions; the rest is open.

    Up to a half it is a square below, facing down; beyond, a crate of five sides that face outwards, open at the top.
    """
    half = 1.5
    if share < 0.5:
        y = -distance_of_share(share, half)
        return quad((-half, y, -half), (half, y, -half), (half, y, half), (-half, y, half), 1)
    top = distance_of_share(1.0 - share, half)
    return box((-half, -half, -half), (half, top, half), 1, sides=("-x", "+x", "-y", "-z", "+z"))


def scene_of(mesh: Mesh, material: Material, half: float = 6.0) -> SceneData:
    """Return `mesh` in a lit room whose walls face inwards."""
    shell = box((-half, -half, -half), (half, half, half), 0, inward=True)
    # Under the middle, so that it shines on the fronts and the backs of what is there.
    lamps = [Light("point", (50.0, 50.0, 50.0), (0.0, y, 0.0)) for y in (-0.9 * half, 0.9 * half)]
    objects = [Object("shell", [shell]), Object("thing", [mesh])]
    camera = Camera((0.0, 5.0, 5.0), (0.0, 0.0, 0.0), fov=90.0)
    return SceneData("backs", objects, [Material(), material], lamps, [camera])


def first_frame(index: int = 0) -> Frame:
    return Frame(dr.opaque(mi.UInt32, index), dr.opaque(mi.UInt32, 1), dr.opaque(mi.Bool, True))


def rays_of_centre(state: DdgiState, results: ProbeRayResults) -> tuple[np.ndarray, np.ndarray]:
    """Return directions with depth (N, 4) and radiance with the back flag (N, 4) of the probe in the middle."""
    each = state.settings.rays_per_probe
    span = slice(CENTRE * each, (CENTRE + 1) * each)
    rows, light = (np.array(part).reshape(-1, 4)[span] for part in (results.direction_depth, results.radiance))
    return rows, light


# ---------- Light and depth of a ray ----------


@pytest.mark.parametrize(
    ("rule", "material", "stops"),
    [
        ("rohacek", SILVER, True),
        ("rohacek", ONE_SIDED, True),
        ("luxel", SILVER, False),
        ("luxel", ONE_SIDED, True),
    ],
)
@pytest.mark.parametrize("detect", [True, False])
def test_light_and_depth_of_rays_that_meet_backs(build, rule: str, material: Material, stops: bool, detect) -> None:
    """A lit back at a known place below: by the thesis no light and no depth, else what any surface gives."""
    below = quad((-1.5, -1.2, -1.5), (1.5, -1.2, -1.5), (1.5, -1.2, 1.5), (-1.5, -1.2, 1.5), 1)
    scene = upload(scene_of(below, material))
    state = build(scene, boxes=GRID, extra_probes=0, backface_rule=rule, detect_dead_probes=detect)
    rows, light = rays_of_centre(state, trace_probes(scene, state, first_frame()))
    at = rows[:, :3] * (1.2 / np.maximum(-rows[:, 1:2], 1e-9))
    meets = (rows[:, 1] < 0.0) & (np.abs(at[:, [0, 2]]).max(axis=1) < 1.49)
    misses = (rows[:, 1] >= 0.0) | (np.abs(at[:, [0, 2]]).max(axis=1) > 1.51)
    assert meets.sum() > 10 and (light[meets, 3] == 1.0).all() and not light[misses, 3].any()
    length = 1.2 / -rows[meets, 1]
    np.testing.assert_allclose(np.abs(rows[meets, 3]), length, rtol=1e-4)
    assert (light[misses, :3] > 0.0).all() and (rows[misses, 3] > 0.0).all()
    if stops:
        assert not light[meets, :3].any(), "it brings no light"
        assert (rows[meets, 3] < 0.0).all(), "negative stands for depth zero"
    else:
        assert (light[meets, :3] > 0.0).all() and (rows[meets, 3] > 0.0).all()


@pytest.mark.parametrize("model", ["moments", "planes"])
def test_a_stopped_ray_is_depth_zero_in_the_texels(bare, build, rays, model: str) -> None:
    """All rays of one half space are stopped 2 m away: nothing is seen there, not even what is nearer."""

    def distance(origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        return np.where(directions[:, 1] < 0.0, -2.0, 2.0)

    state = build(bare, boxes=GRID, extra_probes=0, depth_model=model)
    for index in range(8):
        results = rays(state, distance=distance, frame=index)
        depth = blend_depth(bare, state, results, first_frame(index))
        state = replace(state, depth=depth, probes=replace(state.probes, age=state.probes.age + 1))
    state = pack(state)
    q = state.probes.p

    def sight(y: float) -> np.ndarray:
        return np.array(
            chebyshev_visibility(state, dr.arange(mi.UInt32, 27), q, q + mi.Vector3f(0.0, y, 0.0), mi.Bool(True))
        )

    assert sight(-0.3).max() < 1e-3 and sight(-1.5).max() < 1e-3
    assert sight(0.3).min() > 0.9 and sight(1.5).min() > 0.9


@pytest.mark.parametrize("share", [0.1, 0.25])
def test_planes_are_seen_through_by_the_share_of_free_rays(bare, build, rays, share: float) -> None:
    """Of all rays this share is stopped at once, the others end at 2 m: sight is the rest, cubed as in the paper."""
    state = build(bare, boxes=GRID, extra_probes=0, num_samples_per_probe=512)
    rng = np.random.default_rng(5)
    for index in range(12):
        results = rays(state, distance=lambda p, d: np.where(rng.random(len(d)) < share, -2.0, 2.0), frame=index)
        depth = blend_depth(bare, state, results, first_frame(index))
        state = replace(state, depth=depth, probes=replace(state.probes, age=state.probes.age + 1))
        dr.eval(state.depth)
    state = pack(state)
    q = state.probes.p
    found = chebyshev_visibility(state, dr.arange(mi.UInt32, 27), q, q + mi.Vector3f(0.3, 1.0, 0.2), mi.Bool(True))
    assert float(np.array(found).mean()) == pytest.approx((1.0 - share) ** 3, rel=0.15)


# ---------- Who is dead ----------


@pytest.mark.parametrize(
    ("rule", "material", "share", "dead"),
    [
        # The thesis: more than half of the rays, whatever the surface.
        ("rohacek", SILVER, 0.4, False),
        ("rohacek", SILVER, 0.6, True),
        ("rohacek", ONE_SIDED, 0.4, False),
        ("rohacek", ONE_SIDED, 0.6, True),
        # Ours: a quarter of one-sided backs, two thirds of two-sided ones.
        ("luxel", SILVER, 0.4, False),
        ("luxel", SILVER, 0.6, False),
        ("luxel", ONE_SIDED, 0.2, False),
        ("luxel", ONE_SIDED, 0.4, True),
    ],
)
def test_who_is_dead_by_the_share_of_backs(rule: str, material: Material, share: float, dead: bool) -> None:
    params = {"boxes": GRID, "extra_probes": 0, "sleep_after": 0, "offset_dead_probes": False, "backface_rule": rule}
    renderer = Renderer(scene_of(backs_of_share(share), material), "ddgi", params, size=(16, 16), seed=1)
    renderer.run(12)
    _, light = rays_of_centre(renderer.state, trace_probes(renderer.scene, renderer.state, first_frame(3)))
    assert light[:, 3].mean() == pytest.approx(share, abs=0.04), "the scene is as it should be"
    assert np.array(renderer.state.probes.status)[CENTRE] == (DEAD if dead else AWAKE)


def by_hand(state: DdgiState, stopped: int, of: int) -> ProbeRayResults:
    """Return rays of which the first `stopped` of each probe's `of` met a back 1 m away, the others nothing."""
    total = state.settings.total
    each = state.settings.rays_per_probe
    assert each == of
    angle = np.linspace(0.0, 2.0 * np.pi, each, endpoint=False)
    rows = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle, np.full(each, MISS)], axis=1)
    rows[:stopped, 3] = -1.0
    light = np.zeros((each, 4))
    light[:stopped, 3] = 1.0
    rows, light = (np.tile(part, (total, 1)).astype(np.float32) for part in (rows, light))
    width = total * each
    return ProbeRayResults(
        mi.Float(rows.ravel()), mi.Float(light.ravel()), dr.zeros(mi.Point3f, width), dr.zeros(mi.Bool, width)
    )


@pytest.mark.parametrize(("stopped", "dead"), [(0, False), (26, False), (32, False), (33, True), (38, True)])
def test_more_than_half_means_more_than_half(bare, build, stopped: int, dead: bool) -> None:
    """Of 64 rays 26 are 40 %, 38 are 60 %, and 32 are just half: not more."""
    state = build(bare, "rohacek", boxes=GRID, num_samples_per_probe=64)
    results = by_hand(state, stopped, 64)
    probes = update_probes(state, results, gather_probe_hits(state, results), first_frame())
    assert (np.array(probes.status) == (DEAD if dead else AWAKE)).all()


# ---------- Certainty ----------


def frames_until(
    state: DdgiState, step: Callable[[DdgiState, int], DdgiState], done: Callable[[DdgiState], bool]
) -> int:
    for index in range(200):
        state = step(state, index)
        if done(state):
            return index + 1
    return 200


@pytest.mark.parametrize("hysteresis", [0.5, 0.8, 0.95])
def test_certainty_grows_by_the_hysteresis(bare, build, hysteresis: float) -> None:
    """After n frames in something it is 1 - h^n: a probe long in the open dies when that exceeds a half."""
    state = build(
        bare,
        "rohacek",
        boxes=GRID,
        num_samples_per_probe=64,
        dead_probes_hysteresis=hysteresis,
        offset_dead_probes=False,
    )
    nothing, backs = by_hand(state, 0, 64), by_hand(state, 60, 64)

    def step(results: ProbeRayResults) -> Callable[[DdgiState, int], DdgiState]:
        def one(state: DdgiState, index: int) -> DdgiState:
            probes = update_probes(state, results, gather_probe_hits(state, results), first_frame(index))
            dr.eval(probes)
            return replace(state, probes=probes)

        return one

    for index in range(3):
        state = step(nothing)(state, index)
    after_one = step(backs)(state, 3)
    np.testing.assert_allclose(np.array(after_one.probes.dead), 1.0 - hysteresis, rtol=1e-4)
    frames = frames_until(state, step(backs), lambda state: (np.array(state.probes.status) == DEAD).all())
    assert frames == math.floor(math.log(0.5) / math.log(hysteresis)) + 1 or math.isclose(hysteresis**frames, 0.5)


@pytest.mark.parametrize("pattern", ["axes", "backface"])
@pytest.mark.parametrize("hysteresis", [0.0, 0.95])
def test_too_near_is_a_certainty_too(pattern: str, hysteresis: float) -> None:
    """A wall 2 cm beside a probe moves it; it is not dead for that, and goes on answering."""
    wall = quad((-0.02, -2, 2), (-0.02, -2, -2), (-0.02, 2, -2), (-0.02, 2, 2), 1)
    data = scene_of(wall, SILVER, half=3.0)
    params = {
        "boxes": GRID, "extra_probes": 0, "sleep_after": 0, "num_samples_per_probe": 128, "dead_probe_threshold": 0.2,
        "dead_probes_hysteresis": hysteresis, "offset_pattern": pattern, "backface_rule": "rohacek",
    }  # fmt: skip
    renderer = Renderer(data, "ddgi", params, size=(16, 16), seed=1)
    moved_at = None
    for index in range(60):
        renderer.step()
        assert np.array(renderer.state.probes.status)[CENTRE] == AWAKE
        if moved_at is None and np.abs(np.array(renderer.state.probes.p).T[CENTRE]).max() > 0.0:
            moved_at = index
    assert moved_at is not None and moved_at < 10, "its first frame counts whole: it is certain at once"
    assert np.array(renderer.state.probes.unfit)[CENTRE] < 0.5, "where it is now it may stay"


def test_what_comes_near_has_to_stay_before_a_probe_gives_way() -> None:
    """1 - 0.95^n exceeds a half after 14 frames: until then the probe stays, and after them it has moved."""
    plate = make_mesh([(-0.02, -2, 2), (-0.02, -2, -2), (-0.02, 2, -2), (-0.02, 2, 2)], [(0, 1, 2), (0, 2, 3)], 1)

    def motion(time: float) -> np.ndarray:
        matrix = np.eye(4)
        matrix[0, 3] = 0.0 if time > 0.5 else -2.0
        return matrix

    data = scene_of(plate, SILVER, half=5.0)
    data.objects[1] = Object("plate", [plate], motion=motion)
    data.duration = 1.0
    params = {
        "boxes": GRID, "extra_probes": 0, "sleep_after": 0, "num_samples_per_probe": 128, "dead_probe_threshold": 0.2,
        "dead_probes_hysteresis": 0.95,
    }  # fmt: skip
    renderer = Renderer(data, "ddgi", params, size=(16, 16), seed=1, preset="rohacek")

    def place() -> np.ndarray:
        return np.array(renderer.state.probes.p).T[CENTRE]

    for _ in range(6):
        renderer.step(time=0.0)
    for _ in range(10):
        renderer.step(time=1.0)
    assert not place().any()
    for _ in range(30):
        renderer.step(time=1.0)
    assert np.abs(place()).max() > 0.0
