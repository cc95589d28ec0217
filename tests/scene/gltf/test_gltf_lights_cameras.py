"""KHR_lights_punctual and cameras."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from luxel.errors import LuxelError
from luxel.scene.model import Camera

if TYPE_CHECKING:
    from conftest import GltfBuilder

HALF = math.sqrt(0.5)
DOWN = [-HALF, 0.0, 0.0, HALF]  # turns -Z to -Y


def test_point_light(builder: GltfBuilder) -> None:
    lamp = builder.light(type="point", color=[1.0, 0.5, 0.25], intensity=40.0, range=12.0)
    builder.node(mesh=builder.mesh())
    builder.node(children=[builder.node(root=False, extensions=lamp, translation=[1, 2, 3])], scale=[2.0, 2.0, 2.0])
    data = builder.load()
    light = data.lights[0]
    assert (light.kind, light.name) == ("point", "light 0")
    assert light.color == (40.0, 20.0, 10.0)
    assert light.position == (2.0, 4.0, 6.0)
    assert light.range == 12.0 and light.motion is None
    assert not any("light 0" in warning or "KHR_lights" in warning for warning in data.warnings)


def test_spot_light_and_its_cone(builder: GltfBuilder) -> None:
    lamp = builder.light(type="spot", name="beam", spot={"innerConeAngle": 0.25, "outerConeAngle": 0.5}, intensity=9.0)
    builder.node(mesh=builder.mesh())
    builder.node(extensions=lamp, rotation=DOWN, scale=[3.0, 3.0, 3.0])
    light = builder.load().lights[0]
    assert (light.kind, light.name, light.color) == ("spot", "beam", (9.0, 9.0, 9.0))
    np.testing.assert_allclose(light.direction, [0.0, -1.0, 0.0], atol=1e-12)
    assert (light.cos_inner, light.cos_outer) == (math.cos(0.25), math.cos(0.5))
    assert light.range == math.inf


def test_defaults_of_lights(builder: GltfBuilder) -> None:
    builder.node(mesh=builder.mesh())
    builder.node(extensions=builder.light(type="spot"), name="lamp")
    builder.node(extensions=builder.light(type="directional", range=5.0))
    spot, sun = builder.load().lights
    assert (spot.name, spot.color) == ("lamp", (1.0, 1.0, 1.0))
    np.testing.assert_allclose([spot.cos_inner, spot.cos_outer], [1.0, HALF])
    assert sun.kind == "directional" and sun.range == math.inf
    assert sun.direction == (0.0, 0.0, -1.0)


def test_unknown_light_type(builder: GltfBuilder) -> None:
    builder.node(mesh=builder.mesh())
    builder.node(extensions=builder.light(type="area"))
    data = builder.load()
    assert data.lights == []
    assert "The light type area is unknown and is ignored." in data.warnings


def test_animated_light_starts_where_it_says(builder: GltfBuilder) -> None:
    builder.node(mesh=builder.mesh())
    node = builder.node(extensions=builder.light(type="spot"), rotation=DOWN, scale=[2.0, 2.0, 2.0])
    builder.animate(node, "translation", [0.0, 2.0], [[1.0, 0.0, 0.0], [1.0, 4.0, 0.0]])
    builder.animate(node, "rotation", [0.0, 2.0], [DOWN, [0.0, 0.0, 0.0, 1.0]])
    light = builder.load().lights[0]
    assert light.motion is not None
    assert light.position == (1.0, 0.0, 0.0)
    np.testing.assert_allclose(light.direction, [0.0, -1.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(light.motion(0.0), np.eye(4), atol=1e-12)
    for time, position, direction in ((1.0, [1, 2, 0], [0, -HALF, -HALF]), (2.0, [1, 4, 0], [0, 0, -1])):
        matrix = light.motion(time)
        np.testing.assert_allclose(matrix @ [*light.position, 1.0], [*position, 1.0], atol=1e-6)
        np.testing.assert_allclose(matrix[:3, :3] @ light.direction, direction, atol=1e-6)


def camera_of(builder: GltfBuilder, *, aspect: float | None = None, **node: Any) -> Camera:
    perspective = {"yfov": math.radians(50.0), "znear": 0.1}
    if aspect is not None:
        perspective["aspectRatio"] = aspect
    index = builder.add("cameras", {"type": "perspective", "perspective": perspective, "name": "lens"})
    builder.node(mesh=builder.mesh())
    builder.node(camera=index, **node)
    return builder.load().cameras[0]


@pytest.mark.parametrize(("aspect", "expected"), [(None, 50.0), (1.0, 50.0), (16 / 9, 79.3173), (0.5, 26.2485)])
def test_field_of_view_is_horizontal(builder: GltfBuilder, aspect: float | None, expected: float) -> None:
    assert camera_of(builder, aspect=aspect).fov == pytest.approx(expected, abs=1e-3)


def test_camera_looks_along_minus_z(builder: GltfBuilder) -> None:
    camera = camera_of(builder, translation=[1.0, 2.0, 3.0], rotation=DOWN, scale=[5.0, 5.0, 5.0])
    assert camera.name == "lens" and camera.motion is None
    assert camera.eye == (1.0, 2.0, 3.0)
    np.testing.assert_allclose(np.subtract(camera.target, camera.eye), [0.0, -1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(camera.up, [0.0, 0.0, -1.0], atol=1e-12)


def test_animated_camera(builder: GltfBuilder) -> None:
    index = builder.add("cameras", {"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.1}})
    builder.node(mesh=builder.mesh())
    node = builder.node(camera=index, name="rig")
    builder.animate(node, "translation", [0.0, 1.0], [[0.0, 0.0, 5.0], [0.0, 0.0, 9.0]])
    camera = builder.load().cameras[0]
    assert camera.name == "rig" and camera.motion is not None
    assert camera.eye == (0.0, 0.0, 5.0)
    assert camera.motion(0.5)[:3, 3].tolist() == [0.0, 0.0, 7.0]
    np.testing.assert_allclose(camera.motion(0.5)[:3, :3], np.eye(3))


def test_orthographic_camera_sees_twice_its_xmag(builder: GltfBuilder) -> None:
    lens = {"xmag": 1.5, "ymag": 1.0, "zfar": 9.0, "znear": 0.1}
    builder.node(mesh=builder.mesh())
    index = builder.add("cameras", {"type": "orthographic", "orthographic": lens, "name": "plan"})
    builder.node(camera=index, translation=[0.0, 3.0, 0.0], rotation=DOWN, scale=[4.0, 4.0, 4.0])
    (camera,) = builder.load().cameras
    # glTF 2.0, section 3.10.3.3: xmag is half the width.
    assert camera.name == "plan" and camera.orthographic_width == 3.0
    assert camera.eye == (0.0, 3.0, 0.0)
    np.testing.assert_allclose(np.subtract(camera.target, camera.eye), [0.0, -1.0, 0.0], atol=1e-12)


@pytest.mark.parametrize(
    ("camera", "words"),
    [({"type": "orthographic", "orthographic": {"xmag": 0.0, "ymag": 1.0}}, "xmag 0"),
     ({"type": "orthographic", "orthographic": {"ymag": 1.0}}, "xmag of camera 0 is missing")],
)  # fmt: skip
def test_cameras_that_see_nothing(builder: GltfBuilder, camera: dict[str, Any], words: str) -> None:
    builder.node(mesh=builder.mesh())
    builder.node(camera=builder.add("cameras", camera))
    with pytest.raises(LuxelError, match=words):
        builder.load()


def test_unknown_cameras_are_named(builder: GltfBuilder) -> None:
    builder.node(mesh=builder.mesh())
    builder.node(camera=builder.add("cameras", {"type": "fisheye", "name": "eye"}))
    data = builder.load()
    assert data.cameras == [] and any("neither perspective nor orthographic" in one for one in data.warnings)


@pytest.mark.parametrize("reach", [0, 0.0, -3.0])
def test_range_of_zero_is_no_limit(builder: GltfBuilder, reach: float) -> None:
    builder.node(mesh=builder.mesh())
    builder.node(extensions=builder.light(type="point", name="bulb", range=reach))
    data = builder.load()
    assert data.lights[0].range == math.inf
    assert any("no limit of range: bulb" in warning for warning in data.warnings)


def test_negative_light_is_dark_and_named(builder: GltfBuilder) -> None:
    builder.node(mesh=builder.mesh())
    builder.node(extensions=builder.light(type="point", name="hole", color=[1.0, 0.5, 1.0], intensity=-2.0))
    data = builder.load()
    assert data.lights[0].color == (0.0, 0.0, 0.0)
    assert any("below zero is read as none: hole" in warning for warning in data.warnings)


def test_light_beyond_all_measure_is_refused(builder: GltfBuilder) -> None:
    builder.node(mesh=builder.mesh())
    builder.node(extensions=builder.light(type="point", color=[1.0, 1e38, 1.0], intensity=50.0))
    with pytest.raises(LuxelError, match="color times intensity of light 0 is 5e"):
        builder.load()


def test_cameras_get_distinct_names_and_scenes_may_have_none(builder: GltfBuilder) -> None:
    builder.node(mesh=builder.mesh())
    assert builder.load().cameras == []
    index = builder.add("cameras", {"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.1}})
    for _ in range(3):
        builder.node(camera=index)
    data = builder.load()
    assert [camera.name for camera in data.cameras] == ["camera-0", "camera-0-2", "camera-0-3"]
    assert data.flight == []
