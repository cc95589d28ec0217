"""`--preset ekberg` stays chapter 4 of the document: its image does not change when the defaults do."""

from __future__ import annotations

import os
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

from luxel.methods import METHODS
from luxel.methods.gibs.params import EKBERG
from luxel.render.renderer import Renderer
from luxel.scene import load

PINNED = Path(__file__).parent / "images" / "ekberg-cornell-box.exr"
"""Indirect irradiance, W/m^2, float16, as the preset gave it on 2026-11-27 (two CPU cores, LLVM)."""
FRAMES = 192
SUM_ORDER = 1e-3
"""Share of a pixel by which the order of sums may move it. One and two threads agreed to the bit when it was made."""
HALF = 2.0**-10
"""What float16 rounds off, as a share."""
DIALS_OF_THE_DOCUMENT = {
    "rays_per_surfel", "surfel_target", "radius", "capacity", "cell_size", "items_per_surfel", "tile_size",
    "spawn_threshold", "spawn_chance", "plane_scale", "short_blend", "longest_window",
}  # fmt: skip
"""Dials of what chapter 4 has too, and one that a cold estimator never reads. All others have a line in the preset."""


def render_preset() -> np.ndarray:
    """Return the indirect irradiance (64, 64, 3) of seed 0, large surfels so that 16 tiles cover the view."""
    renderer = Renderer(load("cornell-box"), "gibs", {"surfel_target": 1000}, preset="ekberg", size=(64, 64), seed=0)
    renderer.run(FRAMES)
    return renderer.layers().indirect


@pytest.mark.skipif(
    "cuda" in os.environ.get("LUXEL_TEST_DEVICE", "cpu"),
    reason="the pinned image is a CPU's: a GPU rounds otherwise, and one surfel born elsewhere moves all that follow",
)
def test_the_preset_gives_the_pinned_image() -> None:
    wanted = np.array(mi.Bitmap(str(PINNED))).astype(np.float64)[..., :3]
    found = render_preset()
    assert (wanted > 0.0).mean() > 0.5, "surfels answer at most of the pixels"
    np.testing.assert_allclose(found, wanted, rtol=SUM_ORDER + HALF, atol=1e-6)


def test_every_dial_of_ours_is_off_in_the_preset() -> None:
    """A new dial must have a line in the preset, or be named above as one of the document's own."""
    ours = set(vars(METHODS["gibs"].Params())) - DIALS_OF_THE_DOCUMENT
    assert ours == set(EKBERG) - {"tile_size", "spawn_chance"}


@pytest.mark.parametrize("change", [{"normal_power": 4}, {"hit_spawn_threshold": 0.3}, {"fade_in": 8}])
def test_the_pin_notices_a_dial_that_is_not_off(change: dict[str, float]) -> None:
    wanted = np.array(mi.Bitmap(str(PINNED))).astype(np.float64)[..., :3]
    settings = {"surfel_target": 1000, **change}
    renderer = Renderer(load("cornell-box"), "gibs", settings, preset="ekberg", size=(64, 64), seed=0)
    renderer.run(FRAMES)
    assert not np.allclose(renderer.layers().indirect, wanted, rtol=SUM_ORDER + HALF, atol=1e-6)
