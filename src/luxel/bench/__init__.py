"""Speed: whole frames, stages, the floor, and the machine that they were measured on."""

from __future__ import annotations

from luxel.bench.machine import machine_name, machine_record
from luxel.bench.run import bench, record

__all__ = ["bench", "machine_name", "machine_record", "record"]
