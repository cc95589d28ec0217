"""Blender's half of the comparison: Cycles bakes into luxel's atlas. Runs in a Python that has `bpy`, alone.

python bake_in_blender.py FOLDER

It is started by `blender.py`, reads one order a line from standard input (JSON, a dict with `do`) and answers each
by one line: `load` takes scene.npz and scene.json of FOLDER, `light` sets lights, emission and sky, `bake` bakes and
writes the texels to a .npy. An order that fails is answered by {"error": …}. Blender's own talk goes to standard error.
"""

from __future__ import annotations

import json
import math
import os
import sys
import time
from pathlib import Path
from typing import Any

import bpy  # type: ignore[import-not-found]
import mathutils  # type: ignore[import-not-found]
import numpy as np

BOUNCES = 64
"""Of a path at most: what is beyond carries nothing in these scenes. Russian roulette ends most of them earlier."""
POINT_WATTS = 4.0 * math.pi
"""Blender's power of a point light of radiant intensity 1 W/sr; checked by the bias of a converged bake."""


class Peer:
    """The scene in Blender."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.materials: list[Any] = []
        self.image: Any = None

    def load(self, order: dict[str, Any]) -> dict[str, Any]:
        """Build the scene: one mesh that is baked, one that only stands in the light's way, their materials."""
        start = time.perf_counter()
        bpy.ops.wm.read_factory_settings(use_empty=True)
        arrays = dict(np.load(self.folder / "scene.npz"))
        about = json.loads((self.folder / "scene.json").read_text())
        self.image = bpy.data.images.new(
            "texels", about["width"], about["height"], alpha=True, float_buffer=True, is_data=True
        )
        self.materials = [
            make_material(number, item, arrays.get(f"picture_{number}"), self.image)
            for number, item in enumerate(about["materials"])
        ]
        baked = add_mesh("baked", arrays, "baked", self.materials)
        if len(arrays["rest.p"]):
            add_mesh("rest", arrays, "rest", self.materials)
        baked.select_set(True)
        bpy.context.view_layer.objects.active = baked
        set_up_cycles(order["threads"])
        return {"blender": bpy.app.version_string, "load_s": time.perf_counter() - start}

    def light(self, order: dict[str, Any]) -> dict[str, Any]:
        """Set lights without a surface, the radiance of materials, the sky's."""
        start = time.perf_counter()
        for item in [item for item in bpy.data.objects if item.type == "LIGHT"]:
            bpy.data.objects.remove(item)
        for light in order["lights"]:
            add_light(light)
        for material, radiance in zip(self.materials, order["emission"], strict=True):
            set_emission(material, radiance)
        set_sky(order["sky"])
        return {"light_s": time.perf_counter() - start}

    def bake(self, order: dict[str, Any]) -> dict[str, Any]:
        """Bake `samples` paths a texel with `seed`; the passes `passes` of `kind`. Writes (H, W, 4) to `out`."""
        scene = bpy.context.scene
        scene.cycles.samples, scene.cycles.seed = order["samples"], order["seed"]
        scene.cycles.use_denoising = order["denoise"]
        start = time.perf_counter()
        bpy.ops.object.bake(
            type=order["kind"], pass_filter=set(order["passes"]), margin=0, use_clear=True, target="IMAGE_TEXTURES"
        )
        bake_s = time.perf_counter() - start
        pixels = np.empty(4 * self.image.size[0] * self.image.size[1], np.float32)
        self.image.pixels.foreach_get(pixels)
        read_s = time.perf_counter() - start - bake_s
        np.save(self.folder / order["out"], pixels.reshape(self.image.size[1], self.image.size[0], 4))
        return {"bake_s": bake_s, "read_s": read_s}


def set_up_cycles(threads: int) -> None:
    """Choose Cycles on the CPU with what its defaults take from the light put back."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.render.threads_mode, scene.render.threads = "FIXED", threads
    # A second bake of the same scene may keep what it can.
    scene.render.use_persistent_data = True
    scene.render.bake.margin = 0
    cycles = scene.cycles
    cycles.device = "CPU"
    cycles.use_adaptive_sampling = False
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    cycles.max_bounces = cycles.diffuse_bounces = BOUNCES
    cycles.caustics_reflective = cycles.caustics_refractive = False


def add_mesh(name: str, arrays: dict[str, np.ndarray], prefix: str, materials: list[Any]) -> Any:
    """Add the triangles `prefix`.p (T, 3, 3) with their normals, coordinates and materials."""
    p, n = arrays[f"{prefix}.p"], arrays[f"{prefix}.n"]
    count = len(p)
    keys, index = np.unique(p.reshape(-1, 3), axis=0, return_inverse=True)
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(keys))
    mesh.vertices.foreach_set("co", keys.astype(np.float32).ravel())
    mesh.loops.add(3 * count)
    mesh.loops.foreach_set("vertex_index", index.ravel().astype(np.int32))
    mesh.polygons.add(count)
    mesh.polygons.foreach_set("loop_start", np.arange(0, 3 * count, 3, dtype=np.int32))
    mesh.polygons.foreach_set("material_index", arrays[f"{prefix}.material"].astype(np.int32))
    mesh.polygons.foreach_set("use_smooth", arrays[f"{prefix}.smooth"].astype(bool))
    # The atlas stands last and is the one that Cycles bakes to; pictures read the first set.
    for layer, key in (("own", "uv"), ("atlas", "atlas")):
        mesh.uv_layers.new(name=layer).uv.foreach_set("vector", arrays[f"{prefix}.{key}"].astype(np.float32).ravel())
    mesh.uv_layers["atlas"].active = True
    mesh.uv_layers["own"].active_render = True
    for material in materials:
        mesh.materials.append(material)
    mesh.update(calc_edges=True)
    if arrays[f"{prefix}.smooth"].any():
        mesh.normals_split_custom_set(n.reshape(-1, 3))
    item = bpy.data.objects.new(name, mesh)
    # Cycles moves shadow rays off coarse smooth meshes; luxel does not.
    item.cycles.shadow_terminator_geometry_offset = 0.0
    item.cycles.shadow_terminator_offset = 0.0
    bpy.context.collection.objects.link(item)
    return item


def make_material(number: int, about: dict[str, Any], picture: np.ndarray | None, target: Any) -> Any:
    """Return a diffuse material, black behind where it is one-sided, with an emission node and the bake's target."""
    material = bpy.data.materials.new(f"{number} {about['name']}")
    nodes, links = nodes_of(material)
    nodes.clear()
    output, diffuse, add = (nodes.new(f"ShaderNode{kind}") for kind in ("OutputMaterial", "BsdfDiffuse", "AddShader"))
    diffuse.inputs["Color"].default_value = (*about["albedo"], 1.0)
    if picture is not None:
        image = nodes.new("ShaderNodeTexImage")
        image.image = bpy.data.images.new(
            f"picture {number}", picture.shape[1], picture.shape[0], float_buffer=True, is_data=True
        )
        image.image.pixels.foreach_set(np.ascontiguousarray(picture, np.float32).ravel())
        image.image.update()
        image.extension = about["extension"]
        image.interpolation = "Closest" if about["nearest"] else "Linear"
        place = nodes.new("ShaderNodeUVMap")
        place.uv_map = "own"
        links.new(place.outputs["UV"], image.inputs["Vector"])
        links.new(image.outputs["Color"], diffuse.inputs["Color"])
    emission = nodes.new("ShaderNodeEmission")
    emission.name = "light"
    emission.inputs["Strength"].default_value = 0.0
    lit: Any = diffuse
    side = nodes.new("ShaderNodeNewGeometry")
    if not about["reflect_back"]:
        lit = mix_by_side(nodes, links, side, diffuse, black(nodes))
    glow: Any = emission
    if not about["emit_back"] and about["emits"]:
        glow = mix_by_side(nodes, links, side, emission, None)
    if about["emits"]:
        links.new(lit.outputs[0], add.inputs[0])
        links.new(glow.outputs[0], add.inputs[1])
        lit = add
        material.cycles.emission_sampling = "FRONT_BACK" if about["emit_back"] else "FRONT"
    links.new(lit.outputs[0], output.inputs["Surface"])
    texture = nodes.new("ShaderNodeTexImage")
    texture.image = target
    texture.select = True
    nodes.active = texture
    return material


def nodes_of(item: Any) -> tuple[Any, Any]:
    """Return the nodes and links of a material or world; older versions of Blender want them asked for."""
    if item.node_tree is None:
        item.use_nodes = True
    tree: Any = item.node_tree
    return tree.nodes, tree.links


def mix_by_side(nodes: Any, links: Any, side: Any, front: Any, back: Any | None) -> Any:
    """Return a shader that is `front` seen from the front and `back` (None: nothing) from behind."""
    mix = nodes.new("ShaderNodeMixShader")
    links.new(side.outputs["Backfacing"], mix.inputs[0])
    links.new(front.outputs[0], mix.inputs[1])
    if back is not None:
        links.new(back.outputs[0], mix.inputs[2])
    return mix


def black(nodes: Any) -> Any:
    """Return a diffuse shader that takes all light."""
    shader = nodes.new("ShaderNodeBsdfDiffuse")
    shader.inputs["Color"].default_value = (0.0, 0.0, 0.0, 1.0)
    return shader


def set_emission(material: Any, radiance: list[float]) -> None:
    """Set the radiance of a material's front, W/(m^2 sr)."""
    node = material.node_tree.nodes["light"]
    strength = max(radiance)
    node.inputs["Color"].default_value = (*(channel / max(strength, 1e-30) for channel in radiance), 1.0)
    node.inputs["Strength"].default_value = strength


def add_light(about: dict[str, Any]) -> None:
    """Add a directional light (irradiance on a facing plane) or a point light (radiant intensity), without size."""
    kind = {"directional": "SUN", "point": "POINT"}[about["kind"]]
    light = bpy.data.lights.new(about["kind"], kind)
    strength = max(about["color"])
    light.color = [channel / max(strength, 1e-30) for channel in about["color"]]
    item = bpy.data.objects.new(about["kind"], light)
    if kind == "SUN":
        light.energy, light.angle = strength, 0.0
        item.rotation_mode = "QUATERNION"
        item.rotation_quaternion = mathutils.Vector(about["direction"]).to_track_quat("-Z", "Y")
    else:
        light.energy, light.shadow_soft_size, light.use_soft_falloff = POINT_WATTS * strength, 0.0, False
        item.location = about["position"]
    bpy.context.collection.objects.link(item)


def set_sky(radiance: list[float]) -> None:
    """Set the same radiance in all directions."""
    world = bpy.context.scene.world or bpy.data.worlds.new("sky")
    bpy.context.scene.world = world
    nodes, links = nodes_of(world)
    nodes.clear()
    background, output = nodes.new("ShaderNodeBackground"), nodes.new("ShaderNodeOutputWorld")
    strength = max(radiance)
    background.inputs["Color"].default_value = (*(channel / max(strength, 1e-30) for channel in radiance), 1.0)
    background.inputs["Strength"].default_value = strength
    links.new(background.outputs[0], output.inputs["Surface"])


def main() -> None:
    # Answers keep the pipe to themselves; what Blender prints goes where errors go.
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    peer = Peer(Path(sys.argv[1]))
    for line in sys.stdin:
        order = json.loads(line)
        try:
            answer = {"load": peer.load, "light": peer.light, "bake": peer.bake}[order["do"]](order)
        except Exception as error:
            answer = {"error": f"{type(error).__name__}: {error}".strip()}
        print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    main()
