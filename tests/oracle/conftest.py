"""The oracle: luxel's truth of a Mitsuba file beside `mi.render` of the same file.

`stage` writes a file around what a test is about; `judge` renders it twice and compares. Luxel's rays go through pixel
centres, so its image is made `FINER` times as large and averaged, as the box filter of the reference does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from luxel.render.truth import render_truth
from luxel.scene import load
from luxel.scene.edit import default_camera
from luxel.scene.host import Looks
from luxel.scene.model import SceneData

WIDTH, HEIGHT, BLOCK = 64, 48, 16
FINER = 4
MEAN_LIMIT, BLOCK_LIMIT = 0.01, 0.02
BRIGHT = 8.0
"""Pixels are clamped at so many times the mean of the reference, in both images: edges of lamps decide nothing."""

INTEGRATOR = '<integrator type="path"><integer name="max_depth" value="24"/></integrator>'
CAMERA = """<sensor type="perspective"><float name="fov" value="45"/>
  <transform name="to_world"><lookat origin="1.1, 2.6, 5.2" target="0.1, 0.6, 0" up="0.05, 1, 0"/></transform>
  <film type="hdrfilm"><integer name="width" value="64"/><integer name="height" value="48"/>
  <rfilter type="box"/></film></sensor>"""
ROOM = """
  <bsdf type="twosided" id="white"><bsdf type="diffuse"><rgb name="reflectance" value="0.6, 0.6, 0.6"/></bsdf></bsdf>
  <bsdf type="twosided" id="blue"><bsdf type="diffuse"><rgb name="reflectance" value="0.2, 0.3, 0.7"/></bsdf></bsdf>
  <shape type="rectangle"><transform name="to_world"><rotate x="1" angle="-90"/><scale value="4"/></transform>
    <ref id="white"/></shape>
  <shape type="rectangle"><transform name="to_world"><scale value="4"/><translate z="-2.5"/></transform>
    <ref id="blue"/></shape>
  <shape type="cube"><transform name="to_world"><scale x="0.3" y="0.5" z="0.3"/><rotate y="1" angle="25"/>
    <translate x="-1.3" y="0.5" z="0.4"/></transform><ref id="white"/></shape>"""
"""A floor, a wall at the back and a block on the left: nothing looks the same after a turn or in a mirror."""


@dataclass
class Stage:
    """A file on its way: `body` stands in a lit or unlit room, before `camera`."""

    folder: Path

    def write(
        self,
        body: str,
        *,
        camera: str = CAMERA,
        room: str = ROOM,
        integrator: str = INTEGRATOR,
        name: str = "scene.xml",
    ) -> Path:
        path = self.folder / name
        path.write_text(f'<scene version="3.0.0">{integrator}{camera}{room}{body}</scene>')
        return path


@pytest.fixture
def stage(tmp_path: Path) -> Stage:
    return Stage(tmp_path)


@pytest.fixture
def judge() -> Callable[..., SceneData]:
    """`judge(path, spp=32)` fails where the images of luxel and Mitsuba differ; returns what luxel loaded.

    `judge(path, spp, data)` renders `data` in its place: what luxel makes of other words for the same scene.
    `materials="full"` renders all that surfaces do.
    """
    return compare_with_mitsuba


def compare_with_mitsuba(
    path: Path, spp: int = 32, data: SceneData | None = None, materials: Looks = "diffuse"
) -> SceneData:
    """Render `path` by both; `spp` paths a pixel for luxel's finer image, `spp * FINER` for the reference's."""
    data = load(path) if data is None else data
    ours = render_luxel(data, spp, materials)
    theirs = render_mitsuba(path, spp * FINER)
    cap = BRIGHT * float(np.mean(theirs))
    ours, theirs = (np.minimum(halves, cap) for halves in (ours, theirs))
    mean = float(theirs.mean())
    assert mean > 0.0, "the reference is black, so it can judge nothing"
    off = float(ours.mean()) / mean - 1.0
    noise = sum(_block_rmse(half[0], half[1]) / 2.0 for half in (ours, theirs)) / mean
    error = _block_rmse(ours.mean(axis=0), theirs.mean(axis=0)) / mean
    said = f"mean {off:+.4f} (limit {MEAN_LIMIT}), blocks {error:.4f} (limit {BLOCK_LIMIT} + noise {noise:.4f})"
    assert noise < BLOCK_LIMIT / 2.0, f"too noisy to judge: {said}"
    assert abs(off) <= MEAN_LIMIT and error <= BLOCK_LIMIT + noise, f"luxel is not as mi.render: {said}"
    return data


def render_luxel(data: SceneData, spp: int, materials: Looks = "diffuse") -> np.ndarray:
    """Return two independent halves (2, H, W, 3) of luxel's truth by the file's own camera."""
    camera = data.cameras[0] if data.cameras else default_camera(data)
    size = (WIDTH * FINER, HEIGHT * FINER)
    truth = render_truth(data, camera=camera, size=size, spp=spp, cache=False, materials=materials)
    images = truth.image_halves
    if images is None:
        layers, images = truth.layers, []
        for direct, indirect in zip(truth.direct_halves, truth.halves, strict=True):
            layers.direct, layers.indirect = direct, indirect
            images.append(layers.image())
    return np.stack([image.reshape(HEIGHT, FINER, WIDTH, FINER, 3).mean(axis=(1, 3)) for image in images])


def render_mitsuba(path: Path, spp: int) -> np.ndarray:
    scene: Any = mi.load_file(str(path))
    return np.stack([np.array(mi.render(scene, spp=spp, seed=seed), float)[..., :3] for seed in (1, 2)])


def _block_rmse(a: np.ndarray, b: np.ndarray) -> float:
    blocks = (a - b).reshape(HEIGHT // BLOCK, BLOCK, WIDTH // BLOCK, BLOCK, 3).mean(axis=(1, 3))
    return float(np.sqrt((blocks**2).mean()))
