"""Lanes that go on, brought to the front of arrays whose width stays: behind them whole warps have nothing to do."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from typing import TypeVar

import drjit as dr
import mitsuba as mi

from luxel.kernels.side_by_side import take_lanes

T = TypeVar("T")


def pack_lanes(alive: mi.Bool) -> tuple[mi.UInt32, mi.Bool]:
    """Return which lanes come where, those that are `alive` first and in their order, and where there is one."""
    width = dr.width(alive)
    lane = dr.arange(mi.UInt32, width)
    counted = dr.select(alive, mi.UInt32(1), mi.UInt32(0))
    order = dr.zeros(mi.UInt32, width)
    dr.scatter(order, lane, dr.prefix_sum(counted), alive)
    return order, lane < dr.sum(counted)


def take_record(record: T, lanes: mi.UInt32) -> T:
    """Return the rows `lanes` of a record, which may hold others (`take_lanes`)."""
    if not is_dataclass(record):
        return take_lanes(record, lanes)
    return type(record)(**{item.name: take_record(getattr(record, item.name), lanes) for item in fields(record)})
