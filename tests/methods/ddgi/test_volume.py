"""From the world to the lattice and back, and windows that scroll over an endless lattice."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.methods.ddgi.boxes import ProbeBox
from luxel.methods.ddgi.volume import (
    Volume,
    cage_of,
    grid_coordinates,
    inside_share,
    is_inside,
    make_volume,
    node_of_probe,
    probe_of_node,
    world_position,
)

LOWS = [(0, 0, 0), (-3, 5, -11), (100000, -99999, 7), (-1000003, 1000000, -1)]


def volume_at(low: tuple[int, int, int] = (0, 0, 0), turn: float = 0.0, first: int = 17) -> Volume:
    box = ProbeBox((1.0, -2.0, 3.0), (4.0, 3.0, 10.0), (5, 4, 6), turn)
    return replace(make_volume(box, first, 0.45), low=mi.Vector3i(*low))


def nodes_of(volume: Volume) -> np.ndarray:
    index = dr.arange(mi.UInt32, volume.probe_count)
    return np.array(node_of_probe(volume, index, volume.low)).T


@pytest.mark.parametrize("turn", [0.0, 30.0, -135.0])
def test_world_to_lattice_and_back(turn: float) -> None:
    volume = volume_at(turn=turn)
    p = np.random.default_rng(1).uniform(-10.0, 10.0, (2000, 3)).astype(np.float32)
    g = grid_coordinates(volume, mi.Point3f(p.T))
    np.testing.assert_allclose(np.array(world_position(volume, g)).T, p, atol=2e-5)
    # Lengths are the cells', whatever the turn.
    a, b = (np.array(world_position(volume, mi.Point3f(*at))).ravel() for at in ((0, 0, 0), (1, 1, 1)))
    assert np.linalg.norm(a - b) == pytest.approx(np.sqrt(1.0 + 1.0 + 4.0), rel=1e-5)


@pytest.mark.parametrize("turn", [0.0, 30.0])
def test_the_corner_probes_are_the_boxs_corners(turn: float) -> None:
    volume = volume_at(turn=turn)
    ends = [np.array(world_position(volume, mi.Point3f(*at))).ravel() for at in ((0, 0, 0), (4, 3, 5))]
    np.testing.assert_allclose((ends[0] + ends[1]) / 2, (1.0, -2.0, 3.0), atol=1e-5)
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    # About Y, from +Z towards +X: the box's own Z axis is (s, 0, c), its X axis (c, 0, -s).
    half = 2.0 * np.array([c, 0, -s]) + 1.5 * np.array([0, 1, 0]) + 5.0 * np.array([s, 0, c])
    np.testing.assert_allclose(ends[1], np.array([1.0, -2.0, 3.0]) + half, atol=1e-5)


@pytest.mark.parametrize("low", LOWS)
def test_nodes_and_probes_invert(low: tuple[int, int, int]) -> None:
    volume = volume_at(low)
    nodes = nodes_of(volume)
    assert (nodes.min(axis=0) == low).all() and (nodes.max(axis=0) == np.array(low) + (4, 3, 5)).all()
    assert len(np.unique(nodes, axis=0)) == volume.probe_count
    back = np.array(probe_of_node(volume, mi.Vector3i(nodes.T)))
    np.testing.assert_array_equal(back, 17 + np.arange(volume.probe_count))


@pytest.mark.parametrize("low", LOWS)
@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("step", [1, -1])
def test_scrolling_renames_the_entering_plane_only(low: tuple[int, int, int], axis: int, step: int) -> None:
    before = nodes_of(volume_at(low))
    moved = list(low)
    moved[axis] += step
    after = nodes_of(volume_at((moved[0], moved[1], moved[2])))
    changed = (before != after).any(axis=1)
    counts = np.array((5, 4, 6))
    assert changed.sum() == counts.prod() // counts[axis]
    entering = low[axis] + (counts[axis] if step == 1 else -1)
    assert (after[changed][:, axis] == entering).all()


@pytest.mark.parametrize("low", LOWS[:2])
def test_every_point_has_a_cage_of_the_window(low: tuple[int, int, int]) -> None:
    volume = volume_at(low)
    rng = np.random.default_rng(2)
    points = [rng.uniform(-20, 20, (3000, 3)), rng.uniform(-1, 1, (500, 3)) * 1e7, [[np.nan] * 3, [np.inf] * 3]]
    g = np.concatenate(points).astype(np.float32)
    base, inner = cage_of(volume, mi.Point3f(g.T))
    base, inner = np.array(base).T, np.array(inner).T
    assert (base >= low).all() and (base <= np.array(low) + (3, 2, 4)).all()
    finite = np.isfinite(g).all(axis=1)
    assert (inner[finite] >= 0.0).all() and (inner[finite] <= 1.0).all()
    inside = finite & (g >= low).all(axis=1) & (g <= np.array(low) + (4, 3, 5)).all(axis=1)
    np.testing.assert_allclose((base + inner)[inside], g[inside], atol=1e-5)
    # Outside: the nearest place of the box.
    np.testing.assert_allclose((base + inner)[finite], np.clip(g[finite], low, np.array(low) + (4, 3, 5)), atol=1e-4)


def test_the_share_is_one_inside_and_falls_over_the_last_cell() -> None:
    volume = volume_at((2, 2, 2))
    x = np.linspace(1.0, 7.5, 651, dtype=np.float32)
    g = mi.Point3f(mi.Float(x), mi.Float(3.5), mi.Float(4.5))
    share, inside = np.array(inside_share(volume, g)), np.array(is_inside(volume, g))
    assert (share[(x >= 3.0) & (x <= 5.0)] == 1.0).all() and (share[(x <= 2.0) | (x >= 6.0)] == 0.0).all()
    assert np.abs(np.diff(share)).max() < 0.011
    np.testing.assert_array_equal(inside, (x >= 2.0) & (x <= 6.0))
