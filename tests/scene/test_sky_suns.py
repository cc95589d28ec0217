"""Suns are cut out of sky images: what counts as one, that no light is lost, and that it shines where it stood."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

import luxel
from luxel import runtime
from luxel.scene import live
from luxel.scene.device import upload
from luxel.scene.digest import hash_scene
from luxel.scene.edit import apply_envmap, apply_sky, apply_sun
from luxel.scene.library.shapes import box
from luxel.scene.model import Light, Material, Object, SceneData, Sky
from luxel.scene.sky_suns import part_suns, sky_lights

HEIGHT, WIDTH = 256, 512
TINT = np.array([1.0, 0.8, 0.5], np.float32)


@pytest.fixture(autouse=True)
def started() -> None:
    runtime.start()


def scene(**fields: Any) -> SceneData:
    return SceneData("test", [Object("box", [box((0, 0, 0), (8, 3, 4), 0)])], [Material()], **fields)


def grid(height: int = HEIGHT) -> tuple[np.ndarray, np.ndarray]:
    """Return the direction (H, W, 3) and the solid angle (H, 1) of each pixel, as `Sky` describes them."""
    edges = np.linspace(0.0, np.pi, height + 1)
    theta = (edges[1:] + edges[:-1])[:, None] / 2
    phi = ((np.arange(2 * height) + 0.5) / (2 * height) - 0.5)[None] * 2 * np.pi
    x, y, z = np.broadcast_arrays(np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi))
    return np.stack([x, y, z], axis=-1), ((np.cos(edges[:-1]) - np.cos(edges[1:])) * np.pi / height)[:, None]


def grey(level: float = 0.5) -> np.ndarray:
    return np.full((HEIGHT, WIDTH, 3), level, np.float32)


def pixels(*places: tuple[int, int], level: float = 0.5) -> np.ndarray:
    image = grey(level)
    for row, column in places:
        image[row, column] = 2e4 * TINT
    return image


def near(direction: np.ndarray, degrees: float, value: float, level: float = 0.5) -> np.ndarray:
    """A round sun of so many degrees across."""
    towards, _ = grid()
    image = grey(level)
    image[np.linalg.norm(towards - direction / np.linalg.norm(direction), axis=2) < math.radians(degrees / 2)] = value
    return image


SUNS = {
    "one pixel": (pixels((60, 100)), 1),
    "two pixels": (pixels((60, 100), (60, 101)), 1),
    "corners that touch": (pixels((60, 100), (61, 101)), 1),
    "across the seam": (pixels((60, 0), (60, WIDTH - 1), (61, WIDTH - 1)), 1),
    "across the seam by a corner": (pixels((60, 0), (61, WIDTH - 1)), 1),
    "at the zenith": (pixels((0, 10), (0, 200), (1, 201)), 1),
    "at the nadir": (pixels((HEIGHT - 1, 10), (HEIGHT - 1, 266)), 1),
    "round, 4 degrees": (near(np.array([0.3, 0.5, 0.7]), 3.9, 900.0), 1),
    "beside the zenith": (near(np.array([0.02, 1.0, 0.01]), 3.9, 900.0), 1),
    "two suns": (pixels((60, 100), (90, 400)), 2),
    "six suns": (pixels((60, 100), (90, 400), (30, 30), (120, 120), (100, 300), (70, 200)), 4),
    "before black": (pixels((60, 100), level=0.0), 1),
    "before half a black sky": (np.where(np.arange(HEIGHT)[:, None, None] < 128, pixels((60, 100)), 0.0), 1),
    "a window": (near(np.array([0.3, 0.5, 0.7]), 9.0, 900.0), 0),
    "a window before black": (near(np.array([0.3, 0.5, 0.7]), 9.0, 900.0, level=0.0), 0),
    "not so bright": (near(np.array([0.3, 0.5, 0.7]), 3.0, 20.0), 0),
    "all one value": (grey(3.0), 0),
    "all black": (grey(0.0), 0),
}


@pytest.mark.parametrize(("image", "count"), SUNS.values(), ids=SUNS.keys())
def test_no_light_is_lost_and_it_comes_from_where_it_stood(image: np.ndarray, count: int) -> None:
    image = image.astype(np.float32)
    sky = part_suns(Sky((1.0, 1.0, 1.0), image))
    assert sky.image is not None and sky.suns is not None and len(sky.suns) == count
    if not count:
        assert sky.image is image
        return
    towards, solid_angle = grid()
    gone = (image.astype(float) - sky.image) * solid_angle[..., None]
    assert gone.min() >= 0.0
    # Small suns: the irradiance on a plane that faces one is its flux.
    brought = np.sum([sun.color for sun in sky.suns], axis=0)
    np.testing.assert_allclose(brought, gone.sum(axis=(0, 1)), rtol=1e-3)
    # What is filled is as its rim, and what was left alone is as it was.
    held = gone.max(axis=2) == 0.0
    assert np.array_equal(sky.image[held], image[held])
    if count < 4:
        assert sky.image.max() <= 0.5
    for sun in sky.suns:
        assert sun.kind == "directional" and sun.in_sky
        mine = np.linalg.norm(towards + np.array(sun.direction), axis=2) < math.radians(4.0)
        power = np.where(mine, gone.sum(axis=2), 0.0)
        middle = (towards * power[..., None]).sum(axis=(0, 1))
        assert np.linalg.norm(middle / np.linalg.norm(middle) + sun.direction) < math.pi / HEIGHT, "within a pixel"
        # All these are of one radiance, so the disc covers what the pixels do.
        disc = 2 * math.pi * (1 - math.cos(math.radians(sun.angular_diameter / 2)))
        assert disc == pytest.approx(np.broadcast_to(solid_angle, mine.shape)[mine & (power > 0)].sum(), rel=1e-3)


def test_the_brightest_four_of_many_are_cut() -> None:
    image, places = grey(0.01), [(40 + 17 * i, 30 + 41 * i) for i in range(10)]
    for number, (row, column) in enumerate(places):
        image[row, column] = 10.0 * (number + 1) / grid()[1][row, 0] * 1e-3
    sky = part_suns(Sky((1.0, 1.0, 1.0), image))
    assert sky.image is not None
    cut = [number for number, place in enumerate(places) if sky.image[place][0] < 1.0]
    assert cut == [6, 7, 8, 9] and len(sky.suns or ()) == 4
    assert [light.name for light in sky.suns or ()] == ["sky-sun", "sky-sun-2", "sky-sun-3", "sky-sun-4"]
    assert part_suns(sky) is sky, "once is enough"


def test_glints_beside_a_sun_are_not_worth_a_lamp() -> None:
    image = 20.0 * pixels((60, 100), level=0.025)
    image[90, 300] = 30.0
    sky = part_suns(Sky((1.0, 1.0, 1.0), image))
    assert sky.image is not None and len(sky.suns or ()) == 1 and sky.image[90, 300, 0] == 30.0


def test_a_sun_in_a_wide_glow_is_cut_and_the_glow_stays() -> None:
    towards, solid_angle = grid()
    apart = np.linalg.norm(towards - np.array([0.3, 0.5, 0.7]) / np.linalg.norm([0.3, 0.5, 0.7]), axis=2)
    glow = 0.5 + 400.0 * np.exp(-np.degrees(apart) / 4.0)
    inside = apart < math.radians(1.0)
    image = (glow + np.where(inside, 1e5, 0.0)).astype(np.float32)[..., None] * TINT
    sky = part_suns(Sky((1.0, 1.0, 1.0), image))
    assert sky.suns is not None
    (sun,) = sky.suns
    assert sun.color[0] == pytest.approx(1e5 * float((solid_angle * inside).sum()), rel=0.01)
    assert sun.angular_diameter == pytest.approx(2.0, rel=0.1)
    assert sky.image is not None and 300.0 < sky.image.max() < 500.0


def test_uneven_windows_and_soft_blobs_stay() -> None:
    towards, _ = grid()
    apart = np.linalg.norm(towards - np.array([0.6, 0.0, 0.8]), axis=2)
    rough = np.random.default_rng(5).uniform(0.6, 1.4, (HEIGHT, WIDTH))
    for image in (np.where(apart < 0.3, 300.0 * rough, 0.5), 0.5 + 900.0 * np.exp(-((apart / 0.1) ** 2))):
        sky = part_suns(Sky((1.0, 1.0, 1.0), np.repeat(image[..., None], 3, axis=2).astype(np.float32)))
        assert sky.suns == []


def test_suns_turn_with_the_sky_and_take_its_colour() -> None:
    sky = part_suns(Sky((1.0, 1.0, 1.0), pixels((128, WIDTH // 2))))
    (plain,) = sky_lights(sky)
    np.testing.assert_allclose(plain.direction, (0.0, 0.0, 1.0), atol=0.01)
    sky.rotation, sky.color = 90.0, (2.0, 0.5, 0.0)
    (turned,) = sky_lights(sky)
    # Positive turns from -Z towards +X, so the light now travels along -X.
    np.testing.assert_allclose(turned.direction, (-1.0, 0.0, 0.0), atol=0.01)
    np.testing.assert_allclose(turned.color, np.multiply(plain.color, (2.0, 0.5, 0.0)))


def test_every_way_a_sky_comes_in(tmp_path: Path) -> None:
    image = pixels((60, 100))
    mi.Bitmap(image).write(str(tmp_path / "sky.exr"))
    by_file = apply_envmap(scene(), tmp_path / "sky.exr")
    by_hand = upload(scene(sky=Sky((1.0, 1.0, 1.0), image))).host.data
    edited = upload(scene(lights=[Light("point", (1.0, 1.0, 1.0))]))
    live.set_sky(edited, Sky((1.0, 1.0, 1.0), image))
    for data in (by_file, by_hand, edited.host.data):
        (sun,) = (light for light in data.lights if light.in_sky)
        assert data.sky.image is not None and data.sky.image.max() < 1.0
        assert sun.color == pytest.approx(by_hand.lights[0].color, rel=2e-3)


def test_another_sky_takes_the_suns_of_the_old_one() -> None:
    lamp = Light("point", (1.0, 1.0, 1.0))
    renderer = luxel.Renderer(scene(lights=[lamp]), "none", size=(16, 16))
    renderer.set_sky(image=pixels((60, 100), (90, 300)), color=(1.0, 1.0, 1.0))
    assert [light.in_sky for light in renderer.data.lights] == [False, True, True]
    renderer.set_sky(image=pixels((30, 300)))
    assert [light.in_sky for light in renderer.data.lights] == [False, True]
    before = renderer.data.lights[1]
    renderer.set_sky(color=(0.0, 0.0, 0.0))
    assert max(renderer.data.lights[1].color) == 0.0
    renderer.set_sky(color=(2.0, 2.0, 2.0), rotation=180.0)
    after = renderer.data.lights[1]
    np.testing.assert_allclose(after.color, np.multiply(before.color, 2.0))
    np.testing.assert_allclose(after.direction, np.multiply(before.direction, (-1, 1, -1)), atol=1e-9)
    renderer.set_sun(30.0, 40.0, 5.0, 2.0)
    assert [(light.kind, light.in_sky) for light in renderer.data.lights] == [
        ("point", False), ("directional", True), ("directional", False),
    ]  # fmt: skip
    other = luxel.Renderer(scene(), "none", size=(16, 16))
    other.set_sky(renderer.data.sky)
    assert [light.in_sky for light in other.data.lights] == [True], "a sky brings its suns along"
    renderer.set_sky(image=None, color=(1.0, 1.0, 1.0))
    assert not any(light.in_sky for light in renderer.data.lights)


def test_what_a_hand_changed_of_a_sky_s_sun_stays_when_the_sky_turns() -> None:
    renderer = luxel.Renderer(scene(sky=Sky((1.0, 1.0, 1.0), pixels((60, 100), (90, 300)))), "none", size=(16, 16))
    before = renderer.data.lights
    renderer.set_light("sky-sun", color=(3.0, 2.0, 1.0))
    renderer.remove_light("sky-sun-2")
    renderer.set_sky(rotation=180.0)
    (sun,) = renderer.data.lights
    assert sun.color == (3.0, 2.0, 1.0)
    np.testing.assert_allclose(sun.direction, np.multiply(before[0].direction, (-1, 1, -1)), atol=1e-9)
    renderer.set_sky(suns=[Light("directional", (5.0, 5.0, 5.0), in_sky=True)])
    assert [light.color for light in renderer.data.lights] == [(5.0, 5.0, 5.0)]


def test_a_new_sky_of_the_same_image_keeps_its_suns() -> None:
    """What a renderer holds has its suns cut out: a sky made of that image must not be without them."""
    renderer = luxel.Renderer(scene(sky=Sky((1.0, 1.0, 1.0), pixels((60, 100), (90, 300)))), "none", size=(16, 16))
    before = renderer.data.lights
    renderer.set_sky(Sky((2.0, 2.0, 2.0), renderer.data.sky.image, rotation=180.0))
    assert len(renderer.data.lights) == 2
    for sun, old in zip(renderer.data.lights, before, strict=True):
        np.testing.assert_allclose(sun.color, np.multiply(old.color, 2.0))
        np.testing.assert_allclose(sun.direction, np.multiply(old.direction, (-1, 1, -1)), atol=1e-9)


def test_suns_given_by_hand_belong_to_the_sky() -> None:
    renderer = luxel.Renderer(scene(), "none", size=(16, 16))
    for image in (grey(0.5), grey(0.2)):
        renderer.set_sky(Sky((1.0, 1.0, 1.0), image, suns=[Light("directional", (5.0, 5.0, 5.0))]))
        assert [(light.color, light.in_sky) for light in renderer.data.lights] == [((5.0, 5.0, 5.0), True)]


def test_a_file_s_suns_are_edited_one_by_one(tmp_path: Path) -> None:
    """A light that a hand changes in a loaded scene leaves what the sky knows of its suns as it was."""
    mi.Bitmap(pixels((60, 100))).write(str(tmp_path / "sky.exr"))
    (tmp_path / "scene.xml").write_text(
        """<scene version="3.0.0"><emitter type="envmap"><string name="filename" value="sky.exr"/></emitter>
        <shape type="rectangle"/></scene>"""
    )
    data = luxel.load(tmp_path / "scene.xml")
    data.lights[0].color = (3.0, 2.0, 1.0)
    renderer = luxel.Renderer(data, "none", size=(16, 16))
    renderer.set_sky(color=(0.5, 0.5, 0.5))
    assert renderer.data.lights[0].color == (3.0, 2.0, 1.0)


def test_the_suns_option_leaves_suns_of_the_sky(tmp_path: Path) -> None:
    mi.Bitmap(pixels((60, 100))).write(str(tmp_path / "sky.exr"))
    data = scene(lights=[Light("directional", (1.0, 1.0, 1.0), name="old")])
    apply_envmap(data, tmp_path / "sky.exr")
    apply_sun(data, "10,20,5,1.5")
    assert [light.name for light in data.lights] == ["sky-sun", "sun"]
    assert data.lights[1].angular_diameter == 1.5
    assert [light.name for light in apply_sky(data, "0.5").lights] == ["sun"]


def test_a_sun_s_size_is_part_of_a_scenes_name_in_caches() -> None:
    def key(**fields: Any) -> str:
        return hash_scene(scene(lights=[Light("directional", (1.0, 1.0, 1.0), **fields)]))

    assert len({key(), key(angular_diameter=1.0), key(angular_diameter=2.0), key(in_sky=True)}) == 4
    assert key() == key(angular_diameter=0.0, in_sky=False)
