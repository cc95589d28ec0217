"""Ask the cache for the light at points of your own: a strip along the floor of the Cornell box, written as a table.

python examples/05_irradiance_anywhere.py [OUT] [SIZE]
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import luxel

POINTS = 9


def main(out: Path, size: int) -> None:
    """Write floor.csv: x in metres and the indirect irradiance there in W/m^2, red to green wall."""
    renderer = luxel.Renderer("cornell-box", "gibs", size=(size, size))
    renderer.run(64)
    x = np.linspace(-0.9, 0.9, POINTS)
    points = np.stack([x, np.full(POINTS, -1.0), np.full(POINTS, 0.85)], axis=1)
    normals = np.tile([0.0, 1.0, 0.0], (POINTS, 1))
    irradiance = renderer.irradiance_at(points, normals)  # (9, 3): nothing is rendered for it
    out.mkdir(parents=True, exist_ok=True)
    table = np.concatenate([x[:, None], irradiance], axis=1)
    np.savetxt(out / "floor.csv", table, fmt="%.4f", delimiter=",", header="x,red,green,blue", comments="")
    for row in table:
        print("x {:+.2f} m   E {:.2f} {:.2f} {:.2f} W/m^2".format(*row))


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out"), int(sys.argv[2]) if len(sys.argv) > 2 else 128)
