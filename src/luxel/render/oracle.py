"""The oracle of full materials: a scene path traced by Mitsuba itself, to hold luxel's own pictures against.

Tests and pictures in docs use it; no command and no figure comes from it. A Mitsuba file renders as it is; other
scenes get the BSDFs of `oracle_materials.py`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.kernels.camera import camera_ray, make_pinhole
from luxel.kernels.film import Film
from luxel.render.oracle_materials import describe_emission, describe_material, describe_medium, passes_straight
from luxel.scene.arrays import from_numpy
from luxel.scene.edit import scene_bounds
from luxel.scene.local import localise
from luxel.scene.model import Camera, Light, Material, Mesh, SceneData, Sky, Texture

WIDTH = 1 << 16
"""Rays that are traced at once, where a picture has not more pixels than that."""
FAR_DISC = 1e3
"""How many of the scene's diagonals away a sun's disc is hung."""


def render_full(
    data: SceneData,
    camera: Camera,
    *,
    size: tuple[int, int],
    spp: int,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> np.ndarray:
    """Return the path-traced image with full materials, (H, W, 3) float32 linear radiance, rays at pixel centres.

    The device must have been started. `size` is (width, height); animated scenes are taken at time 0.
    """
    # Mitsuba has single precision too: both are measured from the scene's origin.
    origin = np.asarray(data.origin, np.float64)
    scene: Any = data.mitsuba_full() if data.mitsuba_full is not None else make_full_scene(localise(data))
    integrator: Any = mi.load_dict(
        {"type": choose_integrator(data), "max_depth": -1, "hide_emitters": data.hide_emitters}
    )
    sampler: Any = mi.load_dict({"type": "independent"})
    film, pinhole = Film(*size), make_pinhole(camera, *size, origin=origin)
    # Many samples at once: a pass of a small picture takes longer to record than to trace.
    passes = min(spp, max(1, WIDTH // film.lane_count))
    column, row, inside = film.pixel_of_lane(dr.arange(mi.UInt32, film.lane_count * passes) // passes)
    x = (mi.Float(column) + 0.5) * (2.0 / film.width) - 1.0
    y = 1.0 - (mi.Float(row) + 0.5) * (2.0 / film.height)
    origin, direction = camera_ray(pinhole, x, y)
    total = dr.zeros(mi.Color3f, film.lane_count)
    number = dr.arange(mi.UInt32, film.lane_count * passes) % passes
    for first in range(0, spp, passes):
        sampler.seed((seed * 0x9E3779B1 + first) & 0xFFFFFFFF, film.lane_count * passes)
        ray = mi.RayDifferential3f(mi.Ray3f(origin, direction))
        counts = inside & (number + first < spp)
        radiance, _, _ = integrator.sample(scene, sampler, ray, None, counts)
        total += dr.block_sum(mi.Color3f(dr.select(counts, mi.Color3f(radiance), 0.0)), passes)
        dr.eval(total)
        if progress is not None:
            dr.sync_thread()
            progress(min(first + passes, spp) / spp)
    return (np.array(total).T / spp)[film.lanes_of_image()].astype(np.float32)


def choose_integrator(data: SceneData) -> str:
    """Return the name of Mitsuba's integrator for `data`.

    Its `path` takes holes and panes for opaque on the way to a lamp, and loses no light inside of glass. Files render
    as Mitsuba's own default does; `volpath` does not know what hidden emitters are.
    """
    needed = any(map(passes_straight, data.materials)) and data.mitsuba_full is None and not data.hide_emitters
    return "volpath" if needed else "path"


def make_full_scene(data: SceneData) -> mi.Scene:
    """Return a Mitsuba scene of `data` at time 0, its materials included.

    Area lights shine from their front only; light ranges and colours per vertex are left out.
    """
    parts: dict[str, Any] = {"type": "scene"}
    bsdfs = [mi.load_dict(describe_material(material)) for material in data.materials]
    for number, item in enumerate(data.objects):
        shapes = (
            item.deform(0.0) if item.deform is not None else [(mesh.positions, mesh.normals) for mesh in item.meshes]
        )
        matrix = np.asarray(item.to_world if item.motion is None else item.motion(0.0), np.float64)
        for index, (mesh, (positions, normals)) in enumerate(zip(item.meshes, shapes, strict=True)):
            material = data.materials[mesh.material]
            name = f"mesh_{number}_{index}"
            parts[name] = _make_mesh(name, mesh, positions, normals, matrix, material, bsdfs[mesh.material])
    for number, light in enumerate(data.lights):
        wide = light.kind == "directional" and light.angular_diameter > 0.0
        parts[f"light_{number}"] = _describe_disc(light, data) if wide else _describe_light(light)
    if max(data.sky.color) > 0.0:
        parts["sky"] = _describe_sky(data.sky)
    scene = mi.load_dict(parts)
    assert isinstance(scene, mi.Scene)
    return scene


# ---------- Shapes ----------


def _make_mesh(
    name: str,
    mesh: Mesh,
    positions: np.ndarray,
    normals: np.ndarray | None,
    matrix: np.ndarray,
    material: Material,
    bsdf: Any,
) -> Any:
    properties = mi.Properties()
    properties["bsdf"] = bsdf
    if max(material.emission) > 0.0:
        properties["emitter"] = mi.load_dict({"type": "area", "radiance": describe_emission(material)})
    medium = describe_medium(material)
    if medium is not None:
        properties["interior"] = mi.load_dict(medium)
    uv = mesh.uv2 if _first_uv_set(material) == 1 else mesh.uv
    made = mi.Mesh(name, len(positions), len(mesh.faces), properties, normals is not None, uv is not None)
    parameters: Any = mi.traverse(made)
    world = positions @ matrix[:3, :3].T + matrix[:3, 3]
    parameters["vertex_positions"] = from_numpy(mi.Float, world)
    faces = mesh.faces if np.linalg.det(matrix[:3, :3]) > 0.0 else mesh.faces[:, ::-1]
    parameters["faces"] = from_numpy(mi.UInt32, faces)
    if normals is not None:
        turned = normals @ np.linalg.inv(matrix[:3, :3])
        turned = turned / np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-12)
        parameters["vertex_normals"] = from_numpy(mi.Float, turned)
    if uv is not None:
        parameters["vertex_texcoords"] = from_numpy(mi.Float, uv)
    parameters.update()
    return made


def _first_uv_set(material: Material) -> int:
    textures = (value for value in vars(material).values() if isinstance(value, Texture))
    return next((texture.uv_set for texture in textures), 0)


# ---------- Light from afar ----------


def _describe_light(light: Light) -> dict[str, Any]:
    matrix = np.eye(4) if light.motion is None else np.asarray(light.motion(0.0))
    position = matrix[:3, :3] @ np.asarray(light.position, float) + matrix[:3, 3]
    direction = matrix[:3, :3] @ np.asarray(light.direction, float)
    color = {"type": "rgb", "value": [float(channel) for channel in light.color]}
    if light.kind == "directional":
        return {"type": "directional", "direction": direction.tolist(), "irradiance": color}
    if light.kind == "point":
        return {"type": "point", "position": position.tolist(), "intensity": color}
    up = [0.0, 0.0, 1.0] if abs(direction[1]) > 0.9 * np.linalg.norm(direction) else [0.0, 1.0, 0.0]
    target = (position + direction).tolist()
    outer, inner = np.degrees(np.arccos(np.clip([light.cos_outer, light.cos_inner], -1.0, 1.0)))
    return {
        "type": "spot",
        "to_world": mi.ScalarTransform4f().look_at(position.tolist(), target, up),
        "intensity": color,
        "cutoff_angle": float(outer),
        "beam_width": float(min(inner, 0.999 * outer)),
    }


def _describe_disc(light: Light, data: SceneData) -> dict[str, Any]:
    """Return a sun that is wider than one direction: a glowing disc far away, which lets through what is behind it.

    Cameras see it, whether it is part of the sky or not.
    """
    lo, hi = scene_bounds(data, times=(0.0,))
    far = FAR_DISC * max(float(np.linalg.norm(hi - lo)), 1e-3)
    matrix = np.eye(4) if light.motion is None else np.asarray(light.motion(0.0))
    travels = matrix[:3, :3] @ np.asarray(light.direction, float)
    travels /= np.linalg.norm(travels)
    radius = math.radians(0.5 * light.angular_diameter)
    middle = 0.5 * (lo + hi)
    up = [0.0, 0.0, 1.0] if abs(travels[1]) > 0.9 else [0.0, 1.0, 0.0]
    place: Any = mi.ScalarTransform4f().look_at((middle - far * travels).tolist(), middle.tolist(), up)
    radiance = [float(channel) / (math.pi * math.sin(radius) ** 2) for channel in light.color]
    return {
        "type": "disk",
        "to_world": place @ mi.ScalarTransform4f().scale(far * math.tan(radius)),
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": radiance}},
        "bsdf": {"type": "mask", "opacity": 0.0, "bsdf": {"type": "diffuse"}},
    }


def _describe_sky(sky: Sky) -> dict[str, Any]:
    if sky.image is None:
        return {"type": "constant", "radiance": {"type": "rgb", "value": [float(channel) for channel in sky.color]}}
    image = np.nan_to_num(sky.image, posinf=65504.0) * np.asarray(sky.color, np.float32)
    # Mitsuba's left edge looks along -Z, ours along +Z; it turns the other way.
    turned = np.roll(image, -(image.shape[1] // 2), axis=1)
    return {
        "type": "envmap",
        "bitmap": mi.Bitmap(np.ascontiguousarray(turned, np.float32)),
        "to_world": mi.ScalarTransform4f().rotate([0.0, 1.0, 0.0], -sky.rotation),
    }
