"""What stands in the texels: the path tracer's light, by every method, and no hole anywhere."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from luxel.bake import bounce
from luxel.bake.core import Baked, bake_scene
from luxel.bake.lamps import scale_lights
from luxel.errors import LuxelError
from luxel.scene import load
from luxel.scene.library.analytic import sphere

from .conftest import SMALL

ATLAS = {"texel_target": SMALL["texel_target"]}


@pytest.fixture(scope="module")
def truth() -> Baked:
    return bake_scene(load("cornell-box"), "path", dict(ATLAS), samples=32)


def test_texels_hold_what_the_path_tracer_finds(cornell: Baked, truth: Baked) -> None:
    np.testing.assert_array_equal(cornell.layout.slot, truth.layout.slot)
    own = cornell.layout.source == np.arange(len(cornell.layout.slot))
    assert cornell.light.indirect[own].mean() == pytest.approx(truth.light.indirect[own].mean(), rel=0.03)
    assert cornell.light.direct[own].mean() == pytest.approx(truth.light.direct[own].mean(), rel=0.02)
    difference = np.abs(cornell.light.indirect - truth.light.indirect)[own].mean()
    assert difference < 0.15 * truth.light.indirect[own].mean()


def test_probes_bake_too(truth: Baked) -> None:
    baked = bake_scene(load("cornell-box"), "ddgi", dict(ATLAS), frames=48, samples=8)
    own = truth.layout.source == np.arange(len(truth.layout.slot))
    assert baked.light.indirect[own].mean() == pytest.approx(truth.light.indirect[own].mean(), rel=0.1)


def test_light_bounces_until_it_has_settled() -> None:
    data = sphere(albedo=0.95)
    small = {**SMALL, "texel_target": 1024}
    baked = bake_scene(data, "lightmap", small, samples=1)
    assert baked.light.indirect.mean() == pytest.approx(data.facts["indirect_irradiance"], rel=0.01)
    assert 32 < baked.frames_run < 512 and not baked.notes
    short = bake_scene(data, "lightmap", small, frames=32, samples=1)
    assert short.frames_run == 32
    assert short.light.indirect.mean() < 0.9 * data.facts["indirect_irradiance"]


def test_light_that_does_not_settle_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bounce, "FRAMES_AT_MOST", 12)
    baked = bake_scene(load("cornell-box"), "ddgi", dict(ATLAS), samples=1)
    assert baked.frames_run == 12 and "after 12 frames" in baked.notes[-1]


def test_texels_inside_things_take_their_neighbours_light(cornell: Baked) -> None:
    layout, light = cornell.layout, cornell.light
    inside = np.flatnonzero(layout.source != np.arange(len(layout.slot)))
    from_there = layout.source[inside]
    assert len(inside) and (np.diff(layout.starts)[from_there] > 0).all()
    places = np.column_stack([layout.slot % layout.width, layout.slot // layout.width])
    assert (np.linalg.norm(places[inside] - places[from_there], axis=1) < 4.0).all()
    for values in (light.direct, light.indirect, light.albedo):
        np.testing.assert_allclose(values[inside], values[from_there], rtol=1e-5)
    assert (light.indirect[inside] > 0.0).all()


def test_a_method_that_needs_a_camera_is_refused() -> None:
    with pytest.raises(LuxelError, match="'gibs' cannot bake"):
        bake_scene(load("cornell-box"), "gibs")


@pytest.mark.parametrize("method", ["path", "lightmap"])
def test_stopped_samples_go_on(method: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Stopped amid its samples, a bake comes out as if it had not been; under another light it starts anew."""
    monkeypatch.setattr("luxel.bake.light.CHECKPOINT_EVERY", 0.0)
    small = {"texel_target": 256}
    if method == "lightmap":
        small |= {"surfel_target": 32, "rays_per_texel": 32, "probe_target": 1}

    class Stopped(Exception):
        pass

    def stop(text: str, share: float) -> None:
        if text == "lighting texels" and share >= 0.5:
            raise Stopped

    whole = bake_scene(load("cornell-box"), method, small, frames=2, samples=8)
    with pytest.raises(Stopped):
        bake_scene(load("cornell-box"), method, small, frames=2, samples=8, workdir=tmp_path, report=stop)
    shares: list[float] = []

    def note(text: str, share: float) -> None:
        if text == "lighting texels":
            shares.append(share)

    again = bake_scene(load("cornell-box"), method, small, frames=2, samples=8, workdir=tmp_path, report=note)
    assert len(shares) == 4, "half of the samples were kept"
    np.testing.assert_array_equal(again.light.direct, whole.light.direct)
    np.testing.assert_array_equal(again.light.indirect, whole.light.indirect)
    other = scale_lights(load("cornell-box"), {"lamp": 2.0})
    shares.clear()
    bake_scene(other, method, small, frames=2, samples=8, workdir=tmp_path, report=note)
    assert len(shares) == 8, "samples of another light are of no use"
