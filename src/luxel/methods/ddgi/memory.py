"""What the probes will take, said before it is taken (Roháček 2022, section 4.1)."""

from __future__ import annotations

import math
from dataclasses import replace

from luxel import runtime
from luxel.errors import LuxelError
from luxel.methods.ddgi.boxes import ProbeBox
from luxel.methods.ddgi.params import DdgiParams

BYTES = {"float16": 2, "float32": 4}
ESTIMATE_FLOATS = 12
"""Words a texel that the adaptive mean keeps beside the atlas."""
RAY_FLOATS = 16
SKY_RAY_FLOATS = 8
PROBE_FLOATS = 32
SHARE = 0.6
"""Share of the free memory that the probes may take."""


def atlas_bytes(params: DdgiParams) -> int:
    """Return the bytes of both atlases a probe, with gutter: the thesis's formula 4.1; planes take twice the depth."""
    depth = (params.depth_resolution + 2) ** 2 * BYTES[params.depth_format] * depth_channels(params)
    light = (params.irradiance_resolution + 2) ** 2 * BYTES[params.irradiance_format] * 4
    return depth + light


def depth_channels(params: DdgiParams) -> int:
    """Return values a depth texel of the atlas: mean and deviation, or a plane and its deviation."""
    return 4 if params.depth_model == "planes" else 2


def depth_floats(params: DdgiParams) -> int:
    """Return words a depth texel that its running sums take."""
    return 11 if params.depth_model == "planes" else 3


def probe_bytes(params: DdgiParams) -> int:
    """Return all bytes a probe: atlases, running means, rays and bookkeeping."""
    means = 4 * (ESTIMATE_FLOATS * params.irradiance_resolution**2 + depth_floats(params) * params.depth_resolution**2)
    rays = RAY_FLOATS * params.num_samples_per_probe + SKY_RAY_FLOATS * params.sky_rays
    return atlas_bytes(params) + means + 4 * (rays + PROBE_FLOATS)


def count_probes(params: DdgiParams, boxes: list[ProbeBox]) -> int:
    """Return the probes of all boxes and those held back."""
    return sum(box.probe_count for box in boxes) + extra_count(params)


def extra_count(params: DdgiParams) -> int:
    """Return the probes held back: none where the boxes move, since the next cascade answers there."""
    return 0 if params.follow_camera else params.extra_probes


def describe_memory(params: DdgiParams, boxes: list[ProbeBox]) -> str:
    """Return one sentence: the atlases' bytes a probe and the total."""
    count = count_probes(params, boxes)
    total = count * probe_bytes(params)
    grids = " + ".join("x".join(str(n) for n in box.counts) for box in boxes)
    return (
        f"ddgi: {grids} probes and {extra_count(params)} held back, atlases of {atlas_bytes(params):,} bytes a probe "
        f"({count * atlas_bytes(params) / 2**20:.1f} MiB), {total / 2**20:.1f} MiB in all"
    )


def check_memory(params: DdgiParams, boxes: list[ProbeBox], free_bytes: int | None = None) -> None:
    """Raise LuxelError where the probes would not fit; the message names the largest grid that does."""
    free = runtime.free_bytes() if free_bytes is None else free_bytes
    limit = min(SHARE * free, 2**32 * 3)  # beyond that, indices of texels leave 32 bits
    total = count_probes(params, boxes) * probe_bytes(params)
    if total <= limit:
        return
    finest = boxes[0]
    room = limit / probe_bytes(params) - extra_count(params)
    counts, low, high = [2, 2, 2], 0.0, 1.0
    for _ in range(40):
        scale = 0.5 * (low + high)
        smaller = [max(int(scale * n), 2) for n in finest.counts]
        fits = math.prod(smaller) * len(boxes) <= room
        counts, low, high = (smaller, scale, high) if fits else (counts, low, scale)
    largest = replace(finest, counts=(counts[0], counts[1], counts[2]))
    raise LuxelError(
        f"{describe_memory(params, boxes)}: {free / 2**20:,.0f} MiB are free, of which it may take {SHARE:.0%}; "
        f"the largest grid of this shape that fits is {'x'.join(str(n) for n in largest.counts)}"
    )
