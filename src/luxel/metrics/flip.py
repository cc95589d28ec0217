"""FLIP: how much two displayed images differ to a viewer who flips between them.

Andersson et al., "FLIP: A Difference Evaluator for Alternating Images", 2020, by the authors' own evaluator at its
default of 67 pixels per degree.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from luxel.errors import LuxelError


def flip(test: np.ndarray, truth: np.ndarray) -> float:
    """Return the mean FLIP error, 0..1, of two displayed images, (H, W, 3) in 0..1.

    Raises LuxelError where the shapes differ or the evaluator is missing.
    """
    return float(_evaluate(test, truth, magma=False).mean(dtype=np.float64))


def flip_map(test: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Return the FLIP error of each pixel in the magma colour map, (H, W, 3) in 0..1; errors as for `flip`."""
    return np.clip(_evaluate(test, truth, magma=True), 0.0, 1.0)


def flip_values(test: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Return the FLIP error of each pixel, (H, W) in 0..1; errors as for `flip`."""
    values = _evaluate(test, truth, magma=False)
    return values.reshape(values.shape[:2])


def _evaluate(test: np.ndarray, truth: np.ndarray, magma: bool) -> np.ndarray:
    if test.shape != truth.shape:
        raise LuxelError(f"FLIP needs two images of one shape, not {test.shape} and {truth.shape}")
    # The evaluator takes displayed images in 0..1, sRGB-encoded, as contiguous float32.
    first, second = (np.ascontiguousarray(np.clip(image, 0.0, 1.0), np.float32) for image in (truth, test))
    image, _, _ = _evaluator().evaluate(first, second, "LDR", applyMagma=magma, computeMeanError=False)
    return np.asarray(image, np.float32)


def _evaluator() -> Any:
    try:
        import flip_evaluator
    except ImportError as error:
        raise LuxelError("FLIP needs the package flip-evaluator: run `pip install flip-evaluator`") from error
    return flip_evaluator
