"""A lamp circles and objects move: the surfels follow, and the run becomes an animated picture.

python examples/03_moving_light.py [OUT] [SIZE]
"""

from __future__ import annotations

import sys
from pathlib import Path

import luxel
from luxel.image.tonemap import to_display
from luxel.render.sequence import open_sequence

FPS = 10
FRAMES = 40  # the scene repeats after 4 seconds
WARM_UP = 16


def main(out: Path, size: int) -> None:
    """Write moving.gif; the frames before time 0 fill the cache, so that the first one shown is not dark."""
    renderer = luxel.Renderer("moving", "gibs", size=(size, size))
    for index in range(WARM_UP):
        renderer.step(time=(index - WARM_UP) / FPS)
    exposure = renderer.auto_exposure()  # one for all frames, or the picture would pump
    with open_sequence(out / "moving.gif", fps=FPS) as add:
        for index in range(FRAMES):
            renderer.step(time=index / FPS)
            add(to_display(renderer.image(), exposure))
    print(f"{out / 'moving.gif'}: {FRAMES} frames, {renderer.cache()['surfel_count']:,} surfels")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out"), int(sys.argv[2]) if len(sys.argv) > 2 else 192)
