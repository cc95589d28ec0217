"""The comparison with Blender's Cycles: error functions, the texels compared and, where there is a Blender, units.

The last kind needs a Python that has `bpy`, named by LUXEL_BLENDER_PYTHON; without one it is skipped.
"""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from luxel.bake.core import Baked
from luxel.errors import LuxelError
from luxel.scene import load
from luxel.scene.device import upload
from luxel.scene.model import Light, SceneData, Sky

from .conftest import two_lamps

REPOSITORY = Path(__file__).resolve().parents[2]
PARTS = ("blender", "errors", "export", "table", "truth")


@pytest.fixture(scope="module")
def peer() -> Iterator[Any]:
    """The benchmark's modules, `peer.errors` and so on; they are no part of the package."""
    if not (REPOSITORY / "benchmarks" / "cycles").is_dir():
        pytest.skip("benchmarks/ is not here: this is no checkout of the repository")
    sys.path.insert(0, str(REPOSITORY))
    yield SimpleNamespace(**{part: importlib.import_module(f"benchmarks.cycles.{part}") for part in PARTS})
    sys.path.remove(str(REPOSITORY))


# --- errors --------------------------------------------------------------------------------------------------------


def noisy_truth(peer: Any, count: int, noise: float) -> tuple[np.ndarray, Any]:
    """Return the true values (count, 3), of mean 2, and halves of them that are off by `noise`."""
    random = np.random.default_rng(3)
    true = 1.0 + 2.0 * random.random((count, 3))
    return true, peer.errors.Halves(*(true + noise * random.standard_normal(true.shape) for _ in range(2)))


def test_the_truths_noise_is_no_error(peer: Any) -> None:
    true, truth = noisy_truth(peer, 40_000, 0.3)
    off = true + 0.1 * np.random.default_rng(4).standard_normal(true.shape)
    assert peer.errors.relative_rmse(off, truth) == pytest.approx(0.05, rel=0.05)
    assert peer.errors.relative_rmse(true, truth) < 0.01
    plain = float(np.sqrt(((off - truth.mean) ** 2).mean())) / float(true.mean())
    assert plain > 0.1
    assert truth.noise() == pytest.approx(0.3 / np.sqrt(2.0) / 2.0, rel=0.02)


def test_bias_is_signed(peer: Any) -> None:
    true, truth = noisy_truth(peer, 10_000, 0.05)
    assert peer.errors.relative_bias(1.03 * true, truth) == pytest.approx(0.03, abs=0.002)
    assert peer.errors.relative_bias(0.9 * true, truth) == pytest.approx(-0.1, abs=0.002)


def test_patches_forgive_noise_and_not_stains(peer: Any) -> None:
    x, y = (part.ravel() for part in np.meshgrid(np.arange(64), np.arange(64)))
    patch = peer.errors.patch_of_texels(x, y, np.zeros(len(x), int))
    assert len(np.unique(patch)) == 64
    true, truth = noisy_truth(peer, len(x), 0.05)
    noisy = true + 0.4 * np.random.default_rng(5).standard_normal(true.shape)
    stained = true + 0.4 * np.where((x < 32)[:, None], 1.0, -1.0)
    by_noise, by_stain = (peer.errors.judge(values, truth, patch) for values in (noisy, stained))
    assert by_noise["rmse"] == pytest.approx(by_stain["rmse"], rel=0.05)
    assert by_noise["patch_rmse"] < 0.2 * by_stain["patch_rmse"]
    assert by_stain["patch_rmse"] == pytest.approx(0.2, rel=0.05)


def test_patches_end_with_their_chart(peer: Any) -> None:
    x, y = (part.ravel() for part in np.meshgrid(np.arange(8), np.arange(8)))
    patch = peer.errors.patch_of_texels(x, y, (x >= 3).astype(int))
    assert len(np.unique(patch)) == 2 and patch.min() >= 0
    # One row of eight texels is too little to judge by.
    assert (peer.errors.patch_of_texels(x, y, (y == 0).astype(int))[y == 0] == -1).all()


def test_samples_for_a_time_and_for_an_error(peer: Any) -> None:
    samples = [4, 16, 64, 256]
    assert peer.errors.samples_for_time(samples, [0.1 + 0.02 * n for n in samples], 4.1) == 200
    assert peer.errors.samples_for_time(samples, [0.1 + 0.02 * n for n in samples], 0.01) == 1
    falling = [0.8 * n**-0.5 for n in samples]
    assert peer.errors.samples_for_error(samples, falling, 0.02) == 1600
    assert peer.errors.samples_for_error(samples, falling, 0.2) == 16
    assert peer.errors.samples_for_error(samples, [0.2, 0.101, 0.1, 0.1], 0.02) is None


# --- texels --------------------------------------------------------------------------------------------------------


def test_cycles_samples_the_middle_of_a_texel(peer: Any, cornell: Baked) -> None:
    layout = cornell.layout
    counts = np.diff(layout.starts)
    inner = np.bincount(np.repeat(np.arange(len(counts)), counts), peer.truth.find_inner(layout), len(counts))
    assert (inner[counts == 16] == 4).all()


def test_jittered_points_stay_in_their_triangles_and_cells(peer: Any, cornell: Baked) -> None:
    layout = cornell.layout
    moved = peer.truth.jitter(layout, np.random.default_rng(0))
    assert moved.weights.min() >= 0.0 and np.allclose(moved.weights.sum(axis=1), 1.0, atol=1e-5)
    places = [(layout.uv[item.face] * item.weights[..., None]).sum(axis=1) for item in (layout, moved)]
    step = places[1] - places[0]
    assert np.abs(step).max() < 0.1251
    assert np.abs(step).mean() > 0.05 and np.abs(step.mean(axis=0)).max() < 0.003


def test_texels_in_two_triangles_at_once_are_left_out(peer: Any, cornell: Baked) -> None:
    layout, corners = cornell.layout, scene_corners(cornell)
    everywhere = np.ones((layout.height, layout.width), bool)
    plain = peer.truth.choose_texels(layout, corners, everywhere)
    assert 0.5 < plain.share < 1.0
    first = layout.prim[layout.face[layout.starts[plain.texel]]]
    doubled = np.concatenate([corners, corners[first[:1]][:, ::-1]])
    fewer = peer.truth.choose_texels(layout, doubled, everywhere)
    lost = np.setdiff1d(plain.texel, fewer.texel)
    assert len(lost)
    for texel in lost:
        # Texels on the quad's diagonal have points in both of its triangles.
        assert first[0] in layout.prim[layout.face[layout.starts[texel] : layout.starts[texel + 1]]]
    assert len(peer.truth.choose_texels(layout, corners, ~everywhere).texel) == 0


@pytest.mark.parametrize("what", ["spot", "sky"])
def test_what_blender_would_not_get_is_refused(peer: Any, what: str) -> None:
    data = two_lamps()
    if what == "spot":
        data.lights = [Light("spot", (1.0, 1.0, 1.0))]
    else:
        data.sky = Sky((1.0, 1.0, 1.0), image=np.ones((2, 4, 3), np.float32))
    with pytest.raises(LuxelError, match="the peer knows"):
        peer.export.check_scene(data)


def test_a_python_that_is_none_is_named(peer: Any, tmp_path: Path) -> None:
    with pytest.raises(LuxelError, match="name a Python that has bpy"):
        peer.blender.Blender(str(tmp_path / "nowhere"), tmp_path, 1)


def test_tables_say_what_was_run(peer: Any) -> None:
    figures = {"rmse": 0.1234, "patch_rmse": 0.05, "bias": -0.01}
    cycles = {"by": "cycles", "what": "total", **figures}
    line = {
        "scene": "box", "texels": 8000, "compared": 4000, "compared_share": 0.5, "truth_noise": 0.01, "blender": "5",
        "cpu": "x", "cores": 2, "first": [
            {**cycles, "samples": 16, "s": 0.0123, "patch_rmse": 0.0},
            {**cycles, "samples": 64, "s": 0.2},
            {**cycles, "samples": 640, "s": 2.0, "equal_time": True},
            {**cycles, "samples": 640, "s": 2.1, "denoised": True},
        ],
        "second": [{"by": "luxel", "what": "indirect", "how": "1 frame", "s": 1.5, **figures}],
    }  # fmt: skip
    table = peer.table.write_tables([{**line, "texels": 1}, line, {**line, "scene": "hall", "second": []}])
    assert "`box`: 8,000 texels, 4,000 of them compared (50 % of those in the open)" in table
    assert "| Cycles, all light, 16 samples | 12.3 ms: 12.3 % (below noise) | 12.3 ms: 12.3 % (below noise) |" in table
    assert "| Cycles, all light, in luxel's time | 2 s, 640 samples: 12.3 % (5.0 %) |" in table
    assert "| Cycles, all light, in luxel's time, denoised | 2.1 s, 640 samples: 12.3 % (5.0 %) |" in table
    assert "| luxel, indirect light, 1 frame | 1.5 s: 12.3 % (5.0 %) | — |" in table
    assert "64 samples" not in table


# --- Blender -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def blender(peer: Any, cornell: Baked, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    python = os.environ.get("LUXEL_BLENDER_PYTHON")
    if not python:
        pytest.skip("name a Python that has bpy in LUXEL_BLENDER_PYTHON")
    folder = tmp_path_factory.mktemp("blender")
    peer.export.write_scene(cornell, folder)
    with peer.blender.Blender(python, folder, 2) as process:
        yield process


def scene_corners(baked: Baked) -> np.ndarray:
    geometry = baked.scene.geometry
    rows = np.array(geometry.triangles).reshape(-1, 4)[:, :3].astype(np.int64)
    return np.array(geometry.vertices).reshape(-1, 4)[rows, :3].astype(np.float64)


def by_lamp() -> SceneData:
    return load("cornell-box")


def by_sun_and_sky() -> SceneData:
    """The box as a porch: a coloured sun and sky shine in at its front."""
    sun = Light("directional", (3.0, 2.0, 1.0), direction=(0.3, -0.6, -1.0), name="sun")
    return replace(two_lamps(), lights=[sun], sky=Sky((0.3, 0.5, 0.9)))


@pytest.mark.parametrize("make", [by_lamp, two_lamps, by_sun_and_sky])
def test_cycles_agrees_with_the_truth(peer: Any, blender: Any, cornell: Baked, make: Any) -> None:
    """Units, sides and texels match: what a converged bake would differ by is below one per cent, in every channel."""
    layout, data = cornell.layout, make()
    blender.light(peer.export.light_order(data))
    sheet, seconds = blender.bake(256, ["DIRECT", "INDIRECT"])
    assert seconds > 0.0
    texels = peer.truth.choose_texels(layout, scene_corners(cornell), sheet[..., 3] > 0.5)
    _, inner = peer.truth.make_truth(upload(data), layout, 16, 9, lambda text, share: None)
    truth = inner.total.take(texels.texel)
    found = np.pi * texels.pick(layout, sheet)
    np.testing.assert_allclose(found.mean(axis=0), truth.mean.mean(axis=0), rtol=0.01)
    assert peer.errors.relative_rmse(found, truth) < 0.1
    assert 0.6 < texels.share < 1.0


def test_a_refused_order_is_told(blender: Any) -> None:
    with pytest.raises(LuxelError, match="Blender refused 'bake'"):
        blender.bake(1, ["NO SUCH PASS"])
