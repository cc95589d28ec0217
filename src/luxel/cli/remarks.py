"""What `luxel render` has to say of its picture: what it leaves out, and what is wrong with it."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from luxel.image.layers import Layers
    from luxel.render.renderer import Renderer
    from luxel.scene.model import SceneData

DIFFUSE_PICTURE = "'{name}' lights the diffuse part of materials alone; '--method path' shows all that they do."
DIFFUSE_TRUTH = (
    "The error is that of diffuse materials, which is all that '{name}' lights; only '--method path' shows full ones."
)
NOTHING_SEEN = "Camera '{name}' sees no surface, so the picture shows the sky alone; choose another by --camera."
NOT_FINITE = "Method '{name}' gives NaN or infinite light in {share:.2%} of the pixels; a .png shows them black."


def remark(data: SceneData, renderer: Renderer, layers: Layers, materials: str, measured: bool) -> list[str]:
    """One sentence each on the scene, the picture and the cache.

    `materials` are those asked for; `measured`: the error against the truth is given too.
    """
    return [
        *_on_materials(data, renderer, materials, measured),
        *_on_picture(layers, renderer),
        *renderer.method.warnings(renderer.state),
    ]


def _on_materials(data: SceneData, renderer: Renderer, materials: str, measured: bool) -> list[str]:
    """Return what the loader says that holds for this picture, and who would show what is left out."""
    from luxel.scene.gloss import is_glossy

    name = renderer.method.name
    if renderer.scene.host.looks == "full":
        return [sentence for sentence in data.warnings if sentence not in data.diffuse_warnings]
    if materials == "diffuse":
        return list(data.warnings)
    if measured and any(map(is_glossy, data.materials)):
        return [*data.warnings, DIFFUSE_TRUTH.format(name=name)]
    # Loaders name what is left out, having looked at the textures; scenes made in Python have nobody who does.
    untold = any(one.metallic_roughness_texture is None and one.metallic > 0.0 for one in data.materials)
    if data.diffuse_warnings or untold:
        return [*data.warnings, DIFFUSE_PICTURE.format(name=name)]
    return list(data.warnings)


def _on_picture(layers: Layers, renderer: Renderer) -> list[str]:
    import numpy as np

    found = [] if layers.hit.any() else [NOTHING_SEEN.format(name=renderer.camera.name)]
    holes = 1.0 - float(np.isfinite(layers.image()).all(axis=-1).mean())
    return [*found, NOT_FINITE.format(name=renderer.method.name, share=holes)] if holes else found
