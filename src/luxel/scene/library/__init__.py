"""The built-in scenes by name.

Each is a function with keyword dials; the first line of its doc is what `luxel scenes` says.
"""

from __future__ import annotations

from luxel.scene.library.analytic import furnace, sphere
from luxel.scene.library.atrium import atrium
from luxel.scene.library.attic import attic
from luxel.scene.library.cornell_box import cornell_box
from luxel.scene.library.dials import SceneMaker
from luxel.scene.library.glossy import glossy
from luxel.scene.library.moving import moving
from luxel.scene.library.rooms import opening, two_rooms

BUILT_IN: dict[str, SceneMaker] = {
    "cornell-box": cornell_box,
    "furnace": furnace,
    "sphere": sphere,
    "two-rooms": two_rooms,
    "opening": opening,
    "attic": attic,
    "atrium": atrium,
    "moving": moving,
    "glossy": glossy,
}
