"""The bake as a whole: weights, regions, resuming, files, and what it refuses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from luxel.errors import LuxelError
from luxel.methods.lightmap.bake.bake import bake_scene
from luxel.methods.lightmap.bake.forest import check_node_count
from luxel.methods.lightmap.bake.words import HIT_BITS
from luxel.methods.lightmap.method import Lightmap
from luxel.methods.lightmap.params import LightmapParams
from luxel.methods.lightmap.run.state import bake_of
from luxel.methods.lightmap.run.upload import bounce_gain, upload_bake
from luxel.methods.params import make_params
from luxel.render.renderer import Renderer
from luxel.scene import load
from luxel.scene.device import upload

HITS = (1 << HIT_BITS) - 1


def test_weights_of_every_row_sum_to_one(cornell: Renderer) -> None:
    bake = bake_of(cornell.state)
    hits = (bake.words & HITS).sum(axis=1)
    lit = bake.words.any(axis=1)
    assert lit.mean() > 0.95
    np.testing.assert_array_equal(hits[lit], bake.rays)
    assert (bake.words >> HIT_BITS).max() < len(bake.tree_low)
    assert (bake.words != 0).sum(axis=1).max() <= 90


def test_rays_that_leave_meet_the_sky_where_there_is_one(small: LightmapParams) -> None:
    scene = upload(load("attic"))
    bake = bake_scene(scene, replace(small, rays_per_texel=64), 0)
    root = bake.roots[-2]
    cluster = bake.words >> HIT_BITS
    of_sky = (bake.tree_low[cluster] >= bake.tree_low[root]) & (bake.tree_high[cluster] <= bake.tree_high[root])
    share = np.where(of_sky & (bake.words != 0), bake.words & HITS, 0).sum() / (bake.words & HITS).sum()
    assert 0.05 < share < 0.7
    assert bake.sky_angle.sum() == pytest.approx(4.0 * np.pi)


def test_surfels_share_out_the_area(cornell: Renderer) -> None:
    bake = bake_of(cornell.state)
    white, red = np.array([0.885809, 0.698859, 0.666422]), np.array([0.570068, 0.0430135, 0.0443706])
    assert np.isclose(bake.surfel_albedo, white, atol=1e-3).all(axis=1).any()
    assert np.isclose(bake.surfel_albedo, red, atol=1e-3).all(axis=1).any()
    # What lies under the boxes, and the wall behind the lamp, is no part of them.
    assert 23.0 < bake.surfel_area.sum() < 26.0
    assert np.quantile(bake.surfel_area, 0.9) < 3.0 * np.median(bake.surfel_area)
    np.testing.assert_allclose(np.linalg.norm(bake.surfel_normal, axis=1), 1.0, atol=1e-6)


def test_texels_under_a_box_are_filled_from_their_neighbours(cornell: Renderer) -> None:
    bake = bake_of(cornell.state)
    buried = ~bake.texel_fine
    assert 5 <= buried.sum() < 0.15 * len(buried)
    filled = bake.words[: len(buried)][buried].any(axis=1)
    charts = np.unique(bake.texel_chart[bake.texel_fine])
    np.testing.assert_array_equal(filled, np.isin(bake.texel_chart[buried], charts))


def test_no_cluster_reaches_into_a_closed_room(small: LightmapParams) -> None:
    bake = bake_scene(upload(load("two-rooms")), small, 0)
    dark = bake.surfel_p[:, 0] > 0.02
    for node in np.unique(bake.words[bake.words != 0] >> HIT_BITS):
        items = bake.tree_leaf[bake.tree_low[node] : bake.tree_high[node]]
        assert len(set(dark[items[items < len(dark)]])) <= 1


def test_the_gain_of_a_bounce_is_below_one(cornell: Renderer) -> None:
    bake = bake_of(cornell.state)
    assert bounce_gain(bake) == pytest.approx(bake.surfel_albedo.max()) and bounce_gain(bake) < 1.0
    with pytest.raises(LuxelError, match="never settle"):
        upload_bake(cornell.scene, replace(bake, surfel_albedo=bake.surfel_albedo * 1.2), 0)


def test_a_stopped_bake_goes_on(tmp_path: Path, small: LightmapParams, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("luxel.methods.lightmap.bake.rows.RAYS_AT_ONCE", 1 << 16)
    scene = upload(load("cornell-box"))
    whole = bake_scene(scene, small, 3)

    class Stopped(Exception):
        pass

    def stop(text: str, share: float) -> None:
        if text == "casting rays" and share > 0.5:
            raise Stopped

    with pytest.raises(Stopped):
        bake_scene(scene, small, 3, workdir=tmp_path, report=stop)
    left = sorted(tmp_path.iterdir())
    assert len(left) > 2
    left[0].write_bytes(b"cut short")
    kept = left[1].stat().st_mtime_ns
    told: list[tuple[str, float]] = []
    again = bake_scene(scene, small, 3, workdir=tmp_path, report=lambda *now: told.append(now))
    assert left[1].stat().st_mtime_ns == kept, "a finished batch is not cast again"
    np.testing.assert_array_equal(again.words, whole.words)
    np.testing.assert_array_equal(again.seen, whole.seen)
    stages = list(dict.fromkeys(text for text, _ in told))
    assert stages[:2] == ["finding what light can reach", "unwrapping"] and stages[-1] == "casting rays"
    for stage in stages:
        shares = [share for text, share in told if text == stage]
        assert shares == sorted(shares) and 0.0 <= shares[0] <= shares[-1] <= 1.0
    assert told[-1] == ("casting rays", 1.0)


def test_the_bake_of_another_scene_is_refused(tmp_path: Path, cornell: Renderer, small: LightmapParams) -> None:
    file = tmp_path / "bake.npz"
    cornell.method.save(cornell.state, file)
    other = upload(load("furnace"))
    with pytest.raises(LuxelError, match="bake of another scene"):
        cornell.method.load(other, small, file)
    with pytest.raises(LuxelError, match="other parameters"):
        cornell.method.load(cornell.scene, replace(small, tree_chart=9.0), file)
    with np.load(file) as held:
        arrays = {key: held[key] for key in held.files if key != "bake.roots"}
    np.savez(file, **arrays)
    with pytest.raises(LuxelError, match="another version: it lacks 'roots'"):
        cornell.method.load(cornell.scene, small, file)


def test_more_clusters_than_words_can_name_are_refused(small: LightmapParams, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not every surfel was asked for: each piece of a chart has one."""
    check_node_count(500_000, 128, "the most that parameters ask for")
    with pytest.raises(LuxelError, match="leaves: 524,300 surfels"):
        check_node_count(524_300, 0, "leaves")
    scene = upload(load("cornell-box"))
    count = len(bake_scene(scene, small, 0).tree_low)
    monkeypatch.setattr("luxel.methods.lightmap.bake.forest.NODE_LIMIT", count - 1)
    with pytest.raises(LuxelError, match="surfels make more clusters than"):
        bake_scene(scene, small, 0)


@pytest.mark.parametrize(
    ("name", "value"), [("rays_per_texel", 5000), ("visibility", "magic"), ("clusters_per_texel", 1), ("refine", "x")]
)
def test_bad_parameters_are_refused(name: str, value: object) -> None:
    with pytest.raises(LuxelError, match=f"parameter '{name}'"):
        Lightmap().build(upload(load("furnace")), make_params("lightmap", settings={name: value}), 0)


def test_the_form_factor_renders(cornell: Renderer) -> None:
    """Texels miss what no ray met, and show too much where surfaces meet; what bounces counts rays, and settles."""
    settings = {"texel_target": 1024, "surfel_target": 128, "rays_per_texel": 64, "probe_target": 8}
    renderer = Renderer(load("cornell-box"), "lightmap", {**settings, "visibility": "form-factor"}, size=(32, 32))
    renderer.run(24)
    found, wanted = (float(one.layers().indirect.mean()) for one in (renderer, cornell))
    assert 0.5 * wanted < found < 2.0 * wanted


def test_the_form_factor_flares_where_surfaces_meet(small: LightmapParams) -> None:
    """Why the source gave it up: weights of close surfels pass one, and rows no longer sum to it."""
    scene = upload(load("furnace"))
    sums = {}
    for visibility in ("rays", "form-factor"):
        params = replace(small, visibility=visibility, rays_per_texel=2048, surfel_target=128)
        bake = bake_scene(scene, params, 0)
        rows = bake.words[: len(bake.texel_slot)]
        sums[visibility] = (rows & HITS).sum(axis=1) / bake.rays
    np.testing.assert_array_equal(sums["rays"], 1.0)
    assert sums["form-factor"].max() > 1.3 and np.ptp(sums["form-factor"]) > 0.5
