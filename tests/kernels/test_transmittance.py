"""What panes leave of the light along a shadow ray, against Fresnel's equations in NumPy."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.kernels.direct import direct_irradiance
from luxel.kernels.surface import free_surface
from luxel.kernels.surface_bsdf import prepare_bsdf
from luxel.kernels.transmittance import trace_transmittance
from luxel.scene.device import Scene, upload
from luxel.scene.library.shapes import quad
from luxel.scene.model import Light, Material, Mesh, Object, SceneData

COUNT = 64
CLEAR: dict[str, Any] = {"base_color": (1.0, 1.0, 1.0), "specular": 1.0, "transmission": 1.0, "roughness": 0.0}
PANE = Material(**{**CLEAR, "thin": True})
BLUE = Material(**{**CLEAR, "thin": True, "base_color": (0.2, 0.5, 0.9)})


def sheet(height: float, material: int, half: float = 9.0) -> Mesh:
    return quad((-half, height, half), (half, height, half), (half, height, -half), (-half, height, -half), material)


def scene_of(*sheets: Material, looks: Any = "full", one_accel: bool | None = None, half: float = 9.0) -> Scene:
    """Return a floor under horizontal sheets at heights 1, 2, ... and a lamp above all of them."""
    meshes = [sheet(1.0 + index, 1 + index, half) for index in range(len(sheets))]
    objects = [Object("floor", [sheet(0.0, 0)]), Object("sheets", meshes)]
    lamp = Light("point", (100.0, 100.0, 100.0), (0.0, 9.0, 0.0))
    data = SceneData("panes", objects, [Material(), *sheets], lights=[lamp])
    scene = upload(data, one_accel, materials=looks)
    prepare_bsdf(scene)
    return scene


def passed(scene: Scene, angle: float, distance: float = 50.0, active: bool = True) -> np.ndarray:
    """Return what passes upwards at an angle with the normal, (3,); all lanes are alike."""
    origin = mi.Point3f(mi.Float(np.linspace(-0.5, 0.5, COUNT)), 0.1, 0.0)
    direction = mi.Vector3f(math.sin(angle), math.cos(angle), 0.0)
    found = trace_transmittance(scene, origin, direction, mi.Float(distance), dr.full(mi.Bool, active, COUNT))
    values = np.broadcast_to(np.array(found, float), (3, COUNT)).T
    np.testing.assert_allclose(values, np.tile(values[0], (COUNT, 1)), atol=1e-5)
    return values[0]


def through_pane(angle: float, ior: float = 1.5) -> float:
    """Return 1 less what a pane reflects with all passes to and fro: 2 R / (1 + R), R by Fresnel, unpolarised."""
    cosine = math.cos(angle)
    inside = math.sqrt(1.0 - (math.sin(angle) / ior) ** 2)
    s = (cosine - ior * inside) / (cosine + ior * inside)
    p = (ior * cosine - inside) / (ior * cosine + inside)
    r = 0.5 * (s * s + p * p)
    return 1.0 - 2.0 * r / (1.0 + r)


@pytest.mark.parametrize("one_accel", [None, True])
@pytest.mark.parametrize("degrees", [0.0, 40.0, 75.0])
def test_panes_weaken_and_colour_light_one_after_the_other(degrees: float, one_accel: bool | None) -> None:
    angle = math.radians(degrees)
    plastic = Material(**{**CLEAR, "thin": True, "interface": "plastic", "base_color": (0.2, 0.5, 0.9)})
    one = passed(scene_of(plastic, one_accel=one_accel), angle)
    np.testing.assert_allclose(one, through_pane(angle) * np.array([0.2, 0.5, 0.9]), rtol=1e-4)
    two = passed(scene_of(plastic, plastic, one_accel=one_accel), angle)
    np.testing.assert_allclose(two, one**2, rtol=1e-4)


def test_what_lies_behind_the_lights_place_does_not_count() -> None:
    scene = scene_of(BLUE, Material())
    assert passed(scene, 0.0, 1.5).min() > 0.1 and not passed(scene, 0.0).any()
    np.testing.assert_allclose(passed(scene, 0.0, 0.5), 1.0)
    assert not passed(scene, 0.0, 0.5, active=False).any()


@pytest.mark.parametrize("other", [{"thin": False}, {"roughness": 0.5}, {"transmission": 0.0}])
def test_what_is_no_smooth_pane_stops_light(other: dict[str, Any]) -> None:
    scene = scene_of(PANE, Material(**{**CLEAR, "thin": True, **other}))
    assert not passed(scene, 0.2).any()


def test_the_diffuse_condition_lets_light_pass_by_chance() -> None:
    """There glass is a hole for the share that it lets pass."""
    assert passed(scene_of(PANE, looks="diffuse"), 0.2).min() == 1.0


def test_a_lamp_behind_a_pane_lights_the_floor_through_it() -> None:
    scene, bare = scene_of(BLUE), scene_of()
    surface = free_surface(np.array([[0.0, 0.0, 0.0]]), np.array([[0.0, 1.0, 0.0]]))

    def lit(scene: Scene) -> np.ndarray:
        return np.array(direct_irradiance(scene, surface, mi.UInt32(1), mi.UInt32(0), mi.Bool(True)), float).ravel()

    np.testing.assert_allclose(lit(bare), 100.0 / 81.0, rtol=1e-4)
    np.testing.assert_allclose(lit(scene) / lit(bare), through_pane(0.0) * np.array([0.2, 0.5, 0.9]), rtol=2e-3)


def test_a_stack_of_panes_ends() -> None:
    """Each of 100 panes lets all pass but what it reflects; after the limit of layers nothing is asked any more."""
    meshes = [sheet(1.0 + 0.01 * index, 0) for index in range(100)]
    scene = upload(SceneData("stack", [Object("stack", meshes)], [PANE]), materials="full")
    prepare_bsdf(scene)
    assert not passed(scene, 0.0).any()
