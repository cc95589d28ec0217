"""Where Ekberg's three views of Crytek Sponza stand, chosen by the thesis's words and pictures; it prints no numbers.

Coordinates are those of the Khronos sample model: metres, +Y up, the courtyard along X, banners at Z of -2 and +1.5.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SponzaView:
    """One configuration: a camera and the one directional light."""

    camera: str
    """EYE;TARGET;FOV as the command line takes it, metres and degrees."""
    sun: str
    """AZIMUTH,ELEVATION of where the sun stands, degrees, azimuth from +Z towards +X."""


@dataclass(frozen=True)
class Region:
    """A box in the world whose surfaces are looked at apart, metres."""

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]

    @property
    def middle(self) -> tuple[float, float, float]:
        """The box's middle."""
        (x0, y0, z0), (x1, y1, z1) = self.lower, self.upper
        return 0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.5 * (z0 + z1)

    def grown(self, metres: float) -> Region:
        """Return the box with `metres` more on every side."""
        lower, upper = ([v + sign * metres for v in end] for sign, end in ((-1, self.lower), (1, self.upper)))
        return Region((lower[0], lower[1], lower[2]), (upper[0], upper[1], upper[2]))


VIEWS = {
    "hallway": SponzaView("7.5,1.3,-1.2;-3,1.5,1.9;70", "170,72"),
    "overview": SponzaView("-7.6,3.0,-0.2;4,1.6,-0.4;85", "165,68"),
    "lion": SponzaView("-7.5,1.5,-0.3;-11,1.6,-0.3;60", "75,66"),
}
"""Hallway: along the courtyard at eye height, past pillars between sunlit banners. Overview: the courtyard from above
one end. Lion: the relief at the end wall."""

PILLARS = (
    Region((-2.26, 0.2, 0.9), (-1.64, 2.5, 2.4)),
    Region((0.74, 0.2, 0.9), (1.26, 2.5, 2.4)),
    Region((3.64, 0.2, 1.42), (4.26, 2.5, 2.4)),
)
"""Pillars of the hallway view between banners of two colours; the banners' own cloth is outside the boxes."""

PLANT = Region((-5.2, 0.8, -2.05), (-4.7, 1.7, -1.6))
"""The hanging plant at the left of the overview."""

FLIGHT = (
    "-7.6,3.0,-0.2;4,1.6,-0.4;85",
    "7.5,1.3,-1.2;-3,1.5,1.9;80",
    "7.5,1.3,1.0;-3,1.5,-2.2;80",
    "9.5,1.5,3.4;-6,1.5,3.4;85",
    "-10.5,1.5,3.4;6,1.5,3.4;85",
    "-10.5,1.5,-4.0;6,1.5,-4.0;85",
    "9.5,1.5,-4.0;-6,1.5,-4.0;85",
    "9.5,5.4,3.4;-6,5.4,3.2;85",
    "-10.5,5.4,3.4;6,5.4,3.2;85",
    "-10.5,5.4,-4.0;6,5.4,-3.8;85",
    "9.5,5.4,-4.0;-6,5.4,-3.8;85",
    "-7.0,9.0,-0.3;6,6,-0.3;90",
    "6.0,9.0,-0.3;-7,6,-0.3;90",
    "-7.5,1.5,-0.3;-11,1.6,-0.3;75",
    "6.5,1.5,-0.3;10,1.6,-0.3;75",
)
"""A flight around both storeys, for the surfels that a moving camera leaves behind."""
