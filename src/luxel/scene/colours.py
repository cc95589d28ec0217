"""Luminance of linear Rec. 709 colours on the host; `kernels/direct.py` has that of colours on the device."""

from __future__ import annotations

import numpy as np

LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Rec. 709 weights of red, green and blue."""


def luminance(colors: np.ndarray) -> np.ndarray:
    """Return the luminance of linear Rec. 709 colours, (...) float64 from (..., 3)."""
    return np.asarray(colors, np.float64) @ np.array(LUMINANCE)
