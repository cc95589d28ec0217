"""The ray budget against NumPy and arithmetic: never too many rays, everyone in turn, no bias."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.errors import LuxelError
from luxel.kernels.mean_estimator import EstimatorDials, advance_estimate, new_estimate
from luxel.methods.gibs.budget import PARTS, owners, plan_rays, share_out
from luxel.methods.gibs.params import VIEW_TURN
from luxel.methods.gibs.surfels import GibsState
from luxel.methods.gibs.workload import GibsWorkload
from luxel.render.renderer import Renderer
from luxel.scene import load
from luxel.scene.arrays import from_numpy

CAPACITY = 2048
WORKLOAD = GibsWorkload()


@pytest.fixture(scope="module")
def box() -> Renderer:
    params = {"surfel_target": CAPACITY // 2, "ray_budget": 700}
    return Renderer(load("cornell-box"), "gibs", params, size=(32, 32), seed=1)


def with_surfels(
    state: GibsState, alive: np.ndarray, seen: np.ndarray, count: float = 1000.0, inconsistency: float = 0.0
) -> GibsState:
    """Return the state with living surfels that a view saw in those frames."""
    surfels = state.surfels
    estimate = replace(
        surfels.estimate,
        count=dr.full(mi.Float, count, CAPACITY),
        inconsistency=dr.full(mi.Float, inconsistency, CAPACITY),
    )
    sight = replace(surfels.sight, seen=from_numpy(mi.UInt32, seen.astype(np.uint32)))
    placed = from_numpy(mi.UInt32, alive.astype(np.uint32))
    return replace(state, surfels=replace(surfels, object_id=placed, sight=sight, estimate=estimate))


def test_shares_are_whole_rays_side_by_side() -> None:
    """Against cumsum: rounding the running sum gives each what it asked for on average, and nobody a ray too many."""
    rng = np.random.default_rng(3)
    parts = rng.integers(0, 4 * PARTS, 5000)
    counts = []
    for shift in range(0, PARTS, 8):
        plan = share_out(from_numpy(mi.UInt32, parts.astype(np.uint32)), mi.UInt32(shift), 1 << 24)
        ends = (np.cumsum(parts) + shift) // PARTS
        np.testing.assert_array_equal(np.array(plan.first), np.concatenate([[0], ends[:-1]]))
        np.testing.assert_array_equal(np.array(plan.count), np.diff(ends, prepend=0))
        assert int(np.array(plan.total)[0]) == ends[-1]
        counts.append(np.array(plan.count))
    np.testing.assert_allclose(np.mean(counts, axis=0), parts / PARTS, atol=8 / PARTS)
    assert int(np.array(share_out(mi.UInt32(parts), mi.UInt32(0), 321).total)[0]) == 321


def test_lanes_know_their_surfel() -> None:
    """Against repeat."""
    counts = np.random.default_rng(4).integers(0, 5, 1000)
    plan = share_out(from_numpy(mi.UInt32, (counts * PARTS).astype(np.uint32)), mi.UInt32(0), 4096)
    surfel, ray, active = (np.array(part) for part in owners(plan, 4096))
    assert active.sum() == counts.sum() and active[: counts.sum()].all()
    np.testing.assert_array_equal(surfel[active], np.repeat(np.arange(1000), counts))
    np.testing.assert_array_equal(ray[active], np.concatenate([np.arange(count) for count in counts]))


@pytest.mark.parametrize(("count", "alive_share"), [(0.0, 1.0), (30.0, 0.9), (1e6, 1.0), (1e6, 0.02)])
def test_the_budget_holds_and_everyone_has_a_turn(box: Renderer, count: float, alive_share: float) -> None:
    """Newborn, grown and settled pools, full and nearly empty; half of the surfels in view, by blocks of ids."""
    rng = np.random.default_rng(5)
    alive = rng.random(CAPACITY) < alive_share
    in_view = alive & (np.arange(CAPACITY) < CAPACITY // 2)
    state = with_surfels(box.state, alive, np.where(in_view, 1 << 20, 0), count)
    frames, cast = 64, []
    for frame in range(frames):
        # What the views saw last was always the frame before.
        now = with_surfels(state, alive, np.where(in_view, 1000 + frame - 1, 0), count)
        plan = plan_rays(now, dr.opaque(mi.UInt32, 1000 + frame))
        cast.append(np.array(plan.count))
        assert cast[-1].sum() == int(np.array(plan.total)[0]) <= 700
    cast = np.array(cast) > 0
    assert not cast[:, ~alive].any()
    for start in range(frames - VIEW_TURN + 1):
        assert cast[start : start + VIEW_TURN, in_view].any(axis=0).all()
    assert cast[:, alive].any(axis=0).all()


def test_rays_go_to_the_seen_and_the_young(box: Renderer) -> None:
    everyone = np.ones(CAPACITY, bool)
    half = np.arange(CAPACITY) % 2 == 0
    large = replace(box.state, settings=replace(box.state.settings, ray_lanes=1 << 16))

    def mean_rays(state: GibsState) -> np.ndarray:
        plans = [plan_rays(state, dr.opaque(mi.UInt32, frame)) for frame in range(500, 564)]
        return np.mean([np.array(plan.count) for plan in plans], axis=0)

    # Seen in a frame to come counts as seen now.
    grown = with_surfels(large, everyone, np.where(half, 1 << 30, 0), count=100.0)
    rays = mean_rays(grown)
    assert rays[half].mean() == pytest.approx(4.0 + 1 / 8, rel=0.02)
    assert rays[~half].mean() == pytest.approx(1.0 + 1 / 64, rel=0.05)
    young = mean_rays(with_surfels(large, everyone, np.where(half, 1 << 30, 0), count=0.0))
    assert young.mean() == pytest.approx(16.0, rel=0.02)
    settled = mean_rays(with_surfels(large, everyone, np.where(half, 1 << 30, 0), count=1e9))
    assert settled[half].mean() == pytest.approx(1 / 8) and settled[~half].mean() == pytest.approx(1 / 64)
    # The common alarm wakes them all, and so does what disagrees with itself.
    awake = replace(with_surfels(large, everyone, np.where(half, 1 << 30, 0), count=1e9), drift=mi.Float(0.1))
    assert mean_rays(awake).min() >= 3.0
    doubtful = with_surfels(large, everyone, np.where(half, 1 << 30, 0), count=1e9, inconsistency=1.0)
    assert mean_rays(doubtful).min() >= 3.0


def test_where_no_view_looks_all_count_as_seen(box: Renderer) -> None:
    state = with_surfels(box.state, np.ones(CAPACITY, bool), np.zeros(CAPACITY), count=100.0)
    state = replace(state, settings=replace(state.settings, ray_lanes=1 << 16))
    assert np.array(plan_rays(state, mi.UInt32(500)).count).min() >= 4


def test_samples_count_by_their_rays() -> None:
    """Once warm, each sample's weight in the mean is as its rays are: the blends say so, by arithmetic."""
    worth = np.random.default_rng(6).choice([0.25, 1.0, 4.0], 100)
    dials = EstimatorDials(mi.Float(0.08), mi.Float(4.0), mi.Float(1e9))
    estimate, blends = new_estimate(1), []
    for weight in worth.tolist():
        estimate, blend = advance_estimate(
            estimate, mi.Color3f(1.0), mi.Float(1.0), mi.Float(0.0), dials, mi.Bool(True), mi.Float(weight)
        )
        blends.append(float(np.array(blend)[0]))
    left = np.cumprod((1.0 - np.array(blends))[::-1])[::-1]
    weights = np.array(blends) * np.append(left[1:], 1.0)
    share = weights[30:] / worth[30:]
    np.testing.assert_allclose(share, share.mean(), rtol=2e-3)
    assert float(np.array(estimate.count)[0]) == pytest.approx(worth.sum(), rel=1e-5)


def test_the_furnace_is_as_bright_as_it_should_be_with_few_rays() -> None:
    """Half a ray a surfel: what settled ones and unseen ones leave out is no bias. One seed alone is off by 0.3 %."""
    data, found = load("furnace"), []
    for seed in range(1, 5):
        renderer = Renderer(data, "gibs", {"surfel_target": 1000, "ray_budget": 512}, size=(32, 32), seed=seed)
        renderer.run(200)
        assert 0 < int(np.array(renderer.state.cast).sum()) <= 512
        found.append(renderer.layers().indirect.mean())
    assert np.mean(found) == pytest.approx(data.facts["indirect_irradiance"], rel=0.005)


def test_what_is_counted_is_what_is_cast(box: Renderer) -> None:
    renderer = Renderer(load("cornell-box"), "gibs", {"surfel_target": 800}, size=(32, 32), seed=1)
    before = np.array(renderer.state.surfels.ray_index).astype(int)
    for _ in range(6):
        renderer.step()
        after = np.array(renderer.state.surfels.ray_index).astype(int)
        cast = WORKLOAD.ray_counts(renderer.state)["closest"]
        newborn = after == 0
        assert cast == int(np.array(renderer.state.cast).sum()) >= (after - before)[~newborn].sum()
        active = WORKLOAD.ray_origins(renderer.scene, renderer.state)[2]
        assert int(np.array(active).sum()) == cast
        before = after


def test_too_small_a_budget_is_refused() -> None:
    with pytest.raises(LuxelError, match="ray_budget"):
        Renderer(load("furnace"), "gibs", {"surfel_target": 1000, "ray_budget": 100}, size=(16, 16))
