"""From linear light to a picture: the exposure of figures, the sRGB curve, a file."""

from __future__ import annotations

from numbers import Real
from pathlib import Path

import numpy as np

from luxel.errors import LuxelError
from luxel.image.write import write_exr, write_png
from luxel.scene.colours import luminance

MIDDLE_GREY = 0.18
"""Luminance that an exposure brings to the middle of the picture."""


def mean_exposure(image: np.ndarray) -> float:
    """Return the factor that brings the mean luminance of a linear (H, W, 3) image to 0.18.

    The display exposure of every figure (FLIP, flicker, the papers' tables), which must not move with the rule that
    suits the eye: pictures have `exposure.auto_exposure`. Pixels that are not finite are left out; a black
    image gives 1.
    """
    values = luminance(image)
    values = values[np.isfinite(values)]
    mean = float(values.mean()) if values.size else 0.0
    return MIDDLE_GREY / mean if mean > 0.0 else 1.0


def to_display(image: np.ndarray, exposure: float = 1.0) -> np.ndarray:
    """Return a linear (H, W, 3) image times `exposure`, clipped and sRGB-encoded: float32 in 0..1, NaN as black."""
    light = np.clip(np.nan_to_num(image.astype(np.float64) * exposure, nan=0.0), 0.0, 1.0)
    encoded = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1.0 / 2.4) - 0.055)
    return encoded.astype(np.float32)


def write_image(path: str | Path, linear: np.ndarray, exposure: float = 1.0) -> None:
    """Write a linear (H, W, 3) image as `.png` (exposed and sRGB-encoded) or `.exr` (linear, unexposed).

    The file appears whole or not at all. Raises LuxelError for another suffix, for what is no image or no factor,
    or where it cannot be written.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if not isinstance(exposure, Real) or not np.isfinite(float(exposure)):
        raise LuxelError(f"cannot write {path}: exposure is a number, the factor, not {exposure!r}")
    try:
        linear = np.asarray(linear, np.float64)
    except (TypeError, ValueError):
        raise LuxelError(f"cannot write {path}: an image is an array of numbers (H, W, 3)") from None
    if linear.ndim != 3 or linear.shape[2] != 3 or not linear.size:
        shape = "x".join(map(str, linear.shape))
        raise LuxelError(f"cannot write {path}: an image is an array (H, W, 3), not one of shape {shape or '()'}")
    if suffix == ".png":
        write_png(path, to_display(linear, exposure))
    elif suffix == ".exr":
        write_exr(path, linear)
    else:
        raise LuxelError(f"cannot write {path}: images are written as .png or .exr")
