"""Pictures are written as what is shown, or as linear light."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from luxel.image.tonemap import to_display, write_image

IMAGE = np.random.default_rng(7).random((5, 7, 3)).astype(np.float32) * 2.0


def read_png(path: Path) -> np.ndarray:
    """Return (H, W, 3) int64."""
    with Image.open(path) as picture:
        return np.asarray(picture).astype(int)


def test_png_is_the_displayed_image(tmp_path: Path) -> None:
    path = tmp_path / "new" / "folder" / "image.png"
    write_image(path, IMAGE, 0.5)
    read = read_png(path)
    assert read.shape == (5, 7, 3)
    np.testing.assert_allclose(read / 255.0, to_display(IMAGE, 0.5), atol=0.5 / 255 + 1e-6)


def test_exr_keeps_linear_floats(tmp_path: Path) -> None:
    import mitsuba as mi

    path = tmp_path / "image.exr"
    write_image(path, IMAGE, 0.5)
    np.testing.assert_array_equal(np.array(mi.Bitmap(str(path))), IMAGE)
