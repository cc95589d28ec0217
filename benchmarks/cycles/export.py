"""The scene as Blender gets it.

The .glb of a bake shows light and has no lights or materials, so Blender gets the arrays that it was made of:
triangles, atlas, albedo, lights.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from luxel.bake.core import Baked
from luxel.errors import LuxelError
from luxel.kernels.triangle import read_normals, read_positions, read_triangles, read_uv
from luxel.scene.model import Material, SceneData
from luxel.scene.rounding import twin_gaps
from luxel.scene.textures import to_linear

EXTENSIONS = {"repeat": "REPEAT", "clamp": "EXTEND", "mirror": "MIRROR"}
BACK_GAP = 1e-5
"""How far the back of a two-sided triangle lies behind its front, as a share of its longest edge: Cycles bakes fronts
alone, so a back is a triangle of its own."""


def write_scene(baked: Baked, folder: Path) -> None:
    """Write scene.npz and scene.json for Blender's side. Raises LuxelError for what the comparison does not know."""
    check_scene(baked.data)
    layout, scene, triangles = baked.layout, baked.scene, read_triangles(baked.scene)
    normals, own = read_normals(scene)[triangles.vertices], read_uv(scene)[triangles.vertices]
    p = read_positions(scene)[triangles.vertices].astype(np.float64)
    flat = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-30)
    length = np.linalg.norm(normals, axis=2, keepdims=True)
    smooth = (length[..., 0] > 1e-6).all(axis=1)
    n = np.where(length > 1e-6, normals / np.maximum(length, 1e-6), flat[:, None])

    held = np.flatnonzero(layout.chart >= 0)
    prim, back = layout.prim[held], layout.back[held]
    # A back faces the other way, and so do its corners' order and its place.
    turn = np.where(back[:, None], [0, 2, 1], [0, 1, 2])[..., None]
    sign = np.where(back, -1.0, 1.0)[:, None, None]
    gaps = twin_gaps(p.reshape(-1, 3), np.arange(3 * len(p)).reshape(-1, 3), BACK_GAP).reshape(-1, 3, 1)[prim]
    step = np.where(back[:, None, None], gaps, 0.0)
    atlas = (layout.uv[held] + 0.5) / [layout.width, layout.height]
    whole = {"p": p[prim] - step * n[prim], "n": n[prim] * sign, "uv": own[prim]}
    parts = {**{key: layout.at_corners(held, value) for key, value in whole.items()}, "atlas": atlas}
    arrays = {f"baked.{key}": np.take_along_axis(value, turn, axis=1) for key, value in parts.items()}
    arrays |= {"baked.material": triangles.material[prim], "baked.smooth": smooth[prim]}
    # Triangles whose front has no place in the atlas only stand in the light's way.
    rest = np.setdiff1d(np.arange(len(p)), prim[~back])
    arrays |= {
        "rest.p": p[rest],
        "rest.n": n[rest],
        "rest.uv": own[rest],
        "rest.atlas": np.full((len(rest), 3, 2), -1.0),
    }
    arrays |= {"rest.material": triangles.material[rest], "rest.smooth": smooth[rest]}
    materials = []
    for number, material in enumerate(baked.data.materials):
        about, picture = describe_material(material)
        materials.append(about)
        if picture is not None:
            arrays[f"picture_{number}"] = picture
    np.savez(folder / "scene.npz", **{key: np.ascontiguousarray(value) for key, value in arrays.items()})  # type: ignore[arg-type]
    about = {"width": layout.width, "height": layout.height, "materials": materials}
    (folder / "scene.json").write_text(json.dumps(about))


def check_scene(data: SceneData) -> None:
    """Raise LuxelError for what is not handed to Blender."""
    used = {mesh.material for item in data.objects for mesh in item.meshes}
    for material in (data.materials[index] for index in used):
        odd = material.normal_texture or material.emission_texture or material.metallic_roughness_texture
        if odd is not None or material.alpha_mode != "opaque":
            raise LuxelError(f"{data.name}: material '{material.name}' has more than a colour; the peer knows no more")
        texture = material.base_color_texture
        if texture is not None and (texture.uv_set != 0 or np.abs(texture.transform - np.eye(3)).max() > 1e-6):
            raise LuxelError(f"{data.name}: material '{material.name}' moves its texture; the peer knows no such thing")
        if texture is not None and texture.wrap_u != texture.wrap_v:
            raise LuxelError(f"{data.name}: material '{material.name}' wraps unlike in both ways; the peer does not")
    if any(mesh.colors is not None for item in data.objects for mesh in item.meshes):
        raise LuxelError(f"{data.name}: has vertex colours, which the peer does not know")
    odd_lights = [
        light for light in data.lights if light.kind == "spot" or light.range < 1e18 or light.angular_diameter
    ]
    if data.sky.image is not None or odd_lights:
        raise LuxelError(f"{data.name}: the peer knows plain skies, sharp suns and point lights without range")


def describe_material(material: Material) -> tuple[dict[str, Any], np.ndarray | None]:
    """Return what Blender needs to know of a material, and its albedo as a linear picture where it has one."""
    albedo = np.asarray(material.base_color, float) * (1.0 - material.metallic)
    about = {
        "name": material.name, "albedo": albedo.tolist(), "reflect_back": material.reflect_back,
        "emit_back": material.emit_back, "emits": max(material.emission) > 0.0,
    }  # fmt: skip
    texture = material.base_color_texture
    if texture is None:
        return about, None
    about |= {"extension": EXTENSIONS[texture.wrap_u], "nearest": texture.nearest}
    picture = to_linear(texture).copy()
    picture[..., :3] *= albedo
    picture[..., 3] = 1.0
    return about, picture


def light_order(data: SceneData) -> dict[str, Any]:
    """Return the order that gives Blender the lights of `data`."""
    lights = [
        {"kind": light.kind, "color": light.color, "position": light.position, "direction": light.direction}
        for light in data.lights
    ]
    emission = [material.emission for material in data.materials]
    return {"do": "light", "lights": lights, "emission": emission, "sky": data.sky.color}
