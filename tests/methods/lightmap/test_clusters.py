"""One texel's clusters in the scene: the share of each is what rays from the texel find there."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.inspect.looks.shot import surface_at_pixel, take_shot
from luxel.kernels.records import Surface
from luxel.kernels.sampling import cosine_hemisphere, random_2d, to_world
from luxel.kernels.surface import surface_at, surface_at_hit
from luxel.kernels.trace import offset_origin, trace_closest
from luxel.methods import inspector_of
from luxel.methods.lightmap.inspect.clusters import read_texel_row
from luxel.methods.lightmap.run.state import bake_of
from luxel.render.renderer import Renderer
from luxel.scene import load

from .conftest import SMALL

RAYS = 1 << 14


COARSE = {**SMALL, "texel_target": 1024, "surfel_target": 256, "rays_per_texel": 1024, "clusters_per_texel": 24}


@pytest.fixture(scope="module", params=["cornell-box", "opening"])
def coarse(request: pytest.FixtureRequest) -> Renderer:
    """Few clusters of several surfels each, known well: a closed box and one that the sky lights."""
    renderer = Renderer(load(request.param), "lightmap", dict(COARSE), size=(64, 64), seed=1)
    renderer.run(2)
    return renderer


def look_around(renderer: Renderer, point: Surface) -> Surface:
    """Return what cosine-weighted rays from the first point of `point` meet."""
    lane = dr.arange(mi.UInt32, RAYS)
    p, n = (
        type(v)(*(dr.gather(mi.Float, c, dr.zeros(mi.UInt32, RAYS)) for c in v)) for v in (point.p, point.n_geometric)
    )
    direction = to_world(n, cosine_hemisphere(random_2d(mi.UInt32(5), lane)))
    hit = trace_closest(renderer.scene, offset_origin(renderer.scene, p, n), direction, dr.full(mi.Bool, True, RAYS))
    return surface_at_hit(renderer.scene, hit, direction)


def test_rays_from_a_texel_meet_its_clusters_by_their_shares(coarse: Renderer) -> None:
    renderer = coarse
    point = surface_at_pixel(take_shot(renderer), 32, 58)[0]
    row = read_texel_row(renderer.state, point)
    assert row is not None and row.shares.sum() == pytest.approx(1.0) and (np.diff(row.shares) <= 0.0).all()
    around = look_around(renderer, point)
    told = inspector_of(renderer.method).sources(renderer.scene, renderer.state, point, around)
    item = np.where(np.array(told.answered), np.array(told.item).astype(int), -1)
    found = np.array([(item == node).mean() for node in row.nodes])
    bake = bake_of(renderer.state)
    is_void = bake.tree_leaf[bake.tree_low[row.nodes]] == len(bake.tree_leaf) - 1
    # The bake's rays come from all over the texel, and are few: within four standard errors and one ray.
    noise = 4.0 * np.sqrt(np.maximum(found, row.shares) / bake.rays) + 1.0 / bake.rays
    assert (np.abs(found - row.shares) < noise)[~is_void].all()
    assert found.sum() + row.shares[is_void].sum() == pytest.approx(1.0, abs=0.08)
    for node, share in zip(row.nodes[:3], row.shares[:3], strict=True):
        given = np.array(told.share)[item == node]
        np.testing.assert_allclose(given, share, rtol=1e-6)
    assert [number for _, number in told.heaviest] == row.nodes[: len(told.heaviest)].tolist()


def test_only_the_texel_itself_is_marked(coarse: Renderer) -> None:
    shot = take_shot(coarse, pixel=(32, 58))
    told = inspector_of(coarse.method).sources(coarse.scene, coarse.state, shot.chosen_point, shot.gbuffer.surface)
    marked = shot.film.to_image(told.marked).astype(bool)
    p = shot.film.to_image(shot.gbuffer.surface.p)[marked]
    size = float(bake_of(coarse.state).texel_size)
    assert marked[58, 32] and len(p) < 60
    assert np.linalg.norm(p - np.array(shot.chosen_point.p).ravel(), axis=1).max() < 1.5 * size


def test_discs_are_surfels_of_the_items_that_explain_names(coarse: Renderer) -> None:
    point = take_shot(coarse, pixel=(32, 58)).chosen_point
    discs = inspector_of(coarse.method).discs(coarse.scene, coarse.state, point)
    assert discs is not None
    bake = bake_of(coarse.state)
    named = [entry.item for entry in inspector_of(coarse.method).explain(coarse.scene, coarse.state, point)]
    assert set(discs.item.tolist()) <= set(named) and np.bincount(discs.item).max() > 1
    # The heaviest keeps all its surfels; no surfel is drawn twice.
    heaviest = next(node for node in named if bake.tree_leaf[bake.tree_low[node]] < len(bake.surfel_p))
    members = bake.tree_leaf[bake.tree_low[heaviest] : bake.tree_high[heaviest]]
    held = discs.p[discs.item == heaviest]
    assert {tuple(p) for p in held.tolist()} == {tuple(p) for p in bake.surfel_p[members].tolist()}
    assert len(np.unique(discs.p, axis=0)) == len(discs.p)
    assert np.pi * (discs.radius**2).sum() < bake.surfel_area.sum() * 1.0001


def test_a_point_without_a_texel_is_said(coarse: Renderer) -> None:
    nowhere = surface_at(coarse.scene, mi.UInt32([0]), mi.Point2f(0.3), mi.Bool([False]))
    shot = take_shot(coarse)
    free = surface_at(coarse.scene, mi.UInt32([0]), mi.Point2f(0.3), mi.Bool([True]))
    free = replace(free, object_id=mi.UInt32([0]))
    for point, words in ((nowhere, "No surface"), (free, "the probes light it")):
        told = inspector_of(coarse.method).sources(coarse.scene, coarse.state, point, shot.gbuffer.surface)
        assert words in told.words and not told.heaviest
        assert not np.array(told.answered).any() and not np.array(told.marked).any()
        assert inspector_of(coarse.method).discs(coarse.scene, coarse.state, point) is None
