"""luxel: real-time diffuse global illumination, measured against path-traced truth.

    import luxel
    scene = luxel.load("cornell-box")
    image = luxel.render_image(scene)          # (512, 512, 3) float32, linear

Names load what they need on first use, so that `import luxel` stays quick.
"""

from __future__ import annotations

from importlib import import_module as _import_module
from typing import TYPE_CHECKING as _TYPE_CHECKING

from luxel.errors import LuxelError
from luxel.runtime import use_llvm as _use_llvm

if _TYPE_CHECKING:
    from luxel.bake.core import Baked, bake_scene
    from luxel.bake.solve import LightTarget, solve_lights
    from luxel.image.layers import Layers
    from luxel.image.tonemap import write_image
    from luxel.methods import METHODS, make_params
    from luxel.render.animate import render_sequence
    from luxel.render.api import render_image
    from luxel.render.loading import load
    from luxel.render.renderer import Renderer
    from luxel.render.truth import Truth, render_truth
    from luxel.report.compare import compare
    from luxel.scene import list_scenes
    from luxel.scene.model import Camera, Light, Material, Mesh, Object, SceneData, Sky, Texture

__version__ = "0.1.0"

_HOMES = {
    "Baked": "luxel.bake.core",
    "Camera": "luxel.scene.model",
    "Layers": "luxel.image.layers",
    "Light": "luxel.scene.model",
    "LightTarget": "luxel.bake.solve",
    "METHODS": "luxel.methods",
    "Material": "luxel.scene.model",
    "Mesh": "luxel.scene.model",
    "Object": "luxel.scene.model",
    "Renderer": "luxel.render.renderer",
    "SceneData": "luxel.scene.model",
    "Sky": "luxel.scene.model",
    "Texture": "luxel.scene.model",
    "Truth": "luxel.render.truth",
    "bake_scene": "luxel.bake.core",
    "compare": "luxel.report.compare",
    "list_scenes": "luxel.scene",
    "load": "luxel.render.loading",
    "make_params": "luxel.methods",
    "render_image": "luxel.render.api",
    "render_sequence": "luxel.render.animate",
    "render_truth": "luxel.render.truth",
    "solve_lights": "luxel.bake.solve",
    "write_image": "luxel.image.tonemap",
}

__all__ = [
    "Baked",
    "Camera",
    "Layers",
    "Light",
    "LightTarget",
    "LuxelError",
    "METHODS",
    "Material",
    "Mesh",
    "Object",
    "Renderer",
    "SceneData",
    "Sky",
    "Texture",
    "Truth",
    "bake_scene",
    "compare",
    "list_scenes",
    "load",
    "make_params",
    "render_image",
    "render_sequence",
    "render_truth",
    "solve_lights",
    "write_image",
]

# Dr.Jit loads LLVM when it is imported, so the library must be chosen before any of the names above is used.
_use_llvm()


def __getattr__(name: str) -> object:
    if name in _HOMES:
        return getattr(_import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'luxel' has no attribute '{name}'")


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
