"""Sums of several arrays at once: on a GPU each sum of its own is two launches, which cost more than the adding."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

BLOCK = 1024
"""Items that one launch adds up; the few sums that are left are added by whoever asks for them."""


def sum_columns(columns: list[mi.Float]) -> list[mi.Float]:
    """Return the sum of each of several arrays of one width: one launch to lay them side by side, one to add.

    The order of adding is fixed, so that the same values give the same bits.
    """
    width = dr.width(columns)
    blocks = -(-width // BLOCK)
    parts = dr.block_sum(_lay_out(columns, blocks), BLOCK)
    return [_add_up(parts, number * blocks, blocks) for number in range(len(columns))]


@dr.syntax
def _lay_out(columns: list[mi.Float], blocks: int) -> mi.Float:
    """Return the columns one after the other, each padded with zeros to whole blocks."""
    count = len(columns)
    laid = dr.zeros(mi.Float, count * blocks * BLOCK)
    lane = dr.arange(mi.UInt32, dr.width(columns))
    number = mi.UInt32(0)
    # A loop, since two scatters into one array would be two kernels.
    while number < count:
        value = mi.Float(0.0)
        for index in range(count):
            value = dr.select(number == index, columns[index], value)
        dr.scatter(laid, value, number * (blocks * BLOCK) + lane)
        number += 1
    return laid


@dr.syntax
def _add_up(parts: mi.Float, first: int, count: int) -> mi.Float:
    total, index = mi.Float(0.0), mi.UInt32(0)
    while index < count:
        total += dr.gather(mi.Float, parts, first + index)
        index += 1
    return total
