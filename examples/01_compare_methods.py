"""Three methods beside the truth: `regional` is the error of the indirect light, `bias` how much too bright it is.

    python examples/01_compare_methods.py [OUT] [SIZE]

The same from the shell, with every figure: luxel compare cornell-box --methods gibs,path -o out/
"""

from __future__ import annotations

import sys
from pathlib import Path

import luxel
from luxel.metrics import ambient_irradiance, regional
from luxel.metrics.error import bias


def main(out: Path, size: int) -> None:
    """Render each method for 64 frames and print its error and time."""
    scene = luxel.load("cornell-box")
    truth = luxel.render_truth(scene, size=(size, size), spp=256)
    # The best that one constant can do: the truth's own mean.
    settings = {"ambient": {"irradiance": ambient_irradiance(truth.layers)}}
    for method in ("none", "ambient", "path", "gibs"):
        renderer = luxel.Renderer(scene, method, settings.get(method), size=(size, size))
        times = sorted(renderer.run(64)[8:])  # the first frames compile
        layers = renderer.layers()
        error, excess = regional(layers, truth.layers), bias(layers, truth.layers)
        print(f"{method:8} regional {error:.3f}  bias {excess:+.1%}  {times[len(times) // 2]:6.1f} ms a frame")
        luxel.write_image(out / f"{method}.png", layers.image())
    luxel.write_image(out / "truth.png", truth.layers.image())


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out"), int(sys.argv[2]) if len(sys.argv) > 2 else 256)
