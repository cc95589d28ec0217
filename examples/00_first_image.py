"""The Cornell box, lit by surfels: load, render, write."""

import sys
from pathlib import Path

import luxel

out = Path(sys.argv[1] if len(sys.argv) > 1 else "out")
scene = luxel.load("cornell-box")
image = luxel.render_image(scene, "gibs", size=(256, 256), frames=64)  # (256, 256, 3) float32, linear
luxel.write_image(out / "first-image.png", image, exposure=1.0)
print(f"{out / 'first-image.png'}: mean radiance {image.mean():.3f} W/(m^2 sr)")
