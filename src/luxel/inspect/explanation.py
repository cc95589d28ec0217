"""What is known of one pixel, as records: filled by `explain.py`, judged by `diagnosis.py`."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

from luxel.methods.inspect import Contribution

Three = tuple[float, float, float]


FAR = 1e3
"""How many times further away than it is looked at from a place must be to be told in full digits."""


def show_place(place: Three, distance: float | None, gap: str = "  ") -> str:
    """Return a place seen from `distance` metres as text, to a thousandth of that where it lies far from (0, 0, 0)."""
    if distance is None or distance <= 0.0 or max(abs(axis) for axis in place) < FAR * distance:
        # What is nothing beside the others is rounding.
        least = 1e-6 * max(abs(axis) for axis in place)
        return gap.join(f"{axis if abs(axis) > least else 0.0:.3g}" for axis in place)
    decimals = max(3 - math.floor(math.log10(distance)), 0)
    return gap.join(f"{axis:.{decimals}f}" for axis in place)


@dataclass(frozen=True)
class Paths:
    """What paths from the point find, whatever the method says."""

    count: int
    direct: Three
    """E, W/m^2."""
    indirect: Three
    """E, W/m^2."""
    noise: float
    """Standard error of the luminance of `indirect`."""
    backs: float
    """Share of the rays around the point that hit the back of a surface first."""
    misses: float
    """Share of them that hit nothing."""


@dataclass(frozen=True)
class Explanation:
    """All that is known of one pixel."""

    pixel: tuple[int, int]
    """Column and row, from the top left."""
    method: str
    item: str
    """What the method calls one item of its cache; empty where it keeps none."""
    verdict: str
    """One word, a key of `diagnosis.VERDICTS`."""
    words: tuple[str, ...]
    """Sentences, the most important one first."""
    radiance: Three
    """What the pixel holds, W/(m^2 sr)."""
    shown: Three
    """The displayed colour, 0..1."""
    exposure: float
    hit: bool
    """False: no surface is there, and the rest is empty."""
    position: Three | None = None
    """World space of the file, metres."""
    normal: Three | None = None
    """Geometric, on the side that is seen."""
    front: bool = True
    """The side that is seen is the triangles' front."""
    distance: float | None = None
    """From the eye, metres."""
    object_name: str = ""
    material_name: str = ""
    metallic: float = 0.0
    """Factor of the material, without its texture."""
    albedo: Three = (0.0, 0.0, 0.0)
    emission: Three = (0.0, 0.0, 0.0)
    """Radiance; that of the sky where nothing was hit."""
    direct: Three = (0.0, 0.0, 0.0)
    """E in the image, W/m^2."""
    indirect: Three = (0.0, 0.0, 0.0)
    """E in the image, W/m^2."""
    weight: float = 0.0
    """Coverage that the method answered with; 0 is no answer."""
    inspected: bool = True
    """False: the method has no inspector, so nothing is known of its cache."""
    contributions: tuple[Contribution, ...] = ()
    """Heaviest first."""
    paths: Paths | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain values, for JSON."""
        return asdict(self)
