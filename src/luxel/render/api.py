"""One call from a scene to an image."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from luxel.render.renderer import Renderer
from luxel.scene.choice import PICTURE_FILTER
from luxel.scene.host import Looks
from luxel.scene.model import Camera, SceneData


def render_image(
    scene: SceneData | str | Path,
    method: str = "gibs",
    *,
    size: tuple[int, int] = (512, 512),
    frames: int = 64,
    params: dict[str, Any] | None = None,
    preset: str | None = None,
    seed: int = 0,
    camera: Camera | None = None,
    device: str = "auto",
    materials: Looks = "full",
    filter: str = PICTURE_FILTER,
) -> np.ndarray:
    """Return an image of `scene`: (height, width, 3) float32, linear radiance, after `frames` frames of `method`.

    `size` is (width, height). `filter`, `box`, `gaussian` or `none`, smooths edges over the frames. `materials`:
    "full", the default of pictures as in `luxel render`, is all that they do where the method shows it (`path`);
    "diffuse", the default of `Renderer`, their diffuse part, which is what other methods show in any case.
    Raises LuxelError for bad input.
    """
    renderer = Renderer(
        scene,
        method,
        params,
        preset=preset,
        size=size,
        seed=seed,
        camera=camera,
        device=device,
        filter=filter,
        materials=materials,
    )
    renderer.run(frames)
    return renderer.image()
