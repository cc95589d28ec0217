"""Seams: both borders of a cut show the same light."""

from __future__ import annotations

import numpy as np

from luxel.bake.core import Baked, bake_scene
from luxel.bake.seams import find_seams, look_up, measure_seams

from .conftest import SMALL, cut_floor

SEAM_LIMIT = 0.02


def test_a_cut_floor_shows_no_seam() -> None:
    baked = bake_scene(cut_floor(), "lightmap", dict(SMALL), frames=8, samples=2)
    assert baked.seam_count > 20
    assert baked.seam <= SEAM_LIMIT
    assert baked.seam < baked.seam_before


def test_the_cornell_box_has_only_creases(cornell: Baked) -> None:
    assert cornell.seam_count == 0 and cornell.seam == 0.0


def test_a_step_across_a_cut_is_seen() -> None:
    baked = bake_scene(cut_floor(), "lightmap", dict(SMALL), frames=1, samples=1)
    layout = baked.layout
    seams = find_seams(layout, baked.corners)
    side = (look_up(layout, seams.a).T @ np.ones(len(seams.a))) > 0.0
    values = np.where(side, 1.2, 1.0)[:, None].repeat(3, axis=1)
    assert measure_seams(layout, seams, values) > 0.1
    assert measure_seams(layout, seams, np.ones_like(values)) < 1e-6
