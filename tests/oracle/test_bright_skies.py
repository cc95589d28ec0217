"""Sky images with bright places, wider than a sun, over a block and through a roof's gap, beside `mi.render`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from luxel.scene.model import SceneData
from luxel.scene.sky_table import build_sky_table

Judge = Callable[..., SceneData]

ROOF = """
  <shape type="rectangle"><transform name="to_world"><rotate x="1" angle="90"/><scale x="1" z="1.4" y="1"/>
    <translate x="-1.4" y="1.9" z="0.4"/></transform><ref id="white"/></shape>"""
"""A roof over the block, half as wide as the floor: what is under it sees the sky from aside only."""


def sky_with(size: float, peak: float, glow: float) -> np.ndarray:
    """A dim sky with a disc of `size` degrees and radiance `peak`, and a band of radiance `glow` along the horizon."""
    rows = 64
    theta, phi = np.meshgrid((np.arange(rows) + 0.5) / rows, (np.arange(2 * rows) + 0.5) / rows - 1.0, indexing="ij")
    theta, phi = np.pi * theta, np.pi * phi
    d = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi)], axis=-1)
    towards = np.array((0.5, 0.7, 0.5)) / np.linalg.norm((0.5, 0.7, 0.5))
    image = np.full((rows, 2 * rows, 3), (0.1, 0.15, 0.25)) + glow * np.exp(-((d[..., 1:2] / 0.12) ** 2))
    image[d @ towards > np.cos(np.radians(0.5 * size))] = np.array((1.0, 0.8, 0.5)) * peak
    return image.astype(np.float32)


@pytest.mark.parametrize("roof", ["", ROOF], ids=["open", "roof"])
@pytest.mark.parametrize(
    ("size", "peak", "glow"), [(10.0, 30.0, 0.0), (25.0, 6.0, 0.0), (0.0, 0.0, 2.0)], ids=["10", "25", "glow"]
)
def test_bright_places(stage: Any, judge: Judge, size: float, peak: float, glow: float, roof: str) -> None:
    image = sky_with(size, peak, glow)
    assert build_sky_table(image).is_sampled
    mi.Bitmap(image).write(str(stage.folder / "sky.exr"))
    judge(
        stage.write(f'{roof}<emitter type="envmap"><string name="filename" value="sky.exr"/></emitter>'),
        spp=48,
    )
