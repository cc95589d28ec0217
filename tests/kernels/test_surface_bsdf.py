"""From a material to what its surface does with light, and in which frame: against Mitsuba's BSDFs and closed forms."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.kernels.bsdf import BSDFFeatures, evaluate
from luxel.kernels.gloss import bsdf_features
from luxel.kernels.records import Surface
from luxel.kernels.surface import surface_at
from luxel.kernels.surface_bsdf import bsdf_frame, prepare_bsdf
from luxel.render.renderer import Renderer
from luxel.scene import live
from luxel.scene.device import Scene, upload
from luxel.scene.library.shapes import quad
from luxel.scene.model import Light, Material, Object, SceneData

COUNT = 400
PLATE = quad((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), 0)
"""Faces +z, so that world and local directions are one."""
METAL: dict[str, Any] = {"metallic": 1.0, "eta": (0.2, 0.9, 1.5), "k": (3.9, 2.4, 1.9)}


def plate(material: Material, looks: Any = "full") -> Scene:
    scene = upload(SceneData("plate", [Object("plate", [PLATE])], [material]), materials=looks)
    prepare_bsdf(scene)
    return scene


def directions(seed: int, side: float = 1.0) -> mi.Vector3f:
    d = np.random.default_rng(seed).normal(size=(COUNT, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    d[:, 2] = side * np.maximum(np.abs(d[:, 2]), 0.02)
    return mi.Vector3f((d / np.linalg.norm(d, axis=1, keepdims=True)).T.astype(np.float32))


def seen_along(scene: Scene, wo: mi.Vector3f) -> Surface:
    place = mi.Point2f(0.2, 0.3)
    return surface_at(scene, mi.UInt32(0), place, dr.full(mi.Bool, True, COUNT), wo=wo)


def response(scene: Scene, wo: mi.Vector3f, wi: mi.Vector3f) -> np.ndarray:
    """Return BSDF times cosine (COUNT, 3) for world directions."""
    surface = seen_along(scene, wo)
    frame = bsdf_frame(scene, surface)
    value = evaluate(surface.bsdf, frame.to_local(wo), frame.to_local(wi), surface.active).total
    return np.broadcast_to(np.array(value, float), (3, COUNT)).T


def of_mitsuba(plugin: dict[str, Any], wo: mi.Vector3f, wi: mi.Vector3f) -> np.ndarray:
    interaction = dr.zeros(mi.SurfaceInteraction3f, COUNT)
    interaction.wi = wo  # Mitsuba's `wi` points to the viewer.
    return np.array(mi.load_dict(plugin).eval(mi.BSDFContext(), interaction, wi), float).T


def channels(values: tuple[float, ...]) -> dict[str, Any]:
    return {"type": "rgb", "value": list(values)}


@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
@pytest.mark.parametrize("alpha", [0.1, 0.5])
def test_a_metal_of_the_scene_is_mitsubas(distribution: Any, alpha: float) -> None:
    scene = plate(
        Material(base_color=(1, 1, 1), roughness=math.sqrt(alpha), distribution=distribution, **METAL),
    )
    assert bsdf_features(scene).beckmann == (distribution == "beckmann")
    wo, wi = directions(1), directions(2)
    kind = {"type": "roughconductor", "alpha": alpha, "distribution": distribution}
    index = {"eta": channels(METAL["eta"]), "k": channels(METAL["k"])}
    np.testing.assert_allclose(response(scene, wo, wi), of_mitsuba({**kind, **index}, wo, wi), rtol=2e-3, atol=1e-5)


def test_rough_glass_has_its_inside_behind_its_front() -> None:
    """From either side, reflected and refracted, as Mitsuba's rough dielectric."""
    scene = plate(
        Material(base_color=(1, 1, 1), specular=1.0, transmission=1.0, ior=1.5, roughness=0.5, interface="plastic")
    )
    plugin = {"type": "roughdielectric", "alpha": 0.25, "distribution": "ggx", "int_ior": 1.5, "ext_ior": 1.0}
    for seen in (1.0, -1.0):
        for lit in (1.0, -1.0):
            wo, wi = directions(3, seen), directions(4, lit)
            right = of_mitsuba(plugin, wo, wi)
            assert right.max() > 0.01
            np.testing.assert_allclose(response(scene, wo, wi), right, rtol=5e-3, atol=1e-4)


def test_sides_that_reflect_alike_and_such_that_do_not() -> None:
    both, front = (Material(base_color=(1, 1, 1), roughness=0.6, reflect_back=back, **METAL) for back in (True, False))
    wo, wi = directions(5), directions(6)
    for material, share in ((both, 1.0), (front, 0.0)):
        scene = plate(material)
        mirrored = response(scene, mi.Vector3f(wo.x, wo.y, -wo.z), mi.Vector3f(wi.x, wi.y, -wi.z))
        ahead = response(scene, wo, wi)
        assert ahead.max() > 0.01
        np.testing.assert_allclose(mirrored, share * ahead, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("looks", ["diffuse", "full"])
def test_without_gloss_it_is_lamberts_law(looks: Any) -> None:
    scene = plate(Material(base_color=(0.2, 0.5, 0.7)), looks)
    assert scene.materials.gloss.bsdf is None and bsdf_features(scene) == BSDFFeatures()
    wo, wi = directions(7), directions(8)
    right = np.outer(np.array(wi.z, float), (0.2, 0.5, 0.7)) / math.pi
    np.testing.assert_allclose(response(scene, wo, wi), right, rtol=1e-5)
    free = Surface.at(mi.Point3f(0.0), mi.Normal3f(0.0, 0.0, 1.0), albedo=mi.Color3f(0.5))
    frame = bsdf_frame(scene, free)
    value = evaluate(free.bsdf, frame.to_local(wo), frame.to_local(wi)).total
    np.testing.assert_allclose(np.array(value)[0], 0.5 / math.pi * np.array(wi.z), rtol=1e-5)


def test_the_diffuse_condition_sees_no_gloss() -> None:
    scene = plate(Material(base_color=(0.4, 0.4, 0.4), specular=1.0, roughness=0.3), "diffuse")
    wo, wi = directions(9), directions(10)
    np.testing.assert_allclose(response(scene, wo, wi)[:, 0], 0.4 / math.pi * np.array(wi.z), rtol=1e-5)


def test_tables_are_made_once_and_anew_where_an_edit_needs_more() -> None:
    metal = Material(base_color=(1, 1, 1), roughness=0.5, **METAL)
    scene = plate(metal)
    first = scene.materials.gloss.bsdf
    prepare_bsdf(scene)
    assert scene.materials.gloss.bsdf is first is not None
    live.set_material(scene, 0, replace(metal, distribution="beckmann"))
    prepare_bsdf(scene)
    assert scene.materials.gloss.bsdf is not first and bsdf_features(scene).beckmann
    wo, wi = directions(1), directions(2)
    plugin = {"type": "roughconductor", "alpha": 0.25, "eta": channels(METAL["eta"]), "k": channels(METAL["k"])}
    right = of_mitsuba({**plugin, "distribution": "beckmann"}, wo, wi)
    np.testing.assert_allclose(response(scene, wo, wi), right, rtol=2e-3, atol=1e-5)


def test_a_scene_with_gloss_renders_and_replays() -> None:
    lamp = Light("point", (3.0, 3.0, 3.0), (0.5, 0.5, 2.0))
    glossy = Material(base_color=(0.8, 0.6, 0.4), metallic=0.5, specular=1.0, roughness=0.4, compensate=True)
    data = SceneData("glossy", [Object("plate", [PLATE])], [glossy], lights=[lamp])
    scene = upload(data, materials="full")
    prepare_bsdf(scene)
    renderer = Renderer(scene, "gibs", size=(16, 16))
    renderer.run(6)
    recorded = renderer.compilations
    renderer.run(2)
    assert renderer.compilations == recorded and np.isfinite(renderer.image()).all()
    assert renderer.layers().direct.max() > 0.0
