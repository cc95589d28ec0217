"""Denoisers: which one, with what guides, and that it helps."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from luxel.kernels.camera import camera_axes
from luxel.metrics.error import all_errors
from luxel.render import denoise
from luxel.render.denoise import find_denoiser, trace_guides
from luxel.render.renderer import Renderer
from luxel.render.truth import render_truth
from luxel.scene import load
from luxel.scene.device import upload
from luxel.scene.edit import default_camera
from luxel.scene.model import Camera

SIZE = (48, 32)


@pytest.fixture
def without_weights(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(denoise, "OPTIX_WEIGHTS", tmp_path / "missing.bin")


def test_guides_are_seen_from_the_camera() -> None:
    scene = upload(load("cornell-box"))
    camera = Camera((0.5, 0.6, 3.0), (0.0, -0.6, 0.0))
    guides = trace_guides(scene, camera, SIZE)
    assert guides.albedo.shape == guides.normal.shape == (32, 48, 3)
    assert guides.albedo.dtype == guides.normal.dtype == np.float32
    hit = guides.albedo[..., 0] == 1.0
    assert hit.any() and set(np.unique(guides.albedo)) <= {0.0, 1.0}
    np.testing.assert_allclose(np.linalg.norm(guides.normal[hit], axis=1), 1.0, atol=1e-4)
    assert not guides.normal[~hit].any()
    # What is seen faces the viewer; much of it is floor, whose normal is the world's up.
    up = np.array([axis[1] for axis in camera_axes(camera)[1:]]) * (1.0, 1.0, -1.0)
    assert up[2] > 0.1
    assert np.isclose(guides.normal, up, atol=1e-3).all(axis=-1).mean() > 0.1


@pytest.mark.usefixtures("without_weights")
def test_open_image_denoise_takes_noise_away(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    pytest.importorskip("pyoidn", reason="the extra `denoise` is not installed")
    monkeypatch.setenv("LUXEL_CACHE", str(tmp_path))
    denoiser, reason = find_denoiser("cpu")
    assert denoiser is not None and denoiser.used == "oidn" and "Open Image Denoise" in reason
    scene = upload(load("cornell-box"))
    camera = default_camera(scene.host.data)
    truth = render_truth(scene, camera=camera, size=SIZE, spp=256)
    renderer = Renderer(scene, "path", size=SIZE)
    renderer.run(4)
    noisy = renderer.layers()
    before = noisy.indirect.copy()
    clean, ms = denoiser.apply(noisy.indirect, trace_guides(scene, camera, SIZE))
    assert clean.shape == noisy.indirect.shape and clean.dtype == np.float32 and ms > 0.0
    assert np.isfinite(clean).all() and np.array_equal(noisy.indirect, before)
    bare = all_errors(noisy, truth.layers, truth.halves)
    better = all_errors(replace(noisy, indirect=clean), truth.layers, truth.halves)
    assert better["rmse_tonemapped"] < 0.5 * bare["rmse_tonemapped"]
    assert abs(better["bias"]) < 0.1


@pytest.mark.usefixtures("without_weights")
def test_without_the_extra_there_is_none_and_a_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyoidn", None)
    for device, words in (("cpu", "needs the device cuda"), ("cuda", "missing.bin")):
        denoiser, reason = find_denoiser(device)
        assert denoiser is None
        assert words in reason and "luxel[denoise]" in reason


@pytest.mark.usefixtures("without_weights")
def test_without_the_weights_optix_is_not_touched(monkeypatch: pytest.MonkeyPatch) -> None:
    """It would abort the process."""
    monkeypatch.setattr(mi, "OptixDenoiser", lambda *given, **named: pytest.fail("OptiX was asked"), raising=False)
    monkeypatch.setitem(sys.modules, "pyoidn", SimpleNamespace(denoise=lambda color, **guides: color))
    denoiser, reason = find_denoiser("cuda")
    assert denoiser is not None and denoiser.used == "oidn" and "missing.bin" in reason


@pytest.mark.usefixtures("without_weights")
def test_one_that_does_not_run_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(color: np.ndarray, **guides: Any) -> np.ndarray:
        raise RuntimeError("this processor\nis too old")

    monkeypatch.setitem(sys.modules, "pyoidn", SimpleNamespace(denoise=fail))
    denoiser, reason = find_denoiser("cpu")
    assert denoiser is None and "this processor is too old" in reason


def test_optix_gets_mitsubas_axes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """No GPU here: that the images and guides go in as Mitsuba's interface wants them."""
    made: list[tuple[Any, Any]] = []

    class Fake:
        def __init__(self, size: Any, albedo: bool, normals: bool) -> None:
            assert albedo and normals
            made.append((int(size[0]), int(size[1])))

        def __call__(self, noisy: Any, albedo: Any, normals: Any) -> Any:
            assert noisy.shape == albedo.shape == normals.shape == (2, 3, 3)
            np.testing.assert_allclose(np.array(normals)[0, 0], [-0.5, 0.25, -0.75])
            return noisy * 0.5

    weights = tmp_path / "nvoptix.bin"
    weights.touch()
    monkeypatch.setattr(denoise, "OPTIX_WEIGHTS", weights)
    monkeypatch.setattr(mi, "OptixDenoiser", Fake, raising=False)
    denoiser, reason = find_denoiser("cuda")
    assert denoiser is not None and denoiser.used == "optix" and "OptiX" in reason
    noisy = np.ones((2, 3, 3), np.float32)
    guides = denoise.Guides(np.ones_like(noisy), np.broadcast_to(np.array([0.5, 0.25, 0.75], np.float32), noisy.shape))
    for _ in range(2):
        clean, _ = denoiser.apply(noisy, guides)
        np.testing.assert_allclose(clean, 0.5)
    assert made == [(3, 2)]
