"""Depth maps of surfels: how a texel keeps mean and deviation of depth, and what they say of a farther point.

All depths here are in units of a map's reach.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

LEAST_DEVIATION = 0.01
"""Of a depth."""
WORTHLESS = 0.05
"""What Chebyshev's bound, cubed, may be and still count as nothing: the mean over surfels would make all of it."""
BLEND, SURPRISED_BLEND = 0.125, 0.5
"""Of a texel's new sample, and of one that is far from what the texel has seen: something moves, or it is young."""
SURPRISE = 4.0
"""Deviations from which a sample is far."""
BITS = 8
"""Of a mean, and of a deviation. 16 let through as little and take twice the memory."""
TEXELS_A_WORD = 2
TOP = (1 << BITS) - 1


@dataclass
class DepthMaps:
    """The maps of all surfels, in a frame of each surfel's own that turns with its object."""

    words: mi.UInt32
    """(capacity, words a map): texels as mean and deviation in units of `reach`, one after the other."""
    rows: mi.Float
    """(capacity, 4): nearest depth in metres, reach in metres (0: no map yet), packed tangent, words refreshed."""
    cursor: mi.UInt32
    """Surfels whose turn has come, since the start."""


@dataclass
class DepthFormat:
    """How a map lies in memory: by rows, two texels of a row in a word."""

    side: int
    """Texels."""

    @property
    def texels(self) -> int:
        """Texels of one surfel."""
        return self.side * self.side

    @property
    def blocks(self) -> int:
        """Blocks of 2 x 2 texels of one surfel."""
        return self.texels // 4

    @property
    def words_a_row(self) -> int:
        """Words of one row of texels: each is as wide as a block."""
        return self.side // TEXELS_A_WORD

    @property
    def words_a_map(self) -> int:
        """Words of one surfel."""
        return self.texels // TEXELS_A_WORD


def new_depth_maps(capacity: int, layout: DepthFormat) -> DepthMaps:
    """Return maps of surfels that have none."""
    return DepthMaps(
        dr.zeros(mi.UInt32, capacity * layout.words_a_map),
        dr.zeros(mi.Float, 4 * capacity),
        dr.opaque(mi.UInt32, 0),
    )


def blend_depth(mean: mi.Float, deviation: mi.Float, found: mi.Float, count: mi.Float) -> tuple[mi.Float, mi.Float]:
    """Return a texel's mean and deviation after the depth `found`, all in units of the map's reach.

    `count`: samples that it has had so far, 1 or more.
    """
    away = found - mean
    far = dr.abs(away) > SURPRISE * dr.fmax(deviation, LEAST_DEVIATION)
    blend = dr.fmax(dr.select(far, mi.Float(SURPRISED_BLEND), BLEND), 1.0 / (count + 1.0))
    variance = (1.0 - blend) * (dr.square(deviation) + blend * dr.square(away))
    return mean + blend * away, dr.sqrt(variance)


def pack_texel(mean: mi.Float, deviation: mi.Float, part: int, dither: mi.Point2f) -> mi.UInt32:
    """Return mean and deviation, 0..1 and 0..0.5, as bits of a word at the place of its texel `part`.

    `dither`, in [0, 1)^2, rounds up or down by chance, so that means move by less than a step on average too.
    """
    low = mi.UInt32(dr.clip(mean * TOP + dither.x, 0.0, TOP))
    high = mi.UInt32(dr.clip(deviation * (2.0 * TOP) + dither.y, 0.0, TOP))
    return (low | (high << BITS)) << (2 * BITS * part)


def unpack_texel(word: mi.UInt32, part: mi.UInt32 | int) -> tuple[mi.Float, mi.Float]:
    """Return mean and deviation of a word's texel `part`."""
    bits = word >> (mi.UInt32(part) * (2 * BITS))
    return mi.Float(bits & TOP) * (1.0 / TOP), mi.Float((bits >> BITS) & TOP) * (0.5 / TOP)


def chebyshev(distance: mi.Float, mean: mi.Float, deviation: mi.Float) -> mi.Float:
    """Return Chebyshev's bound on the share that lies beyond `distance`, cubed, without its tail; 1 nearer than `mean`.

    All in units of the map's reach.
    """
    variance = dr.square(dr.fmax(deviation, LEAST_DEVIATION))
    bound = variance / (variance + dr.square(dr.fmax(distance - mean, 0.0)))
    return dr.fmax((bound * bound * bound - WORTHLESS) / (1.0 - WORTHLESS), 0.0)
