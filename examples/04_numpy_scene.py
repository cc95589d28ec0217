"""A scene made of NumPy arrays: a landscape under a sky and a low sun, with a lamp that floats above it.

python examples/04_numpy_scene.py [OUT] [SIZE]
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import luxel

CLAY, GLOW = 0, 1
SIDE = 65


def make_hills() -> luxel.Mesh:
    """Return a height field of 8 x 8 m, counter-clockwise from above."""
    x, z = np.meshgrid(np.linspace(-4, 4, SIDE), np.linspace(-4, 4, SIDE))
    y = 0.35 * np.sin(1.7 * x) * np.cos(1.3 * z)
    down_z, along_x = np.gradient(y, 8 / (SIDE - 1))
    positions = np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(np.float32)
    normals = np.stack([-along_x, np.ones_like(y), -down_z], axis=-1).reshape(-1, 3)
    normals = (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32)
    corner = (np.arange(SIDE - 1)[:, None] * SIDE + np.arange(SIDE - 1)).ravel()
    a, b, c, d = corner, corner + 1, corner + SIDE, corner + SIDE + 1  # b is towards +X, c towards +Z
    faces = np.concatenate([np.stack([a, c, b], axis=1), np.stack([b, c, d], axis=1)]).astype(np.uint32)
    return luxel.Mesh(positions, faces, CLAY, normals=normals)


def make_lamp() -> luxel.Mesh:
    """Return a square of 0.6 m that faces down: its area light needs nothing but an emissive material."""
    corners = np.array([(-0.3, 1.1, -0.3), (0.3, 1.1, -0.3), (0.3, 1.1, 0.3), (-0.3, 1.1, 0.3)], np.float32)
    return luxel.Mesh(corners, np.array([(0, 1, 2), (0, 2, 3)], np.uint32), GLOW)


def make_scene() -> luxel.SceneData:
    """Return the whole scene: metres, W/m^2, linear Rec. 709, +Y up."""
    materials = [
        luxel.Material("clay", base_color=(0.72, 0.45, 0.32)),
        luxel.Material("glow", base_color=(0.8, 0.8, 0.8), emission=(30.0, 24.0, 14.0)),
    ]
    objects = [luxel.Object("hills", [make_hills()]), luxel.Object("lamp", [make_lamp()])]
    sun = luxel.Light("directional", color=(4.0, 3.2, 2.2), direction=(-1.0, -0.35, 0.4))
    view = luxel.Camera(eye=(3.0, 2.2, 3.4), target=(0.0, 0.2, 0.0), fov=60.0)
    sky = luxel.Sky(color=(0.25, 0.4, 0.7))
    return luxel.SceneData("hills", objects, materials, lights=[sun], cameras=[view], sky=sky)


def main(out: Path, size: int) -> None:
    """Render the scene with gibs and write it."""
    image = luxel.render_image(make_scene(), "gibs", size=(size, size), frames=64)
    luxel.write_image(out / "hills.png", image, exposure=0.5)
    luxel.write_image(out / "hills.exr", image)
    print(f"{out / 'hills.png'}: {image.shape}, {image.dtype}, mean {image.mean():.3f}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out"), int(sys.argv[2]) if len(sys.argv) > 2 else 256)
