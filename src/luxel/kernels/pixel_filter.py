"""Where in a pixel the rays of a still view go, so that their plain mean is the picture through a pixel filter.

The points are Sobol's first two dimensions, a (0, 2)-sequence (Kollig and Keller 2002): of the first 4, 16, 64 … each
stands in a strip and in a box of its own. The first is the pixel's centre. They are spread as the filter weighs (filter
importance sampling, Ernst et al. 2006), so that every frame counts the same.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from luxel.kernels.sampling import to_unit

DEVIATION = 0.5
"""Of the Gaussian, pixels: that of Mitsuba's filter."""
REACH = 0.99993
"""Share of the Gaussian that is used, along each axis: up to four deviations."""
HALF = 0x80000000
"""One half, as bits of a fraction: moves the first point from the corner to the centre, and keeps the strips."""
PASCAL = ((0xAAAAAAAA, 1), (0xCCCCCCCC, 2), (0xF0F0F0F0, 4), (0xFF00FF00, 8), (0xFFFF0000, 16))
"""(bits, how far they go): Pascal's triangle modulo 2, the matrix of Sobol's second dimension, as five steps."""


def filter_offset(name: str, index: mi.UInt32) -> mi.Vector2f:
    """Return how far from the pixels' centres, in pixels, the rays of a view's still frame number `index` go.

    `name` is `box` (a pixel) or `gaussian` (Mitsuba's: a standard deviation of half a pixel, cut at two pixels).
    """
    second = mi.UInt32(index)
    for bits, places in PASCAL:
        second = second ^ ((second & bits) >> places)
    x, y = (to_unit(dr.brev(word) ^ HALF) for word in (mi.UInt32(index), second))
    if name == "gaussian":
        return mi.Vector2f(_gaussian(x), _gaussian(y))
    return mi.Vector2f(x - 0.5, y - 0.5)


def _gaussian(unit: mi.Float) -> mi.Float:
    """Return the place below which a share `unit` of a Gaussian lies."""
    return DEVIATION * 2.0**0.5 * dr.erfinv(dr.clip(2.0 * unit - 1.0, -REACH, REACH))
