"""Everything that can be shown of a frame besides its image: light taken apart, surfaces, errors, and the cache.

    shot = take_shot(renderer)
    drawing = draw_look("surfels", shot)   # drawing.image (H, W, 3), ready to be shown; drawing.legend

`list_looks` names what a method offers; `luxel render SCENE --look NAME` writes them.
"""

from __future__ import annotations

from luxel.inspect.looks.draw import Drawing, draw_look, find_look, list_looks
from luxel.inspect.looks.legend import Legend, Scale, draw_legend
from luxel.inspect.looks.shot import Shot, take_shot

__all__ = [
    "Drawing",
    "Legend",
    "Scale",
    "Shot",
    "draw_legend",
    "draw_look",
    "find_look",
    "list_looks",
    "take_shot",
]
