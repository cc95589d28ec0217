"""Small bakes that several tests look at."""

from __future__ import annotations

from typing import Any

import pytest

from luxel.methods.lightmap.method import Lightmap
from luxel.methods.lightmap.params import LightmapParams
from luxel.render.renderer import Renderer
from luxel.scene import load

SMALL: dict[str, Any] = {"texel_target": 2048, "surfel_target": 512, "rays_per_texel": 128, "probe_target": 64}


@pytest.fixture(scope="session")
def small() -> LightmapParams:
    return LightmapParams(**SMALL)


@pytest.fixture(scope="session")
def cornell() -> Renderer:
    """The Cornell box with a small lightmap, 24 frames in."""
    renderer = Renderer(load("cornell-box"), "lightmap", dict(SMALL), size=(64, 64), seed=1)
    renderer.run(24)
    assert isinstance(renderer.method, Lightmap)
    return renderer
