"""A comparison as `luxel compare` leaves it, made up in a moment: results.json, EXR and FLIP maps."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from luxel.report import measure

SEEDS = ("0", "1", "2")
SIZE = (40, 24)
"""Width and height of the pictures."""

Comparison = Callable[..., Path]


@pytest.fixture(scope="module")
def short_rest() -> Iterator[None]:
    """Few frames for flicker and lag, whose own tests are elsewhere: each run of a comparison has some hundred else."""
    with pytest.MonkeyPatch.context() as patch:
        for name, value in (("FLICKER_FRAMES", 6), ("LAG_LIMIT", 24), ("LAG_SETTLED", 6)):
            patch.setattr(measure, name, value)
        yield


def make_method(regional: float, frame_ms: float, **more: Any) -> dict[str, Any]:
    """Return a method's part of results.json; `more` replaces figures and parts."""
    figures: dict[str, Any] = {
        "regional": regional, "bias": -0.01, "relmse": 0.05, "rmse_tonemapped": 0.02, "rmse_gi_tonemapped": 0.01,
        "abs_error_mean": 0.02, "abs_error_max": 1.0, "block_error_max": 0.04, "flip": regional, "flicker": 0.01,
        "flicker_absolute": 0.004, "lag_frames": 12.0, "leak": None, "truth_noise": 0.001, "frame_ms": frame_ms,
        "floor_ms": frame_ms / 4.0,
    }  # fmt: skip
    frames = [1, 2, 4, 8]
    return {
        **figures,
        "stages": {"gbuffer": 1.0, "x/trace": 0.6 * frame_ms, "direct": 2.0, "compose": 0.0},
        "rays_per_frame": {"closest": 1000, "shadow": 2000},
        "cache": {"surfel_count": 4321},
        "series": {
            "frame": frames,
            "ms": [frame_ms * frame for frame in frames],
            "regional": [regional * (8 / frame) ** 0.5 for frame in frames],
        },
        "seeds": dict.fromkeys(SEEDS, figures),
        "spread": {name: 0.0 for name in figures},
        **more,
    }


def make_peer(of: str, regional: float, denoised: str | None = None) -> dict[str, Any]:
    """Return the path tracer at equal time with the method `of`."""
    file = f"path_at_{of}" + ("_denoised" if denoised else "")
    return {
        "label": "path", "of": of, "denoised": denoised, "file": file, "ms": 400.0, "of_ms": 400.0, "samples": 16,
        "regional": regional, "flip": regional, "bias": 0.0, "spread": {}, "seeds": {},
    }  # fmt: skip


def make_scene(methods: dict[str, Any], peers: list[dict[str, Any]] | None = None, **more: Any) -> dict[str, Any]:
    """Return a scene's part of results.json; `none` and `ambient` are added."""
    return {
        "reference": {
            "kind": "diffuse", "spp": 512, "seconds": 3.0, "size": list(SIZE), "frames": 8, "flight": False,
            "exposure": 0.5,
        },
        "methods": {"none": make_method(1.2, 1.0), "ambient": make_method(0.5, 1.0), **methods},
        "peers": peers or [],
        **more,
    }  # fmt: skip


def make_results() -> dict[str, Any]:
    """Return two scenes, two methods, peers: one win, one loss, a leak."""
    first = make_scene(
        {
            "gibs": make_method(0.02, 50.0, params={"rays_per_surfel": 4}),
            "ddgi": make_method(0.06, 40.0, leak=None),
        },
        [make_peer("gibs", 0.03), make_peer("gibs", 0.01, "oidn"), make_peer("ddgi", 0.09)],
        path_series={"ms": [25, 50, 100], "regional": [0.25, 0.18, 0.125], "samples": [1, 2, 4]},
    )
    second = make_scene({"gibs": make_method(0.01, 30.0, leak=0.02), "ddgi": make_method(0.04, 60.0, leak=0.0)})
    return {
        "luxel": "0.1.0",
        "date": "2026-01-02T03:04:05+00:00",
        "command": "luxel compare box two-rooms:wall=0.05 -o out/report/",
        "machine": {"device": "cpu", "cpu": "A processor", "cores": 2, "versions": {"numpy": "2.0"}, "commit": "abc"},
        "denoiser": {"used": "oidn", "reason": "there is no GPU"},
        "scenes": {"box": first, "two-rooms:wall=0.05": {**second, "folder": "two-rooms-wall=0.05"}},
    }


def paint_light(stem: str, size: tuple[int, int]) -> np.ndarray:
    """Return a linear picture, (H, W, 3) float32, from black to four times white, tinted by its name."""
    width, height = size
    ramp = np.linspace(0.0, 2.0, width, dtype=np.float32) ** 2
    tint = np.array([1.0, 0.5 + 0.1 * (len(stem) % 5), 0.25], np.float32)
    return np.broadcast_to(ramp[None, :, None] * tint, (height, width, 3)).copy()


def write_light(path: Path, light: np.ndarray) -> None:
    """Write a linear picture as EXR."""
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"RGB": light}).write(str(path))


@pytest.fixture
def usual_results() -> dict[str, Any]:
    """Two scenes, two methods and their peers."""
    return make_results()


@pytest.fixture
def full_results() -> dict[str, Any]:
    """Four scenes, four methods, three seeds, a bare and a denoised peer of each method but the path tracer."""
    methods = ("gibs", "gibs-ekberg", "ddgi", "path")
    peers = [make_peer(of, 0.05, denoiser) for of in methods[:3] for denoiser in (None, "oidn")]
    scene = make_scene({name: make_method(0.02, 50.0) for name in methods}, peers)
    return make_results() | {"scenes": {f"scene-{number}": scene for number in range(4)}}


@pytest.fixture
def comparison(tmp_path: Path) -> Comparison:
    """A function that writes a comparison's folder, of the given results or of the usual ones, and returns it."""

    def write(results: dict[str, Any] | None = None, size: tuple[int, int] = SIZE, noise: float = 0.0) -> Path:
        """`noise` is the standard deviation of the logarithm of the path tracer's light."""
        random = np.random.default_rng(5)
        results = make_results() if results is None else results
        folder = tmp_path / "comparison"
        for name, scene in results["scenes"].items():
            place = folder / scene.get("folder", name)
            place.mkdir(parents=True)
            stems = [
                "truth",
                *scene["methods"],
                *(peer["file"] for peer in scene["peers"] if peer.get("run") != "motion"),
            ]
            for stem in stems:
                for layer in ("", "_indirect"):
                    light = paint_light(stem, size)
                    if noise and stem.startswith("path"):
                        light *= random.lognormal(0.0, noise, light.shape).astype(np.float32)
                    write_light(place / f"{stem}{layer}.exr", light)
                if stem != "truth":
                    Image.new("RGB", size, (80, 20, 120)).save(place / f"{stem}_flip.png")
        (folder / "results.json").write_text(json.dumps(results))
        return folder

    return write
