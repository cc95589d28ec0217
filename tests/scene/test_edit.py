"""Overrides: cameras, sun, sky, environment map, bounds."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

from luxel.errors import LuxelError
from luxel.render.renderer import Renderer
from luxel.render.truth import render_truth
from luxel.scene import load
from luxel.scene.edit import apply_envmap, apply_sky, apply_sun, default_camera, parse_camera, scene_bounds
from luxel.scene.library.shapes import box, translation
from luxel.scene.model import Camera, Light, Material, Mesh, Object, SceneData


def scene(*, inward: bool = False) -> SceneData:
    return SceneData("test", [Object("box", [box((0, 0, 0), (8, 3, 4), 0, inward=inward)])], [Material()])


def message_of(call: Callable[..., object], *arguments: object) -> str:
    with pytest.raises(LuxelError) as caught:
        call(*arguments)
    assert "\n" not in str(caught.value) and str(caught.value).endswith(".")
    return str(caught.value)


def test_parse_camera_by_name_and_by_numbers() -> None:
    data = load("two-rooms")
    assert parse_camera("dark", data) is data.cameras[1]
    camera = parse_camera("-9,2,0;5,2.5,0;65", data)
    assert camera.eye == (-9.0, 2.0, 0.0) and camera.target == (5.0, 2.5, 0.0) and camera.fov == 65.0
    assert parse_camera("0,1,2;3,4,5", data).fov == 60.0
    assert parse_camera("0,5,0;0,0,0", data).up == (0.0, 0.0, -1.0)


def test_a_camera_answers_to_another_letter_case_where_one_fits() -> None:
    data = scene()
    data.cameras = [Camera(name=name) for name in ("Main", "Über", "door", "Door", "DOOR")]
    assert parse_camera("main", data) is data.cameras[0]
    assert parse_camera(" MAIN ", data) is data.cameras[0]
    assert parse_camera("über", data) is data.cameras[1]
    assert [parse_camera(name, data) for name in ("door", "Door", "DOOR")] == data.cameras[2:]
    assert "3 cameras" in message_of(parse_camera, "dOOR", data)
    assert "'door', 'Door', 'DOOR'" in message_of(parse_camera, "dOOR", data)
    assert "has no camera 'mai'" in message_of(parse_camera, "mai", data)


def test_parse_camera_says_what_is_wrong() -> None:
    data = load("two-rooms")
    assert "'default', 'dark'" in message_of(parse_camera, "kitchen", data)
    for text in ("1,2;3,4,5", "1,2,3;x,y,z", "1,2,3;4,5,6;7;8", "1,2,nan;4,5,6"):
        assert "is not a camera" in message_of(parse_camera, text, data)
    assert "field of view" in message_of(parse_camera, "0,0,0;1,0,0;180", data)
    assert "looks nowhere" in message_of(parse_camera, "1,1,1;1,1,1", data)


@pytest.mark.parametrize(
    ("text", "to_sun"),
    [
        ("0,0", (0, 0, 1)),
        ("90,0", (1, 0, 0)),
        ("12,90", (0, 1, 0)),
        ("180,45", (0, math.sqrt(0.5), -math.sqrt(0.5))),
    ],
)
def test_sun_stands_where_azimuth_and_elevation_say(text: str, to_sun: tuple[float, float, float]) -> None:
    data = apply_sun(load("cornell-box"), text)
    assert np.allclose(data.lights[0].direction, np.negative(to_sun), atol=1e-12)
    assert np.allclose(data.lights[0].color, (10.0, 9.3, 8.2))


def test_sun_replaces_directional_lights_only() -> None:
    data = scene()
    data.lights = [Light("directional", (1.0, 1.0, 1.0)), Light("point", (2.0, 2.0, 2.0))]
    apply_sun(data, "10,20,5")
    assert [light.kind for light in data.lights] == ["point", "directional"]
    assert np.allclose(data.lights[1].color, (5.0, 4.65, 4.1))
    assert "is not a sun" in message_of(apply_sun, data, "10")
    assert "is not a sun" in message_of(apply_sun, data, "10,high")
    assert "elevation must lie between -90 and 90 degrees, not 95" in message_of(apply_sun, data, "10,95")
    # Turns do not matter, up to where the angle would be rounding alone.
    far = apply_sun(data, f"{360 * 2777 + 10},20,5").lights[1].direction
    assert np.allclose(far, apply_sun(data, "10,20,5").lights[1].direction, atol=1e-9)
    for text in ("1e30", "-1000001"):
        assert "azimuth must lie between -1e+06 and 1e+06 degrees" in message_of(apply_sun, data, f"{text},20")
    assert "strength must lie between 0 and 1e+09 W/m^2, not -1" in message_of(apply_sun, data, "10,20,-1")
    assert apply_sun(data, "10,20,5,90").lights[1].angular_diameter == 90.0
    for text in ("10,20,5,90.1", "10,20,5,-1"):
        assert "diameter" in message_of(apply_sun, data, text)


def test_sky_none_grey_colour() -> None:
    data = load("atrium")
    assert apply_sky(data, "none").sky.color == (0.0, 0.0, 0.0)
    assert apply_sky(data, "0.5").sky.color == (0.5, 0.5, 0.5)
    assert apply_sky(data, "1,2,3").sky.color == (1.0, 2.0, 3.0)
    assert "is not a sky" in message_of(apply_sky, data, "1,2")
    assert "is not a sky" in message_of(apply_sky, data, "blue")
    assert "between 0 and 1e+09" in message_of(apply_sky, data, "-1")
    assert "between 0 and 1e+09" in message_of(apply_sky, data, "1,1,1.1e9")
    assert apply_sky(data, "1e9").sky.color == (1e9, 1e9, 1e9)


def test_envmap_reads_exr_linearly_and_png_as_srgb(tmp_path: Path) -> None:
    pixels = np.random.default_rng(1).random((4, 8, 3)).astype(np.float32) * 5
    mi.Bitmap(pixels).write(str(tmp_path / "sky.exr"))
    data = apply_envmap(scene(), tmp_path / "sky.exr")
    assert data.sky.image is not None and np.allclose(data.sky.image, pixels, rtol=2e-3)
    mi.Bitmap(np.full((2, 4, 3), 188, np.uint8)).write(str(tmp_path / "sky.png"))
    data = apply_envmap(scene(), tmp_path / "sky.png")
    assert data.sky.image is not None and np.allclose(data.sky.image, 0.5, atol=0.01)


def written(folder: Path, pixels: np.ndarray) -> Path:
    mi.Bitmap(pixels.astype(np.float32)).write(str(folder / "sky.exr"))
    return folder / "sky.exr"


@pytest.mark.parametrize("value", [np.inf, np.nan, -np.inf])
def test_broken_sky_pixels_take_the_mean_around_them(tmp_path: Path, value: float) -> None:
    pixels = np.random.default_rng(3).random((6, 8, 3)).astype(np.float32) + 0.5
    broken = pixels.copy()
    broken[2, 3, 1] = broken[5, 0] = value
    data = apply_envmap(scene(), written(tmp_path, broken))
    around = pixels[1:4, 2:5].reshape(9, 3)[[0, 1, 2, 3, 5, 6, 7, 8]]
    # At the corner: five neighbours, three of them across the edge of the picture or above.
    corner = np.stack([pixels[4, 7], pixels[4, 0], pixels[4, 1], pixels[5, 7], pixels[5, 1]])
    assert data.sky.image is not None
    np.testing.assert_allclose(data.sky.image[2, 3], around.mean(axis=0), rtol=2e-3)
    np.testing.assert_allclose(data.sky.image[5, 0], corner.mean(axis=0), rtol=2e-3)
    untouched = np.isfinite(broken).all(axis=2)
    np.testing.assert_allclose(data.sky.image[untouched], pixels[untouched], rtol=2e-3)
    assert len(data.warnings) == 1 and "2 pixel(s) of NaN or infinity" in data.warnings[0]


def test_large_holes_in_a_sky_are_filled(tmp_path: Path) -> None:
    pixels = np.full((64, 128, 3), 2.0, np.float32)
    pixels[32:, 10:] = np.nan
    data = apply_envmap(scene(), written(tmp_path, pixels))
    assert data.sky.image is not None and (data.sky.image == 2.0).all()


def test_negative_sky_pixels_are_dark_and_named(tmp_path: Path) -> None:
    pixels = np.ones((4, 8, 3), np.float32)
    pixels[1, 2] = (-1.0, 3.0, 2.0)
    data = apply_envmap(scene(), written(tmp_path, pixels))
    assert data.sky.image is not None and data.sky.image[1, 2].tolist() == [0.0, 3.0, 2.0]
    assert len(data.warnings) == 1 and "1 pixel(s) below zero" in data.warnings[0]


@pytest.mark.parametrize(
    ("value", "words"),
    [(np.nan, "no pixel that is a finite number"), (np.inf, "no pixel that is a finite number"),
     (0.0, "no pixel above zero"), (-2.0, "no pixel above zero")],
)  # fmt: skip
def test_skies_without_light_are_refused(tmp_path: Path, value: float, words: str) -> None:
    assert words in message_of(apply_envmap, scene(), written(tmp_path, np.full((4, 8, 3), value)))


def test_envmap_that_cannot_be_read(tmp_path: Path) -> None:
    assert "There is no environment map" in message_of(apply_envmap, scene(), tmp_path / "none.exr")
    assert "is a folder" in message_of(apply_envmap, scene(), tmp_path)
    (tmp_path / "broken.exr").write_bytes(b"not an image")
    assert "cannot be read as an image" in message_of(apply_envmap, scene(), tmp_path / "broken.exr")


def test_default_camera_is_the_files_first() -> None:
    data = scene()
    data.cameras = [Camera(name="first"), Camera(name="second")]
    assert default_camera(data).name == "first"


def test_default_camera_stands_in_rooms_and_in_front_of_objects() -> None:
    room = default_camera(scene(inward=True))
    assert 0 < room.eye[0] < 1 and room.eye[1] == pytest.approx(1.2) and room.target[0] == 8.0
    thing = default_camera(scene())
    assert np.allclose(thing.target, (4.0, 1.5, 2.0)) and thing.eye[0] > 8.0 and thing.eye[1] > 3.0


@pytest.mark.parametrize("aspect", [0.25, 1.0, 16 / 9, 6.0])
@pytest.mark.parametrize("size", [(8.0, 3.0, 4.0), (0.01, 5.0, 0.01), (30.0, 0.0, 30.0), (1e-4, 1e-4, 1e-4)])
def test_default_camera_holds_the_whole_thing_in_any_picture(size: tuple[float, ...], aspect: float) -> None:
    """By the tangents of a pinhole: all corners lie in the picture, and its narrower side is used."""
    thing = box((0, 0, 0), (size[0], max(size[1], 1e-6), size[2]), 0)
    camera = default_camera(SceneData("thing", [Object("box", [thing])], [Material()]), aspect)
    forward = np.subtract(camera.target, camera.eye) / np.linalg.norm(np.subtract(camera.target, camera.eye))
    right = np.cross(forward, (0.0, 1.0, 0.0)) / np.linalg.norm(np.cross(forward, (0.0, 1.0, 0.0)))
    away = np.asarray(thing.positions, np.float64) - camera.eye
    half = math.tan(math.radians(camera.fov / 2))
    x = away @ right / (away @ forward) / half
    y = away @ np.cross(right, forward) / (away @ forward) / (half / aspect)
    widest = max(np.abs(x).max(), np.abs(y).max())
    assert (away @ forward > 0.0).all() and widest < 1.0
    assert widest > 0.9 or max(size) < 1e-3


@pytest.mark.parametrize("size", [(192, 48), (96, 54), (48, 48), (48, 192)])
def test_pictures_without_a_camera_show_the_whole_thing(size: tuple[int, int]) -> None:
    """No border of the picture, nor of the truth, shows a part of it; its middle does."""
    renderer = Renderer(scene(), "none", size=size)
    renderer.step()
    for hit in (renderer.layers().hit, render_truth(scene(), size=size, spp=2, cache=False).layers.hit):
        edges = np.concatenate([hit[0], hit[-1], hit[:, 0], hit[:, -1]])
        assert not edges.any() and hit[size[1] // 2, size[0] // 2]


def test_default_camera_stays_out_of_a_buildings_walls() -> None:
    """Between the outer shell and the inner wall there is a dark gap, as in Sponza: the view starts inside."""
    data = scene(inward=True)
    inner = box((3, 0.1, 0.5), (5, 2.9, 3.5), 0, inward=True, sides=("-x",))
    data.objects.append(Object("inner wall", [inner]))
    camera = default_camera(data)
    assert 3.0 < camera.eye[0] < 3.3 and camera.target[0] == 8.0


def test_bounds_follow_motion_and_deformation() -> None:
    data = SceneData("m", [Object("box", [box((0, 0, 0), (1, 1, 1), 0)])], [Material()], duration=2.0)
    data.objects[0].motion = lambda time: translation(3 * time, 0, 0)
    low, high = scene_bounds(data)
    assert np.allclose(low, 0) and np.allclose(high, (7, 1, 1))
    low, high = scene_bounds(data, times=(1.0,))
    assert np.allclose(low, (3, 0, 0)) and np.allclose(high, (4, 1, 1))
    positions = data.objects[0].meshes[0].positions
    data.objects[0].motion = None
    data.objects[0].deform = lambda time: [(positions * (1 + time), None)]
    assert np.allclose(scene_bounds(data)[1], 3.0)
    assert "no triangles" in message_of(scene_bounds, SceneData("nothing", [], []))


# --- the default camera among strays, domes and grounds -------------------------------------------------------------


def plain_room() -> np.ndarray:
    """Return the triangles (12, 3, 3) of a room of 4 by 3 by 6 m that face inwards."""
    x, y, z = np.array([-2.0, 2.0]), np.array([0.0, 3.0]), np.array([-3.0, 3.0])
    p = np.array([[x[i >> 2], y[i >> 1 & 1], z[i & 1]] for i in range(8)])
    sides = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5))
    inwards = [p[list(side)] for side in sides]
    return np.concatenate([[quad[[0, 1, 2]], quad[[0, 2, 3]]] for quad in inwards])


def as_scene(*parts: np.ndarray) -> SceneData:
    meshes = [
        Mesh(part.reshape(-1, 3).astype(np.float32), np.arange(3 * len(part), dtype=np.uint32).reshape(-1, 3))
        for part in parts
    ]
    return SceneData("test", [Object("all", meshes)], [Material()])


FAR_TRIANGLE = np.array([[[900.0, 0.0, 0.0], [901.0, 0.0, 0.0], [900.0, 1.0, 0.0]]])
GROUND = 1000.0 * np.array([[[-1, 0, -1], [1, 0, 1], [1, 0, -1]], [[-1, 0, -1], [-1, 0, 1], [1, 0, 1]]]) - (0, 0.01, 0)


@pytest.mark.parametrize("outside", [FAR_TRIANGLE, GROUND, np.concatenate([FAR_TRIANGLE, GROUND])])
def test_default_camera_is_in_the_room_whatever_lies_outside(outside: np.ndarray) -> None:
    camera = default_camera(as_scene(plain_room(), outside))
    assert (np.abs(camera.eye) < (2.0, 3.0, 3.0)).all() and camera.eye[1] > 0.0
    assert np.allclose(camera.eye, default_camera(as_scene(plain_room())).eye, atol=0.1)


def test_default_camera_frames_a_thing_on_a_wide_ground() -> None:
    """The block is seen from without, and fills a good part of the picture: no speck in the middle of 2 km."""
    block = plain_room()[:, ::-1]
    camera = default_camera(as_scene(block, GROUND))
    assert 5.0 < np.linalg.norm(np.array(camera.eye) - (0.0, 1.5, 0.0)) < 30.0
