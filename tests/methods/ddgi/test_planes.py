"""Depth as planes: a wall is where it is, at any slant, and nothing else hides a point."""

from __future__ import annotations

from dataclasses import fields, replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.methods.ddgi.atlas import texel_direction
from luxel.methods.ddgi.planes import PlaneSums, join_sums, new_sums, pack_planes, sum_planes, visibility_past_planes

R = 16
SLANTS = [0.0, 30.0, 60.0, 75.0]


def wall(slant: float, height: float) -> tuple[np.ndarray, float]:
    """Return the unit normal and distance of a plane that is `height` from the probe, `slant` degrees off +X."""
    a = np.radians(slant)
    return np.array([np.cos(a), np.sin(a), 0.0]), height


def distances(directions: np.ndarray, plane: tuple[np.ndarray, float]) -> np.ndarray:
    cosine = directions @ plane[0]
    return np.where(cosine > 1e-3, plane[1] / np.maximum(cosine, 1e-3), 1e30)


def sums_of(build, bare, rays, distance, *, count: int = 4096, limit: float = 1e3, reject: bool = True) -> PlaneSums:
    """Return the sums of one probe's texels over `count` rays that go `distance(directions)` far."""
    state = build(bare, boxes="0,0,0 size 2,2,2 probes 2,2,2", extra_probes=0, num_samples_per_probe=count)
    results = rays(state, distance=lambda _, d: distance(d))
    texels = dr.arange(mi.UInt32, R * R)
    direction = texel_direction(texels, R)
    zero = dr.zeros(mi.UInt32, R * R)
    return sum_planes(
        results,
        direction,
        50,
        (mi.Float(0.01), mi.Float(limit)),
        reject,
        (zero, zero + count),
        dr.full(mi.Bool, True, R * R),
    )


def sight(sums: PlaneSums, away: np.ndarray, half: bool = True, reach: float = 20.0) -> np.ndarray:
    atlas = pack_planes(sums, lambda _: mi.Float(reach), R, 1, half)
    probe = dr.zeros(mi.UInt32, len(away))
    return np.array(
        visibility_past_planes(atlas, half, probe, mi.Vector3f(away.T.astype(np.float32)), R, mi.Bool(True))
    )


def towards(plane: tuple[np.ndarray, float], share: float) -> np.ndarray:
    """Return points at `share` of the way to the wall, along directions that meet it within a few heights."""
    d = np.random.default_rng(1).normal(size=(20000, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    # Only where all rays of the four texels around meet the wall too: a lobe reaches 30 degrees far.
    d = d[d @ plane[0] > np.cos(np.radians(45.0))]
    return d * (share * distances(d, plane))[:, None]


@pytest.mark.parametrize("half", [True, False])
@pytest.mark.parametrize("height", [0.05, 1.0, 8.0])
def test_a_wall_is_exactly_where_it_is(build, bare, rays, height: float, half: bool) -> None:
    for slant in SLANTS:
        plane = wall(slant, height)
        sums = sums_of(build, bare, rays, lambda d, plane=plane: distances(d, plane))
        assert sight(sums, towards(plane, 0.99), half, 100.0).min() > 0.9
        assert sight(sums, towards(plane, 1.05), half, 100.0).max() < 1e-3


@pytest.mark.parametrize("count", [64, 256])
def test_few_rays_find_the_wall_too(build, bare, rays, count: int) -> None:
    plane = wall(20.0, 1.0)
    sums = sums_of(build, bare, rays, lambda d: distances(d, plane), count=count)
    assert np.quantile(sight(sums, towards(plane, 0.95)), 0.01) > 0.5
    assert np.quantile(sight(sums, towards(plane, 1.25)), 0.99) < 0.1


def test_one_ray_is_a_plane_that_faces_the_probe() -> None:
    """The matrix of one ray has rank one; what holds it up must not drown in rounding."""
    d = np.array(texel_direction(dr.arange(mi.UInt32, R * R), R)).T.astype(float)
    rng = np.random.default_rng(3)
    w = d + 0.25 * rng.normal(size=d.shape) / np.sqrt(3.0)
    w /= np.linalg.norm(w, axis=1, keepdims=True)
    weight, t = np.maximum((w * d).sum(axis=1), 0.0) ** 50 + 1e-3, 2.0
    x, y, z = w.T
    columns = [
        x * x,
        y * y,
        z * z,
        x * y,
        x * z,
        y * z,
        x / t,
        y / t,
        z / t,
        np.full(len(d), 1 / t**2),
        np.ones(len(d)),
    ]
    sums = PlaneSums(*(mi.Float((weight * column).astype(np.float32)) for column in columns))
    rows = np.array(pack_planes(sums, lambda _: mi.Float(20.0), R, 1, half=False)).reshape(R + 2, R + 2, 4)[1:-1, 1:-1]
    found = (rows[..., :3].reshape(-1, 3) * d).sum(axis=1)
    # Along the texel's middle the plane is about as far as the ray went: up to 25 degrees off, within some 15 %.
    np.testing.assert_allclose(1.0 / found, t, rtol=0.2)
    assert rows[..., 3].max() < 0.05, "one ray lies on its own plane"


def test_empty_texels_are_open_up_to_reach() -> None:
    d = np.random.default_rng(2).normal(size=(2000, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    sums = new_sums(R * R)
    assert sight(sums, 4.9 * d, reach=5.0).min() > 0.9
    assert sight(sums, 0.01 * d, reach=5.0).min() > 0.99


def test_half_and_half_is_the_whole(build, bare, rays) -> None:
    plane = wall(40.0, 1.5)
    whole = sums_of(build, bare, rays, lambda d: distances(d, plane), count=512)
    parts = []
    state = build(bare, boxes="0,0,0 size 2,2,2 probes 2,2,2", extra_probes=0, num_samples_per_probe=512)
    results = rays(state, distance=lambda _, d: distances(d, plane))
    direction, on = texel_direction(dr.arange(mi.UInt32, R * R), R), dr.full(mi.Bool, True, R * R)
    for start in (0, 256):
        span = dr.full(mi.UInt32, start, R * R), dr.full(mi.UInt32, 256, R * R)
        parts.append(sum_planes(results, direction, 50, (mi.Float(0.01), mi.Float(1e3)), True, span, on))
    joined = join_sums(parts[0], parts[1], mi.Float(1.0), 1e9, on)
    for item in fields(PlaneSums):
        found, expected = np.array(getattr(joined, item.name)), np.array(getattr(whole, item.name))
        np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5 * np.abs(expected).max())


def test_the_weight_is_bounded_and_the_plane_stays() -> None:
    ones = PlaneSums(*(mi.Float(2.0) for _ in range(11)))
    joined = join_sums(ones, ones, mi.Float(1.0), 3.0, mi.Bool(True))
    assert np.array(joined.weight)[0] == pytest.approx(3.0) and np.array(joined.xx)[0] == pytest.approx(3.0)
    idle = join_sums(ones, new_sums(1), mi.Float(0.5), 3.0, mi.Bool(True))
    assert np.array(idle.weight)[0] == 2.0
    fresh = join_sums(replace(ones, weight=mi.Float(0.0)), ones, mi.Float(1.0), 30.0, mi.Bool(True))
    assert np.array(fresh.xx)[0] == 2.0, "what was cleared is forgotten whole"


def test_far_rays_are_rejected_or_taken_at_the_limit(build, bare, rays) -> None:
    def some_far(d: np.ndarray) -> np.ndarray:
        return np.where(np.arange(len(d)) % 3 == 0, 1e30, 1.0)

    rejected = sums_of(build, bare, rays, some_far, limit=3.0)
    clamped = sums_of(build, bare, rays, some_far, limit=3.0, reject=False)
    inverse = [np.array(s.square) / np.array(s.weight) for s in (rejected, clamped)]
    np.testing.assert_allclose(inverse[0], 1.0, rtol=1e-5)
    np.testing.assert_allclose(inverse[1], (2.0 + 1.0 / 9.0) / 3.0, rtol=0.15)
