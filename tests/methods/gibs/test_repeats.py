"""Two runs of one seed are equal to the last bit, however many threads sort, cast and add up."""

from __future__ import annotations

import drjit as dr
import numpy as np
import pytest

from luxel.render.renderer import Renderer
from luxel.scene import load

SIZE = (160, 160)
"""Enough for more surfels than one thread takes at a time: smaller pools are always alike."""


def picture(threads: int, **params: float) -> np.ndarray:
    """Return the image (H, W, 3) after 16 frames with so many threads."""
    before = dr.thread_count()
    dr.set_thread_count(threads)
    try:
        renderer = Renderer(load("cornell-box"), "gibs", params, size=SIZE, seed=5)
        renderer.run(16)
        return renderer.image()
    finally:
        dr.set_thread_count(before)


@pytest.mark.parametrize("params", [{}, {"cell_surfels": 6}])
def test_threads_change_no_bit(params: dict[str, float]) -> None:
    """Lists filled as threads come differ in order, and with `cell_surfels` in content."""
    one, two, again = picture(1, **params), picture(2, **params), picture(2, **params)
    np.testing.assert_array_equal(two, again)
    np.testing.assert_array_equal(one, two)
