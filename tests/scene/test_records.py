"""Records of a scene: what cannot be is said when it is set, and what files hold is clamped with a warning."""

from __future__ import annotations

import json
from base64 import b64encode
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import luxel
from luxel import Camera, Light, LuxelError, Material, Mesh, Object, SceneData, Sky, Texture
from luxel.scene.device import upload
from luxel.scene.library.shapes import quad
from luxel.scene.records import clamping
from luxel.scene.rules import RULES

NAN, INF = float("nan"), float("inf")
PIXELS = np.zeros((2, 2, 3), np.uint8)

BAD: tuple[tuple[type, dict[str, Any], str], ...] = (
    (Light, {"kind": "area", "color": (1, 1, 1)}, "kind 'area' cannot be: give one of directional, point, spot"),
    (Light, {"kind": "point", "color": (-1, 0, 0)}, "three finite numbers of 0 or more"),
    (Light, {"kind": "point", "color": (1, INF, 0)}, "three finite numbers of 0 or more"),
    (Light, {"kind": "point", "color": (1, 1)}, "three finite numbers"),
    (Light, {"kind": "point", "color": "red"}, "three finite numbers"),
    (Light, {"kind": "point", "color": 3.0}, "three finite numbers"),
    (Light, {"kind": "point", "color": (1, 1, 1), "position": (0, NAN, 0)}, "three finite numbers"),
    (Light, {"kind": "spot", "color": (1, 1, 1), "cos_outer": 1.5}, "from -1 to 1"),
    (Light, {"kind": "point", "color": (1, 1, 1), "range": 0.0}, "above 0"),
    (Light, {"kind": "point", "color": (1, 1, 1), "range": NAN}, "above 0"),
    (Material, {"base_color": (2, 2, 2)}, r"base_color \(2, 2, 2\) cannot be: give three numbers from 0 to 1"),
    (Material, {"base_color": (0.5, -0.1, 0.5)}, "from 0 to 1"),
    (Material, {"base_color": (NAN, 0, 0)}, "from 0 to 1"),
    (Material, {"emission": (0, 0, -1)}, "0 or more"),
    (Material, {"emission": (0, 0, NAN)}, "0 or more"),
    (Material, {"roughness": -0.1}, "from 0 to 1"),
    (Material, {"metallic": "shiny"}, "from 0 to 1"),
    (Material, {"alpha": 2.0}, "from 0 to 1"),
    (Material, {"alpha_mode": "glass"}, "one of opaque, mask, blend"),
    (Material, {"emission_texture": PIXELS}, "luxel.Texture"),
    (Material, {"reflect_back": "no"}, "True or False"),
    (Light, {"kind": "point", "color": (1, 1, 1), "motion": np.eye(4)}, "a function of the time"),
    (Light, {"kind": "spot", "color": (1, 1, 1), "spot_falloff": "sharp"}, "squared-cosine, linear-angle"),
    (Texture, {"image": np.zeros((4, 4, 2))}, "C in 1, 3, 4"),
    (Texture, {"image": np.zeros((0, 4, 3))}, "C in 1, 3, 4"),
    (Texture, {"image": "wall.png"}, "C in 1, 3, 4"),
    (Texture, {"image": PIXELS, "wrap_u": "tile"}, "repeat, clamp, mirror"),
    (Texture, {"image": PIXELS, "uv_set": 2}, "0 or 1"),
    (Texture, {"image": PIXELS, "transform": np.eye(2)}, "3x3"),
    (Camera, {"fov": 180.0}, "below 180"),
    (Camera, {"fov": 0.0}, "above 0"),
    (Camera, {"eye": (0, 0)}, "three finite numbers"),
    (Camera, {"orthographic_width": -1.0}, "0 or more"),
    (Sky, {"color": (-1, 0, 0)}, "from 0 to"),
    (Sky, {"image": np.zeros((2, 4), np.float32)}, r"\(H, W, 3\)"),
    (Sky, {"rotation": INF}, "finite"),
    (Object, {"name": "box", "meshes": [], "to_world": np.eye(3)}, "object 'box': to_world .* give a 4x4 matrix"),
    (Mesh, {"positions": np.zeros(9), "faces": np.zeros((1, 3))}, r"\(V, 3\)"),
    (Mesh, {"positions": np.zeros((3, 3)), "faces": np.zeros((1, 4, 3))}, r"\(F, 3\)"),
    (Mesh, {"positions": np.zeros((3, 3)), "faces": np.zeros((1, 3)), "material": -1}, "from 0"),
    (Mesh, {"positions": np.zeros((3, 3)), "faces": np.zeros((1, 3)), "uv": np.zeros(3)}, r"\(V, 2\) or None"),
)


@pytest.mark.parametrize(("kind", "fields", "words"), BAD)
def test_a_value_that_cannot_be_is_said_when_it_is_set(kind: Any, fields: dict[str, Any], words: str) -> None:
    with pytest.raises(LuxelError, match=words) as raised:
        kind(**fields)
    assert "\n" not in str(raised.value)


def test_every_field_of_words_or_light_has_a_rule() -> None:
    """A field that comes later is not forgotten: one of some words takes no other, one of a colour no NaN."""
    for kind in (Texture, Material, Mesh, Object, Light, Camera, Sky):
        for item in fields(kind):
            if any(word in str(item.type) for word in ("Literal", "Colour", "bool", "Callable", "float")):
                assert item.name in RULES[kind.__name__], f"{kind.__name__}.{item.name}"
                assert set(RULES[kind.__name__]) <= {each.name for each in fields(kind)}


def test_an_assignment_is_checked_as_a_construction_is() -> None:
    material = Material("paint")
    with pytest.raises(LuxelError, match="material 'paint': base_color"):
        material.base_color = (2.0, 0.0, 0.0)
    assert material.base_color == (0.8, 0.8, 0.8)
    material.base_color = [0.1, 0.2, 0.3]  # type: ignore[assignment]
    assert material.base_color == (0.1, 0.2, 0.3)
    material.emission = np.array((1, 2, 3))  # type: ignore[assignment]
    assert material.emission == (1.0, 2.0, 3.0)


def test_numbers_of_numpy_are_numbers() -> None:
    light = Light("point", (np.float32(0.5), np.float16(2.0), 3), range=np.float32(4.0))  # type: ignore[arg-type]
    assert light.color == (0.5, 2.0, 3.0) and light.range == 4.0
    assert Sky(rotation=np.float16(3.0)).rotation == 3.0  # type: ignore[arg-type]
    with pytest.raises(LuxelError, match="from 0 to 1"):
        Material(roughness=np.float32(1.5))  # type: ignore[arg-type]


def make(**changes: Any) -> SceneData:
    mesh = quad((-1, 0, 1), (1, 0, 1), (1, 0, -1), (-1, 0, -1), 0)
    for name, value in changes.items():
        setattr(mesh, name, value)
    return SceneData("plate", [Object("plate", [mesh])], [Material()])


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (make(material=3), "object 'plate', mesh 0: material 3 is out of range: the scene has materials 0 to 0"),
        (
            SceneData("metal", [], [Material("gold", metallic=1.0, k=(1.0, 2.0, 3.0))]),
            "material 'gold' has k without eta",
        ),
        (make(faces=np.array([[0, 1, 9]])), "vertex 9, which is out of range: the mesh has 4 vertices"),
        (make(faces=np.array([[0, -1, 2]])), "vertex -1"),
        (make(uv=np.zeros((3, 2))), "uv has 3 rows for 4 vertices"),
        (make(normals=np.zeros((5, 3))), "normals has 5 rows for 4 vertices"),
    ],
)
def test_what_does_not_fit_together_is_said_at_upload(data: SceneData, words: str) -> None:
    with pytest.raises(LuxelError, match=words):
        upload(data)


def test_a_scene_is_checked_as_a_whole() -> None:
    for change, words in (
        (lambda data: data.lights.append(Light("spot", (1, 1, 1), direction=(0, 0, 0))), "direction"),
        (lambda data: setattr(data.sky, "image", np.full((2, 4, 3), NAN)), "NaN or infinite"),
        (lambda data: setattr(data.sky, "image", np.full((2, 4, 3), -1.0)), "negative"),
        (lambda data: setattr(data.objects[0], "to_world", np.full((4, 4), NAN)), "'plate' has a matrix"),
        (lambda data: data.materials.clear(), "the scene has no material"),
    ):
        data = make()
        change(data)
        with pytest.raises(LuxelError, match=words):
            upload(data)


# ----------------------------------------------------------------------------------- files


def test_a_reader_clamps_and_says_so() -> None:
    with clamping() as notes:
        material = Material("paint", base_color=(1.5, NAN, -0.5), emission=(-1.0, 2.0, 3.0), roughness=7.0, alpha=NAN)
        Material("paint", base_color=(1.5, NAN, -0.5))
        light = Light("point", (INF, 1.0, -2.0), range=0.0)
        with pytest.raises(LuxelError, match="kind 'area'"):
            Light("area", (1.0, 1.0, 1.0))  # type: ignore[arg-type]
    assert material.base_color == pytest.approx((1.0, 0.0, 0.0), abs=1e-5)
    assert (material.emission, material.alpha) == ((0.0, 2.0, 3.0), 1.0)
    assert material.roughness == pytest.approx(1.0, abs=1e-5)
    assert light.color[1:] == (1.0, 0.0) and np.isfinite(light.color[0]) and light.range == INF
    assert sum("base_color" in note for note in notes) == 1
    assert all(note.endswith(".") and note[0].isupper() for note in notes)
    with pytest.raises(LuxelError, match="from 0 to 1"):
        Material(base_color=(1.5, 0.0, 0.0))


def test_a_file_with_an_albedo_of_two_loads_with_a_warning(tmp_path: Path) -> None:
    corners = np.array([(0, 0, 0), (1, 0, 0), (0, 0, -1)], np.float32).tobytes()
    file = tmp_path / "bright.gltf"
    file.write_text(json.dumps({
        "asset": {"version": "2.0"},
        "buffers": [{"uri": f"data:;base64,{b64encode(corners).decode()}", "byteLength": 36}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "materials": [
            {"name": "paint", "pbrMetallicRoughness": {"baseColorFactor": [2, 0.5, 0.5, 1], "metallicFactor": 0}}
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}],
        "nodes": [{"mesh": 0}], "scenes": [{"nodes": [0]}], "scene": 0,
    }))  # fmt: skip
    data = luxel.load(file)
    (paint,) = [material for material in data.materials if material.base_color[1] == pytest.approx(0.5)]
    assert paint.base_color[0] == pytest.approx(1.0, abs=1e-5)
    assert any("base" in warning.lower() or "paint" in warning for warning in data.warnings), data.warnings
