"""Light from the probes around a point: seams, borrowed answers, overlapping boxes, and exact black."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.kernels.surface import free_surface
from luxel.methods import METHODS
from luxel.methods.ddgi.atlas import texel_direction
from luxel.methods.ddgi.method import pack
from luxel.methods.ddgi.state import DEAD, DdgiState
from luxel.methods.ddgi.volume import cage_of, grid_coordinates, node_of_probe, probe_of_node, world_position
from luxel.methods.ddgi.weights import trilinear_weight

BOX = "0,0,0 size 4,3,2 probes 5,4,3"
OPEN = {"boxes": BOX, "extra_probes": 0, "normal_bias": 0.0, "view_bias": 0.0}


def ask(scene, state: DdgiState, points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    light = METHODS["ddgi"].query(scene, state, free_surface(points, normals))
    return np.array(light.irradiance).T, np.array(light.weight)


def up(count: int) -> np.ndarray:
    return np.tile([0.0, 1.0, 0.0], (count, 1))


def gray(state: DdgiState, values: np.ndarray) -> np.ndarray:
    return np.repeat(np.asarray(values, float)[:, None], 3, axis=1)


def moved(state: DdgiState, seed: int = 1) -> DdgiState:
    """Return the state with every probe off its node by up to 0.45 cells an axis."""
    volume = state.volumes[0]
    offset = np.random.default_rng(seed).uniform(-0.45, 0.45, (3, volume.probe_count)).astype(np.float32)
    node = node_of_probe(volume, dr.arange(mi.UInt32, volume.probe_count), volume.low)
    p = world_position(volume, mi.Point3f(node) + mi.Point3f(offset))
    return replace(state, probes=replace(state.probes, p=p, offset=mi.Vector3f(offset)))


def killed(state: DdgiState, dead: np.ndarray) -> DdgiState:
    status = dr.select(mi.Bool(dead), mi.UInt32(DEAD), state.probes.status)
    return pack(replace(state, probes=replace(state.probes, status=status)))


def positions(state: DdgiState) -> np.ndarray:
    return np.array(state.probes.p).T


# --------------------------------------------------------------------------------------------- one answer of several


def test_light_that_falls_off_along_the_normal_is_that_of_the_surface(bare, build, lit) -> None:
    """Probes in front of a surface have more say than those behind; their light is not the surface's."""
    found = {}
    for word in ("root", "linear"):
        state = build(bare, interpolation=word, **OPEN)
        height = positions(state)[:, 1]
        state = lit(state, gray(state, (1.0 + 0.25 * height) ** 4))
        found[word] = ask(bare, state, np.array([[0.5, -0.2, 0.0]]), up(1))[0][0, 0]
    expected = (1.0 + 0.25 * -0.2) ** 4
    assert found["root"] == pytest.approx(expected, rel=0.1)
    assert found["linear"] > 1.3 * expected


def test_light_that_changes_along_the_surface_is_that_of_the_point(bare, build, lit) -> None:
    """Where some probes of a cage have no say, the mean place of the others is not the point, nor their light its."""
    state = build(bare, interpolation="root", **OPEN)
    p = positions(state)
    slope, point = np.array([0.3, 0.1, -0.2]), np.array([0.6, -0.2, 0.3])
    state = lit(state, gray(state, (1.5 + p @ slope) ** 4))
    east, north, high = p[:, 0] > 0.5, p[:, 2] < 0.5, p[:, 1] > 0.0
    # The mean of those left, brought to the surface along its normal alone, is 29 %, 19 %, 16 % too dark and 9 % too
    # bright.
    for silent, rel in ((east & north, 0.13), (east & high, 0.1), (east & high & north, 0.08), (~east & ~north, 0.05)):
        found = ask(bare, killed(state, silent), point[None], up(1))[0][0, 0]
        assert found == pytest.approx((1.5 + point @ slope) ** 4, rel=rel)


def test_the_fit_keeps_the_hue(bare, build, lit) -> None:
    state = build(bare, interpolation="root", **OPEN)
    p = positions(state)
    level = (1.5 + p @ np.array([0.3, 0.1, -0.2])) ** 4
    state = killed(lit(state, level[:, None] * np.array([0.8, 0.4, 0.1])), (p[:, 0] > 0.5) & (p[:, 2] < 0.5))
    found, _ = ask(bare, state, np.array([[0.6, -0.2, 0.3]]), up(1))
    np.testing.assert_allclose(found[0] / found[0, 0], [1.0, 0.5, 0.125], rtol=5e-3)


def test_roots_of_one_value_are_that_value(bare, build, lit) -> None:
    state = lit(moved(build(bare, **OPEN)), np.full((60, 3), 0.37))
    rng = np.random.default_rng(5)
    found, _ = ask(bare, state, rng.uniform([-2, -1.5, -1], [2, 1.5, 1], (200, 3)), up(200))
    np.testing.assert_allclose(found, 0.37, rtol=2e-3)


# --------------------------------------------------------------------------------------------- how near


def tents(state: DdgiState, x: np.ndarray, clamp_to: np.ndarray | None = None) -> np.ndarray:
    """Return the eight nearness factors of each point, by probe id: (N, probes)."""
    volume = state.volumes[0]
    g = grid_coordinates(volume, mi.Point3f(x.T.astype(np.float32)))
    base, inner = cage_of(volume, g)
    found = np.zeros((len(x), volume.probe_count))
    for corner in range(8):
        bits = mi.Vector3i(corner & 1, (corner >> 1) & 1, corner >> 2)
        probe = probe_of_node(volume, base + bits)
        q = dr.gather(mi.Point3f, state.probes.p, probe)
        near = trilinear_weight(state, volume, q, base + bits, inner - mi.Point3f(bits))
        found[np.arange(len(x)), np.array(probe)] = np.array(near)
    return found


def test_nearness_joins_at_the_cages_borders(bare, build) -> None:
    state = moved(build(bare, **OPEN))
    rng = np.random.default_rng(2)
    for axis, cells in ((0, 4), (1, 3), (2, 2)):
        x = rng.uniform([-2, -1.5, -1], [2, 1.5, 1], (400, 3))
        x[:, axis] = rng.integers(1, cells, 400) - cells / 2
        below, above = x.copy(), x.copy()
        below[:, axis] -= 1e-5
        above[:, axis] += 1e-5
        np.testing.assert_allclose(tents(state, below), tents(state, above), atol=2e-4)


def test_nearness_is_never_negative_and_moves_slowly(bare, build) -> None:
    state = moved(build(bare, **OPEN))
    x = np.random.default_rng(3).uniform([-2, -1.5, -1], [2, 1.5, 1], (4000, 3))
    step = 1e-3 * np.random.default_rng(4).normal(size=x.shape) / np.sqrt(3)
    here, there = tents(state, x), tents(state, x + step)
    assert here.min() >= 0.0 and here.max() <= 1.0 + 1e-6
    # The steepest side of a tent falls over 0.55 of a cell of 1 m.
    assert np.abs(here - there).max() < 2.0 * np.sqrt(3) * np.linalg.norm(step, axis=1).max()


def test_nearness_peaks_at_the_moved_probe_and_ends_at_its_neighbours(bare, build) -> None:
    state = moved(build(bare, **OPEN))
    volume = state.volumes[0]
    q = positions(state)
    inside = (np.abs(q) < (2.0, 1.5, 1.0)).all(axis=1)
    here = tents(state, q[inside])
    np.testing.assert_allclose(here[np.arange(inside.sum()), np.flatnonzero(inside)], 1.0, atol=1e-5)
    # At every node, the probes of all other nodes have nothing to say.
    nodes = np.array(
        world_position(volume, mi.Point3f(node_of_probe(volume, dr.arange(mi.UInt32, volume.probe_count), volume.low)))
    ).T
    at_nodes = tents(state, nodes)
    np.fill_diagonal(at_nodes, 0.0)
    assert np.abs(at_nodes).max() < 1e-5


def test_unmoved_probes_are_plainly_trilinear(bare, build) -> None:
    x = np.random.default_rng(5).uniform([-2, -1.5, -1], [2, 1.5, 1], (1000, 3))
    for corrected in (True, False):
        state = build(bare, **OPEN, corrected_weights=corrected)
        found = tents(state, x)
        distance = np.abs(x[:, None] - positions(state)[None])
        np.testing.assert_allclose(found, np.maximum(1.0 - distance, 0.0).prod(axis=2), atol=1e-5)


# --------------------------------------------------------------------------------------------- answers


def test_equal_probes_answer_alike_everywhere(bare, build, lit) -> None:
    state = moved(build(bare, **OPEN))
    state = lit(state, gray(state, np.full(state.settings.total, 3.0)))
    points = np.random.default_rng(6).uniform(-6, 6, (3000, 3))
    normals = np.random.default_rng(7).normal(size=(3000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    found, weight = ask(bare, state, points, normals)
    np.testing.assert_allclose(found, 3.0, rtol=1e-3)
    assert (weight > 0.0).all()


def test_the_answer_has_no_seams(bare, build, lit) -> None:
    state = moved(build(bare, **OPEN))
    state = lit(state, gray(state, np.random.default_rng(8).uniform(0, 1, state.settings.total)))
    x = np.linspace(-2.5, 2.5, 5001)
    points = np.stack([x, np.full_like(x, 0.31), np.full_like(x, -0.27)], axis=1)
    found, _ = ask(bare, state, points, up(len(x)))
    assert np.abs(np.diff(found[:, 0])).max() < 5e-3


def test_outside_the_nearest_cage_answers(bare, build, lit) -> None:
    state = build(bare, **OPEN)
    state = lit(state, gray(state, positions(state)[:, 0] + 3.0))
    for side in (-1.0, 1.0):
        found, weight = ask(bare, state, np.array([[side * 9.0, 0.2, 0.1]]), up(1))
        np.testing.assert_allclose(found, 3.0 + 2.0 * side, rtol=0.02)
        assert weight[0] > 0.0


def test_dead_probes_have_no_say(bare, build, lit) -> None:
    state = build(bare, **OPEN)
    dead = np.random.default_rng(9).uniform(size=state.settings.total) < 0.5
    state = killed(lit(state, gray(state, np.where(dead, 1000.0, 1.0))), dead)
    points = np.random.default_rng(10).uniform([-2, -1.5, -1], [2, 1.5, 1], (3000, 3))
    found, _ = ask(bare, state, points, up(3000))
    np.testing.assert_allclose(found, 1.0, rtol=1e-3)


def test_a_dead_cage_borrows(bare, build, lit) -> None:
    state = build(bare, **OPEN)
    dead = (positions(state)[:, 0] > -1.5) & (positions(state)[:, 0] < 1.5)
    dead &= ~((positions(state)[:, 0] > 0.5) & (positions(state)[:, 1] > 1.0))
    state = killed(lit(state, gray(state, np.where(dead, 1000.0, 2.0))), dead)
    points = np.random.default_rng(11).uniform([-1.4, -1.5, -1], [1.4, 1.5, 1], (2000, 3))
    found, weight = ask(bare, state, points, up(2000))
    np.testing.assert_allclose(found, 2.0, rtol=1e-3)
    assert (weight > 0.0).all()


def test_where_nobody_can_answer_the_weight_is_zero(bare, build, lit) -> None:
    """The contract: weight 0 means "no answer", never a silent black."""
    state = build(bare, **OPEN)
    state = killed(lit(state, gray(state, np.ones(state.settings.total))), np.ones(state.settings.total, bool))
    found, weight = ask(bare, state, np.zeros((1, 3)), up(1))
    assert not found.any() and weight[0] == 0.0


def test_black_stays_exactly_black(bare, build, lit) -> None:
    state = moved(build(bare, **OPEN))
    state = lit(state, gray(state, np.zeros(state.settings.total)), scale=0.0)
    found, _ = ask(bare, state, np.random.default_rng(12).uniform(-3, 3, (1000, 3)), up(1000))
    assert not found.any()


@pytest.mark.parametrize("model", ["planes", "moments"])
@pytest.mark.parametrize("detect", [True, False])
def test_a_point_exactly_at_a_probe_is_finite(bare, build, lit, model: str, detect: bool) -> None:
    """Without biases a wall may run through a node: the direction to the point is then no direction."""
    state = build(bare, **OPEN, depth_model=model, detect_dead_probes=detect)
    state = lit(state, gray(state, np.ones(state.settings.total)))
    found, weight = ask(bare, state, positions(state), up(state.settings.total))
    assert np.isfinite(found).all() and np.isfinite(weight).all()
    np.testing.assert_allclose(found, 1.0, rtol=1e-3)


def test_irradiance_is_read_in_the_shading_normals_direction(bare, build) -> None:
    state = build(bare, **OPEN, irradiance_resolution=32)
    texels = 32**2
    direction = texel_direction(dr.arange(mi.UInt32, state.settings.total * texels) % texels, 32)
    mean = mi.Color3f(direction.x + 2.0, direction.y + 2.0, direction.z + 2.0)
    known = replace(state.probes, age=dr.full(mi.UInt32, 1, state.settings.total))
    light = replace(state.irradiance, mean=mean)
    state = pack(replace(state, irradiance=light, probes=known, scale=mi.Float(1.0)))
    n = np.random.default_rng(13).normal(size=(1000, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    found, _ = ask(bare, state, np.zeros((1000, 3)), n)
    np.testing.assert_allclose(found, n + 2.0, atol=0.04)


# --------------------------------------------------------------------------------------------- several boxes


def two_boxes(bare, build, lit, coarse: str, **more: object) -> DdgiState:
    """Return a state whose first (finer) box knows 1 and whose second knows 5."""
    settings = {**OPEN, "boxes": f"0,0,0 size 2,2,2 probes 5,5,5; {coarse}", **more}
    state = build(bare, **settings)
    values = np.where(np.arange(state.settings.total) < 125, 1.0, 5.0)
    return lit(state, gray(state, values))


def test_the_finer_box_answers_inside_and_blends_at_its_border(bare, build, lit) -> None:
    state = two_boxes(bare, build, lit, "0,0,0 size 8,8,8 probes 5,5,5")
    x = np.linspace(-2.0, 2.0, 801)
    found, _ = ask(bare, state, np.stack([x, 0 * x + 0.2, 0 * x + 0.2], axis=1), up(len(x)))
    found = found[:, 0]
    np.testing.assert_allclose(found[np.abs(x) < 0.5], 1.0, rtol=1e-3)
    np.testing.assert_allclose(found[np.abs(x) > 1.0], 5.0, rtol=1e-3)
    # A step of 0.01 cells, and of d(1 + 0.495 s)^4 / ds = 6.6 at most.
    assert np.abs(np.diff(found)).max() < 0.07
    assert found[np.searchsorted(x, 0.75)] == pytest.approx(((1.0 + 5.0**0.25) / 2.0) ** 4, rel=0.05)


def test_boxes_apart_do_not_answer_for_one_another(bare, build, lit) -> None:
    """The last cell of a box blends into the next one only where that one is: two rooms far apart have each its own."""
    state = two_boxes(bare, build, lit, "50,0,0 size 3,3,3 probes 5,5,5")
    points = np.array([[0.0, 0.2, 0.2], [0.8, 0.2, 0.2], [0.99, 0.2, 0.2], [1.05, 0.2, 0.2]])
    found, _ = ask(bare, state, points, up(4))
    np.testing.assert_allclose(found[:, 0], 1.0, rtol=1e-3, err_msg="inside the first, 50 m from the second")
    found, _ = ask(bare, state, np.array([[50.0, 0.2, 0.2], [51.4, 0.2, 0.2]]), up(2))
    np.testing.assert_allclose(found[:, 0], 5.0, rtol=1e-3)


def test_a_dead_fine_cage_leaves_it_to_the_coarse_box(bare, build, lit) -> None:
    state = two_boxes(bare, build, lit, "0,0,0 size 8,8,8 probes 5,5,5")
    state = killed(state, np.arange(state.settings.total) < 125)
    found, weight = ask(bare, state, np.full((1, 3), 0.3), up(1))
    np.testing.assert_allclose(found, 5.0, rtol=1e-3)
    assert weight[0] == 1.0
